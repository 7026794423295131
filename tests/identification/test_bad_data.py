"""What cannot be identified is refused with sweep, sample, cause and remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recordings import TOP, classical, sweep

from piezo_rig.errors import InputError
from piezo_rig.identification import identify, prepare

DRIVE, Y = classical([0.0, TOP, 0.0, TOP, 0.0])


def gap(values, at):
    out = np.array(values)
    out[at] = np.nan
    return out


def stopped(at, value=None):
    """The sensor shows one value from a sample on, with its noise."""
    out = np.array(Y)
    out[at:] = out[at] if value is None else value
    return out + 1e-4 * np.random.default_rng(0).standard_normal(out.size)


HALF = int(np.argmax(DRIVE))  # where the drive turns for the first time
CASES = {
    "constant-drive": (np.full(DRIVE.size, 3.0), Y),
    "drive-never-returns": (np.linspace(0, 10, 200), np.linspace(0, 1, 200)),
    "not-a-number": (DRIVE, gap(Y, 77)),
    "unequal-lengths": (DRIVE, Y[:-5]),
    "too-few-samples": (DRIVE[:3], Y[:3]),
    "constant-displacement": (DRIVE, np.zeros(Y.size)),
    "displacement-falls": (DRIVE, -Y),
    "sensor-saturated": (DRIVE, np.minimum(Y, 0.7 * Y.max())),
    "sensor-stands-still": (DRIVE, stopped(HALF + HALF // 3)),
    "travels-disagree": (DRIVE, 1000.0 * Y),
}


@pytest.mark.parametrize("code", CASES)
@pytest.mark.parametrize("scheme", ["least-squares", "slopes"])
def test_refused(code, scheme):
    bad = sweep(*CASES[code], index=2)
    with pytest.raises(InputError) as e:
        identify([sweep(DRIVE, Y), bad], "classical", scheme)
    assert e.value.code == code
    assert "sweep_0002" in e.value.what
    assert e.value.cause
    assert e.value.remedy


def test_the_sample_is_named():
    with pytest.raises(InputError, match="sample 77"):
        identify([sweep(DRIVE, gap(Y, 77))], "classical")


@pytest.mark.parametrize(
    "change", [{"gain": 7.7}, {"offset_v": 73.0}, {"sensitivity_um_per_v": 4.0}]
)
def test_sweeps_of_other_calibrations_are_not_joined(change):
    with pytest.raises(InputError) as e:
        identify([sweep(DRIVE, Y), replace(sweep(DRIVE, Y, index=2), **change)], "classical")
    assert e.value.code == "calibrations-disagree"
    assert "sweep_0002" in e.value.what


def test_half_a_loop_with_unknown_history_is_too_little():
    drive, y = classical([0.0, TOP, 7.0])
    with pytest.raises(InputError) as e:
        identify([sweep(drive[30:130], y[30:130], history="unknown")], "classical")
    assert e.value.code == "too-few-half-loops"


def test_one_condition_cannot_show_a_law():
    with pytest.raises(InputError) as e:
        identify([sweep(*classical([0.0, TOP] + [0.0, TOP] * 3))], "range")
    assert e.value.code == "law-not-determined"


def test_a_friction_damper_that_slides_is_no_sensor_at_its_limit():
    drive = np.concatenate([[0.0], *(np.linspace(a, b, 101)[1:] for a, b in
                                     ((0, 10), (10, -10), (-10, 10), (10, -10)))])  # fmt: skip
    force, y = 0.0, []
    for step in np.diff(drive, prepend=0.0):
        force = float(np.clip(force + 0.6 * step, -3.0, 3.0))
        y.append(force)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(drive.size)
    assert identify([sweep(drive, np.array(y))], "classical").fitted.max_percent < 2.0
    assert identify([sweep(drive, np.array(y) + noise)], "classical").fitted.max_percent < 2.0


@pytest.mark.parametrize("share", [0.5, 1.3, 1.6, 2.4])
def test_a_sensor_that_stops_wherever_it_is_is_refused(share):
    bad = sweep(DRIVE, stopped(int(share * HALF)))
    with pytest.raises(InputError, match="stands still at") as e:
        prepare([bad], clipped=True)
    assert e.value.code == "sensor-stands-still"


def test_a_sensor_that_comes_to_its_end_is_none_that_has_stopped():
    cut = sweep(DRIVE, np.minimum(Y, 0.4 * Y.max()))
    assert any("largest value" in said for said in prepare([cut], clipped=True).left_out)


@pytest.mark.parametrize(("factor", "words"), [
    (1e-3, "nanometres"), (4.0, "switch"), (12.0, "swapped"),
])  # fmt: skip
def test_recordings_that_move_unlike_each_other_are_named_both(factor, words):
    odd = sweep(DRIVE, factor * Y, index=3)
    with pytest.raises(InputError) as e:
        identify([sweep(DRIVE, Y), sweep(DRIVE, Y, index=2), odd], "classical")
    assert e.value.code == "travels-disagree"
    assert "sweep_0003" in e.value.what
    assert words in e.value.cause
    assert "2 of 3" in e.value.cause


@pytest.mark.parametrize("share", [0.15, 0.3, 0.5])
def test_small_loops_beside_large_ones_are_none_that_disagree(share):
    small, moved = classical([0.0, share * TOP, 0.0, share * TOP, 0.0])
    identify([sweep(DRIVE, Y), sweep(small, moved, index=2)], "classical")


def test_names_are_checked():
    for arguments in ({"model": "magic"}, {"scheme": "magic"}, {"elements": 0}):
        with pytest.raises(InputError):
            identify([sweep(DRIVE, Y)], **{"model": "classical", **arguments})


def test_noise_does_not_hide_that_a_sensor_or_a_drive_stands_still():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(DRIVE.size)
    for drive, y, code in (
        (DRIVE, np.minimum(Y, 0.7 * Y.max()) + 1e-3 * noise, "sensor-saturated"),
        (3.0 + 2e-3 * noise, Y, "constant-drive"),
    ):
        with pytest.raises(InputError) as e:
            identify([sweep(drive, y)], "classical")
        assert e.value.code == code


def test_an_interrupted_beam_is_bridged_and_said():
    y = Y.copy()
    y[[50, 210]] = 1e4
    found = identify([sweep(DRIVE, y)], "classical")
    assert found.fitted.max_percent < 2
    assert any("50, 210" in note for note in found.left_out)


def test_a_sensor_that_does_not_follow_the_drive_is_said():
    y = np.random.default_rng(0).standard_normal(DRIVE.size)
    found = identify([sweep(DRIVE, y)], "classical")
    assert any("unexplained" in note for note in found.left_out)


def test_the_file_is_named():
    bad = sweep(DRIVE, gap(Y, 77)).with_(source="monday.lvm")
    with pytest.raises(InputError, match=r"monday.lvm: sweep_0001: .* sample 77"):
        identify([bad], "classical")
