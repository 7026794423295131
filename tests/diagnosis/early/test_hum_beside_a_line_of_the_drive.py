"""A drive with a line where the hum is, and a model that is wrong about it."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis.early.hum import removed, shared
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep

RATE, HUM_HZ, HUM_UM, LINE_UM = 2000.0, 60.0, 1e-3, 8e-3
TIME = np.arange(4000) / RATE
PHASES = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 8)


def session(line_um):
    """Four drives, twice each, with hum of any phase; that of 20 Hz makes a line of its own."""
    out, rng = [], np.random.default_rng(4)
    drives = {f"{hz:g} Hz": 35.0 * (1.0 - np.cos(2.0 * np.pi * hz * TIME))
              for hz in (7.0, 11.0, 13.0, 20.0)}  # fmt: skip
    for number in range(8):
        name, drive = list(drives.items())[number % 4]
        x = 0.12 * drive + HUM_UM * np.sin(2.0 * np.pi * HUM_HZ * TIME + PHASES[number])
        if name == "20 Hz":
            x += line_um * np.sin(2.0 * np.pi * 60.0 * TIME + 0.4)
        x += 2e-3 * rng.standard_normal(TIME.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", drive, x - x[0], RATE, 1.0, 0.0, 1.0, 1, 0.0, name,
            number // 4 + 1, "virgin", 10.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


def heard(line_um):
    """What is taken out as hum, and the amplitudes at its frequency that are left, (4, 2), um."""
    sweeps = session(line_um)
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    model = starting_model(groups, named_model("classical"), "classical")
    hum = removed(groups, model, HUM_HZ, 1e-9, 1e-3)
    turned = np.exp(-2j * np.pi * HUM_HZ * TIME) * 2.0 / TIME.size
    left = [abs((g.measured_um - 0.12 * g.drive_v) @ turned) for g in hum.groups.groups]
    return hum, np.array(left)


def test_the_line_of_the_drive_is_left_to_the_model():
    hum, left = heard(LINE_UM)
    assert left[3] == pytest.approx(2 * [LINE_UM], rel=0.1)
    assert left[:3].max() < 0.2 * HUM_UM
    assert hum.amplitude_nm == pytest.approx(1e3 * HUM_UM, rel=0.1)


def test_where_no_drive_stands_out_every_line_is_hum():
    hum, left = heard(0.0)
    assert left.max() < 0.2 * HUM_UM
    assert hum.amplitude_nm == pytest.approx(1e3 * HUM_UM, rel=0.1)


@pytest.mark.parametrize(("phases", "same"), [
    ((0.3, 2.0), 5.0 - 2.0j), ((0.1, 1.5, 4.0), -0.5 + 3.0j), ((1.0, 3.0, 5.0, 5.5), 4.0j),
])  # fmt: skip
def test_what_lines_of_one_size_share(phases, same):
    lines = np.exp(1j * np.array(phases)) + same
    off = lines - shared(lines, 1.0)
    assert abs(off) == pytest.approx(len(phases) * [1.0], abs=0.02)


def test_a_single_line_is_cut_down_to_the_size():
    assert shared(np.array([3.0 + 4.0j]), 1.0) == pytest.approx(0.8 * (3.0 + 4.0j))
