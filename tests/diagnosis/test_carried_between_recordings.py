"""Recordings of one sitting: each begins with what those before left, and counts from its start.

Nobody says so (``unknown``), and file names only count.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from sliders import play

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early.hum import find_hum
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.held_out import _inside
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from tests.more import first_of

RATE = 1000.0
ENDS = ((10.0, 75.0), (10.0, 55.0), (10.0, 35.0), (40.0, 75.0))
HALF_WAVE_UM = 0.3164


def triangles(low, high, hz=2.0, cycles=3):
    n = round(RATE / hz / 2)
    up = low + (high - low) * np.arange(n) / n
    down = high - (high - low) * np.arange(n) / n
    loop = np.concatenate([up, down] if low < 20.0 else [down, up])
    return np.append(np.tile(loop, cycles), loop[0])


def sine(low, high, hz, seconds):
    t = np.arange(round(seconds * RATE) + 1) / RATE
    return low + 0.5 * (high - low) * (1.0 - np.cos(2 * np.pi * hz * t))


def sitting(drives, amplifier=None, sensor=None, seed=5, names=None, noise_um=2e-3):
    """Sweeps of drives that follow each other, on an actuator that has been to 75 V and back.

    ``amplifier`` : of one drive; ``sensor`` : of displacement since rest, and clock time
    """
    rng = np.random.default_rng(seed)
    limits = np.sort(rng.uniform(0.3, 45.0, 90))
    played = [amplifier(d) if amplifier else d for d in drives]
    before = np.concatenate([np.linspace(0, 75, 50), np.linspace(75, 0, 50)])
    ends = np.cumsum([before.size, *(d.size for d in drives)])
    x = play(np.concatenate([before, *played]), limits, 0.05 / 90 * 1.2)
    start, sweeps = 0.0, []
    for k, drive in enumerate(drives):
        cut = x[ends[k] : ends[k + 1]]
        clock = start + np.arange(drive.size) / RATE
        seen = sensor(cut, clock) if sensor else cut
        seen = seen - seen[0] + noise_um * rng.standard_normal(drive.size)
        name = names[k] if names else f"s{k + 1:02d}"
        sweeps.append(Sweep(
            f"sweep_{k + 1:04d}", drive, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0, name, 1, "unknown",
            start, "IMPORTED",
        ))  # fmt: skip
        start += drive.size / RATE + rng.uniform(6.0, 9.0)
    return sweeps


MATRIX = [triangles(*e) for e in ENDS] * 2
NAMES = [f"{low:g}-{high:g}" for low, high in ENDS] * 2


@pytest.mark.parametrize("hz", [50.0, 59.95])
def test_hum_has_the_frequency_that_it_has(hz):
    """The first recording begins elsewhere than its repeat, by far more than the hum."""
    def sensor(x, clock):
        return x + 1.2e-3 * np.sin(2 * np.pi * hz * clock + 0.4)

    sweeps = sitting(MATRIX, sensor=sensor, names=NAMES)
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    assert groups.repeats == 2
    point = Point(starting_model(groups, named_model("classical"), "classical"))
    hum = find_hum(groups, refit(plain_space(groups, point.model), point).point.model)
    assert hum.frequency == pytest.approx(hz, abs=3.0 * hum.spread_hz)
    assert hum.spread_hz < 0.02


@pytest.mark.study
def test_a_periodic_error_is_named_although_every_recording_has_its_own_phase():
    def sensor(x, clock):
        return x + 4e-3 * np.sin(2 * np.pi * (x + 0.05) / HALF_WAVE_UM)

    found = diagnose(sitting(MATRIX, sensor=sensor, names=NAMES))
    assert [f.cause for f in found.findings] == ["periodic-nonlinearity"]
    assert found.findings[0].parameters["amplitude"].value == pytest.approx(4.0, abs=0.15)
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm == pytest.approx(2.0, rel=0.1)
    # and the report draws what is left of the same recordings: two repeats of 2 nm, averaged
    for g in found.workings.groups[-1].groups:
        left = g.measured_um.mean(axis=0) - g.predicted(found.rung_models[-1])
        for a, b in g.blocks:
            assert 1e3 * np.std(left[a:b]) == pytest.approx(2.0 / np.sqrt(2.0), rel=0.15)


@pytest.mark.study
def test_a_sensor_that_ends_is_told_with_its_level_above_where_the_sweep_begins():
    whole = sitting(MATRIX, names=NAMES, noise_um=0.0)
    level = float(whole[4].displacement_um.max()) - 0.05

    def sensor(x, clock):
        return np.minimum(x, x[0] + level)

    found = diagnose(sitting(MATRIX, sensor=sensor, names=NAMES))
    assert [f.cause for f in found.findings] == ["sensor-clipping"]
    assert found.findings[0].parameters["level"].value == pytest.approx(level, abs=5e-3)


@pytest.mark.study
def test_a_slew_limit_shows_on_sinusoids_that_exceed_it_at_their_steepest():
    """Half loops of 12 Hz are 1200 V/s on the mean, and 1885 V/s where they are steepest."""
    def amplifier(drive):
        out, most = drive.copy(), 1700.0 / RATE
        for k in range(1, out.size):
            out[k] = out[k - 1] + min(max(drive[k] - out[k - 1], -most), most)
        return out

    drives = [sine(10, 75, 2.0, 2.0), sine(10, 60, 12.0, 1.0), sine(10, 60, 5.0, 1.0)] * 2
    found = diagnose(sitting(drives, amplifier=amplifier, names=["a", "b", "c"] * 2))
    assert [f.cause for f in found.findings] == ["slew-limit"]
    assert found.findings[0].parameters["limit"].value == pytest.approx(1700.0, abs=5.0)


@pytest.mark.study
def test_corners_that_are_cut_off_are_no_outliers():
    """A fast triangle that is clipped lacks one sample at each of its lower corners."""
    def amplifier(drive):
        return np.maximum(drive, 11.2)

    drives = [triangles(10.0, 75.0, 1.0), triangles(10.0, 75.0, 20.0, 20),
              triangles(10.0, 60.0, 4.0, 4)]  # fmt: skip
    found = diagnose(sitting(drives, amplifier=amplifier, names=["a", "b", "c"]))
    names = [f.cause for f in found.findings]
    assert names[0] == "drive-clipping"
    assert "outliers" not in names
    assert found.findings[0].parameters["lower"].value == pytest.approx(11.2, abs=0.02)


@pytest.mark.parametrize(("left_out", "inside"), [
    ((10.0, 55.0), True),  # 10 to 75 V is played as well
    ((10.0, 75.0), False),  # no other goes further than 45 V at once
])  # fmt: skip
def test_what_is_left_out_is_judged_only_where_another_drive_goes_as_far(left_out, inside):
    drives = [triangles(*e) for e in ENDS]
    sweeps = sitting(drives, names=NAMES[:4])
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    assert _inside(groups, [ENDS.index(left_out)]) is inside


def test_what_holds_of_many_recordings_is_said_once():
    said = prepare(sitting(MATRIX, names=NAMES), first_rises=True, clipped=True).left_out
    (note,) = (n for n in said if "history unknown" in n)
    assert "and 7 more" in note
    assert "17 %" in note  # half a loop of three


@pytest.mark.parametrize("anew", first_of(1, [True, False]))
def test_clocks_may_begin_again_with_every_recording_that_carries_on(anew):
    """A digitizer that is triggered by each waveform, or one clock for the whole sitting."""
    ppm = 300.0

    def sensor(x, clock):
        seen = (clock if not anew else clock - clock[0]) / (1.0 + 1e-6 * ppm)
        return np.interp(seen + (clock[0] if anew else 0.0), clock, x)

    sweeps = sitting([triangles(*e) for e in (*ENDS, (20.0, 60.0))], sensor=sensor)
    sweeps = [s if k == 0 else s.with_(history="carried") for k, s in enumerate(sweeps)]
    found = diagnose(sweeps)
    assert [f.cause for f in found.findings] == ["clock-ratio"]
    said = found.findings[0].parameters
    assert said["anew"].value == anew
    assert said["ppm"].ci95[0] < ppm < said["ppm"].ci95[1]
