"""A model as plain arrays: what its machine (`machine.py`) reads and never writes.

The laws of the first spring are affine in what a half loop remembers, the range before it and the
drive at its turning point, and in the same of the half loop before, for each direction. So a branch
is five tables: what it is without any of those, and what each volt of the four adds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Branches, Curve, HalfLoops, Model, Stage
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
NUMBERS = 56  # of most operations at most: the stops of an asymmetry, and four more
SLIDERS = (Operation.WIDEN, Operation.STRETCH)
ROUNDING_V = 5e-9
STEADY = 0.8  # share of the way to where a drag would move an actuator against its drive


class Tables(NamedTuple):
    """Operations in the order of the chain, and the curves of the actuator.

    Attributes
    ----------
    kinds : shape (m,), `Operation`
    numbers : shape (m, NUMBERS), or more where one needs them
    caps : shape (m,); most that a drag, or a width, may grow with the rate, per reference rate; of
        ageing, the dead band
    drives : how many of the operations act on the drive; they are the first
    widen : index of the operation that acts on what sliders see, or -1
    init_knots_v, init_compliance : (n0 - 1,) and (n0,), the first rise
    widths_um : shape (e,), of the early bands of a later branch
    slopes : shape (2, e), V/um; falling, rising
    per_volt : shape (2, 4, e), what a volt of range, of extremum, and of the half loop before adds
    rest_knots_v, rest_compliance : the later branch after its early bands
    first_compliance : um/V, of the first spring where sliders do not see the drive itself
    dead_band_v : reversals up to that are not counted as half loops
    keeps_ties : whether a loop that is closed exactly stays in memory
    """

    kinds: NDArray[np.int64]
    numbers: FloatArray
    caps: FloatArray
    drives: int
    widen: int
    init_knots_v: FloatArray
    init_compliance: FloatArray
    widths_um: FloatArray
    slopes: FloatArray
    per_volt: FloatArray
    rest_knots_v: FloatArray
    rest_compliance: FloatArray
    first_compliance: float
    dead_band_v: float
    keeps_ties: bool


def increment_of(stage: Stage, branches: Branches) -> Increment | str | None:
    """What a stage does from sample to sample; None where it only shapes branches or remembers."""
    acts = type(stage).act is not Stage.act or stage.holds_force
    if acts or type(stage).seen_by_sliders is not Stage.seen_by_sliders:
        return stage.increment(branches)
    return None


def tables_of(model: Model, steady: bool, dead_band_v: float = ROUNDING_V) -> Tables:
    """The tables of a model whose stages all have a form sample by sample.

    Parameters
    ----------
    steady : bound the drag of slow drives, so that a drive moves the actuator its own way
        (see `docs/decisions/0015-how-a-model-is-inverted.md`)
    dead_band_v : reversals up to that are not counted as half loops

    Raises
    ------
    InputError : a stage without such a form, or a law that is not affine
    """
    branches = model.branches()
    slopes, per_volt, widths, rest = _branch(branches)
    kinds: list[int] = []
    rows: list[FloatArray] = []
    drives, widen = 0, -1
    for stage in model.stages:
        increment = increment_of(stage, branches)
        if increment is None:
            continue
        if isinstance(increment, str):
            raise InputError(
                "not-stepwise", f"stage {stage.id} has no form sample by sample: {increment}",
                "", "take it out of the model",
            )
        if increment.operation in SLIDERS:
            widen = len(kinds)
        drives += stage.place == "drive"
        kinds.append(int(increment.operation))
        rows.append(np.array(increment.numbers))
    numbers = np.zeros((len(rows), max([NUMBERS, *(row.size for row in rows)])))
    for j, row in enumerate(rows):
        numbers[j, : row.size] = row
    compliance = min(float(branches.initiation.compliance_um_per_v.min()), 1.0 / slopes.max(),
                     float(np.min(rest.compliance_um_per_v, initial=np.inf)))  # fmt: skip
    caps = np.full(len(kinds), np.inf)
    for j, kind in enumerate(kinds):
        if steady and kind in (Operation.DRAG, *SLIDERS):
            caps[j] = STEADY * numbers[j, 2] * numbers[j, 3]
            caps[j] *= compliance if kind == Operation.DRAG else 1.0
            if kind == Operation.STRETCH:  # the widest of them
                caps[j] /= np.max(numbers[j, 5 : 5 + int(numbers[j, 4])], initial=1e-9)
        elif kind == Operation.AGE:
            caps[j] = dead_band_v
    return Tables(
        np.array(kinds, np.int64), numbers, caps, drives, widen,
        branches.initiation.knots_v, branches.initiation.compliance_um_per_v,
        widths, slopes, per_volt, rest.knots_v, rest.compliance_um_per_v,
        1.0 / branches.first_slope_v_per_um, dead_band_v, branches.keeps_ties,
    )  # fmt: skip


def _branch(branches: Branches) -> tuple[FloatArray, FloatArray, FloatArray, Curve]:
    """Slopes, what they grow by per volt of what is remembered, widths of the bands, the rest."""
    some = np.array([37.0, -23.0, 11.0, -5.0])
    tried = np.vstack([np.zeros(4), np.eye(4), some])
    every = np.vstack([tried, tried])
    way = np.repeat([-1.0, 1.0], len(tried))
    # every half loop behind the one before it
    range_v, extremum_v, direction = (
        np.column_stack(pair).ravel()
        for pair in ((every[:, 2], every[:, 0]), (every[:, 3], every[:, 1]), (-way, way))
    )
    index = np.arange(range_v.size)
    bands = branches.bands(HalfLoops(index, index + 1, range_v, extremum_v, direction), False)
    rows = bands.early_slopes_v_per_um
    rows = rows[1::2] if branches.has_laws else np.repeat(rows[:1], len(every), axis=0)
    each = rows.reshape(2, len(tried), -1)
    slopes = each[:, 0]
    per_volt = each[:, 1:-1] - slopes[:, None]
    if not np.allclose(slopes + np.einsum("k,dke->de", some, per_volt), each[:, -1],
                       rtol=1e-9, atol=1e-9 * np.abs(rows).max()):  # fmt: skip
        raise InputError(
            "law-not-affine", "a law of the first spring is not a straight line over its history",
            "the model was written by a newer version", "use the version that wrote it",
        )
    knots = bands.early_knots_v[1] if branches.has_laws else bands.early_knots_v[0]
    edges = np.diff(knots, prepend=0.0)
    return np.ascontiguousarray(slopes), np.ascontiguousarray(per_volt), edges / rows[0], bands.rest
