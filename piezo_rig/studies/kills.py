"""Kills the runner 200 times and writes what was left of file and stack into docs/kills.md.

    python -m piezo_rig.studies.kills run --out build/study-kills.jsonl
    python -m piezo_rig.studies.kills document build/study-kills.jsonl --out docs/kills.md
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.studies.document import fill, number, table
from piezo_rig.studies.kill_bench import (
    IN_BURST,
    PROTOCOL,
    STATES,
    Aim,
    Outcome,
    ServedBench,
    durations,
    kill_once,
    served,
)

BURST_S = 0.6
"""A little longer than a sweep of the protocol."""
HESITATION_S = 0.05
PER_BENCH = 20
"""Kills that share one served bench; its record is read again for each."""

Tell = Callable[[str], None]
Row = dict[str, Any]


def aimed(found: dict[str, list[float]], rng: np.random.Generator) -> Iterator[Aim]:
    """Every state in turn, at a random moment of it.

    Every second time the runner hesitates where the state begins, and is killed while it does:
    steps of a millisecond are hit that way, and bursts half-way. The other times it is killed at
    work, up to the longest time that it was seen in that state.
    """
    hesitates = False
    while True:
        for state in STATES:
            nth = int(rng.integers(1, len(found[state]) + 1))
            if hesitates:
                longest = BURST_S if state == "playing" else HESITATION_S
                yield Aim(state, nth, float(rng.uniform(0.0, longest)), longest + 1.0)
            else:
                yield Aim(state, nth, float(rng.uniform(0.0, max(found[state]))))
        hesitates = not hesitates


def any_time(found: dict[str, list[float]], rng: np.random.Generator) -> Iterator[Aim]:
    """A random moment between the first volt and the closed run."""
    life_s = sum(sum(times) for times in found.values())
    while True:
        yield Aim(STATES[0], 1, float(rng.uniform(0.0, life_s)))


def measure(virtual: int, real: int, seed: int, out: Path, tell: Tell) -> None:
    """Kill and append one line per kill to ``out``; a run that had ended before does not count."""
    rng = np.random.default_rng(seed)
    with out.open("w", encoding="utf-8") as rows:
        for clock, kills, recovery_s in (("virtual", virtual, None), ("real", real, 0.1)):
            done = 0
            while done < kills:
                with tempfile.TemporaryDirectory() as name:
                    folder = Path(name)
                    with served(folder, clock, recovery_s) as bench:
                        done += _kill_many(
                            bench, folder, min(PER_BENCH, kills - done), rng, rows, tell
                        )


def _kill_many(
    bench: ServedBench, folder: Path, kills: int, rng: np.random.Generator, rows: Any, tell: Tell
) -> int:
    protocol = folder / "kills.toml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    bench.reset_generator()
    found = durations(bench, protocol, folder / "unharmed")
    aims = (aimed if bench.clock_name == "virtual" else any_time)(found, rng)
    done = 0
    for index, aim in enumerate(aims):
        outcome = kill_once(bench, protocol, folder / f"out{index}", aim)
        if outcome.was_killed:
            done += 1
            rows.write(json.dumps(as_row(outcome)) + "\n")
            rows.flush()
            tell(f"{bench.clock_name} {done}: {said(outcome)}")
        if done == kills:
            break
    return done


def as_row(outcome: Outcome) -> Row:
    """One kill as plain data."""
    return asdict(outcome) | {"intact": outcome.intact, "rested": outcome.rested}


def said(outcome: Outcome) -> str:
    """One kill in a line."""
    v = outcome.verdict
    assert v is not None
    return (
        f"{outcome.state}: {outcome.stored} stored, {outcome.recovered} recovered "
        f"{'; '.join(outcome.faults)}; {v.killed_v:.2f} V, rest after {v.rest_after_s:.3f} s "
        f"(late {v.late_s:.3f} s), {v.slew_v_per_s:.0f} V/s, then {v.end_v:.4f} V; "
        f"{'ok' if outcome.intact and outcome.rested else 'NOT OK'}"
    )


PAGE = """# What a killed program leaves behind

Written by `make study-kills`. `piezo-rig run` is killed with SIGKILL against
`piezo-rig bench --record` in a process of its own, {{kills}} times: {{virtual}} on a virtual clock,
{{real}} on a real one. The stack is judged by the bench's own record of it, the file by what the
runner had stored when it was killed. The generator is reset before every run, so that every run
begins with 75 V on the stack. {{protocol}}

On the virtual clock every state of the runner is aimed at in turn. Every second time the runner
stands still for a moment where the state begins (in a burst: for as long as a burst), and is killed
at a random moment of that; the other times it is killed at work, a random time after it came to the
state, so that some of these kills strike in the state after it. On the real clock it is killed at a
random moment between the first volt and the closed run; a burst then takes its time, and the guard
is waiting for its end on the runner's behalf. The state in the table is the one in which the runner
was when it died.

{{table}}

*V, at most* is the largest voltage on the stack at a kill. *Stored* are sweeps whose storing the
runner had finished; *lost* those of them that the recovered run lacks or holds damaged. *At rest*
are kills after which the stack was at 0 V (below 0.02 V) by the end of the burst, where one was
under way, or by the kill, plus 1 s of the bench's clock, and stayed there. *Latest* is the longest
time beyond the end of the burst or the kill. *Slew* is the largest change over 10 ms after the
kill. The limits of the config are 300 V/s for a ramp to rest and 10,000 V/s inside a burst, of
which these sweeps use {{planned}} V/s.

{{verdict}}
"""


def document(rows: list[Row]) -> str:
    """The page from the rows of all kills."""
    order = [*STATES]
    keys = sorted(
        {(r["clock"] != "virtual", _state(r)) for r in rows},
        key=lambda key: (key[0], order.index(key[1])),
    )
    lines = []
    for real, state in keys:
        lines.append(_line(
            f"{state}, {'real' if real else 'virtual'} clock",
            [r for r in rows if (r["clock"] != "virtual", _state(r)) == (real, state)],
        ))
    lines.append(_line("**all**", rows))
    files = [r for r in rows if r["recovered"] >= 0]
    return fill(PAGE, {
        "kills": str(len(rows)),
        "virtual": str(sum(r["clock"] == "virtual" for r in rows)),
        "real": str(sum(r["clock"] == "real" for r in rows)),
        "protocol": f"A run is {_SWEEPS} sweeps of half a second between 5 V and 65 or 75 V.",
        "planned": number(max(r["largest_planned_slew"] for r in rows), 0),
        "table": table(
            ("killed while", "kills", "V, at most", "files", "recovered", "stored", "lost",
             "at rest", "latest, s", "slew, V/s"), lines,
        ),
        "verdict": (
            f"{len(rows)} kills: {len(files)} had begun a file, "
            f"{sum(r['intact'] for r in files)} of these were recovered with every stored sweep; "
            f"the stack was at rest in time {sum(r['rested'] for r in rows)} times, and "
            f"{sum(r['verdict']['slew_v_per_s'] <= _slew_limit(r) for r in rows)} times it came "
            f"there within the slew limit. "
            f"{sum(abs(r['verdict']['killed_v']) > 0.02 for r in rows)} kills struck while there "
            f"was voltage on the stack, "
            f"{max(r['verdict']['killed_v'] for r in rows):.1f} V at most."
        ),
    })


_SWEEPS = 6


def _state(row: Row) -> str:
    return next(s for s in STATES if str(row["state"]).startswith(s))


def _slew_limit(row: Row) -> float:
    """Of the simulated bench's config: ramps to rest, and bursts."""
    return 10_000.0 if str(row["state"]).startswith(IN_BURST) else 300.0


def _line(name: str, rows: list[Row]) -> tuple[object, ...]:
    files = [r for r in rows if r["recovered"] >= 0 or r["faults"]]
    return (
        name, len(rows), number(max(r["verdict"]["killed_v"] for r in rows), 1), len(files),
        sum(r["recovered"] >= 0 for r in rows),
        sum(r["stored"] for r in rows),
        sum(max(0, r["stored"] - max(0, r["recovered"])) + len(r["faults"]) for r in rows),
        sum(r["rested"] for r in rows), number(max(r["verdict"]["late_s"] for r in rows), 2),
        number(max(r["verdict"]["slew_v_per_s"] for r in rows), 0),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    run = verbs.add_parser("run")
    run.add_argument("--virtual", type=int, default=160)
    run.add_argument("--real", type=int, default=40)
    run.add_argument("--seed", type=int, default=1)
    run.add_argument("--out", type=Path, required=True)
    write = verbs.add_parser("document")
    write.add_argument("rows", type=Path, nargs="+")
    write.add_argument("--out", type=Path, default=Path("docs/kills.md"))
    options = parser.parse_args()
    if options.verb == "run":
        options.out.parent.mkdir(parents=True, exist_ok=True)
        measure(options.virtual, options.real, options.seed, options.out,
                lambda what: print(what, file=sys.stderr, flush=True))
        return
    rows = [json.loads(line) for path in options.rows for line in path.open(encoding="utf-8")]
    options.out.write_text(document(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
