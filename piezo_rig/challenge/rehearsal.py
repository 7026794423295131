"""What a run will record, asked of the plant itself: with an effect, without it, without noise.

The simulated bench is the same for the same config, and its virtual clock leaves nothing to
chance, so a rehearsal knows when every sweep will be played and what will be in it. It is no
substitute for the run, which goes through drivers and instruments; the run is compared with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.bench import RAMP_SHARE
from piezo_rig.challenge.hiding import Settings, merged
from piezo_rig.challenge.noises import SILENT
from piezo_rig.config import DEFAULT_RIG, Rig, load_rig
from piezo_rig.config.toml_text import Document
from piezo_rig.protocol import Plan, build_plan
from piezo_rig.protocol.protocol_file import parse_protocol

FloatArray = NDArray[np.float64]


def challenge_rig(plant: Settings) -> Rig:
    """The shipped simulated bench with this plant; the drive monitor is not wired."""
    rig = load_rig(DEFAULT_RIG)
    return replace(rig, plant=plant, digitizer=replace(rig.digitizer, monitor_channel=0))


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A protocol on the bench of a challenge.

    ``starts_s`` : bench time at which every sweep begins, shape (sweeps,)
    """

    plan: Plan
    starts_s: FloatArray

    @classmethod
    def of(cls, protocol: str) -> Rehearsal:
        """``protocol`` : the text of a protocol file"""
        rig = challenge_rig({})
        plan = build_plan(parse_protocol(Document(protocol, "challenge", "protocol")), rig)
        ramp_s = rig.limits.drive_max_v / (RAMP_SHARE * rig.limits.rest_slew_v_per_s)
        lengths = [s.wave.codes.size / plan.sample_rate + rig.recovery_s for s in plan.sweeps]
        starts = ramp_s + rig.recovery_s + np.append(0.0, np.cumsum(lengths[:-1]))
        return cls(plan, starts)

    @property
    def rate(self) -> float:
        return self.plan.sample_rate

    @cached_property
    def drives_v(self) -> list[FloatArray]:
        """Drive (n,) of every condition, in the order of the first repeat."""
        count = len(self.plan.sweeps) // self.plan.protocol.repeats
        return [s.wave.drive_v for s in self.plan.sweeps[:count]]

    def displacements(self, plant: Settings, clean: bool = True) -> list[FloatArray]:
        """Displacement (n,) in um from its first sample, of every sweep of a run.

        ``clean`` : without noise and without the sensor's converter
        """
        rig = self.plan.rig
        um_per_v = rig.polarity * rig.sensitivity_um_per_v
        shown = self._shown_v(merged([plant, SILENT]) if clean else plant)
        return [um_per_v * (seen - seen[0]) for seen in shown]

    def range_used(self, plant: Settings) -> float:
        """Largest output of the sensor in a run, of the digitizer's range for it.

        Nobody zeroes the sensor between sweeps: what drifts meanwhile counts.
        """
        most_v = max(float(np.max(np.abs(seen))) for seen in self._shown_v(plant))
        return most_v / self.plan.rig.digitizer.sensor_range_v

    def _shown_v(self, plant: Settings) -> list[FloatArray]:
        """What the sensor puts out, V (n,), in every sweep of a run."""
        from drivers.simulated.plant import Plant

        stack: Any = Plant(plant)
        stack.set_level(0.1, self.plan.rig.rest_command_v)
        out = []
        for sweep, start in zip(self.plan.sweeps, self.starts_s, strict=True):
            stack.play(start, sweep.wave.command_v, self.rate)
            out.append(stack.record(start, self.rate, sweep.samples).sensor_v)
        return out
