"""The tables of ``docs/thesis.md``: what the thesis prints beside what this bench gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Elements, Model
from piezo_rig.studies.document import number, scientific, table
from piezo_rig.studies.fits import NAMES, SCHEMES, TRAINING, Error, Fit, Job
from piezo_rig.studies.half_loops import MeanHalfLoop, pick
from piezo_rig.studies.pairing import Pairs, line

FloatArray = NDArray[np.float64]

# What the thesis prints (sections 4.2 to 4.4, facts checked against its own tables).
PRINTED_R_SQUARED = (0.7716, 0.02972)
PRINTED_ERRORS = {"classical": (0.77, 8.29), "range": (0.25, 2.71)}
PRINTED_RANGE_LAW = (7.465e-3, -0.3578)
PRINTED_EXTREMUM_LAWS = ((9.906e-4, -0.08757), (9.526e-4, -0.08523))


def elements(thesis: Elements, ours: Elements, first: int = 1) -> str:
    """An appendix: number, spring constant and break-away force, theirs and ours."""
    rows = []
    for i in range(first, max(len(thesis), len(ours)) + 1):
        cells = [str(i)]
        for values in (
            (thesis.k_v_per_um, ours.k_v_per_um), (thesis.breakaway_v, ours.breakaway_v)
        ):
            cells += [number(float(v[i - 1]), 4) if i <= v.size else "-" for v in values]
        rows.append(cells)
    head = ("no.", "k thesis (V/um)", "k ours (V/um)", "f thesis (V)", "f ours (V)")
    return table(head, rows)


def laws(thesis_dx: float, ours: Mapping[str, Model], ours_dx: float) -> str:
    """First rows of Appendix B: the laws of the first spring."""
    rows = []
    printed = {
        "range": ("range-dependence", PRINTED_RANGE_LAW),
        "extremum": ("extremum-dependence", PRINTED_EXTREMUM_LAWS[1]),
    }
    for name, (id, (slope, offset)) in printed.items():
        stage = ours[name].stage(id)
        assert stage is not None
        for symbol, a, b in (("k1", 1.0, 1.0), ("f1", thesis_dx, ours_dx)):
            rows.append([
                f"{symbol}, {name} (slope, offset)",
                f"{scientific(a * slope)}, {a * offset:#.4g}",  # four digits, as printed
                f"{scientific(b * stage['slope'])}, {b * stage['offset']:#.4g}",
            ])  # fmt: skip
    return table(("1", "thesis", "ours"), rows)


def travel(model: Model, turns: Sequence[float]) -> FloatArray:
    """Displacement of a model at the turning points of a drive, from a virgin start."""
    legs = [np.linspace(a, b, 2001)[1:] for a, b in pairwise(turns)]
    drive = np.concatenate([[turns[0]], *legs])
    x = model.simulate(np.arange(drive.size) / 5000.0, drive, "virgin")
    return np.asarray(x[::2000])


def check_values(
    thesis: Mapping[str, Model],
    ours: Mapping[str, Model],
    rise: tuple[FloatArray, FloatArray],
    loops: Sequence[MeanHalfLoop],
) -> str:
    """The check values of the appendices: printed, recomputed, our model, this bench."""

    def later(top: float) -> Callable[[Model], float]:
        def half_loop(model: Model) -> float:
            x = travel(model, [0.0, top, 0.0, top])
            return float(x[3] - x[2])

        return half_loop

    rows: list[list[str]] = []
    for top, printed in ((37.7, 4.814), (65.0, 9.195), (75.0, 10.880)):
        both = [float(travel(m["range"], [0.0, top])[1]) for m in (thesis, ours)]
        rows.append([f"first rise to {top:g} V", number(printed), *map(number, both),
                     number(float(np.interp(top, *rise)))])  # fmt: skip
    for top, printed in ((65.0, 8.247), (25.0, 2.709), (10.0, 1.027)):
        both = [later(top)(m["range"]) for m in (thesis, ours)]
        measured = [pick(loops, s, top, d).travel_um[-1] for s, d in ((0.0, 1), (top, -1))]
        rows.append([f"later half loop of {top:g} V", number(printed), *map(number, both),
                     number(float(np.mean(measured)))])  # fmt: skip
    both = [float(travel(m["range"], [0.0, 65.0, 37.7])[2]) for m in (thesis, ours)]
    down = pick(loops, 65.0, 65.0, -1)
    top_um = float(np.interp(65.0, *rise))
    at = top_um - float(np.interp(65.0 - 37.7, down.drive_v, down.travel_um))
    rows.append(["descending from 65 V, at 37.7 V", "6.228 (6.28 measured)", *map(number, both),
                 number(at)])  # fmt: skip
    both = [float(travel(m["classical"], [0.0, 65.0])[1]) for m in (thesis, ours)]
    rows.append(["classical model at 65 V", "9.747", *map(number, both), number(top_um)])
    head = ("displacement (um)", "thesis, its tables", "thesis, replayed here",
            "our models (slopes)", "measured on this bench")  # fmt: skip
    return table(head, rows)


def spring_laws(rows: Sequence[tuple[str, Pairs]]) -> str:
    """Lines of k1 over range and over extremum, for every way of pairing."""
    out = [
        ["thesis, Figure 4-3", f"{scientific(7.465e-3)} R - 0.3578", "0.772",
         f"{scientific(9.526e-4)} E - 0.0852", "0.030"],
    ]  # fmt: skip
    for name, pairs in rows:
        cells = [name]
        for letter, (slope, offset, quality) in (("R", pairs.on_range), ("E", pairs.on_extremum)):
            sign = "+" if offset >= 0 else "-"
            cells += [f"{scientific(slope)} {letter} {sign} {abs(offset):.4f}", number(quality)]
        out.append(cells)
    head = ("first springs from", "k1 over range R", "r-squared", "k1 over extremum E",
            "r-squared")  # fmt: skip
    return table(head, out)


def _where(error: Error) -> str:
    way = "descending" if error.descending else "rising"
    return f"{error.drive_v:.1f} V {way}, at {error.measured_um:.2f} um"


def the_thesis_way(fits: Mapping[Job, Fit]) -> str:
    """Section 4.3 and 4.4: the two published figures beside ours."""
    rows = []
    for name, training in (("classical", "0-75"), ("range", "all")):
        fit = fits[Job(name, "slopes", training)]
        worst, percent = PRINTED_ERRORS[name]
        low, high = fit.spread
        rows.append([
            f"{name}, from {TRAINING[training]}",
            f"{worst:.2f} um, {percent:.2f} %",
            f"{fit.worst.worst_um:.2f} um, {fit.percent:.2f} % ({low:.2f}-{high:.2f})",
            "37.7 V, at 6.28 um" if name == "range" else "not given",
            _where(fit.worst),
        ])  # fmt: skip
    head = ("model", "thesis", "ours (three repeats)", "where, thesis", "where, ours")
    return table(head, rows)


def validation(fits: Mapping[Job, Fit]) -> str:
    """0-65 V, by model, training set and scheme."""
    rows: list[list[str]] = []
    for training in TRAINING:
        for name in NAMES:
            pair = [fits.get(Job(name, scheme, training)) for scheme in SCHEMES]
            if all(f is None for f in pair):
                continue
            cells = [TRAINING[training], name]
            for fit in pair:
                if fit is None or fit.model is None:
                    cells += [fit.refusal if fit else "-", "-"]
                else:
                    rms = 1e3 * float(np.mean([e.rms_um for e in fit.errors]))
                    cells += [f"{fit.percent:.2f}", f"{rms:.0f}"]
            rows.append(cells)
    head = ("built from", "model", "slopes: largest (%)", "slopes: rms (nm)",
            "least squares: largest (%)", "least squares: rms (nm)")  # fmt: skip
    return table(head, rows)


def seeds(found: Sequence[tuple[int, Fit, Fit, Pairs]]) -> str:
    """The four figures that the default plant is set by, for several seeds of noise."""
    rows = []
    for seed, classical, modified, pairs in found:
        rows.append([
            str(seed),
            f"{classical.percent:.2f} ({classical.spread[0]:.2f}-{classical.spread[1]:.2f})",
            f"{modified.percent:.2f} ({modified.spread[0]:.2f}-{modified.spread[1]:.2f})",
            number(pairs.on_range[2]), number(pairs.on_extremum[2]),
        ])  # fmt: skip
    head = ("seed", "classical, largest error (%)", "range, largest error (%)",
            "r-squared, range", "r-squared, extremum")  # fmt: skip
    return table(head, [["thesis", "8.29", "2.71", "0.772", "0.030"], *rows])


def over_range(ranges: FloatArray, series: Mapping[str, tuple[FloatArray, FloatArray]]) -> str:
    """Figure 2-6 as lines: change per volt of range, and r-squared, of slopes and springs."""
    rows = []
    for name, (slopes, springs) in series.items():
        for what, values in (("slope", slopes), ("spring", springs)):
            for i in range(3):
                good = np.isfinite(values[:, i])
                slope, _, quality = line(ranges[good], values[good, i])
                rows.append([f"{name}, {what} {i + 1}", scientific(slope), number(quality)])
    return table(("", "change (V/um per V of range)", "r-squared"), rows)


def same_range(up: Sequence[MeanHalfLoop], down: Sequence[MeanHalfLoop]) -> str:
    """Figure 2-4 as numbers: displacement after 5 V and after 25 V."""
    rows = []
    for loops, name in ((up, "ascending"), (down, "descending")):
        for loop in loops:
            early = float(np.interp(5.0, loop.drive_v, loop.travel_um))
            rows.append([f"{name} from {loop.start_v:g} V", number(early),
                         number(float(loop.travel_um[-1]))])  # fmt: skip
    return table(("half loops of 25 V", "after 5 V (um)", "after 25 V (um)"), rows)


def ends(up: MeanHalfLoop, down: MeanHalfLoop) -> str:
    """Figure 2-3 as numbers: mean compliance of the first and the last 5 V."""

    def compliance(loop: MeanHalfLoop, a: float, b: float) -> float:
        x = np.interp([a, b], loop.drive_v, loop.travel_um)
        return float(x[1] - x[0]) / (b - a)

    rows = []
    last = up.range_v
    for name, a, b in (("first 5 V", 0.0, 5.0), ("last 5 V", last - 5.0, last)):
        values = [1e3 * compliance(loop, a, b) for loop in (up, down)]
        rows.append([name, *(number(v, 1) for v in values), number(values[0] / values[1])])
    return table(("0-65 V", "ascending (nm/V)", "descending (nm/V)", "ratio"), rows)


def settings(rows: Sequence[tuple[str, Any, str, str]], wanted: Sequence[str]) -> str:
    """The plant's defaults that this reproduction rests on."""
    lines = [
        [f"`{key}`", f"{value:g}", unit, text]
        for key, value, unit, text in rows
        if key.split(".")[0] in wanted and not isinstance(value, bool)
    ]
    return table(("setting", "value", "unit", "what"), lines)
