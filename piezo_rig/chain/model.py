"""A model: the ordered stages of a signal chain, and where they came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.branches import Branches
from piezo_rig.chain.drives import (
    Drives,
    at_rest,
    begun,
    long_after,
    preceded,
    refuse_gaps,
    since_begun,
)
from piezo_rig.chain.first_rise import first_rise_um
from piezo_rig.chain.half_loops import HalfLoops, half_loops
from piezo_rig.chain.maxwell import Maxwell
from piezo_rig.chain.memo import Memo
from piezo_rig.chain.stage import PLACES, Reads, Signal, Stage, Wider
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Model:
    """Stages in the order of the chain; exactly one of them is `maxwell`.

    Attributes
    ----------
    stages : in order of place: drive, actuator, sensor, acquisition
    provenance : plain data: runs and their hashes, what was held out, scheme, software version
    name : the named model it is, as in ``range``
    """

    stages: tuple[Stage, ...]
    provenance: dict[str, Any] = field(default_factory=dict)
    name: str = ""

    def __post_init__(self) -> None:
        if sum(isinstance(s, Maxwell) for s in self.stages) != 1:
            raise InputError("model-stage", "a model needs exactly one stage `maxwell`")
        places = [PLACES.index(s.place) for s in self.stages]
        if places != sorted(places):
            raise InputError("model-stage", f"stages are not in the order {', '.join(PLACES)}")

    def __getstate__(self) -> dict[str, Any]:
        """What it is made from; what was worked out on the way is not handed on."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def maxwell(self) -> Maxwell:
        return next(s for s in self.stages if isinstance(s, Maxwell))

    def stage(self, id: str) -> Stage | None:
        """The first stage with that id, or None."""
        return next((s for s in self.stages if s.id == id), None)

    def with_(self, **changes: Any) -> Model:
        return replace(self, **changes)

    def with_stage(self, stage: Stage) -> Model:
        """The model with a stage put in at its place, in the place of one with the same id."""
        kept = [s for s in self.stages if s.id != stage.id]
        own = PLACES.index(stage.place)
        after = [
            s for s in kept
            if PLACES.index(s.place) > own
            or (s.place == stage.place and s.order > stage.order and type(s).act is not Stage.act)
        ]  # fmt: skip
        before = [s for s in kept if s not in after]
        return self.with_(stages=(*before, stage, *after))

    def without(self, id: str) -> Model:
        """The model less one stage."""
        return self.with_(stages=tuple(s for s in self.stages if s.id != id))

    def branches(self) -> Branches:
        """The kernel's branches after every stage has shaped them."""
        return self._branches

    @cached_property
    def _branches(self) -> Branches:
        branches = self.maxwell.branches()
        for stage in self.stages:
            branches = stage.shape(branches)
        return branches

    def check(self) -> None:
        """Raise InputError when a stage's numbers cannot be right."""
        for stage in self.stages:
            stage.check()
        with np.errstate(divide="ignore"):  # a slope of 0 is refused below
            law = bool(self.branches().laws)
        for stage in self.stages:
            if stage.elements is not None:
                stage.elements.check(f"stage {stage.id}", law and isinstance(stage, Maxwell))

    def simulate(
        self,
        time_s: FloatArray,
        drive_v: FloatArray,
        history: str = "virgin",
        free_end: bool = False,
        memo: Memo | None = None,
        earlier: Sequence[FloatArray] = (),
        reads: tuple[Reads, ...] | None = None,
        played: FloatArray | None = None,
        since_virgin: bool = False,
    ) -> FloatArray:
        """What the sensor would show of a drive.

        Stages locked to the clock (hum, drift, jumps) are left out.

        Parameters
        ----------
        time_s, drive_v : shape (n,)
        history : ``virgin``: the memory is empty at the first sample. ``unknown`` and
            ``carried`` (from what was played before and is not given here): the drive is
            taken to have been played once before from a virgin start, so that its largest
            excursion is remembered already; long ago, so that nothing creeps any more.
            Sweeps that carry on from each other are simulated as one drive.
        free_end : leave sensor and acquisition stages out
        memo : of this drive with this history
        earlier : turning points of the drives that were played before a ``virgin`` one, oldest
            first; they matter to a model with a stage that remembers them
        reads : what is known of the recordings along the drive, where they do not begin where the
            model does; the same for every call with one ``memo``
        played : shape (R,), cycles that were played before each of the recordings whose mean is
            asked for, none by default; the same for every call with one ``memo``
        since_virgin : from where the actuator was before anything was played, as its stages see it;
            a bend of the displacement goes by that

        Returns
        -------
        displacement in um, shape (n,), 0 at the first sample unless ``since_virgin``
        """
        if np.size(drive_v) == 0 == np.size(time_s):
            return np.empty(0)
        if history not in ("virgin", "carried", "unknown"):
            raise InputError("history", f"history {history!r} is not virgin, carried or unknown")
        memo = Memo() if memo is None else memo
        signal, before = memo.begun(lambda: begun(time_s, drive_v, history, reads, played))
        drive = signal.drive_v[before:]
        active = [s for s in self.stages if s.locked_to == "drive"]
        if any(s.units or s.place == "drive" for s in active) and not signal.of_drive.get(
            "finite", lambda: bool(np.all(np.isfinite(drive)))
        ):
            refuse_gaps(drive)
        key: tuple[object, ...] = ()
        if history == "virgin" and earlier:
            volts = drive
            for stage in self.remembering:
                left = np.append(volts[0], stage.preface(earlier))
                volts = np.concatenate([left, volts])
                before, key = before + left.size, (*key, id(stage))
            if key:
                time = long_after(signal.time_s, before)
                signal = memo.get(
                    self, ("begun", *key), lambda: at_rest(time, volts, played=played)
                )
        signal = self._play(signal, free_end, memo, key, before if key else 0)
        displacement = signal.displacement_um[before:]
        # one bad sample makes all that follow it bad: looking at the last is enough
        if not np.isfinite(displacement[-1]):
            refuse_gaps(drive)
        if since_virgin or displacement[0] == 0.0:
            return displacement
        return displacement - displacement[0]

    def simulate_each(self, drives: Drives, memo: Memo | None = None) -> FloatArray:
        """`simulate` of several drives at once, one behind the other, shape (n,).

        Parameters
        ----------
        memo : of these drives
        """
        moved = self._play(drives.signal, False, Memo() if memo is None else memo)
        return since_begun(moved.displacement_um[drives.inside], drives.begins)

    def place_um(self, drive_v: FloatArray, history: str = "virgin") -> FloatArray:
        """Where the actuator stands, from its virgin state at 0 V, um, shape (n,).

        Only what has no clock: springs, sliders and what follows them at once. The arguments are
        those of `simulate`.
        """
        still = self.with_(stages=tuple(
            s for s in self.stages if s.rate_free or type(s).act is Stage.act
        ))  # fmt: skip
        drive = np.ascontiguousarray(drive_v, dtype=float)
        before = 0
        if history != "virgin":
            drive = preceded(drive)
            before = drive.size - drive_v.size
        time = np.arange(drive.size, dtype=float)
        return still._play(at_rest(time, drive), True, Memo()).displacement_um[before:]

    @property
    def one_curve(self) -> bool:
        """Whether the first rise follows the same elements as all others."""
        return not any(s.has_elements and not isinstance(s, Maxwell) for s in self.stages)

    @property
    def remembering(self) -> list[Stage]:
        """Stages that know of drives before this one, and can make a virgin model remember them."""
        return [s for s in self.stages if type(s).preface is not Stage.preface]

    @property
    def counts_on(self) -> bool:
        """Whether it matters how many cycles were played in recordings before."""
        return any(s.counts_on for s in self.stages)

    def _play(
        self, signal: Signal, free_end: bool, memo: Memo, key: tuple[object, ...] = (),
        left: int = 0,
    ) -> Signal:
        """What all stages make of a signal; ``left`` : samples that leave a virgin's memory."""
        active = [s for s in self.stages if s.locked_to == "drive"]
        for stage in active:
            if stage.place == "drive":
                key = (*key, id(stage))
                signal = memo.get(self, key, partial(stage.act_on_each, signal))
        given = np.ascontiguousarray(signal.drive_v)
        branches, driven = self.branches(), given
        for stage in active:
            if stage.moves_sliders:
                key = (*key, "sliders", id(stage), id(self.maxwell))
                driven = memo.get(self, key, partial(stage.seen_by_sliders, signal, branches))
        loops = list[HalfLoops]()
        begins = signal.begins
        holding = [s for s in active if s.holds_force]
        if (branches.has_laws or holding) and driven is given:
            loops = signal.of_drive.get("loops", partial(_loops_of, given, begins))
        elif branches.has_laws or holding:
            loops = memo.get(self, ("loops", *key), lambda: _loops_of(driven, begins))
        more = None
        for stage in active:
            wider = stage.wider_by(signal)
            if wider is not None:
                added = partial(_wider_um, branches, begins, given, wider)
                more = memo.get(self, ("wider", *key), added)
        if left and not self.one_curve:
            first, branches = branches, branches.of_one_curve()
            rise = partial(first_rise_um, first.initiation, branches.initiation, driven, left)
            rise_um = memo.get(self, ("first rise", *key, id(self.maxwell),
                                      *(id(s) for s in self.stages if s.has_elements)), rise)
            more = rise_um if more is None else more + rise_um
        key = (*key, *(id(s) for s in self.stages
                       if type(s).shape is not Stage.shape and s not in holding), "kernel",
               id(self.maxwell))  # fmt: skip
        at_rest = signal
        signal = memo.get(
            self, key,
            lambda: at_rest.with_displacement(
                _moved(branches, given, driven, begins, loops, more)
            ),
        )  # fmt: skip
        if holding:
            key = (*key, "held", *(id(s) for s in holding))
            bare = signal.displacement_um

            def held_back() -> Signal:
                less = sum(_held_v(s, loops, begins, driven, bare) for s in holding)
                return at_rest.with_displacement(
                    _moved(branches, given - less, driven - less, begins, loops, more)
                )

            signal = memo.get(self, key, held_back)
        for stage in active:
            if stage.place == "actuator" or (stage.place != "drive" and not free_end):
                if type(stage).act is Stage.act:
                    continue
                key = (*key, id(stage))
                signal = memo.get(self, key, partial(stage.act_on_each, signal))
        return signal


def _loops_of(drive: FloatArray, begins: NDArray[np.int64]) -> list[HalfLoops]:
    """Half loops of every stretch."""
    return [half_loops(part) for part in np.split(drive, begins[1:])]


def _held_v(
    stage: Stage, loops: Sequence[HalfLoops], begins: NDArray[np.int64], drive: FloatArray,
    displacement_um: FloatArray,
) -> FloatArray:
    from piezo_rig.chain.held_force import held_v

    springs = stage.springs(HalfLoops.joined(loops, begins.tolist()), begins)
    return held_v(springs, begins, drive, np.ascontiguousarray(displacement_um))


def _wider_um(
    branches: Branches, begins: NDArray[np.int64], drive: FloatArray, wider: Wider
) -> FloatArray:
    from piezo_rig.chain.widening import wider_um

    return wider_um(branches, begins, drive, wider)


def _moved(
    branches: Branches, drive: FloatArray, seen: FloatArray, begins: NDArray[np.int64],
    loops: Sequence[HalfLoops], more: FloatArray | None,
) -> FloatArray:
    """Displacement where the first spring follows one drive and the sliders another one.

    ``more`` : um, of sliders that widen one by one, and of a first rise from memory
    """
    moved = branches.moved(seen, begins, loops)
    if more is not None:
        moved += more
    if seen is drive:
        return moved
    return moved + since_begun(drive - seen, begins) / branches.first_slope_v_per_um
