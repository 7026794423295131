"""Five hundred simulated actuators, identified and diagnosed: docs/many-actuators.md.

    python -m piezo_rig.studies.actuators [--count N] [--folder DIR] [--out FILE]

Every actuator is a simulated bench with a stack of its own: its parameters are drawn around the
default's. Some are planted: their stack, sensor or file is not like the others. The files are
played through the real drivers and kept in the folder; a second call measures without playing.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import RealClock, VirtualClock
from piezo_rig.bench import open_bench
from piezo_rig.cli import main as piezo_rig
from piezo_rig.config import Rig, load_rig
from piezo_rig.config.toml_text import Document
from piezo_rig.fleet.journal import NAME as JOURNAL
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
DIAGNOSED, ON_CLUSTER = 24, 100
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

TEMPLATE = """# Many actuators

Written by `make study-actuators`; the numbers are those of its last run.

{{count}} simulated actuators, each with a stack of its own: reversible and irreversible strain,
edge, first rise, range dependence and creep vary by 2 to 5 %. Every one was played through the
drivers, {{sweeps}} sweeps and {{samples}} samples, into a run of its own. Among them were planted
{{planted_count}} that are not like the others.

## Identified

`piezo-rig identify actuators/*.h5 --model {{model}} --out models/`, as many processes as this
computer has processors, {{processors}}:

{{timing}}

This holds the start of the processes, the table and the page. The computer was busy with other
work (a load of {{load}}), so the seconds of its processors say more than the clock. From {{small}}
to {{large}} actuators those for one change by {{change}} %. The program itself took {{parent_mb}} MB
at most, a worker {{worker_mb}} MB. A second call with nothing left to do took {{again_s}} s.

On a Dask cluster of two workers, one thread each, on the same computer, {{cluster_count}} actuators
took {{cluster_s}} s, {{local_s}} s without it; the models are {{same}}.

## What stood out

A value stands out beyond a robust z-score of {{limit}}. Planted:

{{planted}}

Besides these, {{false_files}} of the {{others}} ordinary actuators stand out in some value, among
{{compared}} values for each.

## Diagnosed

`piezo-rig diagnose actuators/*.h5 --json diagnoses/` on the first {{diagnosed}}, planted ones
included: {{diagnosed_s}} s, {{each_s}} s of processor for each. Found, by number of actuators:

{{causes}}
"""


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
    """Seconds of one call of the program: by the clock, and of all processors together."""

    wall_s: float
    cpu_s: float


def cpu_s() -> float:
    """Of this process and of all that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def timed(words: Sequence[str]) -> Took:
    """What one call of the program takes."""
    begun, used = time.monotonic(), cpu_s()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        status = piezo_rig(list(words))
    if status != 0:
        raise SystemExit(f"{words[0]} ended with {status}")
    return Took(time.monotonic() - begun, cpu_s() - used)


def identified(paths: Sequence[Path], out: Path, *more: str) -> Took:
    return timed(["identify", *map(str, paths), "--model", MODEL, "--out", f"{out}/", *more])


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
    models = args.folder / "models"
    took = {}
    for size in sorted({min(s, args.count) for s in SIZES}):
        shutil.rmtree(models, ignore_errors=True)
        took[size] = identified(paths[:size], models)
        print(f"identified {size}: {took[size]}", flush=True)
    lines = [json.loads(x) for x in (models / JOURNAL).read_text().splitlines()]
    peak = [resource.getrusage(who).ru_maxrss / 1024
            for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]  # fmt: skip
    again_s = identified(paths, models).wall_s
    some = paths[:ON_CLUSTER]
    local, remote = args.folder / "models-local", args.folder / "models-cluster"
    for folder in (local, remote, args.folder / "diagnoses"):
        shutil.rmtree(folder, ignore_errors=True)
    local_s = identified(some, local).wall_s
    with cluster() as address:
        cluster_s = identified(some, remote, "--scheduler", address).wall_s
    print(f"cluster {cluster_s:.1f} s, local {local_s:.1f} s", flush=True)
    same = all((remote / p.name).read_bytes() == p.read_bytes() for p in local.glob("*.json"))
    dug = timed(["diagnose", *map(str, paths[:DIAGNOSED]),
                 "--json", f"{args.folder / 'diagnoses'}/"])  # fmt: skip
    print(f"diagnosed: {dug}", flush=True)
    rows, diagnosed = rows_of(models), rows_of(args.folder / "diagnoses")
    planted, false = judged(rows, diagnosed)
    small, large = min(took), max(took)
    share = took[large].cpu_s / large / (took[small].cpu_s / small)
    args.out.write_text(fill(TEMPLATE, {
        "count": str(args.count), "sweeps": str(lines[0]["row"]["sweeps"]),
        "samples": str(lines[0]["row"]["samples"]), "planted_count": str(len(PLANTED)),
        "model": MODEL, "small": str(small), "large": str(large),
        "timing": table(("actuators", "seconds", "of processor", "for one"),
                        [(n, number(s.wall_s, 1), number(s.cpu_s, 1), number(s.cpu_s / n, 3))
                         for n, s in took.items()]),
        "change": number(100 * (share - 1), 0), "load": number(os.getloadavg()[2], 1),
        "parent_mb": number(peak[0], 0), "worker_mb": number(peak[1], 0),
        "again_s": number(again_s, 1), "cluster_count": str(len(some)),
        "cluster_s": number(cluster_s, 1), "local_s": number(local_s, 1),
        "same": "the same, byte for byte" if same else "**not the same**",
        "limit": f"{LIMIT:g}", "planted": planted, "false_files": str(false),
        "others": str(args.count - len(PLANTED)), "diagnosed": str(DIAGNOSED),
        "diagnosed_s": number(dug.wall_s, 0), "each_s": number(dug.cpu_s / DIAGNOSED, 1),
        "causes": causes(diagnosed), "processors": str(len(os.sched_getaffinity(0))),
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
    return table(("cause", f"of {len(done)}"), [(n, -k) for k, n in counts])


if __name__ == "__main__":
    main()
