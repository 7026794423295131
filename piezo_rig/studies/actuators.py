"""Five hundred simulated actuators, identified and diagnosed: docs/many-actuators.md.

    python -m piezo_rig.studies.actuators [--count N] [--folder DIR] [--out FILE]

Every actuator is a simulated bench with a stack of its own: its parameters are drawn around the
default's. Some are planted: their stack, sensor or file is not like the others. The files are
played through the real drivers and kept in the folder, as is what was measured: a study that was
stopped goes on.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import RealClock, VirtualClock
from piezo_rig.bench import open_bench
from piezo_rig.config import Rig, load_rig
from piezo_rig.config.toml_text import Document
from piezo_rig.fleet.outliers import LIMIT
from piezo_rig.fleet.page import Overview
from piezo_rig.fleet.table import NAME as TABLE
from piezo_rig.protocol import build_plan
from piezo_rig.protocol.protocol_file import Protocol, parse_protocol
from piezo_rig.runner import Wire, play
from piezo_rig.studies.document import fill, number, table

SEED = 20
MODEL = "classical"
SIZES = (50, 200, 500)
ORDINARY, ON_CLUSTER = 2, 100  # ordinary ones that are diagnosed besides the planted ones
PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "acceptance"
description = "three ranges from 0 V, 3 cycles, twice"
sample_rate = 2000
repeats = 2

[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [30, 50, 75]
frequency_hz = 4
cycles = 3
"""
# relative standard deviation of a stack's parameters from one actuator to the next
SPREAD = {
    ("stack", "reversible"): (0.098, 0.03), ("stack", "irreversible"): (0.00212, 0.04),
    ("stack", "edge"): (31.5, 0.02), ("initiation_stage", "size"): (-0.72, 0.05),
    ("range_dependence", "size"): (0.075, 0.05), ("creep", "rate_per_decade"): (0.025, 0.05),
}  # fmt: skip
# what is planted, and the settings of the plant that do it; None: the file is broken instead
PLANTED: dict[str, dict[str, dict[str, Any]] | None] = {
    "a cracked stack: 25 % less reversible strain": {"stack": {"reversible": 0.0735}},
    "twice as many pinned walls": {"stack": {"irreversible": 0.00424}},
    "no first-rise effect": {"initiation_stage": {"on": False}},
    "a sensor with 60 nm of noise": {"white_noise": {"rms": 60.0}},
    "mains hum of 60 nm": {"mains_hum": {"on": True, "amplitude": 60.0}},
    "a file cut in half": None,
    "an empty file": None,
}

# which findings are true
IN_THE_BENCH = {
    "creep": "yes", "range-dependence": "yes", "direction-asymmetry": "yes",
    "amplifier-lag": "yes", "initiation-stage": "all but one", "mains-hum": "one",
    "time-skew": "as amplifier-lag",
}  # fmt: skip
TEMPLATE = Path(__file__).with_name("actuators_template.md")


def actuator(index: int, kind: str, rig: Rig) -> Rig:
    """The bench of one actuator."""
    rng = np.random.default_rng([SEED, index])
    plant: dict[str, Any] = {"seed": index + 1}
    for (effect, name), (value, spread) in SPREAD.items():
        plant.setdefault(effect, {})[name] = value * (1.0 + spread * float(rng.standard_normal()))
    for effect, settings in (PLANTED.get(kind) or {}).items():
        plant[effect] = plant.get(effect, {}) | settings
    return replace(rig, plant=plant,
                   actuator=replace(rig.actuator, serial=f"SIM-{index:04d}"))  # fmt: skip


def kinds(count: int) -> list[str]:
    """What each actuator is: planted ones are spread over the first third."""
    found = [""] * count
    for i, kind in enumerate(PLANTED):
        found[2 + i * 3] = kind
    return found


def play_all(count: int, folder: Path) -> list[Path]:
    """The runs, played unless they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    rig = load_rig()
    protocol = parse_protocol(Document(PROTOCOL, "acceptance", "protocol"))
    paths = []
    for index, kind in enumerate(kinds(count)):
        path = folder / f"actuator_{index:04d}.h5"
        paths.append(path)
        if path.exists():
            continue
        draft = play_one(actuator(index, kind, rig), protocol, folder / "playing.h5")
        if kind == "a file cut in half":
            draft.write_bytes(draft.read_bytes()[: draft.stat().st_size // 2])
        elif kind == "an empty file":
            draft.write_bytes(b"")
        draft.replace(path)
        if index % 50 == 49:
            print(f"played {index + 1}", flush=True)
    return paths


def play_one(rig: Rig, protocol: Protocol, path: Path) -> Path:
    wire = Wire()
    with open_bench(rig, lambda question: True, wire, VirtualClock()) as bench:
        return play(build_plan(protocol, rig), bench, path, wire, lambda text: None)


@dataclass(frozen=True)
class Took:
    """What one call of the program took.

    ``cpu_s`` is of all processors together, ``peak_mb`` of the largest of its processes.
    """

    wall_s: float
    cpu_s: float
    peak_mb: float


def timed(words: Sequence[str]) -> Took:
    """Call the program in a process of its own."""
    begun = time.monotonic()
    process = subprocess.Popen([sys.executable, "-m", "piezo_rig", *words],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{words[0]} ended with {process.returncode}")
    return Took(time.monotonic() - begun, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def identified(paths: Sequence[Path], out: Path, *more: str) -> Took:
    """Identify all of them into a folder."""
    return timed(["identify", *map(str, paths), "--model", MODEL, "--out", f"{out}/", *more])


class Measured:
    """What was measured already, in a file, so that a study that was stopped goes on."""

    def __init__(self, path: Path) -> None:
        self.path = path
        said = json.loads(path.read_text()) if path.exists() else {}
        self.took = {name: Took(**values) for name, values in said.items()}

    def __call__(self, name: str, measure: Callable[[], Took]) -> Took:
        if name not in self.took:
            self.took[name] = measure()
            self.path.write_text(json.dumps({n: asdict(t) for n, t in self.took.items()}))
            print(name, self.took[name], flush=True)
        return self.took[name]


@contextlib.contextmanager
def cluster(port: int = 18787) -> Iterator[str]:
    """Scheduler and two workers, as a user would start them."""
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["worker", address, "--nthreads", "1", "--no-dashboard"]
    programs = [
        subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{words[0]}", *words[1:]],
                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for words in (scheduler, worker, worker)
    ]  # fmt: skip
    try:
        RealClock().sleep(6.0)
        yield address
    finally:
        for program in programs[::-1]:
            program.terminate()
            program.wait()


def rows_of(folder: Path) -> list[dict[str, Any]]:
    import pyarrow.parquet as pq

    found: list[dict[str, Any]] = pq.read_table(folder / TABLE).to_pylist()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument("--count", type=int, default=SIZES[-1])
    parser.add_argument("--folder", type=Path, default=Path("build/study-actuators"))
    parser.add_argument("--out", type=Path, default=Path("docs/many-actuators.md"))
    args = parser.parse_args()
    paths = play_all(args.count, args.folder / "runs")
    measured = Measured(args.folder / "measured.json")
    folder = {name: args.folder / name for name in ("models", "local", "cluster", "diagnoses")}

    def identify_afresh(count: int, out: Path, *more: str) -> Took:
        shutil.rmtree(out, ignore_errors=True)
        return identified(paths[:count], out, *more)

    def identify_on_cluster() -> Took:
        with cluster() as address:
            return identify_afresh(ON_CLUSTER, folder["cluster"], "--scheduler", address)

    took = {n: measured(f"{n} identified", partial(identify_afresh, n, folder["models"]))
            for n in sorted({min(s, args.count) for s in SIZES})}  # fmt: skip
    again = measured("again", lambda: identified(paths, folder["models"]))
    local = measured("local", lambda: identify_afresh(ON_CLUSTER, folder["local"]))
    remote = measured("cluster", identify_on_cluster)
    what = kinds(args.count)
    chosen = [p for p, kind in zip(paths, what, strict=True) if kind]
    chosen += [p for p, kind in zip(paths, what, strict=True) if not kind][:ORDINARY]
    dug = measured("diagnosed", lambda: timed(
        ["diagnose", *map(str, chosen), "--json", f"{folder['diagnoses']}/"]
    ))  # fmt: skip
    same = all((folder["cluster"] / p.name).read_bytes() == p.read_bytes()
               for p in folder["local"].glob("*_*.json"))  # fmt: skip
    rows, diagnosed = rows_of(folder["models"]), rows_of(folder["diagnoses"])
    planted, false = judged(rows, diagnosed)
    small, large = min(took), max(took)
    share = took[large].cpu_s / large / (took[small].cpu_s / small)
    one = next(row for row in rows if row["status"] == "done")
    args.out.write_text(fill(TEMPLATE.read_text(encoding="utf-8"), {
        "count": str(args.count), "sweeps": str(one["sweeps"]), "samples": str(one["samples"]),
        "planted_count": str(len(PLANTED)), "model": MODEL, "small": str(small),
        "large": str(large), "processors": str(len(os.sched_getaffinity(0))),
        "timing": table(("actuators", "seconds", "of processor", "for one"),
                        [(n, number(s.wall_s, 1), number(s.cpu_s, 1), number(s.cpu_s / n, 3))
                         for n, s in took.items()]),
        "change": number(100 * (share - 1), 0),
        "peak_mb": number(max(t.peak_mb for t in (*took.values(), again, local)), 0),
        "again_s": number(again.cpu_s, 1), "cluster_count": str(min(ON_CLUSTER, args.count)),
        "cluster_s": number(remote.wall_s, 1), "local_s": number(local.wall_s, 1),
        "same": "the same, byte for byte" if same else "**not the same**",
        "limit": f"{LIMIT:g}", "planted": planted, "false_files": str(false),
        "others": str(args.count - len(PLANTED)), "ordinary": str(ORDINARY),
        "diagnosed_s": number(dug.wall_s, 0),
        "dug_mb": number(dug.peak_mb, 0),
        "each_s": number(dug.cpu_s / sum(r["status"] == "done" for r in diagnosed), 1),
        "causes": causes(diagnosed),
        "compared": str(len(Overview("identified", rows).compared())),
    }), encoding="utf-8")  # fmt: skip
    print(f"wrote {args.out}")


def judged(
    rows: Sequence[dict[str, Any]], diagnosed: Sequence[dict[str, Any]]
) -> tuple[str, int]:
    """What became of the planted ones, as a table; how many others stand out."""
    found: dict[str, list[str]] = {}
    for o in Overview("identified", rows).outliers():
        found.setdefault(o.file, []).append(f"{o.column} (z {o.z:.0f})")
    by_file = {r["file"]: r for r in diagnosed}
    body = []
    for kind, row in zip(kinds(len(rows)), rows, strict=True):
        if kind:
            told = row["error_code"] or ", ".join(found.pop(row["file"], [])) or "nothing"
            said = by_file.get(row["file"], {})
            seen = ", ".join(said.get("findings") or []) or said.get("error_code") or "-"
            body.append((kind, told, seen))
    head = ("planted", "stands out in identification by", "diagnosis names")
    return table(head, body), len(found)


def causes(diagnosed: Sequence[dict[str, Any]]) -> str:
    done = [r for r in diagnosed if r["status"] == "done"]
    names = sorted({c for r in done for c in r["findings"]})
    counts = sorted((-sum(n in r["findings"] for r in done), n) for n in names)
    return table(("cause", f"of {len(done)}", "in the bench"),
                 [(n, -k, IN_THE_BENCH.get(n, "no")) for k, n in counts])  # fmt: skip


if __name__ == "__main__":
    main()
