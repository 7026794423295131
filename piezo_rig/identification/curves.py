"""The unknowns of a fit, and the branches that they make.

Three kinds of fit share the kernel and the normal equations:

- one curve (`classical`): the later branch is the first rise drawn at twice the size;
- two curves (`initiation`): the first rise has its own compliances and break points;
- two curves and a law (`range`, `extremum`, ...): the later branch begins with a slope that
  follows the half loop, its first break comes after a fixed displacement.

Compliances (um/V) rather than springs are the unknowns: the displacement is linear in them,
and "every cumulative slope is positive" is simply "every compliance is positive".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Branches, Curve, Elements, HalfLoops, Stage

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curves:
    """Values of all unknowns.

    Attributes
    ----------
    first_knots, first_c : the initiation curve, shapes (n0 - 1,) and (n0,)
    later_knots, later_c : the later branch over the drive change since the turning point,
        shapes (nc - 1,) and (nc,); with laws the first piece is what it is at a neutral law
    shared : one curve: the later branch is the first rise at twice the size
    laws : law stages; their ``offset`` is kept at 0 while fitting
    dx_um : where it is not 0, elements give way at multiples of it (the thesis's spacing): it
        is an unknown itself, and the break points follow from it and the compliances
    """

    first_knots: FloatArray
    first_c: FloatArray
    later_knots: FloatArray
    later_c: FloatArray
    shared: bool
    laws: tuple[Stage, ...] = ()
    dx_um: float = 0.0

    @property
    def law_names(self) -> list[tuple[int, str]]:
        """(law, parameter) of every fitted law parameter; offsets are in the first slope."""
        return [(i, n) for i, s in enumerate(self.laws) for n in s.units if n != "offset"]

    @property
    def by_law(self) -> bool:
        return bool(self.laws)

    def branches(self) -> Branches:
        """For the kernel."""
        c = self.later_c
        alone = c.size == 1
        branches = Branches(
            initiation=Curve(self.first_knots, self.first_c),
            first_slope_v_per_um=float(1.0 / c[0]),
            first_break_um=np.inf if alone else float(self.later_knots[0] * c[0]),
            rest=Curve(self.later_knots[1:] - self.later_knots[:1], c[1:]),
        )
        for law in self.laws:
            branches = law.shape(branches)
        return branches

    def law_derivatives(self, loops: HalfLoops) -> FloatArray:
        """Derivative of every half loop's first slope by (first compliance, law parameters...)."""
        base = self.branches()
        slopes = [np.ones(len(loops))]
        if self.laws:
            # laws are linear in each of their parameters, or nearly: a central difference is exact
            def shifted(first: float, k: int | None = None, by: float = 0.0) -> FloatArray:
                laws = list(self.laws)
                if k is not None:
                    i, name = self.law_names[k]
                    laws[i] = laws[i].with_values(**{name: laws[i][name] + by})
                moved = replace(base, first_slope_v_per_um=first, laws=())
                for law in laws:
                    moved = law.shape(moved)
                return moved.first_slopes(loops)

            s1 = base.first_slope_v_per_um
            h = 1e-3 * s1
            slopes = [(shifted(s1 + h) - shifted(s1 - h)) / (2 * h)]
            for k in range(len(self.law_names)):
                h = 1e-6
                slopes.append((shifted(s1, k, h) - shifted(s1, k, -h)) / (2 * h))
            slopes[0] = -slopes[0] * s1 * s1  # by the first compliance
        return np.stack(slopes, axis=1)

    # -- the vector of unknowns: compliances, first compliance and law, then break points

    @property
    def q(self) -> int:
        """Parameters of the first slope, itself included."""
        return 1 + len(self.law_names) if self.by_law else 0

    def pack(self, knots: bool) -> FloatArray:
        """All unknowns in the order of `sums.columns` (a shared curve: once)."""
        if self.dx_um:
            x = replace(self, dx_um=0.0, shared=False).pack(False)
            if self.shared:
                x = self.first_c
            elif self.by_law:
                x = np.delete(x, self.first_c.size + self.q)
            return np.append(x, self.dx_um)
        if self.shared:
            return np.concatenate([self.first_c] + ([self.first_knots] if knots else []))
        if self.by_law:
            values = [self.laws[i][n] for i, n in self.law_names]
            later: list[FloatArray] = [
                np.array([self.later_c[0], *values]),
                np.array([self.later_knots[0] * self.later_c[0]]),
                self.later_c[1:],
            ]
            moving = self.later_knots[1:] - self.later_knots[0]
        else:
            later, moving = [self.later_c], self.later_knots
        return np.concatenate([self.first_c, *later, *([self.first_knots, moving] * knots)])

    def unpack(self, x: FloatArray, knots: bool) -> Curves:
        """The same fit with other unknowns."""
        n0, nc = self.first_c.size, self.later_c.size
        if self.dx_um:
            return self._spaced(x[:-1], float(x[-1]))
        if self.shared:
            b = x[n0:] if knots else self.first_knots
            return replace(self, first_c=x[:n0], first_knots=b, later_c=x[:n0], later_knots=2.0 * b)
        parts = iter(np.split(x, np.cumsum(self._lengths(knots))[:-1]))
        first_c = next(parts)
        laws = list(self.laws)
        rest = self.later_knots[1:] - self.later_knots[:1]
        if self.by_law:
            slope = next(parts)
            for (i, name), value in zip(self.law_names, slope[1:], strict=True):
                laws[i] = laws[i].with_values(**{name: float(value)})
            first_break = float(next(parts)[0])
            later_c = np.concatenate([slope[:1], next(parts)])
            first_knots = next(parts) if knots else self.first_knots
            rest = next(parts) if knots else rest
            start = first_break / slope[0]
            later_knots = np.concatenate([[start], start + rest])
        else:
            later_c = next(parts)
            first_knots = next(parts) if knots else self.first_knots
            later_knots = next(parts) if knots else self.later_knots
        assert later_c.size == nc
        return Curves(first_knots, first_c, later_knots, later_c, False, tuple(laws))

    def _spaced(self, x: FloatArray, dx: float) -> Curves:
        """The same fit with other compliances and break points at multiples of dx."""
        free = replace(self, dx_um=0.0)
        if self.by_law:
            x = np.insert(x, self.first_c.size + self.q, 2.0 * dx)
        moved = free.unpack(x, False)
        first = dx * np.cumsum(1.0 / moved.first_c)[:-1]
        later = 2.0 * dx * np.cumsum(1.0 / moved.later_c)[:-1]
        return replace(moved, first_knots=first, later_knots=later, dx_um=dx)

    def _lengths(self, knots: bool) -> list[int]:
        n0, nc = self.first_c.size, self.later_c.size
        if self.by_law:
            out = [n0, self.q, 1, nc - 1]
            return out + ([n0 - 1, nc - 2] if knots else [])
        return [n0, nc] + ([n0 - 1, nc - 1] if knots else [])

    def wide_size(self, knots: bool) -> int:
        """Columns that `sums.columns` makes."""
        return int(sum(self._lengths(knots)))

    def narrow(self, knots: bool) -> FloatArray | None:
        """Matrix (wide, narrow) from the unknowns to the columns; None where they agree."""
        if self.dx_um:
            return self._spacing()
        if not self.shared:
            return None
        n = self.first_c.size
        eye, out = np.eye(n), np.zeros((self.wide_size(knots), n + (n - 1) * knots))
        out[:n, :n] = eye
        out[n : 2 * n, :n] = eye
        if knots:
            out[2 * n : 3 * n - 1, n:] = np.eye(n - 1)
            out[3 * n - 1 :, n:] = 2.0 * np.eye(n - 1)
        return out

    def _spacing(self) -> FloatArray:
        """Derivative of all columns, break points included, by (compliances..., dx)."""
        n0, nc, q, dx = self.first_c.size, self.later_c.size, self.q, self.dx_um
        unknowns = n0 + 1 if self.shared else n0 + nc + max(q - 1, 0) + 1
        out = np.zeros((self.wide_size(True), unknowns))
        out[:n0, :n0] = np.eye(n0)
        start = 0 if self.shared else n0  # column of the first later compliance
        if self.by_law:
            out[n0 : n0 + q, n0 : n0 + q] = np.eye(q)
            out[n0 + q, -1] = 2.0
            out[n0 + q + 1 : n0 + q + nc, n0 + q : -1] = np.eye(nc - 1)
            start, rest, row = n0 + q, self.later_c[1:], n0 + q + nc
        else:
            out[n0 : n0 + nc, start : start + nc] = np.eye(nc)
            rest, row = self.later_c, n0 + nc

        def knots(row: int, column: int, c: FloatArray, step: float) -> None:
            below = np.tri(c.size - 1, c.size)
            out[row : row + c.size - 1, column : column + c.size] = -step * dx * below / c**2
            out[row : row + c.size - 1, -1] = step * np.cumsum(1.0 / c)[:-1]

        knots(row, 0, self.first_c, 1.0)
        knots(row + n0 - 1, start, rest, 2.0)
        return out

    def bounded(self, knots: bool) -> NDArray[np.bool_]:
        """Unknowns that must stay positive, shape (p,)."""
        if self.dx_um:
            flags = replace(self, dx_um=0.0).bounded(False)
            drop = [self.first_c.size + self.q] if self.by_law else np.empty(0, int)
            return np.append(np.delete(flags, drop), True)
        if self.shared:
            out = [True] * self.first_c.size + [False] * ((self.first_c.size - 1) * knots)
            return np.array(out)
        marks: list[bool] = []
        kinds = (True, False, True, True) if self.by_law else (True, True)
        for size, flag in zip_longest(self._lengths(knots), kinds, fillvalue=False):
            marks += [flag] * size
        if self.by_law:
            marks[self.first_c.size] = True
        return np.array(marks)

    def runs(self) -> tuple[tuple[int, int], ...]:
        """Where in the vector of unknowns the neighbouring compliances of a curve stand."""
        n0, nc = self.first_c.size, self.later_c.size
        if self.shared:
            return ((0, n0),)
        if self.by_law:
            start = n0 + self.q + (0 if self.dx_um else 1)
            return ((0, n0), (start, start + nc - 1))
        return ((0, n0), (n0, n0 + nc))

    def halved(self) -> tuple[Curves, FloatArray, FloatArray]:
        """The same fit with every band (but a law's first) cut into two.

        Returns
        -------
        curves : p' unknowns
        whole : shape (p', p), unknowns of the halves by those of this fit
        apart : shape (p', p), by the second half's compliance less the first's; 0 in columns
            that are no compliance of a run
        """
        kept = int(self.by_law)
        later = _halves(self.later_knots[kept:], self.later_knots[:kept])
        later_c = np.concatenate([self.later_c[:kept], np.repeat(self.later_c[kept:], 2)])
        first = _halves(self.first_knots, np.empty(0))
        curves = replace(
            self, first_knots=first, first_c=np.repeat(self.first_c, 2), later_c=later_c,
            later_knots=np.concatenate([self.later_knots[:kept], later]),
        )  # fmt: skip
        size = self.pack(False).size
        tied = np.zeros(size, bool)
        for a, b in self.runs():
            tied[a:b] = True
        owner = np.repeat(np.arange(size), np.where(tied, 2, 1))
        whole = np.eye(size)[owner]
        second = np.concatenate([[False], owner[1:] == owner[:-1]])
        apart = whole * np.where(second, 0.5, -0.5)[:, None] * tied
        return curves, whole, apart

    # -- tables

    def later_elements(self, reach_v: float) -> Elements:
        """Elements of the later branches; with an offset law the first constant is 0."""
        end = max(reach_v, 1.05 * float(self.later_knots[-1])) if self.later_knots.size else reach_v
        doubled = Elements.from_curve(np.append(self.later_knots, end), self.later_c)
        table = Elements(doubled.k_v_per_um, doubled.slides_at_um / 2.0)
        if any("offset" in s.units for s in self.laws):
            springs = table.k_v_per_um.copy()
            springs[0] = 0.0
            table = Elements(springs, table.slides_at_um)
        return table

    def first_elements(self, reach_v: float) -> Elements:
        """Elements of the first rise."""
        end = max(reach_v, 1.05 * float(self.first_knots[-1])) if self.first_knots.size else reach_v
        return Elements.from_curve(np.append(self.first_knots, end), self.first_c)

    def law_stages(self) -> Sequence[Stage]:
        """The law stages with the first slope's constant part moved into the first offset."""
        out, given = [], False
        for stage in self.laws:
            if "offset" in stage.units and not given:
                offset = 1.0 / self.later_c[0] - 1.0 / self.later_c[1]
                stage, given = stage.with_values(offset=float(offset)), True
            out.append(stage)
        return out


def _halves(knots: FloatArray, begin: FloatArray) -> FloatArray:
    """Break points with the middles of all bands; the last is as wide as the one before."""
    start = begin if begin.size else np.zeros(1)
    edges = np.concatenate([start, knots])
    width = np.diff(edges)
    ends = np.append(edges, edges[-1] + (width[-1] if width.size else 1.0))
    middles = 0.5 * (ends[1:] + ends[:-1])
    return np.sort(np.concatenate([knots, middles]))
