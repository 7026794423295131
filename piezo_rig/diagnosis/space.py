"""The whitened space in which everything is decided, and its reduction to small matrices.

About a point the columns of `columns.Columns` are joined by its tangent and the residual, and their
Gram matrices kept. After that, refits, tests and bootstraps are linear algebra on a few hundred
rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis import held
from piezo_rig.diagnosis.columns import Columns
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.linear import Bands, Layout, Linear, Rows, assembled, joined

FloatArray = NDArray[np.float64]


class _Row(NamedTuple):
    """Of one piece: what `Linear` holds of all."""

    white: FloatArray
    residual: FloatArray
    raw: FloatArray
    weight: float
    rows: Rows


@dataclass(eq=False)
class Space(Columns):
    """Columns, and the Gram matrices about points."""

    own_um: float = np.inf  # how far off a given model was where it was identified, rms
    law: FloatArray = field(default_factory=lambda: np.zeros(0))
    law_of: Model | None = None
    excluded: dict[str, str] = field(default_factory=dict)  # causes not looked for, and why
    longest: dict[str, float] = field(default_factory=dict)  # s, of causes that last: see `Cause`
    _tangents: dict[int, tuple[Group, Point, FloatArray]] = field(default_factory=dict)
    _linears: dict[int, tuple[Point, Linear]] = field(default_factory=dict)

    def keep(self, point: Point, linear: Linear) -> None:
        """Hold the matrices about a point; those of the latest few are, for they are large."""
        self._linears.pop(id(point), None)
        while len(self._linears) >= self.most_kept:
            self._linears.pop(next(iter(self._linears)))
        self._linears[id(point)] = point, linear  # the point too, so that its id stays its own

    def kept(self, point: Point) -> Linear | None:
        """The matrices about a point, if they are still held."""
        known = self._linears.get(id(point))
        return known[1] if known is not None else None

    def about(self, point: Point, near: Linear, anew: str = "") -> Linear:
        """Gram matrices about a point: those of a point near by, if of the same columns.

        ``anew`` : stage whose parameters' columns are made about the point itself
        """
        if not near.rows or near.made_for != self.made_for:
            return self.linear(point)
        numbers = point.of_stage(anew)
        return self._with_columns(near, point, numbers) if numbers else near

    def linear(self, point: Point, trials: Sequence[tuple[Model, Model]] = ()) -> Linear:
        """Gram matrices about a point.

        Parameters
        ----------
        trials : pairs of models; each column is what the second does beyond the first
        """
        p = point.values().size
        layout = Layout(p, *self.counts, len(trials), len(point.coefficients))
        bands = self.bands(point)
        point.neighbours(point.others)  # known before threads ask for them

        def about(index: int) -> list[_Row]:
            return self._about(index, point, trials, bands)

        found = self.each_group(about)
        law = self.law if self.law.size else np.zeros(self.counts[2])
        return Linear(
            layout, tuple(r.white for r in found), tuple(r.residual for r in found),
            tuple(r.raw for r in found),
            np.array([r.weight for r in found]), law, tuple(r.rows for r in found), self.made_for,
            held.most(self.pieces, self.fixed, self.counts, self.own_um),
        )  # fmt: skip

    def _about(
        self, index: int, point: Point, trials: Sequence[tuple[Model, Model]], bands: list[Bands]
    ) -> list[_Row]:
        """Gram matrices of one group's pieces."""
        group, p, out = self.groups.groups[index], point.values().size, []
        moving = self.moving(group, point, trials)
        for at, piece in enumerate(self.pieces):
            if piece.group != index:
                continue
            cut = moving[:, piece.begin : piece.end]
            fixed, base = self.fixed[at], bands[at]
            k = len(base.white)
            white = self.whiten(cut, at)
            known = base.white @ white.T
            gram = joined(base.gram, known, white @ white.T)
            cross = np.concatenate([base.cross, white @ fixed.white.T])
            own = piece.cells.centred(np.concatenate([cut[: p - k], cut[-1:]]))
            known = base.raw @ own.T
            out.append(_Row(
                assembled(gram[:-1, :-1], cross[:-1], fixed.gram, p),
                np.concatenate([gram[-1, :p], cross[-1], gram[-1, p:]]),
                group.repeats * joined(base.raw_gram, known, own @ own.T),
                float(group.repeats * piece.cells.share.sum()),
                Rows(base, white[: p - k].copy(), own[:-1]),
            ))  # fmt: skip
        return out

    def with_residual(self, linear: Linear, point: Point, leave: int | None = None) -> Linear:
        """The same tangent with the residual of a point near by (no trials).

        ``leave`` : number of the recording of every group that is left out of its mean
        """
        residual, raws, at = list[FloatArray](), list[FloatArray](), 0
        p = linear.layout.base
        for index, group in enumerate(self.groups.groups):
            rows = list(range(group.repeats))
            if leave is not None and group.repeats > 1:
                rows.pop(leave % group.repeats)
            predicted = group.predicted_of(point.model, rows)
            left = group.measured_um[rows].mean(axis=0) - predicted
            left = self.groups.thinned(group, left)
            for piece in self.pieces:
                if piece.group != index:
                    continue
                cut = left[piece.begin : piece.end]
                r = self.whiten(cut[None], at)[0]
                base, own, bare = linear.rows[at]
                residual.append(np.concatenate(
                    [base.white @ r, own @ r, self.fixed[at].white @ r, [r @ r]]
                ))  # fmt: skip
                cut = piece.cells.centred(cut[None])[0]
                cross = group.repeats * np.concatenate([base.raw @ cut, bare @ cut])
                raw = linear.raw[at].copy()
                raw[:p, -1] = raw[-1, :p] = cross
                raw[-1, -1] = group.repeats * cut @ cut
                raws.append(raw)
                at += 1
        return replace(linear, residual=tuple(residual), raw=tuple(raws))

    def _with_columns(self, near: Linear, point: Point, numbers: Sequence[int]) -> Linear:
        """The same with some columns about another point (no trials; the residual is not)."""
        first, p, each = point.compliances, near.layout.base, list(numbers)
        point.neighbours(each)  # known before threads ask for them

        def about(index: int) -> list[tuple[Rows, FloatArray, FloatArray]]:
            group, out = self.groups.groups[index], []
            short, inside = self.groups.short(group)
            tangent = point.tangent(short, each)[:, inside]
            for at, piece in enumerate(self.pieces):
                if piece.group != index:
                    continue
                cut = tangent[:, piece.begin : piece.end]
                bands, white, raw = near.rows[at]
                white, raw = white.copy(), raw.copy()
                gram, raw_gram = near.white[at].copy(), near.raw[at].copy()
                here = [j - first for j in each]
                white[here], raw[here] = self.whiten(cut, at), piece.cells.centred(cut)
                w, r = white[here].T, raw[here].T
                gram[:, each] = np.concatenate([bands.white @ w, white @ w,
                                                self.fixed[at].white @ w])  # fmt: skip
                gram[each] = gram[:, each].T
                raw_gram[:p, each] = group.repeats * np.concatenate([bands.raw @ r, raw @ r])
                raw_gram[each, :p] = raw_gram[:p, each].T
                out.append((Rows(bands, white, raw), gram, raw_gram))
            return out

        found = self.each_group(about)
        law = self.law if self.law.size else np.zeros(self.counts[2])
        return replace(
            near, white=tuple(g for _, g, _ in found), raw=tuple(r for *_, r in found),
            rows=tuple(rows for rows, *_ in found), law=law, axes={},
        )  # fmt: skip

    def moving(
        self, group: Group, point: Point, trials: Sequence[tuple[Model, Model]]
    ) -> FloatArray:
        """Thinned tangent of all but the bands, trial signatures, residual of one group."""
        short, inside = self.groups.short(group)
        tangent = self._tangent(group, point)
        out = np.empty((len(tangent) + len(trials) + 1, int(inside.sum())))
        out[: len(tangent)] = tangent
        for before in {id(before): before for before, _ in trials}.values():
            base = short.remembered(before)
            for k, (other, after) in enumerate(trials):
                if other is before:
                    out[len(tangent) + k] = (short.predicted_once(after) - base)[inside]
        left = group.measured_um.mean(axis=0) - group.predicted(point.model)
        out[-1] = self.groups.thinned(group, left)
        return out

    def _tangent(self, group: Group, point: Point) -> FloatArray:
        """Thinned tangent of all but the bands; that of the latest point is kept."""
        latest = self._tangents.get(id(group))
        if latest is None or latest[0] is not group or latest[1] is not point:
            short, inside = self.groups.short(group)
            tangent = point.tangent(short, point.others)
            latest = group, point, tangent[:, inside]
            self._tangents[id(group)] = latest
        return latest[2]
