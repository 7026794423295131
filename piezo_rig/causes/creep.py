"""Creep: after a change of drive the displacement goes on, logarithmically in time.

Physics: domain walls relax over barriers of very different heights, so that the strain after a
step grows by the same amount in every decade of time. H. Jung and D.-G. Gweon, Rev. Sci. Instrum.
71 (2000) 1896; Kuhnen and Janocha's operator form, Control and Intelligent Systems 29 (2001):
first-order relaxations with time constants spread evenly over the decades, here two per decade
from 10 ms to 1000 s, each driven by the displacement. Kuhnen's operator has a share of its own for
each; where a large effect shows that they are not even, or that it begins before 10 ms, a diagnosis
fits them (``share_1s`` and so on, 1 being the even share) and reports the mean rate from 10 ms on.

Shows as: holds that are not flat, later cycles that ride up after the first, loops that open at
low frequency. With conditions in ascending order it looks much like thermal drift.

Remedy: Nothing is broken: wait after large steps, close the loop, or let `compensate` foresee it
with the saved model.

Plausible: 1-2 % of the displacement change per decade.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Parameter, Signal, Stage

TIMES_S = np.logspace(-2.0, 3.0, 11)
FAST_S = np.logspace(-3.0, -2.5, 2)  # of what may come before
PER_DECADE = 2.0
UNLIKE = (0.0, *np.geomspace(0.01, 3.0, 60))  # what rates may differ by, of their mean
FASTER_S = 4e-3  # of a law that begins at 1 ms and not at 10, per rate: 9 ms over ln(10)
FAST = ("share_1ms", "share_3.2ms")
SHARES = (
    "share_10ms", "share_32ms", "share_100ms", "share_320ms", "share_1s", "share_3.2s",
    "share_10s", "share_32s", "share_100s", "share_320s", "share_1000s",
)  # fmt: skip


def weights() -> FloatArray:
    """Of the relaxations, for a rate of one per decade; shape (11,)."""
    each = np.full(TIMES_S.size, 1.0 / PER_DECADE)
    each[[0, -1]] *= 0.5
    return each


def mean_rate(each: FloatArray, covariance: FloatArray) -> tuple[float, float, FloatArray]:
    """Of rates (k,) that are unlike each other: mean, its standard deviation, parts in it (k,).

    By random effects: what rates differ by beyond their errors is a variance of its own, at its
    restricted likelihood's largest; rates of which the data say little count for little.
    R. DerSimonian and N. Laird, Control. Clin. Trials 7 (1986) 177, with covariances.
    """
    size = max(float(np.mean(np.abs(each))), 1e-300)
    found: tuple[float, float, FloatArray, float] | None = None
    for apart in UNLIKE:
        total = covariance + ((apart * size) ** 2 + (1e-6 * size) ** 2) * np.eye(each.size)
        inverse = np.linalg.inv(total)
        weight = inverse.sum(axis=0)
        part = weight / weight.sum()
        mean = float(part @ each)
        off = each - mean
        worth = -0.5 * (np.linalg.slogdet(total)[1] + np.log(weight.sum()) + off @ inverse @ off)
        if found is None or worth > found[3]:
            found = mean, float(weight.sum() ** -0.5), part, float(worth)
    assert found is not None
    return found[:3]


class Creep(Cause):
    """``rate_per_decade`` of the displacement change."""

    id = "creep"
    place = "actuator"
    together = True
    law: ClassVar[Mapping[str, float]] = {"time_since_turn": 0.01}
    brings_along: ClassVar[tuple[str, ...]] = ("thermal-drift",)
    leaves: ClassVar[float] = 0.1  # other laws of it are as likely
    meanings: ClassVar[Mapping[str, str]] = {
        "rate_per_decade": "share of a change that is added in every tenfold time after it",
        **dict.fromkeys(FAST + SHARES, "its rate around that time after a change, over the mean"),
    }
    units: ClassVar[Mapping[str, str]] = {"rate_per_decade": "1"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "rate_per_decade": (0.0, 0.3), **dict.fromkeys(FAST + SHARES, (0.0, 20.0)),
    }  # fmt: skip

    optional: ClassVar[Mapping[str, str]] = dict.fromkeys(FAST + SHARES, "1")
    neutral: ClassVar[Mapping[str, float]] = dict.fromkeys(FAST, 0.0) | dict.fromkeys(SHARES, 1.0)
    priors: ClassVar[Mapping[str, tuple[float, float]]] = (
        dict.fromkeys(FAST, (0.0, 1.0)) | dict.fromkeys(SHARES, (1.0, 1.0))
    )
    loosened: ClassVar[Mapping[str, float]] = dict.fromkeys(FAST + SHARES, 0.1)

    @property
    def begins_fast(self) -> bool:
        """Whether relaxations before 10 ms have shares."""
        return set(FAST) <= set(self.parameters)

    @property
    def times_s(self) -> FloatArray:
        """Of every relaxation."""
        return np.concatenate([FAST_S, TIMES_S]) if self.begins_fast else TIMES_S

    @property
    def shares(self) -> FloatArray:
        """Of every relaxation, of the displacement."""
        own = [self[n] if n in self.parameters else 1.0 for n in SHARES]
        even = weights() * own
        if self.begins_fast:
            even = np.concatenate([[self[n] / PER_DECADE for n in FAST], even])
        return np.asarray(self["rate_per_decade"] * even)

    @property
    def by_form(self) -> Mapping[str, float]:
        """Its rate, unless the data say what it is in every decade."""
        measured = set(SHARES) <= set(self.parameters)
        return {} if measured else {"rate_per_decade": self.leaves}

    @property
    def as_late_s(self) -> float:
        """What relaxes faster than the law begins to is late by its time constant and no more."""
        return FASTER_S * self["rate_per_decade"] * (0.1 if self.begins_fast else 1.0)

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.relaxation import relaxations_each

        x = np.ascontiguousarray(signal.displacement_um)

        def made() -> FloatArray:
            out = np.empty((x.size, self.times_s.size))
            time = np.ascontiguousarray(signal.time_s)
            relaxations_each(signal.begins, time, x, self.times_s, out)
            return out

        each = signal.of_displacement.get(f"{self.id}, {self.times_s.size}", made)
        return signal.with_displacement(x + each @ self.shares)

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        from piezo_rig.chain.relaxation import relaxed_rows

        time = np.ascontiguousarray(signal.time_s)
        rows = np.ascontiguousarray(changes)
        return changes + relaxed_rows(time, rows, self.times_s, self.shares)

    def reported(self, covariance: FloatArray) -> dict[str, Parameter]:
        """The rate, the mean over decades where they are not even, and shares of that mean."""
        said = super().reported(covariance)
        if not set(SHARES) <= set(self.parameters):
            return said
        names, rate = list(self.parameters), self["rate_per_decade"]
        told_of = [*(FAST if self.begins_fast else ()), *SHARES]
        each, late = rate * np.array([self[n] for n in told_of]), slice(-len(SHARES), None)
        gradient = np.zeros((each.size, len(names)))
        gradient[:, names.index("rate_per_decade")] = each / rate if rate else 0.0
        gradient[range(each.size), [names.index(n) for n in told_of]] = rate
        spread = gradient @ covariance @ gradient.T
        mean, deviation, of_late = mean_rate(each[late], spread[late, late])
        part = np.zeros(each.size)
        part[late] = of_late
        if not mean > 0.0:
            return said
        relative = (np.eye(each.size) - np.outer(each / mean, part)) / mean
        deviations = np.sqrt(np.maximum(np.diag(relative @ spread @ relative.T), 0.0))
        told = {"rate_per_decade": (mean, deviation), **{
            n: (value / mean, d) for n, value, d in zip(told_of, each, deviations, strict=True)
        }}  # fmt: skip
        return said | {
            n: Parameter(value, "1", (value - 1.96 * d, value + 1.96 * d) if d > 0 else None)
            for n, (value, d) in told.items()
        }

    def increment(self, branches: Branches) -> Increment | str:
        return Increment(Operation.RELAX, (float(self.times_s.size), *self.times_s, *self.shares))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, rate_per_decade=0.002)]
