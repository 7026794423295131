"""Resonance: a mechanical mode of the mount rings after each corner.

Physics: stack, holder and target are a mass on a spring; a change of velocity sets off the free
oscillation of the mode, which decays. Textbook second-order response (S. Devasia, E. Eleftheriou,
S. Moheimani, IEEE Trans. Control Syst. Technol. 15 (2007) 802). A sensor that does not look at the
moving end alone sees only a share of it. What damps the mode rests (air, an eddy-current damper) or
moves along (losses in the holder itself, ``moves_along``): then it is not late on a ramp.

Shows as: a decaying oscillation after each corner of the drive, in proportion to the change of
velocity, amplitude velocity / (2 pi frequency); nothing in smooth waveforms far below the mode.

Remedy: Stay clear of the frequency, round the corners of the drive, or stiffen the mount.

Plausible: 0.3-1 kHz mounted, damping 0.01-0.1; tens of kHz for a bare stack, of which a recording
shows what is below two fifths of its rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import NEAR_IN_TIME, Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

LOWEST_HZ, HIGHEST_HZ = 110.0, 16_000.0  # below lies the hum; a bare stack rings far above
MOUNTED_HZ = 2500.0  # up to which large ones are looked for in any case
APART = 0.12  # neighbouring examples, relative
DAMPING = 0.05
# damping: above the first a mode rings little, much like a lag; above the second it is one
LITTLE_RINGING, MOST = 0.25, 0.5
FINER, DAMPINGS = 13, (0.01, 0.02, 0.05, 0.12, 0.3)  # examples about the likeliest
EXAMPLE = 0.01  # share
AT_LARGE = 0.075  # apart, relative
DAMPED, SHARED = (0.01, 0.03, 0.1, 0.3), (0.3, 1.0)
LITTLE = 0.2  # of the displacement: what the base model does may be taken to pass such a mode
NYQUIST = 0.5  # periods between samples
COARSE = 1.0  # periods: between samples further apart a mode rings unseen


class Resonance(Cause):
    """``frequency`` and ``damping`` of a mode on which a ``share`` of the displacement rides.

    ``moves_along`` : 1 where what damps it moves along with what drives it, 0 where it rests
    """

    id = "resonance"
    place = "actuator"
    at_corners = True
    together = True
    largest: ClassVar[float] = 100.0
    beyond: ClassVar[float] = 10.0  # under a smooth drive a mode is a delay, by three numbers
    near: ClassVar[float] = NEAR_IN_TIME
    meanings: ClassVar[Mapping[str, str]] = {
        "share": "of the motion that takes part in the mode",
        "frequency": "of the mode",
        "damping": "of the mode, as a share of the critical one",
        "moves_along": "1: its damper moves along with the stack; 0: it stands on the bench",
    }
    units: ClassVar[Mapping[str, str]] = {"share": "1", "frequency": "Hz", "damping": "1"}
    optional: ClassVar[Mapping[str, str]] = {"moves_along": "1"}
    given: ClassVar[tuple[str, ...]] = ("moves_along",)
    sharp: ClassVar[Mapping[str, float]] = {"frequency": 20.0, "damping": 2.0}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "share": (0.0, 2.0), "frequency": (20.0, 20_000.0), "damping": (1e-3, MOST),
    }

    @property
    def passes(self) -> bool:
        """Far below the mode, if it carries a small share."""
        return self["share"] < LITTLE

    @property
    def plain(self) -> bool:
        return bool(self["damping"] <= LITTLE_RINGING)

    @property
    def along(self) -> bool:
        return "moves_along" in self.parameters and self["moves_along"] > 0

    @property
    def behind_s(self) -> float:
        """How late the mode is on a ramp."""
        return 0.0 if self.along else float(self["damping"] / (np.pi * self["frequency"]))

    def otherwise(self) -> list[Stage]:
        return [self.with_values(moves_along=0.0 if self.along else 1.0)]

    def _mode(self, signal: Signal, rows: FloatArray) -> FloatArray:
        from piezo_rig.chain.oscillation import rung_each

        omega, time = 2.0 * np.pi * self["frequency"], np.ascontiguousarray(signal.time_s)
        rows = np.ascontiguousarray(rows)
        made = rung_each(signal.begins, time, rows, omega, self["damping"], self.behind_s)
        return np.asarray(rows + self["share"] * (made - rows))

    def act(self, signal: Signal) -> Signal:
        moved = self._mode(signal, signal.displacement_um[None, :])[0]
        return signal.with_displacement(moved)

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        step_s = float(np.median(np.diff(signal.time_s)))
        if self.passes or step_s * self["frequency"] > COARSE:
            return changes
        return self._mode(signal, changes)  # it is linear

    def increment(self, branches: Branches) -> Increment | str:
        omega = 2.0 * np.pi * self["frequency"]
        return Increment(
            Operation.MODE, (self["share"], omega, self["damping"], self.behind_s)
        )

    def between_samples(self, step_s: float) -> dict[str, float]:
        """Ringing that begins up to half a sample beside where a straight drive begins it.

        A free oscillation whose phase is off by p is fitted best, over its whole decay, by an
        angular frequency that is off by p x damping x angular frequency.
        """
        frequency, damping = self["frequency"], self["damping"]
        phase = 2.0 * np.pi * frequency * 0.5 * step_s
        return {"frequency": float(phase * damping * frequency / np.sqrt(3.0))}

    def at_large(self, near: Stage | None = None) -> list[Stage]:
        """Much of the displacement through it, at any frequency, or near one at any damping.

        What goes back and forth faster than it rings comes out with the other sign: where all of
        a travel rides on the mode, a small share of quite another one looks better.
        """
        if near is None:
            highest = max(MOUNTED_HZ, self["frequency"])
            count = int(np.ceil(np.log(highest / LOWEST_HZ) / AT_LARGE)) + 1
            return [
                self.with_values(share=share, frequency=f, damping=DAMPED[1])
                for f in np.geomspace(LOWEST_HZ, highest, count) for share in SHARED
            ]  # fmt: skip
        return [
            self.with_values(
                share=near["share"] * share, frequency=near["frequency"] * f, damping=damping
            )
            for f in (0.97, 1.0, 1.03) for damping in DAMPED for share in (0.6, 1.0, 1.6)
        ]  # fmt: skip

    def plausible(self, context: Context) -> bool:
        """Where there are no two samples a period, a mode is a delay or a lag by another name."""
        return self["frequency"] * context.step_s < NYQUIST

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        highest = min(HIGHEST_HZ, 0.4 * context.seen_hz)
        if highest <= LOWEST_HZ:
            return []
        count = int(np.ceil(np.log(highest / LOWEST_HZ) / APART)) + 1
        return [
            [cls.of(None, share=EXAMPLE, frequency=f, damping=DAMPING)]
            for f in np.geomspace(LOWEST_HZ, highest, count)
        ]

    @classmethod
    def finer(cls, trials: Sequence[Stage]) -> list[list[Stage]]:
        """Frequencies between those of the neighbours, each lightly and well damped.

        After dozens of periods a mode that is a few percent off rings against the true one.
        """
        (example,) = trials
        return [
            [example.with_values(frequency=example["frequency"] * f, damping=damping)]
            for f in np.geomspace(1.0 - 0.5 * APART, 1.0 + 0.5 * APART, FINER)
            for damping in DAMPINGS
        ]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        (example,) = trials
        share = float(np.clip(EXAMPLE * shares[0], 1e-6, 2.0))
        return example.with_values(share=share)
