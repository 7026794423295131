"""The columns of the whitened space: what a base, fine thresholds and a dictionary can explain.

Per piece of the data (a block with one free offset) they are thinned, whitened and multiplied with
each other. Those that do not depend on a model are made once; the actuator's go through the
model's other stages, and are made anew when those have changed by more than a little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import NEAR, Cause
from piezo_rig.chain import Model, Signal, Stage
from piezo_rig.chain.stage import Wider
from piezo_rig.diagnosis import basis, dictionary, held
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.left_before import left_before
from piezo_rig.diagnosis.linear import Bands, Fixed, Frame, Key, Piece, joined, no_bands, no_columns
from piezo_rig.diagnosis.right_angles import Kept, factor_of
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
LEAST_KEPT, MOST_KEPT = 2, 6  # sets of columns
OF_DRIVES = 4  # columns of drives of each group: with a first rise and without, twice
KEPT = 100_000  # thinned samples of all that are kept: a GB
SAME_KNOTS = 1e-6  # V
Made = TypeVar("Made")
Numbers = tuple[tuple[float, ...], tuple[float, ...], float]


@dataclass(eq=False)
class Columns:
    """Data, whitener and the columns that are prepared for a model."""

    groups: Groups
    pieces: tuple[Piece, ...]
    whitener: CellWhitener
    scales: Scales
    first_rise: bool  # whether the model has an own curve for the first rise
    held: bool = False  # whether the model is held fixed: nothing of it follows the data
    loose: bool = False  # whether it may all the same be wrong by a bend and a smooth density
    bare: bool = False  # whether there are none: for least squares on compliances alone
    tags: list[str] = field(default_factory=list)
    fixed: list[Fixed] = field(default_factory=list)
    generic: list[Fixed] = field(default_factory=list)
    counts: tuple[int, int, int] = (0, 0, 0)
    made_for: Key = ()  # which columns they are now
    still: bool = False  # whether they stay what they are, whatever the model
    _prepared: Model | None = None
    _known: dict[Key, tuple[Model, list[Fixed], tuple[int, int, int]]] = field(default_factory=dict)
    _frames: dict[Key, Frame] = field(default_factory=dict)
    _of_given: dict[Key, Any] = field(default_factory=dict)
    _knots: list[FloatArray] = field(default_factory=list)

    @property
    def most_kept(self) -> int:
        """How many sets of columns are kept: fewer of long data, for they are large."""
        samples = sum(p.end - p.begin for p in self.pieces)
        return int(np.clip(KEPT // max(samples, 1), LEAST_KEPT, MOST_KEPT))

    def state(self) -> dict[str, Any]:
        """All that changes as models come and go, to `restore`."""
        return {k: copy(v) if isinstance(v, dict | list) else v for k, v in vars(self).items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        vars(self).update(state)

    @contextmanager
    def as_it_is(self) -> Iterator[None]:
        """For looks at other models by the same columns."""
        before, self.still = self.still, True
        try:
            yield
        finally:
            self.still = before

    @property
    def noise_nm(self) -> float:
        """Noise of one recording at the thinned rate, rms."""
        return 1e3 * self.whitener.spectrum.rms_um

    @property
    def sample_noise_nm(self) -> float:
        """Noise of one recording sample by sample, rms, as errors are counted."""
        if self.whitener.samples is not None:
            return 1e3 * self.whitener.samples.spectrum.rms_um
        return float(np.sqrt(self.groups.factor)) * self.noise_nm

    def prepare(self, model: Model) -> None:
        """Build and whiten the fixed columns; ``model`` predicts where on its way the sensor is.

        The dictionary is made once. The actuator's columns go through the model's other stages,
        and are made anew when those have changed by more than a little. The bands of the tables
        go through the same ones: a difference between the two would hold a share of a cause.
        """
        key = self._key_near(model)
        if self.fixed and (self.still or key == self.made_for):
            return
        self.made_for = key
        if key in self._known:
            self._prepared, self.fixed, self.counts = self._known[key]
            return
        self._prepared = model
        if self.bare:
            self.fixed = [no_columns(p.end - p.begin) for p in self.pieces]
            self._known[key] = (model, self.fixed, self.counts)
            return
        if not self.generic:
            self._make_generic(model)
        while len(self._known) >= self.most_kept:
            old = next(iter(self._known))
            self._known.pop(old)
            self._frames = {k: v for k, v in self._frames.items() if k[0] != old}
        self._forget_oldest()
        every = [_driven(group, model) for group in self.groups.groups]
        tight = self.held and not self.loose
        left = held.bends_left(self.groups, every, model, self.scales) if tight else []

        def of(index: int) -> list[tuple[int, Kept]]:
            group, made = self.groups.groups[index], []
            powers, plays = self._of_drive(index, every[index], model)
            if tight:
                columns = np.concatenate([left[index], plays])
            else:
                smooth = dictionary.smooth(plays, self.scales, self.first_rise)
                columns = np.concatenate([powers, smooth, plays])
            moved = self._carried(model, group, columns)
            bends = moved.shape[0] - plays.shape[0]
            for at, piece in enumerate(self.pieces):
                if piece.group == index:
                    made.append((bends, self._kept(moved[:, piece.begin : piece.end], at)))
            return made

        found = self.each_group(of)
        bends, actuators = found[0][0] if found else 0, [kept for _, kept in found]
        found.clear()
        self.fixed = self._beside_dictionary(actuators, model if tight else None)
        fine = self.fixed[0].white.shape[0] - bends - len(self.tags) if self.fixed else 0
        self.counts = (bends, fine, len(self.tags))
        self._known[key] = (model, self.fixed, self.counts)

    def _beside_dictionary(self, actuators: list[Kept], given: Model | None) -> list[Fixed]:
        """Columns of every piece; those of a ``given`` model less most of what is like a factor.

        ``actuators`` : is emptied, for all of them twice are too many
        """
        others = [(g.white, g.raw) for g in self.generic]
        if given is not None:
            factor = factor_of(self.groups, self.pieces, given, self.whiten)
            actuators, others = factor.off(actuators), factor.off(others)
        out = []
        for (w, r), generic in zip(others, self.generic, strict=True):
            white, raw = actuators.pop(0)
            own = generic.gram if given is None else w @ w.T
            gram = joined(white @ white.T, white @ w.T, own)
            out.append(Fixed(np.concatenate([white, w]), gram, np.concatenate([raw, r])))
        return out

    def frame(self, point: Point) -> Frame:
        """Bands of a point's tables and fixed columns, as of the model that was prepared."""
        assert self._prepared is not None
        key = (self.made_for, *self._tables(point.tables), *left_before(point.model))
        if key not in self._frames:
            while len(self._frames) > self.most_kept:
                self._frames.pop(next(iter(self._frames)))
            recordings = tuple(self.groups.groups[p.group].repeats for p in self.pieces)
            self._frames[key] = Frame(
                tuple(self._bands_of(point)), tuple(self.fixed), recordings, self.counts
            )
        return self._frames[key]

    def _bands_of(self, point: Point) -> list[Bands]:
        """Derivatives by the compliances, piece by piece."""
        assert self._prepared is not None
        if not point.tables:
            return [no_bands(p.end - p.begin, len(f.white))
                    for p, f in zip(self.pieces, self.fixed, strict=True)]  # fmt: skip
        self._forget_oldest()
        model = _with_tables(self._prepared, point.model)
        tables = self._tables(model.stages)
        mine = np.concatenate([
            np.full(len(s.elements), s.id not in point.fixed)
            for s in model.stages if s.elements is not None
        ])  # fmt: skip

        def of(index: int) -> list[Bands]:
            group, made = self.groups.groups[index], []
            free = self._bare_bands(index, model, tables)[mine]
            moved = self._carried(model, group, free)
            for at, piece in enumerate(self.pieces):
                if piece.group != index:
                    continue
                cut = moved[:, piece.begin : piece.end]
                white, raw = self.whiten(cut, at), piece.cells.centred(cut)
                fixed = self.fixed[at].white
                made.append(Bands(white, raw, white @ white.T, raw @ raw.T, white @ fixed.T))
            return made

        return self.each_group(of)

    def whiten(self, rows: FloatArray, at: int) -> FloatArray:
        """Rows of one piece, whitened, its offset projected out."""
        piece = self.pieces[at]
        white = self.whitener.beside_offset(rows, piece.cells)
        white *= np.sqrt(self.groups.groups[piece.group].repeats)
        return white

    def _of_drive(
        self, index: int, driven: Group, model: Model
    ) -> tuple[FloatArray, FloatArray]:
        """Powers and fine thresholds of a group's drive as it is delivered, thinned."""
        slid, wider = _as_sliders_see(driven, model)

        def made() -> tuple[FloatArray, FloatArray]:
            plays = dictionary.fine(slid, self.scales, self.first_rise, model, wider)
            powers = dictionary.powers(driven, self.scales)
            return self.groups.thinned(driven, powers), self.groups.thinned(driven, plays)

        if wider is not None or slid is not self.groups.groups[index]:
            return made()
        return self._kept_of(("drive", index, self.first_rise, left_before(model)), made)

    def _bare_bands(self, index: int, model: Model, tables: Key) -> FloatArray:
        """Thinned displacement of the bands of all tables before any stage acts on it."""
        group = self.groups.groups[index]

        def made() -> FloatArray:
            return self.groups.thinned(group, basis.bands(model, group))

        if any(s.place == "drive" or s.moves_sliders for s in model.stages):
            return made()
        left = left_before(model)
        return self._kept_of(("bands", index, tables, model.branches().keeps_ties, left), made)

    def _kept_of(self, key: Key, make: Callable[[], Made]) -> Made:
        """What is known of the given drives by a key, else what ``make`` makes."""
        if key not in self._of_given:
            self._of_given[key] = make()
        found: Made = self._of_given[key]
        return found

    def _forget_oldest(self) -> None:
        """Make room for a set of every group, before it is asked for."""
        while len(self._of_given) > max(self.most_kept, OF_DRIVES) * len(self.groups.groups):
            self._of_given.pop(next(iter(self._of_given)))

    def _key_near(self, model: Model) -> Key:
        """The key of known columns that are near enough to a model's, else the model's own."""
        stages = [
            s for s in model.stages
            if s in model.remembering or s.moves_sliders
            or (dictionary.carries(s) and s.locked_to == "drive")
        ]  # fmt: skip
        key = (
            (self.first_rise, self.held, self.loose),
            tuple(s.id for s in stages),
            tuple(numbers_of(s) for s in stages),
        )
        for known in (self.made_for, *self._known):
            if known[:2] == key[:2] and near_to(known[2], key[2]):
                return known
        return key

    def _make_generic(self, model: Model) -> None:
        tags: dict[int, list[str]] = {}

        def of(index: int) -> list[Fixed]:
            group, out = self.groups.groups[index], []
            f = dictionary.features(group, self.scales, group.predicted(model))
            made, tags[index] = dictionary.generic(group, self.scales, f)
            generic = self.groups.thinned(group, made)
            for at, piece in enumerate(self.pieces):
                if piece.group == index:
                    white, raw = self._kept(generic[:, piece.begin : piece.end], at)
                    out.append(Fixed(white, white @ white.T, raw))
            return out

        self.generic = self.each_group(of)
        self.tags = tags[0]

    def _kept(self, cut: FloatArray, at: int) -> Kept:
        """Columns of one piece, whitened, and unwhitened and centred.

        What the base leaves of them is far smaller than they are: the white ones stay exact.
        """
        return self.whiten(cut, at), self.pieces[at].cells.centred(cut).astype(np.float32)

    def each_group(self, make: Callable[[int], list[Made]]) -> list[Made]:
        """What ``make`` makes of every group."""
        return [row for index in range(len(self.groups.groups)) for row in make(index)]

    def _tables(self, stages: Sequence[Stage]) -> Key:
        """A number for the break points of every table; the same for those that rounding moved."""
        return tuple(self._number(s.elements.knots_v) for s in stages if s.elements is not None)

    def _number(self, knots: FloatArray) -> int:
        for k, known in enumerate(self._knots):
            if known.shape == knots.shape and np.max(np.abs(known - knots)) < SAME_KNOTS:
                return k
        self._knots.append(knots)
        return len(self._knots) - 1

    def _carried(self, model: Model, group: Group, columns: FloatArray) -> FloatArray:
        """Thinned changes of the actuator's displacement as the sensor shows them."""
        if group.blocks != ((0, group.drive_v.size),):
            # cut-out stretches: the stages after the actuator act on what is left of each
            return np.concatenate(
                [
                    dictionary.through(model, self._short(group, a, b), columns[:, i:j])
                    for (a, b), (i, j) in zip(
                        group.blocks, self.groups.edges(group), strict=True
                    )
                ],
                axis=1,
            )
        return dictionary.through(model, self._short(group, *group.blocks[0]), columns)

    def _short(self, group: Group, begin: int, end: int) -> Group:
        """A stretch of a group at the thinned rate."""
        whole = replace(group, blocks=((begin, end),))
        whole = replace(whole, reads=group.reads_between(begin, end))
        thin = self.groups.thinned
        time = thin(whole, group.time_s)
        return replace(
            whole, time_s=time, drive_v=thin(whole, group.drive_v), denser=None,
            blocks=((0, time.size),),
        )


def numbers_of(stage: Stage) -> Numbers:
    """A stage's parameters; apart from them the optional ones, of which each does little; how near
    others must be.
    """
    own = tuple(p.value for n, p in stage.parameters.items() if n not in stage.optional)
    rest = tuple(
        stage[n] if n in stage.parameters else stage.neutral.get(n, 0.0) for n in stage.optional
    )
    return own, rest, stage.near if isinstance(stage, Cause) else NEAR


def near_to(known: object, wanted: tuple[Numbers, ...]) -> bool:
    """Whether the numbers of two models are near: one by one, optional ones together."""
    assert isinstance(known, tuple)
    for (a, b, near), (c, d, _) in zip(known, wanted, strict=True):
        if any(abs(x - y) > near * max(abs(x), abs(y)) for x, y in zip(a, c, strict=True)):
            return False
        off = sum(abs(x - y) for x, y in zip(b, d, strict=True))
        if off > near * max(sum(map(abs, b)), sum(map(abs, d))):
            return False
    return True


def _driven(group: Group, model: Model) -> Group:
    """The group with the drive as a model's amplifier delivers it."""
    stages = [s for s in model.stages if s.place == "drive" and s.locked_to == "drive"]
    signal = Signal(group.time_s, group.drive_v, np.zeros(0))
    for stage in stages:
        signal = stage.act(signal)
    if not stages:
        return group
    return replace(group, drive_v=np.ascontiguousarray(signal.drive_v), denser=None)


def _as_sliders_see(driven: Group, model: Model) -> tuple[Group, Wider | None]:
    """A group whose drive is delivered with the drive that sliders follow, and by how much each of
    them is wider.
    """
    for stage in model.stages:
        if stage.moves_sliders:
            signal = Signal(driven.time_s, driven.drive_v, np.zeros(0))
            wider = stage.wider_by(signal)
            if wider is not None:
                return driven, wider
            seen = stage.seen_by_sliders(signal, model.branches())
            return replace(driven, drive_v=np.ascontiguousarray(seen), denser=None), None
    return driven, None


def _with_tables(model: Model, of: Model) -> Model:
    """A model's other stages around another one's element tables, and what those remember."""
    def kept(stage: Stage) -> bool:
        return stage.elements is not None or stage in of.remembering

    others = [s for s in model.stages if s.elements is None and s not in model.remembering]
    out = of.with_(stages=tuple(s for s in of.stages if kept(s)))
    for stage in others:
        out = out.with_stage(stage)
    return out
