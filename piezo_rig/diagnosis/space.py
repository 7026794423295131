"""The whitened space in which everything is decided, and its reduction to small matrices.

Per piece of the data (a block with one free offset) the columns are thinned, whitened and their
Gram matrices kept. What never changes (powers, fine thresholds, dictionary) is whitened once.
After that, refits, tests and bootstraps are linear algebra on a few hundred rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model, Stage
from piezo_rig.diagnosis import dictionary
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.noise import Whitener

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """Thinned samples begin..end of one block of one group; ``fold`` is held out together."""

    group: int
    begin: int
    end: int
    fold: int


@dataclass(frozen=True, eq=False)
class Fixed:
    """Columns that do not depend on the model's numbers, of one piece.

    ``white`` (m, n) whitened: powers, fine, generic; ``gram`` (m, m) of it; ``raw`` (m, n)
    unwhitened and centred, for sizes in nm.
    """

    white: NDArray[np.float32]
    gram: FloatArray
    raw: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where which columns are: base, powers, fine, generic, trials, residual."""

    base: int
    powers: int
    fine: int
    generic: int
    trials: int

    def part(self, name: str) -> slice:
        at = 0
        for key in ("base", "powers", "fine", "generic", "trials"):
            n = int(getattr(self, key))
            if key == name:
                return slice(at, at + n)
            at += n
        return slice(at, at + 1)  # residual


@dataclass(frozen=True, eq=False)
class Linear:
    """Gram matrices about one point, per piece.

    Attributes
    ----------
    white : shape (k, c, c), columns as `Layout` says, last the residual
    raw : shape (k, p + 1, p + 1), unwhitened base columns and residual, um^2 summed over samples
    count : shape (k,), recordings x thinned samples
    law : shape (generic,), variance of each dictionary column that the freedom of the accepted
        causes' assumed laws gives it, um^2
    rows : per piece the whitened and the unwhitened base columns, for another residual
    """

    layout: Layout
    white: FloatArray
    raw: FloatArray
    count: FloatArray
    law: FloatArray
    rows: tuple[tuple[FloatArray, FloatArray], ...] = ()


@dataclass(eq=False)
class Space:
    """Data, whitener and fixed columns together."""

    groups: Groups
    pieces: tuple[Piece, ...]
    whitener: Whitener
    scales: Scales
    first_rise: bool  # whether the model has an own curve for the first rise
    tags: list[str] = field(default_factory=list)
    fixed: list[Fixed] = field(default_factory=list)
    counts: tuple[int, int, int] = (0, 0, 0)
    law: FloatArray = field(default_factory=lambda: np.zeros(0))
    _made_for: tuple[object, ...] = ()

    def prepare(self, model: Model) -> None:
        """Build and whiten the fixed columns; ``model`` predicts where on its way the sensor is."""
        key = (
            self.first_rise,
            *(
                (s.id, *(round(p.value, 12) for p in s.parameters.values()))
                for s in model.stages
                if type(s).act is not Stage.act
            ),
        )
        if self.fixed and key == self._made_for:
            return
        self._made_for = key
        self.fixed = []
        for index, group in enumerate(self.groups.groups):
            mine = [p for p in self.pieces if p.group == index]
            predicted = group.predicted(model)
            f = dictionary.features(group, self.scales, predicted)
            plays = dictionary.fine(group, self.scales, self.first_rise)
            columns = np.concatenate(
                [
                    dictionary.powers(group, self.scales),
                    dictionary.smooth(plays, self.scales, self.first_rise),
                    plays,
                ]
            )
            if group.blocks == ((0, group.drive_v.size),):
                # later stages are slow or smooth: thinned columns go through them as well
                thin = self.groups.thinned
                short = replace(
                    group, time_s=thin(group, group.time_s), drive_v=thin(group, group.drive_v)
                )
                moved = dictionary.through(model, short, thin(group, columns))
            else:
                moved = self.groups.thinned(group, dictionary.through(model, group, columns))
            bend, fine = moved[: -plays.shape[0]], moved[-plays.shape[0] :]
            made, self.tags = dictionary.generic(group, self.scales, f)
            generic = self.groups.thinned(group, made)
            self.counts = (bend.shape[0], fine.shape[0], generic.shape[0])
            columns = np.concatenate([bend, fine, generic])
            weight = np.sqrt(group.repeats)
            for piece in mine:
                cut = columns[:, piece.begin : piece.end]
                white = self.whiten(cut, weight)
                raw = cut - cut.mean(axis=1, keepdims=True)
                # Gram matrices of exactly what is kept: what the base leaves of these columns is
                # far smaller than the columns, and must not drown in mixed roundings
                rows = white.astype(np.float32)
                white = rows.astype(float)
                self.fixed.append(Fixed(rows, white @ white.T, raw.astype(np.float32)))

    def whiten(self, rows: FloatArray, weight: float) -> FloatArray:
        """Whitened rows with the piece's offset projected out."""
        one = self.whitener(np.ones(rows.shape[1]))
        white = self.whitener(rows)
        return weight * (white - np.outer(white @ one, one) / float(one @ one))

    def linear(self, point: Point, trials: Sequence[tuple[Model, Model]] = ()) -> Linear:
        """Gram matrices about a point.

        Parameters
        ----------
        trials : pairs of models; each column is what the second does beyond the first
        """
        p = point.values().size if not point.fixed else 0
        layout = Layout(p, *self.counts, len(trials))
        whites, raws, counts, rows = [], [], [], []
        at = 0
        for index, group in enumerate(self.groups.groups):
            moving = self.moving(group, point, trials)
            for piece in self.pieces:
                if piece.group != index:
                    continue
                cut = moving[:, piece.begin : piece.end]
                fixed = self.fixed[at]
                at += 1
                weight = np.sqrt(group.repeats)
                white = self.whiten(cut, weight)
                cross = white @ fixed.white.T.astype(float)
                whites.append(_assembled(white @ white.T, cross, fixed.gram, p, len(trials)))
                own = np.concatenate([cut[:p], cut[-1:]])
                own = own - own.mean(axis=1, keepdims=True)
                raws.append(group.repeats * own @ own.T)
                counts.append(float(group.repeats * cut.shape[1]))
                rows.append((white[:p], own[:p]))
        law = self.law if self.law.size else np.zeros(self.counts[2])
        return Linear(layout, np.array(whites), np.array(raws), np.array(counts), law, tuple(rows))

    def with_residual(self, linear: Linear, point: Point) -> Linear:
        """The same tangent with the residual of a point near by (no trials)."""
        white, raw, at = linear.white.copy(), linear.raw.copy(), 0
        p = linear.layout.base
        for index, group in enumerate(self.groups.groups):
            left = group.measured_um.mean(axis=0) - group.predicted(point.model)
            left = self.groups.thinned(group, left)
            for piece in self.pieces:
                if piece.group != index:
                    continue
                cut = left[piece.begin : piece.end]
                r = self.whiten(cut[None], np.sqrt(group.repeats))[0]
                columns, own = linear.rows[at]
                cross = np.concatenate([columns @ r, self.fixed[at].white.astype(float) @ r])
                white[at, :-1, -1] = white[at, -1, :-1] = cross
                white[at, -1, -1] = r @ r
                cut = cut - cut.mean()
                raw[at, :p, -1] = raw[at, -1, :p] = group.repeats * own @ cut
                raw[at, -1, -1] = group.repeats * cut @ cut
                at += 1
        return replace(linear, white=white, raw=raw)

    def moving(
        self, group: Group, point: Point, trials: Sequence[tuple[Model, Model]]
    ) -> FloatArray:
        """Thinned base tangent, trial signatures, residual of one group; (p + t + 1, m)."""
        if point.fixed:
            predicted = group.predicted(point.model)
            tangent = np.empty((0, predicted.size))
        else:
            predicted, tangent = point.tangent(group)
        rows = [tangent]
        known: dict[int, FloatArray] = {id(point.model): predicted}
        for before, after in trials:
            if id(before) not in known:
                known[id(before)] = group.predicted(before)
            rows.append((group.predicted(after) - known[id(before)])[None])
        mean = group.measured_um.mean(axis=0)
        rows.append((mean - predicted)[None])
        return self.groups.thinned(group, np.concatenate(rows))


def _assembled(own: FloatArray, cross: FloatArray, fixed: FloatArray, p: int, t: int) -> FloatArray:
    """Columns in the order base, fixed, trials, residual."""
    m = fixed.shape[0]
    out = np.empty((p + m + t + 1, p + m + t + 1))
    mine = np.concatenate([np.arange(p), np.arange(p + m, p + m + t + 1)])
    theirs = np.arange(p, p + m)
    out[np.ix_(mine, mine)] = own
    out[np.ix_(mine, theirs)] = cross
    out[np.ix_(theirs, mine)] = cross.T
    out[np.ix_(theirs, theirs)] = fixed
    return out
