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
# with nothing to find, a diagnosis scores every cause once and ends
_PLAIN = "\n".join(
    f"[plant.{effect}]\non = false"
    for effect in ("initiation_stage", "range_dependence", "direction_asymmetry", "creep",
                   "amplifier_lag", "resonance", "time_skew")
)


def main() -> None:
    """Plays, identifies and diagnoses a fraction of a second through every kernel."""
    from piezo_rig.cli import main as command
    from piezo_rig.resources import find

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        protocol = Path(folder) / "warm_up.toml"
        protocol.write_text(_PROTOCOL, encoding="utf-8")
        out, rig = str(Path(folder) / "model.json"), Path(folder) / "rig.toml"
        bench = find("configs", "simulated_bench").read_text(encoding="utf-8")
        rig.write_text(bench + _PLAIN, encoding="utf-8")
        status = command(["run", str(protocol), "--rig", str(rig), "--out", folder])
        for run in Path(folder).glob("*.h5"):
            words = ["identify", str(run), "--model", "range", "--elements", "8", "--out", out]
            status = status or command(words)
            status = status or command(["diagnose", str(run)])
        target = Path(folder) / "target.csv"
        target.write_text("time_s,displacement_um\n0,0\n0.01,0.1\n", encoding="utf-8")
        words = ["compensate", out, str(target), "--out", str(Path(folder) / "drive.csv")]
        status = status or command(words)
    if status:
        raise SystemExit("the program does not work on this machine; see the message above")
    write_bytecode(list(sys.modules.values()))


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
    main()
