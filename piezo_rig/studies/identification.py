"""Do the stated bands of an identification hold? Measured, and written to docs/identification.md.

    python -m piezo_rig.studies.identification [--trials N] [--out FILE]

Actuators are drawn at random and played by `played` below, which shares no code with the chain:
branches are tabulated, turning points are a list. Every trial adds fresh noise, identifies, and
asks for every band whether the truth lies in it. The figure is the mean over all bands of a kind.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification import Identification, identify
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.studies.document import number, table

FloatArray = NDArray[np.float64]
Law = Callable[[float, float], float]
NOISE_UM = 0.005
POINTS = 125  # samples of a half loop
TRIALS = 200
ACTUATORS = 20  # drawn at random; each serves trials / actuators draws of noise
KINDS = ("first rise", "later branch", "first elements", "later elements", "slope", "offset")
WIDTHS = ("first rise, nm", "later branch, nm")


@dataclass(frozen=True)
class Actuator:
    """Springs (V/um) that give way ``dx`` um after one another, and the first later one's law."""

    dx: float | FloatArray
    first: FloatArray
    later: FloatArray
    law: Law
    slope: float = 0.0
    offset: float = 0.0

    def rise(self) -> tuple[FloatArray, FloatArray]:
        """The first rise as a table: drive, displacement."""
        return _tabulated(self.first, self.dx)

    def branch(self, k1: float) -> tuple[FloatArray, FloatArray]:
        """A later branch as a table."""
        return _tabulated(np.concatenate([[k1], self.later[1:]]), 2.0 * self.dx)


def _tabulated(
    springs: FloatArray, step: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    steps = np.broadcast_to(step, springs.shape)
    drive, moved = [0.0], [0.0]
    for i in range(len(springs)):
        width = float(steps[i]) if i + 1 < len(springs) else 1e3
        drive.append(drive[-1] + width * float(np.sum(springs[i:])))
        moved.append(moved[-1] + width)
    return np.array(drive), np.array(moved)


def played(actuator: Actuator, turns: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Drive and displacement over turning points; the first of them is virgin."""
    first = actuator.rise()
    drives, moves = [np.array([turns[0]])], [np.zeros(1)]
    memory: list[tuple[float, tuple[FloatArray, FloatArray]]] = []
    y, change = 0.0, 0.0
    for k, (a, b) in enumerate(pairwise(turns)):
        if k:
            memory.append((a, actuator.branch(actuator.law(change, a))))
        change = abs(b - a)
        v = a + (b - a) * np.arange(1, POINTS + 1) / POINTS
        out = np.empty(v.size)
        here, done = a, 0
        while done < v.size:
            if memory:
                turn, table = memory[-1]
                end = memory[-2][0] if len(memory) > 1 else 2.0 * turns[0] - turn
            else:
                turn, table, end = turns[0], first, np.inf * np.sign(b - a)
            inside = (v <= end) if b > a else (v >= end)
            upto = int(np.count_nonzero(inside))
            start = float(np.interp(abs(here - turn), *table))
            moved = np.interp(np.abs(v[done:upto] - turn), *table) - start
            out[done:upto] = y + np.sign(b - a) * moved
            if upto == v.size and not (memory and v[-1] == end):
                y = float(out[-1])
                break
            y += float(np.sign(b - a) * (np.interp(abs(end - turn), *table) - start))
            here, done = end, upto
            del memory[-2:]
        drives.append(v)
        moves.append(out)
    return np.concatenate(drives), np.concatenate(moves)


def conditions(spans: Sequence[float], top: float, cycles: int) -> dict[str, list[float]]:
    """The thesis's matrix on a smaller scale: 0-span, and from the top down."""
    out = {}
    for span in spans:
        out[f"0-{span:g}"] = [0.0] + [span, 0.0] * cycles
        if span < top:
            out[f"{top:g}-{top - span:g}"] = [0.0, *([top, top - span] * cycles), top, 0.0]
    return out


def random_actuator(
    rng: np.random.Generator, n: int, by_law: bool, uneven: float = 0.0
) -> Actuator:
    """n elements up to 75 V and about 11 um; some springs are negative.

    ``uneven``: thresholds are apart by 1 - uneven to 1 + uneven of their mean.
    """

    def springs(scale: float) -> FloatArray:
        slopes = np.exp(rng.normal(0.0, 0.04, n)) * np.linspace(9.0, 5.5, n) * scale
        return np.append(-np.diff(slopes), slopes[-1])

    first, later = springs(1.0), springs(1.05)
    if not by_law:
        later = first
    dx: float | FloatArray = 75.0 / float(np.sum(np.cumsum(first[::-1])))
    if uneven:
        dx = dx * rng.uniform(1.0 - uneven, 1.0 + uneven, n)
    slope, offset = (float(rng.uniform(0.004, 0.01)), float(later[0])) if by_law else (0.0, 0.0)

    def law(span: float, extreme: float) -> float:
        return slope * span + offset if by_law else float(later[0])

    return Actuator(dx, first, later, law, slope, offset)


def record(
    clean: dict[str, tuple[FloatArray, FloatArray]], rng: np.random.Generator, correlation: float
) -> list[Sweep]:
    """Sweeps with fresh noise; ``correlation`` of neighbouring samples."""
    from scipy.signal import lfilter

    sweeps = []
    for i, (name, (drive, y)) in enumerate(clean.items(), start=1):
        noise = NOISE_UM * rng.standard_normal(y.size)
        if correlation:
            noise = lfilter([np.sqrt(1 - correlation**2)], [1.0, -correlation], noise)
        z = y + noise
        sweeps.append(
            Sweep(f"sweep_{i:04d}", drive, z, 500.0, 1.0, 0.0, 1.0, 1, float(z[0]), name, 1,
                  "virgin", 0.0, "SIMULATED")
        )  # fmt: skip
    return sweeps


def covered(found: Identification, truth: Actuator, same: bool) -> dict[str, FloatArray]:
    """For every kind of band, 1 where the truth lies in it.

    ``same``: the fit has the truth's elements; else elements are compared by their mean.
    """
    b = found.bands
    assert b is not None
    span, extreme, _ = b.later_loop
    tables = (truth.rise(), truth.branch(truth.law(span, extreme)))
    reach = b.drive_v[-1]
    out: dict[str, FloatArray] = {}
    for kind, shown in zip(WIDTHS, (b.first_um, b.later_um), strict=True):
        out[kind] = np.atleast_1d(1e3 * np.median(np.ptp(shown, axis=1)))
    rows = ((b.first_um, b.drive_v, KINDS[0]), (b.later_um, 2.0 * b.drive_v, KINDS[1]))
    for (band, drive, kind), curve in zip(rows, tables, strict=True):
        inside = (drive > 0) & (drive <= min(span, 2.0 * reach) if kind == KINDS[1] else True)
        out[kind] = _in(band[inside], np.interp(drive[inside], *curve))
    knots = _knots(found)
    springs = (truth.first, truth.later)
    bands = (b.first_compliance, b.later_compliance)
    for i, kind in enumerate(KINDS[2:4]):
        skip = 1 if i and truth.slope else 0  # the first of them is the law's
        edges = np.append(knots[i], (reach, span)[i])
        use = [j for j in range(skip, len(bands[i])) if edges[j] < 0.98 * edges[-1]]
        if same:
            true = 1.0 / np.cumsum(springs[i][::-1])[::-1]
        else:
            moved = np.interp(edges, *tables[i])
            true = np.diff(moved) / np.maximum(np.diff(edges), 1e-12)
        if use:
            out[kind] = _in(bands[i][use], true[use])
    stage = found.model.stage("range-dependence")
    if stage is not None:
        for kind, value in (("slope", truth.slope), ("offset", truth.offset)):
            ci = stage.parameters[kind].ci95
            assert ci is not None
            out[kind] = _in(np.array([ci]), np.array([value]))
    return out


def _knots(found: Identification) -> tuple[FloatArray, FloatArray]:
    """Where the elements of the first rise and of the branch of the bands begin, volts."""
    from piezo_rig.chain import HalfLoops

    assert found.bands is not None
    branches = found.model.branches()
    none = np.zeros(1, np.int64)
    loop = HalfLoops(none, none, *(np.array([x]) for x in found.bands.later_loop))
    slope = branches.first_slopes(loop)[0]
    first_break = branches.first_break_um * slope
    later = np.concatenate([[0.0, first_break], first_break + branches.rest.knots_v])
    return np.concatenate([[0.0], branches.initiation.knots_v]), later


def _in(band: FloatArray, value: FloatArray) -> FloatArray:
    return ((band[:, 0] <= value) & (value <= band[:, 1])).astype(float)


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    what: str
    model: str
    true_elements: int
    elements: int | None
    spans: tuple[float, ...] = (20.0, 35.0, 50.0, 65.0, 75.0)
    cycles: int = 4
    correlation: float = 0.0
    uneven: float = 0.0


CASES = (
    Case("classical, its own elements", "classical", 12, 12),
    Case("initiation, its own elements", "initiation", 12, 12),
    Case("range, its own elements", "range", 12, 12),
    Case("range, three sweeps", "range", 12, 12, (50.0, 75.0)),
    Case("range, noise correlated over 20 samples", "range", 12, 12, correlation=0.95),
    Case("classical, one sweep", "classical", 12, 12, (75.0,), 6),
    Case("classical, chosen, truth has 12", "classical", 12, None),
    Case("classical, chosen, 12 uneven, one sweep", "classical", 12, None, (75.0,), 6, uneven=0.7),
    Case("classical, chosen, 27 uneven, coloured", "classical", 27, None, correlation=0.95,
         uneven=0.7),
    Case("initiation, chosen, 18 uneven", "initiation", 18, None, uneven=0.7),
    Case("range, chosen, truth has 12", "range", 12, None),
    Case("range, chosen, truth has 27", "range", 27, None),
    Case("range, chosen, 12 uneven", "range", 12, None, uneven=0.7),
    Case("range, chosen, 27 uneven", "range", 27, None, uneven=0.7),
    Case("range, chosen, 18 uneven, coloured", "range", 18, None, correlation=0.95, uneven=0.7),
    Case("range, chosen, 12 uneven, three sweeps", "range", 12, None, (50.0, 75.0), uneven=0.7),
    Case("range, chosen, 18 uneven, twelve ranges", "range", 18, None,
         tuple(np.linspace(20.0, 75.0, 12)), 2, uneven=0.7),
)


def _actuator_trials(job: tuple[int, int, int]) -> list[dict[str, FloatArray]]:
    """All draws of noise of one case on one actuator."""
    number, actuator, draws = job
    case = CASES[number]
    rng = np.random.default_rng([number, actuator])
    truth = random_actuator(rng, case.true_elements, case.model == "range", case.uneven)
    if case.model == "initiation":
        other = random_actuator(rng, case.true_elements, False)
        later = other.first * 1.05
        truth = Actuator(truth.dx, truth.first, later, lambda span, extreme: float(later[0]))
    plan = conditions(case.spans, 75.0, case.cycles)
    clean = {name: played(truth, turns) for name, turns in plan.items()}
    out = []
    for _ in range(draws):
        found = identify(record(clean, rng, case.correlation), case.model, elements=case.elements)
        out.append(covered(found, truth, case.elements is not None))
    return out


def measure(
    trials: int, progress: Callable[[str], None], processes: int = 2
) -> list[dict[str, float]]:
    """Per case: share covered of every kind in percent, and the seconds that it took."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    draws = -(-trials // ACTUATORS)
    rows = []
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for number, case in enumerate(CASES):
            progress(case.what)
            jobs = [(number, actuator, draws) for actuator in range(ACTUATORS)]
            found = [r for part in pool.map(_actuator_trials, jobs) for r in part]
            rows.append({
                kind: float(np.mean([np.mean(r[kind]) for r in found if kind in r]))
                for kind in found[0]
            })  # fmt: skip
            for kind in KINDS:
                if kind in rows[-1]:
                    rows[-1][kind] *= 100.0
            progress(str({k: float(f"{v:.4g}") for k, v in rows[-1].items()}))
    return rows


PAGE = """# Do the bands of an identification hold?

Written by `make study-identification`: {trials} trials a row, {actuators} actuators drawn at
random and played by a generator that shares no code with the program, noise of 5 nm. Every trial
draws new noise and identifies; the table says how often the truth lies in the stated 95 % band.

{table}

- *First rise* and *later branch* are bands of the response (the later branch of the largest half
  loop), *elements* those of the single compliances, *slope* and *offset* the law's intervals.
- *Own elements*: `--elements` is the actuator's own number. Only noise makes an error there.
- *Chosen*: the default. The grid is not the actuator's; *uneven* thresholds lie 0.3 to 1.7 of their
  mean apart, drawn afresh for every actuator; *coloured* noise has a correlation of 0.95 between
  neighbouring samples. The aim is 92-98 % in every column.
- The last columns are the median widths of the bands of the response.
- A share is of {trials} trials on {actuators} actuators, and uncertain by 2 to 3 %. Narrow:
  coloured noise together with a law and elements that are chosen.

What is estimated does not depend on our grid. The *response* is the truth's at a drive. An
*element's* compliance is the truth's mean over the stretch of drive that the element covers.
*Slope* is what a volt of input range adds to the slope that a branch begins with. *Offset* is that
first slope continued to no range, less the slope just after the first element has given way.

## How the bands are made

Scores of the conditions (of sweeps, or of half loops, where there is one) are drawn again 1000
times, with what a unit hides by pulling the fit towards itself added from the variation of its
half loops, and widened by Student's t with each quantity's own degrees of freedom
(`piezo_rig/identification/uncertainty.py`). Where the number of elements is chosen, the error of
the grid is added: what the ties between elements hide, what happens inside elements, and where else
the first break might be (`smooth.py`, `tied.py`, decision 6). Data without noise have no such
error; where few levels of drive leave open what happens between them, break points drawn at the
levels themselves say how much that matters.

The table before, when whole sweeps were drawn with replacement and the spread scaled by
sqrt(n / (n - 1)); in its last two rows the bands did not know the error of the grid:

{before}

A draw without the only sweep that reaches 75 V does not know what lies up there, and a draw with
it has no other opinion: too wide for what all sweeps share, too narrow for what few of them see.
"""

BEFORE = [  # measured once with the same generator, 200 trials
    dict(zip(KINDS, row, strict=False))
    for row in (
        (89.9, 89.0, 91.1, 88.5),
        (90.6, 91.9, 92.1, 91.0),
        (92.6, 89.7, 92.9, 90.0, 92.0, 92.0),
        (86.1, 100.0, 76.4, 85.1, 100.0, 100.0),
        (91.0, 87.7, 90.0, 91.5, 90.5, 89.0),
        (96.9, 94.4, 96.3, 93.6),
        (81.4, 87.6, 73.9, 92.3, 64.0, 73.0),
        (87.5, 82.5, 82.6, 88.9, 66.5, 66.5),
    )
]

NAMES_BEFORE = [
    *(case.what for case in CASES[:6]),
    "range, elements chosen, truth has 12", "range, elements chosen, truth has 27",
]  # fmt: skip


def _table(rows: list[dict[str, float]], names: list[str] | None = None) -> str:
    names = [case.what for case in CASES] if names is None else names
    return table(
        ("95 % bands cover, %", *KINDS, *(WIDTHS if WIDTHS[0] in rows[0] else ())),
        [
            (name, *(number(row.get(kind), 1) for kind in KINDS),
             *(number(row[kind], 1) for kind in WIDTHS if kind in row))
            for name, row in zip(names, rows, strict=True)
        ],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("docs/identification.md"))
    options = parser.parse_args()
    rows = measure(
        options.trials, lambda what: print(what, file=sys.stderr, flush=True), options.processes
    )
    page = PAGE.format(trials=options.trials, actuators=ACTUATORS, table=_table(rows),
                       before=_table(BEFORE, NAMES_BEFORE))  # fmt: skip
    options.out.write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
