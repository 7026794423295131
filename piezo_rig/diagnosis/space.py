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
from piezo_rig.diagnosis.columns import Columns, Numbers
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.linear import Frame, Key, Layout, Linear, Rows
from piezo_rig.diagnosis.together import Together

FloatArray = NDArray[np.float64]
CLOCK = "clock"  # what a stage is locked to, and a column of the dictionary goes by


class _Row(NamedTuple):
    """Of one piece: what `Linear` holds of all."""

    cross: FloatArray
    own: FloatArray
    residual: FloatArray
    raw_cross: FloatArray
    raw_own: FloatArray
    raw_residual: FloatArray
    weight: float
    rows: Rows


@dataclass(eq=False)
class Space(Columns):
    """Columns, and the Gram matrices about points."""

    own_um: float = np.inf  # how far off a given model was where it was identified, rms
    law: FloatArray = field(default_factory=lambda: np.zeros(0))
    law_of: tuple[Key, tuple[Numbers, ...]] | None = None  # the stages it is about
    excluded: dict[str, str] = field(default_factory=dict)  # causes not looked for, and why
    longest: dict[str, float] = field(default_factory=dict)  # s, of causes that last: see `Cause`
    warm: dict[int, tuple[Point, float]] = field(default_factory=dict)  # see `warmth`
    _together: Together | None = None
    _tangent_of: tuple[Point, FloatArray] | None = None
    _linears: dict[int, tuple[Point, Linear]] = field(default_factory=dict)

    @property
    def together(self) -> Together:
        """The thinned drives of all groups."""
        if self._together is None:
            self._together = Together.of(self.groups)
        return self._together

    def with_measured(self, groups: Groups) -> Space:
        """The space of other recordings of the same drives, in the same noise: of the columns none
        depends on what was measured.
        """
        state = self.state() | {"groups": groups, "warm": {}, "_linears": {}}
        return Space(**state)

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
        """Products about a point: those of a point near by, if of the same columns.

        ``anew`` : stage whose parameters' columns are made about the point itself
        """
        if not near.rows or near.made_for != self.made_for:
            return self.linear(point)
        numbers = point.of_stage(anew)
        if numbers and near.model is not None:
            return self._with_columns(near, near.model, point, numbers)
        return near if near.model is point.model else self.with_residual(near, point)

    def linear(self, point: Point, trials: Sequence[tuple[Model, Model]] = ()) -> Linear:
        """Gram matrices about a point.

        Parameters
        ----------
        trials : pairs of models; each column is what the second does beyond the first
        """
        p = point.values().size
        layout = Layout(p, *self.counts, len(trials), len(point.coefficients))
        frame = self.frame(point)
        moving = self.moving(point, trials)

        def about(index: int) -> list[_Row]:
            return self._about(index, moving, len(point.others), frame)

        found = self.each_group(about)
        return Linear(
            layout, frame,
            np.array([r.cross for r in found]), np.array([r.own for r in found]),
            np.array([r.residual for r in found]), np.array([r.raw_cross for r in found]),
            np.array([r.raw_own for r in found]), np.array([r.raw_residual for r in found]),
            np.array([r.weight for r in found]), self._law, tuple(r.rows for r in found),
            self.made_for, point.model,
            held.most(self.pieces, self.fixed, self.counts, self.own_um),
            self.driven if _knows_a_trend(point) else None,
        )  # fmt: skip

    @property
    def driven(self) -> FloatArray:
        """Shape (generic,), 0 for columns of the dictionary that go by the clock, else 1."""
        return np.array([float(tag != CLOCK) for tag in self.tags])

    @property
    def _law(self) -> FloatArray:
        return self.law if self.law.size else np.zeros(self.counts[2])

    def _about(self, index: int, moving: FloatArray, base: int, frame: Frame) -> list[_Row]:
        """Products of one group's pieces."""
        group, out = self.groups.groups[index], []
        moving = moving[:, self.together.part(index)]
        for at, piece in enumerate(self.pieces):
            if piece.group != index:
                continue
            cut = moving[:, piece.begin : piece.end]
            bands, fixed = frame.bands[at], frame.fixed[at]
            white = self.whiten(cut, at)
            cross = np.concatenate([white @ bands.white.T, white @ fixed.white.T], axis=1)
            own = white @ white.T
            bare = piece.cells.centred(np.concatenate([cut[:base], cut[-1:]]))
            raw_cross = group.repeats * bare @ bands.raw.T
            raw_own = group.repeats * bare @ bare.T
            out.append(_Row(
                cross[:-1], own[:-1, :-1],
                np.concatenate([cross[-1], own[-1]]),
                raw_cross[:-1], raw_own[:-1, :-1],
                np.concatenate([raw_cross[-1], raw_own[-1]]),
                float(group.repeats * piece.cells.share.sum()),
                Rows(white[:base].copy(), bare[:-1], white[-1].copy(), bare[-1]),
            ))  # fmt: skip
        return out

    def with_residual(self, linear: Linear, point: Point) -> Linear:
        """The same tangent with the residual of a point near by (no trials)."""
        return self._with_residuals(linear, point, [None])[0]

    def left_out(self, linear: Linear, point: Point) -> list[Linear]:
        """As often as there are recordings: without one of every group in its mean."""
        return self._with_residuals(linear, point, list(range(self.groups.repeats)))

    def _with_residuals(
        self, linear: Linear, point: Point, leave: Sequence[int | None]
    ) -> list[Linear]:
        """``leave`` : number of the recording of every group that is left out of its mean."""

        def off(index: int) -> list[list[tuple[Rows, FloatArray, FloatArray]]]:
            group, made = self.groups.groups[index], []
            left = np.array([
                group.measured_um[rows].mean(axis=0) - group.predicted_of(point.model, rows)
                for rows in (group.without(k) for k in leave)
            ])  # fmt: skip
            left = self.groups.thinned(group, left)
            for at, piece in enumerate(self.pieces):
                if piece.group != index:
                    continue
                cut, own = left[:, piece.begin : piece.end], linear.rows[at]
                bands, fixed = linear.frame.bands[at], linear.frame.fixed[at]
                white, raw = self.whiten(cut, at), piece.cells.centred(cut)
                of_white = np.hstack([white @ x.T for x in (bands.white, fixed.white, own.white)])
                of_raw = np.hstack([raw @ x.T for x in (bands.raw, own.raw)])
                made.append([
                    (own._replace(left=r, raw_left=bare), np.append(w, r @ r),
                     group.repeats * np.append(b, bare @ bare))
                    for r, bare, w, b in zip(white, raw, of_white, of_raw, strict=True)
                ])  # fmt: skip
            return made

        found = zip(*self.each_group(off), strict=True)
        return [
            replace(
                linear, rows=tuple(rows), residual=np.array(white), raw_residual=np.array(raw),
                model=point.model if k is None else None,
            )
            for k, (rows, white, raw) in zip(
                leave, (zip(*each, strict=True) for each in found), strict=True
            )
        ]  # fmt: skip

    def _with_columns(
        self, near: Linear, before: Model, point: Point, numbers: Sequence[int]
    ) -> Linear:
        """The same with some columns and the residual about another point (no trials).

        ``before`` : the model that the known residual is of. What lies between the two is played
        thinned, as tangents are.
        """
        here, frame, data = [j - point.compliances for j in numbers], near.frame, self.together
        change = (data.predicted(point.model) - data.predicted(before))[data.inside]
        every = np.vstack([point.tangent(data, numbers), change])

        def about(index: int) -> list[tuple[Rows, FloatArray, FloatArray]]:
            out, moved = [], every[:, data.part(index)]
            for at, piece in enumerate(self.pieces):
                if piece.group != index:
                    continue
                cut, known = moved[:, piece.begin : piece.end], near.rows[at]
                w, r = self.whiten(cut, at), piece.cells.centred(cut)
                white, raw = known.white.copy(), known.raw.copy()
                white[here], raw[here] = w[:-1], r[:-1]
                out.append((
                    Rows(white, raw, known.left - w[-1], known.raw_left - r[-1]),
                    np.hstack([w @ frame.bands[at].white.T, w @ frame.fixed[at].white.T]),
                    frame.recordings[at] * r @ frame.bands[at].raw.T,
                ))  # fmt: skip
            return out

        cross, own, residual = near.cross.copy(), near.own.copy(), near.residual.copy()
        raw_cross, raw_own = near.raw_cross.copy(), near.raw_own.copy()
        raw_residual, kept = near.raw_residual.copy(), list[Rows]()
        m, b = cross.shape[2], raw_cross.shape[2]
        for at, (rows, of_frame, of_bands) in enumerate(self.each_group(about)):
            kept.append(rows)
            cross[at, here], raw_cross[at, here] = of_frame[:-1], of_bands[:-1]
            residual[at, :m] -= of_frame[-1]
            raw_residual[at, :b] -= of_bands[-1]
            both = np.vstack([rows.white, rows.left])
            bare, times = np.vstack([rows.raw, rows.raw_left]), frame.recordings[at]
            own[at, here] = rows.white[here] @ rows.white.T
            own[at, :, here] = own[at, here]
            raw_own[at, here] = times * rows.raw[here] @ rows.raw.T
            raw_own[at, :, here] = raw_own[at, here]
            residual[at, m:] = both @ rows.left
            raw_residual[at, b:] = times * bare @ rows.raw_left
        return replace(
            near, cross=cross, own=own, residual=residual, raw_cross=raw_cross, raw_own=raw_own,
            raw_residual=raw_residual, rows=tuple(kept), model=point.model, law=self._law, axes={},
        )  # fmt: skip

    def moving(
        self, point: Point, trials: Sequence[tuple[Model, Model]]
    ) -> FloatArray:
        """Thinned tangent of all but the bands, trial signatures, residual of all groups."""
        tangent, data = self._tangent(point), self.together
        out = np.empty((len(tangent) + len(trials) + 1, tangent.shape[1]))
        out[: len(tangent)] = tangent
        for before in {id(before): before for before, _ in trials}.values():
            own = [k for k, (other, _) in enumerate(trials) if other is before]
            out[[len(tangent) + k for k in own]] = data.changes(
                data.remembered(before), [trials[k][1] for k in own]
            )

        def left(index: int) -> list[None]:
            group = self.groups.groups[index]
            off = group.measured_um.mean(axis=0) - group.predicted(point.model)
            out[-1, data.part(index)] = self.groups.thinned(group, off)
            return []

        self.each_group(left)
        return out

    def _tangent(self, point: Point) -> FloatArray:
        """Thinned tangent of all but the bands; that of the latest point is kept."""
        if self._tangent_of is None or self._tangent_of[0] is not point:
            self._tangent_of = point, point.tangent(self.together, point.others)
        return self._tangent_of[1]


def _knows_a_trend(point: Point) -> bool:
    """Whether a stage that goes by the clock is fitted: what does so has a name."""
    fitted = {id for id, _ in point.names}
    return any(s.id in fitted and s.locked_to == CLOCK for s in point.model.stages)
