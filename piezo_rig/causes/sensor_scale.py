"""Sensor scale: the sensitivity, in um/V, is not the one on the label.

Physics: the displacement is sensor volts x sensitivity. An interferometer knows its wavelength to
parts per million, but not what its analog output makes of it, nor at which angle the beam meets
the motion. What moves by x is recorded as x / ratio: with a true sensitivity above the nominal
one the record is too small. The remedy is to multiply the sensitivity by the ratio.

Shows as: a displacement that is off by the same factor everywhere, at all drives and speeds, with
every turning point and threshold where it should be. A model that is refitted takes the factor
into its compliances and hides it completely; only a model of the same actuator that is held fixed
can show it. A wrong drive gain looks nearly the same, but moves the thresholds.

Remedy: Check the sensitivity switch, the alignment and the calibration file; `calibrate` with a
reference displacement.

Plausible: 0.1-2 %; a factor of four where the switch stood elsewhere (refused as such).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.stage import Signal, Stage


class SensorScale(Cause):
    """``ratio`` of the true sensitivity to the nominal one; the record is x / ratio."""

    id = "sensor-scale"
    place = "sensor"
    together = True
    needs_fixed_model = True
    meanings: ClassVar[Mapping[str, str]] = {
        "ratio": "scale of the sensor over the one that is assumed",
    }
    units: ClassVar[Mapping[str, str]] = {"ratio": "1"}
    neutral: ClassVar[Mapping[str, float]] = {"ratio": 1.0}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"ratio": (0.2, 5.0)}

    def act(self, signal: Signal) -> Signal:
        return signal.with_displacement(signal.displacement_um / self["ratio"])

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, ratio=1.002)]
