"""A stage: one piece of physics at one place in the signal chain.

A stage acts in one of two ways. It shapes the branches of the Maxwell kernel
(`shape`: own elements for the first rise, a law for the first spring), or it
acts on the signal itself (`act`: the drive before the actuator, the
displacement at and after it). Both default to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.branches import Branches
from piezo_rig.chain.elements import Elements
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.increments import Increment
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.chain.held_force import Springs

FloatArray = NDArray[np.float64]
Made = TypeVar("Made")
PLACES = ("drive", "actuator", "sensor", "acquisition")
KEPT = 24


@dataclass(frozen=True)
class Parameter:
    """A value with its unit and, where known, its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float] | None = None


class Reads(NamedTuple):
    """What is known of one recording's own scale.

    Attributes
    ----------
    from_s, to_s : of the drive's time, where its memory is known
    scale_um : what an interferometer's own scale reads, in the mean over that time
    """

    from_s: float
    to_s: float
    scale_um: float


class Wider(NamedTuple):
    """By how much the thresholds of all sliders are wider, sample by sample.

    Attributes
    ----------
    share : shape (n,), of themselves
    still_v : shape (n,), the drive at which they were not, on the way from the sample before; NaN
        where they were all the way
    """

    share: FloatArray
    still_v: FloatArray

    def after(self, count: int) -> Wider:
        """Behind so many samples at which they are not wider."""
        return Wider(*(np.concatenate([np.full(count, v), own])
                       for v, own in zip((0.0, np.nan), self, strict=True)))  # fmt: skip


class Kept:
    """What was made of something that stays as it is; the latest few things."""

    def __init__(self) -> None:
        self._known: dict[Hashable, Any] = {}
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What is known by a key, else what ``make`` makes; not to be written to."""
        found: Made | None = self._known.get(key)
        if found is not None:
            return found
        made = make()
        with self._lock:
            while len(self._known) >= KEPT:
                self._known.pop(next(iter(self._known)))
            self._known[key] = made
        return made


@dataclass(frozen=True, eq=False)
class Signal:
    """What travels along the chain; all of shape (n,).

    ``drive_v`` is the drive on the actuator, ``displacement_um`` what has become of it so far.
    ``begins`` : shape (k,), samples at which a stretch begins, played by itself: several drives
    are played at once as one signal. ``of_drive`` keeps what stages make of time and drive alone,
    ``of_displacement`` what they make of the displacement too. ``reads`` : for each stretch what is
    known of the recordings along it, in time; None where they begin where the model does.
    ``played`` : for each stretch the cycles that were played before it, one number for each
    recording whose mean it stands for; None where it is the first.
    """

    time_s: FloatArray
    drive_v: FloatArray
    displacement_um: FloatArray
    begins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    of_drive: Kept = field(default_factory=Kept, repr=False)
    of_displacement: Kept = field(default_factory=Kept, repr=False)
    reads: tuple[tuple[Reads, ...] | None, ...] | None = None
    played: tuple[FloatArray, ...] | None = None

    def with_drive(self, drive_v: FloatArray) -> Signal:
        """The signal with another drive."""
        return Signal(
            self.time_s, drive_v, self.displacement_um, self.begins, reads=self.reads,
            played=self.played,
        )  # fmt: skip

    def with_displacement(self, displacement_um: FloatArray) -> Signal:
        """The signal with another displacement."""
        return Signal(
            self.time_s, self.drive_v, displacement_um, self.begins, self.of_drive,
            reads=self.reads, played=self.played,
        )  # fmt: skip

    @property
    def stretches(self) -> list[Signal]:
        """Every stretch by itself."""
        if self.begins.size == 1:
            return [self]
        known = self.of_drive.get("stretches", lambda: [Kept() for _ in self.begins])
        ends = [*self.begins[1:].tolist(), self.time_s.size]
        reads, played = self.reads, self.played
        return [
            Signal(self.time_s[a:b], self.drive_v[a:b], self.displacement_um[a:b], of_drive=kept,
                   reads=None if reads is None else reads[k : k + 1],
                   played=None if played is None else played[k : k + 1])
            for k, (a, b, kept) in enumerate(zip(self.begins.tolist(), ends, known, strict=True))
        ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Stage:
    """Base of every stage.

    Class attributes
    ----------------
    id : stable name, one of the catalogue's for a cause
    place : ``drive``, ``actuator``, ``sensor`` or ``acquisition``
    locked_to : ``drive`` (repeats with the drive) or ``clock`` (left out of simulations)
    units : its parameters and their units, in order
    optional : parameters that a stage may do without
    linear : parameters that the displacement is linear in, fitted with the element tables
    neutral : values at which it does nothing, where that is not 0
    has_elements : whether it carries an element table
    rate_free : whether what it does to the signal knows no clock
    together : whether it acts on all stretches of a signal at once
    order : among the stages of its place that act; others stand in the order they were put in
    """

    id: ClassVar[str] = ""
    place: ClassVar[str] = "actuator"
    locked_to: ClassVar[str] = "drive"
    units: ClassVar[Mapping[str, str]] = {}
    optional: ClassVar[Mapping[str, str]] = {}
    neutral: ClassVar[Mapping[str, float]] = {}
    linear: ClassVar[tuple[str, ...]] = ()
    has_elements: ClassVar[bool] = False
    rate_free: ClassVar[bool] = False
    together: ClassVar[bool] = False
    order: ClassVar[int] = 0

    parameters: dict[str, Parameter] = field(default_factory=dict)
    elements: Elements | None = None

    @classmethod
    def of(cls, elements: Elements | None = None, **values: float) -> Stage:
        """A stage from plain numbers in the units of the class."""
        units = {**cls.units, **cls.optional}
        return cls({k: Parameter(float(v), units[k]) for k, v in values.items()}, elements)

    def __getitem__(self, name: str) -> float:
        """Value of one parameter."""
        return self.parameters[name].value

    def with_values(self, **values: float) -> Stage:
        """The same stage with other values; intervals are dropped."""
        merged = {k: p.value for k, p in self.parameters.items()} | values
        return type(self).of(self.elements, **merged)

    def shape(self, branches: Branches) -> Branches:
        """What the stage makes of the kernel's branches."""
        return branches

    @property
    def moves_sliders(self) -> bool:
        """Whether sliders follow another drive than the first spring does."""
        return type(self).seen_by_sliders is not Stage.seen_by_sliders

    def seen_by_sliders(self, signal: Signal, branches: Branches) -> FloatArray:
        """The drive (n,) that the sliders follow; the first spring follows the drive itself."""
        return signal.drive_v

    def wider_by(self, signal: Signal) -> Wider | None:
        """By how much the thresholds of all sliders are wider; None where they stay."""
        return None

    @property
    def holds_force(self) -> bool:
        """Whether `springs` is its law, and nothing else shapes the branches."""
        return False

    def springs(self, loops: HalfLoops, begins: NDArray[np.int64]) -> Springs:
        """The first spring of every half loop, where it keeps its force.

        ``begins`` : shape (k,), samples at which stretches begin; the first half loop of each has
        none before it
        """
        raise TypeError("only asked of a stage that holds a force")

    def preface(self, before: Sequence[FloatArray]) -> FloatArray:
        """Volts (k,) that leave a virgin actuator with what it remembers of drives before this one.

        ``before`` : turning points of those drives, oldest first
        """
        return np.empty(0)

    def act(self, signal: Signal) -> Signal:
        """What the stage makes of the signal at its place."""
        return signal

    def act_on_each(self, signal: Signal) -> Signal:
        """`act` on every stretch of a signal."""
        if self.together or signal.begins.size == 1:
            return self.act(signal)
        done = [self.act(part) for part in signal.stretches]
        if self.place == "drive":
            return signal.with_drive(np.concatenate([part.drive_v for part in done]))
        return signal.with_displacement(np.concatenate([part.displacement_um for part in done]))

    def increment(self, branches: Branches) -> Increment | str:
        """What `act` or `seen_by_sliders` does in one step, or why that has no form.

        ``branches`` : the kernel's, after every stage has shaped them. Not asked of a stage that
        only shapes them.
        """
        return "its effect on a sample needs more than the samples before it"

    @property
    def counts_on(self) -> bool:
        """Whether it matters how many cycles were played in recordings before this one."""
        return False

    @property
    def passes(self) -> bool:
        """Whether small changes of the displacement before it show behind it as they are."""
        return False

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        """What the stage makes of small changes (k, n) of the displacement of a signal."""
        if self.passes:
            return changes
        plain, out = self.act(signal).displacement_um, np.empty_like(changes)
        size = 1e-3 * max(float(np.ptp(signal.displacement_um)), 1e-9)
        for k, change in enumerate(changes):
            step = size / max(float(np.ptp(change)), 1e-30)
            moved = signal.with_displacement(signal.displacement_um + step * change)
            out[k] = (self.act(moved).displacement_um - plain) / step
        return out

    def check(self) -> None:
        """Raise InputError when the stage's numbers cannot be right."""
        missing = set(self.units) - set(self.parameters)
        if missing or (self.has_elements and self.elements is None):
            raise InputError(
                "model-stage",
                f"stage {self.id}: {', '.join(sorted(missing)) or 'the element table'} is missing",
                "the model file is damaged or was written by hand",
                "identify the model again, or complete the file",
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a model file."""
        out: dict[str, Any] = {"id": self.id, "place": self.place, "parameters": {}}
        for name, p in self.parameters.items():
            ci95 = None if p.ci95 is None else [float(x) for x in p.ci95]
            out["parameters"][name] = {"value": float(p.value), "unit": p.unit, "ci95": ci95}
        if self.elements is not None:
            out["elements"] = self.elements.to_rows()
        return out
