"""Compiles the numeric kernels once, so that no later process waits for it.

``make`` runs this as the last step of the set-up; an installed wheel compiles
at its first use. What is compiled is kept beside the modules: the kernels', and
the bytecode of every module that was needed, which packages are installed
without. Where Python is told to write none, each command would read some
thousand sources again, which takes longer than many a command.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import py_compile
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

_PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "warm_up"
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [30, 50, 75]
frequency_hz = 10
cycles = 4
"""
_PLAIN = "\n".join(
    f"[plant.{effect}]\non = false"
    for effect in ("initiation_stage", "range_dependence", "direction_asymmetry", "creep",
                   "amplifier_lag", "resonance", "time_skew")
)


def main() -> None:
    """Plays, identifies and diagnoses a fraction of a second through every kernel.

    What a diagnosis needs is compiled in a second process meanwhile, by a recording of its own.
    """
    with tempfile.TemporaryDirectory() as folder:
        aside = subprocess.Popen([sys.executable, "-m", "piezo_rig.warm_up", folder])
        status = _play_and_identify(Path(folder))
        status = aside.wait() or status
    if status:
        raise SystemExit("the program does not work on this machine; see the message above")
    write_bytecode(list(sys.modules.values()))


def _play_and_identify(folder: Path) -> int:
    from piezo_rig.resources import find

    protocol, rig, model = folder / "warm_up.toml", folder / "rig.toml", folder / "model.json"
    protocol.write_text(_PROTOCOL, encoding="utf-8")
    bench = find("configs", "simulated_bench").read_text(encoding="utf-8")
    rig.write_text(bench + _PLAIN, encoding="utf-8")
    status = _command("run", protocol, "--rig", rig, "--out", folder)
    for run in folder.glob("*.h5"):
        shape = "--model", "range", "--elements", "8"
        status = status or _command("identify", run, *shape, "--out", model)
    target = folder / "target.csv"
    target.write_text("time_s,displacement_um\n0,0\n0.01,0.1\n", encoding="utf-8")
    return status or _command("compensate", model, target, "--out", folder / "drive.csv")


def _diagnose(folder: Path) -> int:
    """Triangles from rest, and a displacement with loops and noise, in a file of their own."""
    import numpy as np

    step = np.arange(8000)
    drive = np.repeat([40.0, 75.0], 4000) * (1.0 - np.abs(step % 500 - 250) / 250)
    seen = 0.08 * drive + np.random.default_rng(0).normal(0.0, 0.003, step.size)
    for limit in np.geomspace(0.5, 35.0, 12):
        behind = 0.0
        for k, v in enumerate(drive):
            behind = min(max(behind, v - limit), v + limit)
            seen[k] += 0.006 * behind
    path = folder / "recording.csv"
    np.savetxt(
        path, np.column_stack([step / 5000, drive, seen]), fmt="%.6f", delimiter=",",
        header="time_s,drive_v,displacement_um", comments="",
    )  # fmt: skip
    return _command("diagnose", path, "--history", "virgin")


def _command(*words: str | Path) -> int:
    """The exit status of a command; what it prints, but for errors, is not shown."""
    from piezo_rig.cli import main as command

    with contextlib.redirect_stdout(io.StringIO()):
        return command([str(word) for word in words])


def write_bytecode(modules: Iterable[ModuleType]) -> None:
    """Beside the source of every module, unless newer bytecode is there."""
    for module in modules:
        source = getattr(getattr(module, "__spec__", None), "origin", None)
        if not source or not source.endswith(".py"):
            continue
        kept = Path(importlib.util.cache_from_source(source))
        # not where it may not be written, and not of files that only look like modules
        with contextlib.suppress(OSError, py_compile.PyCompileError):
            if not kept.exists() or kept.stat().st_mtime < Path(source).stat().st_mtime:
                py_compile.compile(source, doraise=True)


if __name__ == "__main__":
    if sys.argv[1:]:
        code = _diagnose(Path(sys.argv[1]))
        write_bytecode(list(sys.modules.values()))
        raise SystemExit(code)
    main()
