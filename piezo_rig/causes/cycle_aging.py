"""Cycle ageing: the travel changes with the number of cycles played.

Physics: walls that defects hold at rest are shaken loose by cycling, a few more with every decade
of cycles, and at rest they are caught again: the ageing and de-ageing of ceramics, both in the
logarithm of what went before (D. Damjanovic, Rep. Prog. Phys. 61 (1998) 1267, section 6). The
fatigue that stays begins at a million cycles and is not meant here. What is loose takes part in
every excursion, so that cycle n travels 1 + rate log10(n) times as far as the first. Two forms:
the stroke of each cycle is longer (the place where a rise begins stays), or the whole strain
since rest grows, as the count does.

The count: a cycle is two half loops. Either it begins anew with every recording, for the rest that
clears the memory lets the walls be caught as well; or it goes on through the whole session, and
recordings of one drive differ by when they were made. The data decide where they know the order.
A recording that carries on counts on in any case. Where few walls are weak enough to be freed it
is over after some cycles, a first-order process: 1 - exp(-n / n0).

Shows as: excursions that grow or shrink from cycle to cycle, most between the first and the
second. Creep moves the middle of the cycles instead, and goes on in holds; a drift goes on at
rest. The first rise belongs to the first cycle: where nothing but a first cycle and few later
ones is played it looks like an initiation stage.

Remedy: Play some ten cycles before a measurement that counts, and record in random order, so that
ageing is not taken for what the order changes.

Plausible: 0.2-2 % of the travel per decade.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.drives import first_measured
from piezo_rig.chain.half_loops import half_loops
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

HALF = 0.5
SETTLED = (1.3, 2.5, 5.0, 10.0)  # cycles; of more, few recordings have enough to tell
DECADE = 9.0  # cycles from the first to the tenth
FORMS: tuple[dict[str, float], ...] = (
    {"whole": 0.0}, {"whole": 1.0, "begins_at": HALF}, {"whole": 1.0, "begins_at": 1.0},
)  # fmt: skip


class CycleAging(Cause):
    """``rate_per_decade`` of cycles by which the travel changes.

    ``whole`` : 1 where the whole strain since rest grows with the count, 0 where the stroke of
    every cycle does; ``session`` : 1 where it counts on from recording to recording;
    ``begins_at`` : the count at the first sample of a strain that grows, half a cycle where a cycle
    has its number in its middle, one where it has it at its beginning; ``settles`` : cycles after
    which 63 % of it is done, 0 where it goes with the logarithm of the count; the rate is then that
    over the first decade
    """

    id = "cycle-aging"
    place = "actuator"
    law: ClassVar[Mapping[str, float]] = {"cycle": 0.1, "first rise": 0.1}
    meanings: ClassVar[Mapping[str, str]] = {
        "rate_per_decade": "change of travel from the first cycle to the tenth",
        "whole": "0: the stroke of every cycle grows; 1: the whole strain since rest",
        "session": "0: the count begins anew with every recording; 1: it goes on",
        "begins_at": "the count at the first sample of a strain that grows",
        "settles": "cycles after which 63 % of it is done; 0: it goes with their logarithm",
    }
    units: ClassVar[Mapping[str, str]] = {"rate_per_decade": "1"}
    optional: ClassVar[Mapping[str, str]] = {
        "whole": "1", "session": "1", "begins_at": "1", "settles": "1",
    }  # fmt: skip
    given: ClassVar[tuple[str, ...]] = ("whole", "session", "begins_at", "settles")
    sized: ClassVar[tuple[str, ...]] = ("rate_per_decade",)
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rate_per_decade": (-0.3, 0.3)}

    def act(self, signal: Signal) -> Signal:
        if signal.displacement_um.size < 2:
            return signal
        aged = self._aged(signal, signal.displacement_um)
        return signal.with_displacement(signal.displacement_um + aged)

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        return np.asarray(changes + self._aged(signal, changes))

    def _aged(self, signal: Signal, x: FloatArray) -> FloatArray:
        """What ageing adds to displacements (..., n) under the drive of a signal."""
        begin = first_measured(signal.time_s)
        count = signal.of_drive.get(self.id, lambda: cycles(signal.drive_v[begin:]))
        before = np.zeros(1)
        if self.counts_on and signal.played is not None:
            (before,) = signal.played
        out = np.zeros_like(x)
        if self._whole:
            number = np.maximum(count + self._begins_at, 1.0)
            out[..., begin:] = self._grown(number, before) * x[..., begin:]
        else:
            number = np.floor(count[1:]) + 1.0
            steps = self._grown(number, before) * np.diff(x[..., begin:], axis=-1)
            out[..., begin + 1 :] = np.cumsum(steps, axis=-1)
        return self["rate_per_decade"] * out

    @property
    def counts_on(self) -> bool:
        return "session" in self.parameters and self["session"] > 0

    def _grown(self, number: FloatArray, before: FloatArray) -> FloatArray:
        """What has grown by a count (n,), the mean over recordings played after so many (R,)."""
        settles = self._settles
        if not settles > 0.0:
            return np.asarray(np.mean([np.log10(number + n) for n in before], axis=0))
        done = np.mean([-np.expm1((1.0 - number - n) / settles) for n in before], axis=0)
        return np.asarray(done / -np.expm1(-DECADE / settles))

    @property
    def _settles(self) -> float:
        return self["settles"] if "settles" in self.parameters else 0.0

    @property
    def _begins_at(self) -> float:
        return self["begins_at"] if "begins_at" in self.parameters else HALF

    @property
    def _whole(self) -> bool:
        return "whole" in self.parameters and self["whole"] > 0

    def otherwise(self) -> list[Stage]:
        own: dict[str, float] = {"whole": 0.0}
        if self._whole:
            own = {"whole": 1.0, "begins_at": self._begins_at}
        return [self.with_values(**form) for form in FORMS if form != own]

    def increment(self, branches: Branches) -> Increment | str:
        if self._whole:
            return "how far a half loop will go is not known before its end"
        return Increment(Operation.AGE, (self["rate_per_decade"], self._settles))

    def shapes(self) -> dict[str, list[Stage]]:
        return {
            "settling": [self.with_values(settles=n) for n in SETTLED],
            "logarithm": [self.with_values(settles=0.0)],
        }

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        sessions = (0.0, 1.0) if context.cycles_before else (0.0,)
        return [
            [cls.of(None, rate_per_decade=0.002, session=session, **form)]
            for session in sessions for form in FORMS
        ] + [
            [cls.of(None, rate_per_decade=0.002, session=0.0, settles=SETTLED[1], **form)]
            for form in FORMS[:2]
        ]  # fmt: skip


def cycles(drive_v: FloatArray) -> FloatArray:
    """Cycles played up to each sample of a drive (n,), two half loops each; shape (n,).

    Within a half loop it grows with the way of the drive. A sample belongs to the half loop that
    ends in it.
    """
    drive = np.ascontiguousarray(drive_v)
    loops = half_loops(drive)
    index = np.clip(np.searchsorted(loops.start, np.arange(drive.size), side="left") - 1, 0, None)
    way = np.abs(drive[loops.stop] - drive[loops.start])
    here = np.abs(drive - drive[loops.start[index]]) / np.maximum(way, 1e-30)[index]
    # a sample that ends a cycle still belongs to it
    return np.asarray(0.5 * (index + np.clip(here, 0.0, 1.0 - 1e-9)), float)
