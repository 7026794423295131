"""The sensor's noise at rest, against its calibration."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezo_rig.bench import Bench, instrument_errors
from piezo_rig.doctor.check import Check

NOISE_FACTORS = (0.33, 2.0)  # of what the calibration says
NOISE_S = 1.0
SETTLE_S = 2.0


def noise(bench: Bench, rate: float) -> Iterator[Check]:
    """The sensor's noise at rest against its calibration."""
    rig = bench.rig
    setup, calibration = rig.digitizer, rig.interferometer_calibration
    bench.step("looking at the sensor's noise", SETTLE_S + NOISE_S)
    bench.clock.sleep(SETTLE_S)  # the stack creeps after the way to rest
    rate *= setup.oversampling
    count = int(NOISE_S * rate) // 4 * 4
    with instrument_errors():
        bench.digitizer.configure(
            rate, count, {setup.sensor_channel: setup.sensor_range_v}, trigger="IMM"
        )
        bench.digitizer.arm()
        volts = bench.digitizer.fetch([setup.sensor_channel], count)[setup.sensor_channel]
    scale = rig.sensitivity_um_per_v
    measured = 1e3 * scale * _rms_without_drift(volts)
    step_v = 2 * setup.sensor_range_v / 65_536 / math.sqrt(12)
    parts = [calibration.noise_nm, 1e3 * scale * calibration.output_noise_v, 1e3 * scale * step_v]
    if math.isnan(calibration.noise_nm):
        yield Check("note", "interferometer", f"noise at rest is {measured:.2f} nm rms; the "
                    "calibration states none (noise_nm)")
        return
    expected = math.hypot(*(0.0 if math.isnan(p) else p for p in parts))
    said = f"noise at rest is {measured:.2f} nm rms, the calibration says {expected:.2f} nm"
    low, high = (factor * expected for factor in NOISE_FACTORS)
    if np.ptp(volts) == 0:
        yield Check(
            "FAULT", "interferometer", f"its output stands still at {volts[0]:.4g} V",
            "the beam is interrupted, the output saturates, or its cable is off",
            "adjust the beam, look at the signal strength, check the cable to the digitizer",
        )
    elif measured > high:
        yield Check(
            "FAULT", "interferometer", said, _kind_of_noise(volts, rate),
            "close the hood, look at beam and grounding, wait until the room is quiet",
        )
    elif measured < low:
        yield Check(
            "FAULT", "interferometer", said,
            "the beam is interrupted, or the sensitivity switch is not where the config says",
            f"adjust the beam; set the switch to {rig.sensitivity_switch}",
        )
    else:
        yield Check("ok", "interferometer", said)


def _rms_without_drift(volts: NDArray[np.float64]) -> float:
    """Rms of what a cubic through the record leaves: creep and drift of a second are smooth."""
    x = np.linspace(-1, 1, volts.size)
    smooth = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, volts, 3))
    return float(np.std(volts - smooth))


def _kind_of_noise(volts: NDArray[np.float64], rate: float) -> str:
    """What the noise looks like, as a likely cause."""
    x = volts - volts.mean()
    power = np.abs(np.fft.rfft(x * np.hanning(x.size))) ** 2
    frequency = np.fft.rfftfreq(x.size, 1 / rate)
    for mains in (50.0, 60.0):
        near = np.abs(frequency - mains) < 2.5
        if power[near].sum() > 0.3 * power[frequency > 5].sum():
            return f"mains hum at {mains:g} Hz: a ground loop, or a supply near the cable"
    deviation = np.abs(x - np.median(x))
    if deviation.max() > 12 * np.median(deviation):
        return "single spikes: the beam is interrupted for moments"
    return "air, vibration, or a weak beam"
