"""The two curves of an actuator and the law of its first spring, ready for the kernel.

The initiation curve is followed beyond the largest past drive, the later
branch from every turning point on. On a later branch an element gives way
after twice its break-away displacement. The first element's spring may follow
a law; its break-away displacement stays (thesis eq. 8 and 10), so the drive at
which it gives way moves, and all others with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.elements import Elements
from piezo_rig.chain.half_loops import HalfLoops, half_loops
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
TAPER = 6  # steps in which a law fades out
TAPER_ENDS = 2.0 * np.arange(1, TAPER + 1) / TAPER  # of its reach
TAPER_SHARES = 1.0 - (np.arange(TAPER) + 0.5) / TAPER
NO_LEAPS = np.empty(0)
ONE = np.ones(1)
KEPT = 256  # grids
Law = Callable[[FloatArray, HalfLoops], FloatArray]
"""Slopes (..., m) V/um before the law, and the half loops -> slopes (..., m) after it."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Piecewise linear: ``compliance_um_per_v`` (n,) on the pieces between ``knots_v`` (n-1,)."""

    knots_v: FloatArray
    compliance_um_per_v: FloatArray

    @cached_property
    def grids(self) -> dict[tuple[object, ...], Grid]:
        """What laws with a reach have made of it: see `Branches.grid`."""
        return {}

    @cached_property
    def moved_um(self) -> FloatArray:
        """Displacement at the beginning of the curve and at every knot, shape (n,)."""
        moved = np.zeros(self.knots_v.size + 1)
        np.cumsum(_steps(self.knots_v) * self.compliance_um_per_v[:-1], out=moved[1:])
        return moved

    def beyond(self, volts: float) -> Curve:
        """What is left of it behind so many volts."""
        first = int(np.searchsorted(self.knots_v, volts, side="right"))
        return Curve(self.knots_v[first:] - volts, self.compliance_um_per_v[first:])

    @classmethod
    def of(cls, elements: Elements) -> Curve:
        """The first rise of a set of elements; past the last break point its slope goes on."""
        return cls(elements.knots_v[:-1], 1.0 / elements.slopes)


@dataclass(frozen=True, eq=False)
class Walk:
    """A drive cut into segments, columns as `kernels` says, and the bands that it walked on."""

    ints: NDArray[np.int64]
    floats: FloatArray
    bands: Bands


@dataclass(frozen=True, eq=False)
class Bands:
    """A later branch as the kernel takes it: its first ``e`` bands half loop by half loop.

    Attributes
    ----------
    early_knots_v, early_slopes_v_per_um : shape (m, e), volts from the turning point to the end
        of a band, and the slope on it
    rest : the bands after those, over the volts since
    """

    early_knots_v: FloatArray
    early_slopes_v_per_um: FloatArray
    rest: Curve


@dataclass(frozen=True, eq=False)
class Reaching:
    """A law for every slope up to a reach, wherever the table's first element gives way.

    Attributes
    ----------
    reach_um : displacement after the turning point
    law : as in `Branches.laws`
    closing : share of the volts that the law adds up to the reach which is taken back until
        twice the reach; with 1 a loop closes although its two half loops differ
    tapered : whether the law fades out linearly until twice the reach, instead of ending at it
    carries : whether the spring keeps its force over a turning point: what turns it round is then
        half of what the half loop before has left in it, and half of what it will leave
    """

    reach_um: float
    law: Law
    closing: float = 0.0
    tapered: bool = False
    carries: bool = False

    @cached_property
    def _ends_um(self) -> FloatArray:
        """Where each of its steps ends, shape (s,)."""
        return self.reach_um * (TAPER_ENDS if self.tapered else ONE)

    @property
    def _step_shares(self) -> FloatArray:
        """Share of the law on each step, shape (s,)."""
        return TAPER_SHARES if self.tapered else ONE

    @property
    def steps(self) -> list[tuple[float, float, float]]:
        """Stretches (from, to, share of the law) after the turning point, um."""
        ends = [0.0, *self._ends_um.tolist()]
        return list(zip(ends[:-1], ends[1:], self._step_shares.tolist(), strict=True))

    @property
    def breaks(self) -> FloatArray:
        """Displacements at which slopes change because of it, um, shape (b,)."""
        return np.append(self._ends_um, 2.0 * self.last_um) if self.closing > 0 else self._ends_um

    def added(self, offset: float) -> tuple[FloatArray, FloatArray]:
        """Where pieces end, um, and V/um on each, of a law that adds an offset to every slope."""
        added = offset * self._step_shares
        if not self.closing > 0:
            return self.breaks, added
        gained = float(_steps(self._ends_um) @ added)
        return self.breaks, np.append(added, -self.closing * gained / self.last_um)

    @property
    def last_um(self) -> float:
        """Displacement after the turning point at which the law ends."""
        return float(self._ends_um[-1])

    def shares(self, ends_um: FloatArray) -> FloatArray:
        """Share of the law in each of the bands with these ends that it reaches."""
        to = self._ends_um
        reached = ends_um[: np.searchsorted(ends_um, to[-1], side="right")]
        return np.asarray(self._step_shares[np.searchsorted(to, reached)])

    def taken_back(self, ends_um: FloatArray) -> NDArray[np.bool_]:
        """Of bands with these ends (e,), those on which what it adds is taken back."""
        return (ends_um > self.last_um) & (ends_um <= 2.0 * self.last_um)


@dataclass(frozen=True, eq=False)
class Grid:
    """The early bands of a later branch under laws with a reach, as displacements.

    Attributes
    ----------
    ends_um : shape (e,), displacement after the turning point at which each band ends
    of_first : shape (e,), whether the table's first element still holds there
    slopes_v_per_um : shape (e,), before any law; NaN where the first element holds
    rest : the bands after those; None where the only element never gives way
    """

    ends_um: FloatArray
    of_first: NDArray[np.bool_]
    slopes_v_per_um: FloatArray
    rest: Curve | None

    @cached_property
    def widths_um(self) -> FloatArray:
        return _steps(self.ends_um)


@dataclass(frozen=True, eq=False)
class Branches:
    """What the kernel needs to know of an actuator.

    Attributes
    ----------
    initiation : the first rise, over |drive - first drive|
    first_slope_v_per_um : first slope of a later branch before any law
    first_break_um : displacement after a turning point at which the first element gives way
    rest : the later branch after that, over the volts since
    laws : applied to the first slope in this order
    reaching : laws that hold up to a reach of their own
    keeps_ties : whether a loop that the drive closes exactly stays in memory, so that the branch
        from its beginning is taken up again where the next one passes its far end; where branches
        differ from half loop to half loop this shows
    """

    initiation: Curve
    first_slope_v_per_um: float
    first_break_um: float
    rest: Curve
    laws: tuple[Law, ...] = field(default=())
    reaching: tuple[Reaching, ...] = field(default=())
    keeps_ties: bool = False

    @classmethod
    def of(cls, later: Elements, initiation: Elements | None = None) -> Branches:
        """Branches of constant elements, with an own set for the first rise if given."""
        slopes = later.slopes
        steps = 2.0 * np.diff(later.slides_at_um)
        return cls(
            initiation=Curve.of(initiation if initiation is not None else later),
            first_slope_v_per_um=float(slopes[0]),
            first_break_um=2.0 * float(later.slides_at_um[0]) if len(later) > 1 else np.inf,
            rest=Curve(np.cumsum(slopes[1:] * steps)[:-1], 1.0 / slopes[1:]),
        )

    def of_one_curve(self) -> Branches:
        """With a first rise by the elements of the later branches, before any law."""
        slopes = np.append(1.0 / self.first_slope_v_per_um, self.rest.compliance_um_per_v)
        knots = 0.5 * (self.first_slope_v_per_um * self.first_break_um + self.rest.knots_v)
        if not np.isfinite(self.first_break_um):
            return replace(self, initiation=Curve(np.empty(0), slopes[:1]))
        first = 0.5 * self.first_slope_v_per_um * self.first_break_um
        return replace(self, initiation=Curve(np.append(first, knots), slopes))

    @property
    def has_laws(self) -> bool:
        """Whether branches differ from half loop to half loop."""
        return bool(self.laws or self.reaching)

    def first_slopes(self, loops: HalfLoops, checked: bool = True) -> FloatArray:
        """First slope of the branches of every half loop, V/um, shape (m,)."""
        slopes = np.full(len(loops), self.first_slope_v_per_um)
        for law in self.laws:
            slopes = law(slopes, loops)
        if checked:
            _positive(slopes, loops)
        return slopes

    def bands(self, loops: HalfLoops, checked: bool = True) -> Bands:
        """The later branches of these half loops; ``checked``: refuse what cannot be.

        Raises
        ------
        InputError : a slope that is not positive
        """
        first = self.first_slopes(loops, checked)
        if not self.reaching:
            return Bands((self.first_break_um * first)[:, None], first[:, None], self.rest)
        grid = self.grid()
        ends, widths = grid.ends_um, grid.widths_um
        # bands before half loops, so that a law meets rows of half loops
        slopes = np.where(grid.of_first[:, None], first, grid.slopes_v_per_um[:, None])
        for r in self.reaching:
            shares = r.shares(ends)
            here = slice(shares.size)
            change = shares[:, None] * (r.law(slopes[here], loops) - slopes[here])
            if r.carries:
                change[:, 1:] -= 0.5 * np.diff(change, axis=1)
            slopes[here] += change
            if r.closing > 0:
                slopes[r.taken_back(ends)] -= r.closing / r.last_um * (widths[here] @ change)
        slopes = np.ascontiguousarray(slopes.T)
        if checked:
            _positive(slopes.min(axis=1), loops)
        rest = Curve(np.empty(0), 1.0 / first[:1]) if grid.rest is None else grid.rest
        return Bands(np.cumsum(slopes * widths, axis=1), slopes, rest)

    def grid(self) -> Grid:
        """The bands that laws with a reach make of a later branch; the same for all half loops."""
        known = self.rest.grids
        laws = tuple((r.reach_um, r.closing > 0, r.tapered) for r in self.reaching)
        key = (self.first_break_um, laws)
        grid = known.get(key)  # threads play the same model: another one may clear what is known
        if grid is None:
            if len(known) >= KEPT:
                known.clear()
            grid = known[key] = self._grid()
        return grid

    def _grid(self) -> Grid:
        ends = self.first_break_um + self.rest.moved_um
        later = 1.0 / self.rest.compliance_um_per_v
        reaches = np.concatenate([r.breaks for r in self.reaching])
        breaks = np.unique(np.concatenate([ends, reaches]))
        early = breaks[breaks <= reaches.max()]
        rest: Curve | None = None
        if early[-1] < ends[0] < np.inf:
            # inside the first element: the rest of it is one more band, also by its law
            early = np.append(early, ends[0])
            rest = Curve(self.rest.knots_v, 1.0 / later)
        elif ends[0] < np.inf:
            left = ends[ends > early[-1]]
            springs = later[np.searchsorted(ends, early[-1], side="right") - 1 :]
            steps = springs[: left.size] * _steps(left, early[-1])
            rest = Curve(np.cumsum(steps), 1.0 / springs)
        # slope of each early band before any spring is added; its middle says which one it was
        middle = early - 0.5 * _steps(early)
        which = np.searchsorted(ends, middle)
        return Grid(early, which == 0, np.append(np.nan, later)[which], rest)

    def walk(self, drive_v: FloatArray, loops: HalfLoops | None = None) -> Walk:
        """Cut a drive (n,) into segments; the memory is virgin at its first sample."""
        from piezo_rig.chain import kernels

        if self.has_laws:
            loops = half_loops(drive_v) if loops is None else loops
            bands, start = self.bands(loops), loops.start
        else:
            slope = np.array([[self.first_slope_v_per_um]])
            bands = Bands(self.first_break_um * slope, slope, self.rest)
            start = np.zeros(1, np.int64)
        ints, floats = kernels.walk(
            drive_v,
            float(drive_v[0]),
            self.initiation.knots_v,
            bands.early_knots_v,
            bands.rest.knots_v,
            start,
            bands.early_slopes_v_per_um,
            self.keeps_ties,
            NO_LEAPS,
            NO_LEAPS,
        )
        return Walk(ints, floats, bands)

    def moved(
        self, drive_v: FloatArray, begins: NDArray[np.int64], each: Sequence[HalfLoops]
    ) -> FloatArray:
        """Displacement (n,) of stretches of a drive, um, each from a virgin start and 0 there.

        Parameters
        ----------
        begins : shape (k,), where they begin
        each : half loops of every stretch; of none where branches do not differ
        """
        from piezo_rig.chain import kernels

        if self.has_laws:
            loops = HalfLoops.joined(each, begins.tolist())
            bands, start = self.bands(loops), loops.start
            loop_begins = np.cumsum([0, *(len(own) for own in each[:-1])])
        else:
            slope = np.array([[self.first_slope_v_per_um]])
            bands = Bands(self.first_break_um * slope, slope, self.rest)
            start, loop_begins = np.zeros(1, np.int64), np.zeros(0, np.int64)
        out = np.empty(drive_v.size)
        kernels.moved_each(
            begins, drive_v, self.initiation.knots_v, self.initiation.compliance_um_per_v,
            bands.early_knots_v, bands.early_slopes_v_per_um, bands.rest.knots_v,
            bands.rest.compliance_um_per_v, bands.rest.moved_um, start, loop_begins,
            self.keeps_ties, out,
        )
        return out

    def displacement(self, drive_v: FloatArray, walked: Walk | None = None) -> FloatArray:
        """Displacement of a drive (n,), um, 0 at the first sample."""
        from piezo_rig.chain import kernels

        walked = self.walk(drive_v) if walked is None else walked
        # numpy asks for large pages, the compiled code would not
        out = np.empty(drive_v.size)
        kernels.fill(
            drive_v,
            walked.ints,
            walked.floats,
            self.initiation.compliance_um_per_v.size,
            self.initiation.compliance_um_per_v,
            walked.bands.early_slopes_v_per_um,
            walked.bands.rest.compliance_um_per_v,
            out,
        )
        return out


def sliders(branches: Branches) -> tuple[FloatArray, FloatArray]:
    """Thresholds V of the sliders of a later branch, and by how much each opens it, um/V; (m,)."""
    first = branches.first_break_um * branches.first_slope_v_per_um
    if not np.isfinite(first):
        return np.empty(0), np.empty(0)
    thresholds = 0.5 * (first + np.append(0.0, branches.rest.knots_v))
    own = np.append(1.0 / branches.first_slope_v_per_um, branches.rest.compliance_um_per_v)
    return thresholds, np.diff(own)


def _steps(ends: FloatArray, begin: float = 0.0) -> FloatArray:
    """Widths (n,) of what ends there, one after the other."""
    steps = ends.copy()
    steps[1:] -= ends[:-1]
    steps[:1] -= begin
    return steps


def _positive(slopes: FloatArray, loops: HalfLoops) -> None:
    """Refuse slopes (m,) of half loops that are not above 0."""
    bad = ~(slopes > 0)
    if np.any(bad):
        i = int(np.argmax(bad))
        raise InputError(
            "slope-not-positive",
            f"the first slope of half loop {i + 1} (sample {loops.start[i]}) is "
            f"{slopes[i]:.4g} V/um: it begins at {loops.extremum_v[i]:.4g} V after a change "
            f"of {loops.range_v[i]:.4g} V",
            "the law of the first spring does not hold for this drive",
            "use the model inside the range that it was identified on",
        )
