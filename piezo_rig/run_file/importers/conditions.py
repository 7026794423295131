"""Which recordings are of one condition, and which repeat of it each is.

A name says so where it says anything (`0-65 sense3 test 2`). Names that only count, as `s01` to
`s08`, do not: there the drive does.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from piezo_rig.run_file.importers.sentences import Sentences
from piezo_rig.run_file.sweep import Sweep

ALIKE = 0.05  # repeats of one condition agree in drive and pace to this share
SAME = 0.002  # rms difference of drives that are one and the same, of their range
SHORTER = 0.05  # that a repeat may be, of its length
_COUNTED = re.compile(r"\d+|(?<![A-Za-z])[A-Za-z](?![A-Za-z])")  # a number, a letter by itself


@dataclass(frozen=True)
class Played:
    """What two sweeps must share to be repeats: drives in volts, passes of its middle a second."""

    lowest_v: float
    highest_v: float
    passes: int
    per_second: float

    @classmethod
    def of(cls, sweep: Sweep) -> Played:
        drive = sweep.drive_v
        low, high = map(float, np.percentile(drive, (0.1, 99.9)))  # a spike is no drive
        quarter = 0.25 * (high - low)
        side = np.where(drive > high - quarter, 1, np.where(drive < low + quarter, -1, 0))
        side = side[side != 0]
        passes = int(np.count_nonzero(np.diff(side)))
        return cls(low, high, passes, passes / max(float(sweep.time_s[-1]), 1e-12))

    def like(self, other: Played) -> bool:
        """Whether the one may be a repeat of the other, cut short perhaps."""
        near = ALIKE * max(self.highest_v - self.lowest_v, other.highest_v - other.lowest_v)
        apart = abs(self.per_second - other.per_second)
        few = 1.5 * max(p.per_second / max(p.passes, 1) for p in (self, other))
        return (
            abs(self.lowest_v - other.lowest_v) <= near
            and abs(self.highest_v - other.highest_v) <= near
            and apart <= max(few, ALIKE * max(self.per_second, other.per_second))
        )

    def __str__(self) -> str:
        digits = 1 - int(np.floor(np.log10(max(self.highest_v - self.lowest_v, 1e-9))))
        low, high = round(self.lowest_v, digits) + 0.0, round(self.highest_v, digits) + 0.0
        return f"{low:g} to {high:g} V, {self.per_second / 2.0:.2g} cycles/s"


class Conditions:
    """The conditions so far: names, what was played under them, and their repeats."""

    def __init__(self, told: Sentences, warned: Sentences) -> None:
        self._told = told
        self._warned = warned
        self._taken: dict[str, set[int]] = {}
        self._played: dict[str, Played] = {}
        self._first: dict[str, Sweep] = {}

    def numbered(self, sweep: Sweep, number: int, stated: bool = False) -> Sweep:
        """The sweep with its name, and with a repeat that no other sweep of its condition has.

        ``stated`` : the file itself says its condition
        """
        condition = self._condition(sweep)
        again = None if stated else self._repeated(sweep, condition)
        self._first.setdefault(condition, sweep)
        if again is not None:
            condition = again
            self._told.add(sweep.source, [
                f"plays the same as {self._first[again].source}, and only a number or a letter "
                f"tells their names apart: taken for a repeat of condition '{again}'"
            ])  # fmt: skip
        taken = self._taken.setdefault(condition, set())
        repeat = sweep.repeat
        if repeat in taken:
            while repeat in taken:
                repeat += 1
            if again is None:
                self._warned.add(sweep.source, [
                    f"repeat {sweep.repeat} of condition '{condition}' was given before; "
                    f"this one counts as repeat {repeat}"
                ])  # fmt: skip
        taken.add(repeat)
        return sweep.with_(name=f"sweep_{number:04d}", repeat=repeat, condition=condition)

    def _condition(self, sweep: Sweep) -> str:
        """Its condition by name; another where something else was played under that name."""
        if np.isnan(sweep.command_v).any():
            return sweep.condition
        played = Played.of(sweep)
        first = self._played.setdefault(sweep.condition, played)
        if played.like(first):
            return sweep.condition
        condition = f"{sweep.condition}, {played}"
        self._played.setdefault(condition, played)
        self._warned.add(
            sweep.source,
            [
                f"plays {played}, but another recording of condition '{sweep.condition}' "
                f"plays {first}: not a repeat of it, so its condition is '{condition}'"
            ],
        )
        return condition

    def _repeated(self, sweep: Sweep, condition: str) -> str | None:
        """An earlier condition, told from this one by a count, under which the same was played."""
        if condition in self._first or np.isnan(sweep.command_v).any():
            return None
        bare = _COUNTED.sub("", condition)
        for other, first in self._first.items():
            if _COUNTED.sub("", other) == bare and _same_drive(sweep, first):
                return other
        return None


def _same_drive(a: Sweep, b: Sweep) -> bool:
    n, longer = sorted((a.samples, b.samples))
    if longer - n > SHORTER * n or abs(a.sample_rate - b.sample_rate) > SAME * b.sample_rate:
        return False
    x, y = a.drive_v[:n], b.drive_v[:n]
    return bool(np.sqrt(np.mean((x - y) ** 2)) <= SAME * np.ptp(y))
