"""A rig's config: what is accepted, and what a slip is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from piezo_rig.config import load_rig
from piezo_rig.config.calibration import load_interferometer
from piezo_rig.errors import InputError
from piezo_rig.resources import find, shipped_folder

SIMULATED = (shipped_folder("configs") / "simulated_bench.toml").read_text()


def rig_with(tmp_path: Path, old: str, new: str):
    assert old in SIMULATED
    path = tmp_path / "rig.toml"
    path.write_text(SIMULATED.replace(old, new))
    return load_rig(str(path))


def test_the_default_rig_is_the_bench_of_the_thesis():
    rig = load_rig()
    assert (rig.gain, rig.offset_v, rig.polarity) == (7.5, 75.0, -1)
    assert rig.sensitivity_um_per_v == 15.48
    assert rig.rest_command_v == -10.0


@pytest.mark.parametrize("table", ["printed", "exact"])
def test_sensitivities_are_the_printed_ones_or_990_44_over_powers_of_four(table):
    values = load_interferometer(find("calibration", "sios_sp_s120"), table).sensitivities_um_per_v
    exact = [990.44 / 4**k for k in range(6, -1, -1)]
    if table == "exact":
        assert values == pytest.approx(exact, rel=1e-12)
    else:
        # two decimals at most, as printed
        assert values == tuple(round(v, 2) if v < 60 or v > 62 else 61.9 for v in exact)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("sensitivity = 3 ", "sensitivity = 9 ", "sensitivity"),
        ("polarity = -1", "polarity = 0", "polarity"),
        ("sensor_range_v = 1", "sensor_range_v = 3", "sensor_range_v"),
        ("monitor_channel = 1", "monitor_channel = 2", "monitor_channel"),
        ("recovery_s = 30.0", "recovery_s = -1", "recovery_s"),
        ('driver = "keysight_33500b"', 'driver = "hp_3325"', "driver"),
        ("drive_max_v = 75.0", "drive_max_volt = 75.0", "drive_max_volt"),
        ('calibration = "amplifier"', 'calibration = "nowhere"', "nowhere"),
        ('clock = "virtual"', 'clock = "sundial"', "clock"),
    ],
)
def test_a_slip_is_named(tmp_path, old, new, told):
    with pytest.raises(InputError) as caught:
        rig_with(tmp_path, old, new)
    assert told in caught.value.what
    assert caught.value.exit_status == 2


def test_a_real_rig_needs_addresses(tmp_path):
    with pytest.raises(InputError, match="address"):
        rig_with(tmp_path, 'simulated = true\nclock = "virtual"            # "real" plays in real '
                 "time", "simulated = false")


def test_an_amplifier_whose_rest_the_generator_cannot_reach_is_refused(tmp_path):
    (tmp_path / "amp.toml").write_text(
        'schema = "piezo-rig/calibration/1"\ninstrument = "amplifier"\n'
        "gain = 7.0\noffset_v = 75.0\n"
    )
    with pytest.raises(InputError, match="rest"):
        rig_with(tmp_path, 'calibration = "amplifier"', 'calibration = "amp.toml"')
