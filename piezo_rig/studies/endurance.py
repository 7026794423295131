"""Does a day on the bench cost memory, threads or handles? Measured, docs/endurance.md.

    python -m piezo_rig.studies.endurance [--hours H] [--out FILE]

The thesis's matrix is played again and again into one run, through the real
transports, drivers and simulated instruments, all in one process, on the
virtual clock. Once in every hour of bench time the process is looked at from
outside its own book-keeping: resident memory, threads and open files as the
kernel counts them.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.clock import RealClock
from piezo_rig.bench import open_bench
from piezo_rig.config import load_rig
from piezo_rig.protocol import Plan, build_plan, load_protocol
from piezo_rig.resources import find
from piezo_rig.runner import Wire, play
from piezo_rig.studies.document import fill, number, table

HOUR_S = 3600.0
ALLOWED_PERCENT = 5.0
PROTOCOL = "thesis_matrix"

TEMPLATE = """# A day on the bench

Written by `make study-endurance`; the numbers are those of its last run.

The thesis's matrix was played {{repeats}} times over into one run: {{sweeps}} sweeps,
{{hours}} hours of bench time on the virtual clock, in {{minutes}} minutes. Runner, drivers,
transports, simulated instruments and the stack behind them were one process, so whatever any of
them keeps is in these figures. Memory is what the kernel calls resident.

| what | after the first hour | at the end | change | allowed |
| :-- | --: | --: | --: | --: |
| memory | {{first_mb}} MB | {{last_mb}} MB | {{growth}} % | {{allowed}} % |
| threads | {{first_threads}} | {{last_threads}} | {{more_threads}} | 0 |
| open files | {{first_files}} | {{last_files}} | {{more_files}} | 0 |

{{verdict}} The run file was {{run_mb}} MB. Closing it, which copies it, raised the memory to
{{closed_mb}} MB. Threads and open files before the bench was opened: {{begun_threads}}
and {{begun_files}}; after it was left: {{left_threads}} and {{left_files}}.

{{every_hour}}
"""


@dataclass(frozen=True)
class Look:
    """The process at one moment of bench time, as the kernel sees it."""

    bench_s: float
    resident_kb: int
    threads: int
    files: int


def look(bench_s: float) -> Look:
    """Read /proc: Linux only."""
    status = Path("/proc/self/status").read_text(encoding="ascii")

    def field(name: str) -> int:
        found = re.search(rf"^{name}:\s+(\d+)", status, re.MULTILINE)
        assert found is not None
        return int(found.group(1))

    # One file is open for the listing itself.
    return Look(bench_s, field("VmRSS"), field("Threads"), len(os.listdir("/proc/self/fd")) - 1)


def long_plan(hours: float) -> Plan:
    """The matrix, repeated until it fills this many hours with its rests."""
    rig = load_rig()
    protocol = load_protocol(find("protocols", PROTOCOL))
    once = build_plan(replace(protocol, repeats=1), rig)
    repeats = max(1, -(-round(hours * HOUR_S) // round(once.duration_s)))
    return build_plan(replace(protocol, repeats=repeats), rig)


def measure(plan: Plan, folder: Path) -> tuple[Look, list[Look], Look, Look, int]:
    """Play a plan; looks before, every hour, after closing the run, after leaving the bench."""
    looks: list[Look] = []
    wire = Wire()
    before = look(0.0)
    with open_bench(plan.rig, lambda question: True, wire) as bench:
        begun = bench.clock.now()

        def every_hour(text: str) -> None:
            passed = bench.clock.now() - begun
            if passed >= HOUR_S * (len(looks) + 1):
                looks.append(look(passed))
                print(f"{passed / HOUR_S:5.1f} h  {looks[-1]}", flush=True)

        path = play(plan, bench, folder / "endurance.h5", wire, every_hour)
        closed = look(bench.clock.now() - begun)
        size = path.stat().st_size
    RealClock().sleep(0.5)  # the system takes a thread away a moment after it has ended
    return before, looks, closed, look(closed.bench_s), size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of bench time; default: 24")
    parser.add_argument("--out", type=Path, default=Path("docs/endurance.md"))
    args = parser.parse_args()
    plan = long_plan(args.hours)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="endurance-") as folder:
        before, looks, closed, left, size = measure(plan, Path(folder))
    if len(looks) < 2:
        parser.error("two hours at least: the first is what the others are compared with")
    args.out.write_text(
        document(plan, before, looks, closed, left, size, time.monotonic() - begun),
        encoding="utf-8",
    )
    print(f"wrote {args.out}")


def document(
    plan: Plan, before: Look, looks: list[Look], closed: Look, left: Look, size: int, took_s: float
) -> str:
    """The page."""
    first, last = looks[0], looks[-1]
    growth = 100.0 * (last.resident_kb / first.resident_kb - 1.0)
    threads, files = last.threads - first.threads, last.files - first.files
    met = growth < ALLOWED_PERCENT and threads <= 0 and files <= 0
    return fill(TEMPLATE, {
        "repeats": str(max(sweep.repeat for sweep in plan.sweeps)),
        "sweeps": str(len(plan.sweeps)),
        "hours": number(closed.bench_s / HOUR_S, 1),
        "minutes": number(took_s / 60, 0),
        "first_mb": number(first.resident_kb / 1024, 1),
        "last_mb": number(last.resident_kb / 1024, 1),
        "growth": number(growth, 2),
        "allowed": number(ALLOWED_PERCENT, 0),
        "first_threads": str(first.threads),
        "last_threads": str(last.threads),
        "more_threads": f"{threads:+d}",
        "first_files": str(first.files),
        "last_files": str(last.files),
        "more_files": f"{files:+d}",
        "verdict": "All three are met." if met else "**Not all of it is met.**",
        "run_mb": number(size / 1e6, 0),
        "closed_mb": number(closed.resident_kb / 1024, 1),
        "left_threads": str(left.threads),
        "left_files": str(left.files),
        "begun_threads": str(before.threads),
        "begun_files": str(before.files),
        "every_hour": table(
            ("bench time, h", "memory, MB", "threads", "open files"),
            ((number(one.bench_s / HOUR_S, 2), number(one.resident_kb / 1024, 1), one.threads,
              one.files) for one in looks),
        ),
    })


if __name__ == "__main__":
    main()
