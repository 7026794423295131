"""The plan is what will be played: its counts, levels and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.config import Rig, load_rig
from piezo_rig.config.toml_text import Document
from piezo_rig.errors import InputError, LimitError, PiezoRigError
from piezo_rig.protocol import Plan, build_plan, load_protocol
from piezo_rig.protocol.protocol_file import parse_protocol
from piezo_rig.resources import find, shipped_names


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig()


def plan_of(text: str, rig: Rig) -> Plan:
    return build_plan(parse_protocol(Document(text, "test.toml", "protocol")), rig)


def shipped(name: str, rig: Rig) -> Plan:
    return build_plan(load_protocol(find("protocols", name)), rig)


TRIANGLE = """
schema = "piezo-rig/protocol/1"
[[condition]]
waveform = "triangle"
lower_v = {lower}
upper_v = {upper}
start = "{start}"
frequency_hz = {frequency}
cycles = {cycles}
"""


def triangle(rig: Rig, lower=0.0, upper=65.0, start="lower", frequency=2.0, cycles=10) -> Plan:
    return plan_of(
        TRIANGLE.format(
            lower=lower, upper=upper, start=start, frequency=frequency, cycles=cycles
        ),
        rig,
    )


def test_the_thesis_matrix_has_the_counts_of_the_design(rig):
    plan = shipped("thesis_matrix", rig)
    assert len(plan.sweeps) == 81
    assert plan.samples == 2_122_500
    sizes = {s.condition.name: s.samples for s in plan.sweeps}
    assert len(sizes) == 27
    assert sizes["0-65"] == 25_000
    assert sizes["75-65"] == 27_500
    assert sum(s.samples for s in plan.sweeps if s.repeat == 1) == 707_500


def test_the_staircase_is_one_sweep_of_the_length_in_the_design(rig):
    plan = shipped("thesis_staircase", rig)
    assert {s.samples for s in plan.sweeps} == {727_500}


@pytest.mark.parametrize("name", shipped_names("protocols"))
def test_every_shipped_protocol_passes_its_checks(name, rig):
    plan = shipped(name, rig)
    assert plan.samples > 0


def test_a_triangle_is_the_closed_form_to_half_a_dac_step(rig):
    drive = triangle(rig).sweeps[0].wave.drive_v
    t = np.arange(25_000) / 5000.0
    asked = 65.0 * (1 - np.abs(2 * ((2.0 * t) % 1.0) - 1))
    half_step = 0.5 * 65.0 / 65534
    assert np.abs(drive - asked).max() <= half_step * 1.0001


def test_both_rails_are_reached_exactly(rig):
    wave = triangle(rig, upper=75.0).sweeps[0].wave
    assert wave.command_v.min() == -10.0
    assert wave.command_v.max() == 0.0
    assert wave.drive_v.max() == 75.0


def test_every_waveform_begins_and_ends_at_the_lowest_code(rig):
    for sweep in shipped("minor_loops", rig).sweeps:
        assert sweep.wave.codes[0] == sweep.wave.codes[-1] == -32767
        assert sweep.wave.low_v == -10.0


def test_a_sweep_from_75_v_rises_and_falls_at_300_v_per_s(rig):
    drive = triangle(rig, lower=65.0, upper=75.0, start="upper").sweeps[0].wave.drive_v
    rise, fall = drive[:1251], drive[-1250:]
    np.testing.assert_allclose(rise, 300.0 * np.arange(1251) / 5000, atol=1e-3)
    np.testing.assert_allclose(fall, 75.0 - 300.0 * np.arange(1250) / 5000, atol=1e-3)


def test_the_digitizer_gets_a_multiple_of_four_samples_filled_with_rest(rig):
    plan = triangle(rig, frequency=7.0, cycles=3)  # 2142.86 samples
    wave = plan.sweeps[0].wave
    assert wave.drive_v.size % 4 == 0
    assert wave.codes.size == wave.drive_v.size + 1


def test_turning_points_of_a_path_are_hit_exactly(rig):
    plan = plan_of(
        'schema = "piezo-rig/protocol/1"\n[[condition]]\nwaveform = "turning-points"\n'
        "points_v = [0, 61.3, 17.9, 44.4, 0]\nslew_v_per_s = 333\n", rig,
    )
    drive = plan.sweeps[0].wave.drive_v
    turns = drive[1:-1][np.diff(np.sign(np.diff(drive))) != 0]
    np.testing.assert_allclose(turns[:3], [61.3, 17.9, 44.4], atol=1e-3)
    assert np.abs(np.diff(drive)).max() * 5000 <= 333 + 10


def test_a_shuffled_protocol_plays_the_same_conditions_in_another_order_every_repeat(rig):
    listed, shuffled = shipped("thesis_matrix", rig), shipped("shuffled_matrix", rig)
    orders = [
        [s.condition.name for s in shuffled.sweeps if s.repeat == r] for r in (1, 2, 3)
    ]
    assert sorted(orders[0]) == sorted(s.condition.name for s in listed.sweeps if s.repeat == 1)
    assert orders[0] != orders[1] != orders[2] != orders[0]


def test_the_hash_tells_plans_apart_and_is_stable(rig):
    assert triangle(rig).hash == triangle(rig).hash
    assert triangle(rig).hash != triangle(rig, upper=65.01).hash


def test_carried_history_waits_only_before_the_first_sweep(rig):
    text = TRIANGLE.format(lower=0, upper=20, start="lower", frequency=2, cycles=2)
    plan = plan_of('history = "carried"\nrepeats = 3\n' + text, rig)
    assert [s.history for s in plan.sweeps] == ["virgin", "carried", "carried"]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"upper": 80.0}, "limit-drive"),
        ({"lower": -1.0}, "limit-drive"),
        ({"upper": 75.01}, "limit-drive"),
        ({"frequency": 200.0}, "limit-slew"),
    ],
)
def test_a_plan_beyond_a_limit_is_refused_with_exit_3(changes, code, rig):
    with pytest.raises(LimitError) as caught:
        triangle(rig, **changes)
    assert caught.value.code == code
    assert caught.value.exit_status == 3
    assert "test.toml:6" in caught.value.what  # where upper_v stands
    assert "sample" in caught.value.what


def test_the_current_limit_counts_the_large_signal_capacitance(rig):
    # 75 V at 2 Hz: 300 V/s x 1.5 uF x 1.7 = 0.765 mA
    tight = replace(rig, limits=replace(rig.limits, current_a=0.000765 * 0.97))
    with pytest.raises(LimitError, match="mA"):
        triangle(tight, upper=75.0)
    loose = replace(rig, limits=replace(rig.limits, current_a=0.000765 * 1.01))
    triangle(loose, upper=75.0)


def test_a_sensitivity_that_would_clip_is_refused_and_a_fitting_one_named(rig):
    with pytest.raises(LimitError) as caught:
        triangle(replace(rig, sensitivity_switch=1))
    assert caught.value.code == "limit-sensor"
    assert "sensitivity = 3" in caught.value.remedy


def test_a_monitor_range_that_would_clip_is_refused(rig):
    small = replace(rig, digitizer=replace(rig.digitizer, monitor_range_v=32.0))
    with pytest.raises(LimitError) as caught:
        triangle(small, upper=75.0)
    assert caught.value.code == "limit-monitor"
    triangle(small, upper=30.0)


def test_a_sweep_beyond_the_generators_memory_is_refused_before_it_is_made(rig):
    with pytest.raises(LimitError) as caught:
        triangle(rig, cycles=1_000_000)
    assert caught.value.code == "limit-memory"


def test_a_sample_rate_off_the_digitizers_grid_is_refused_with_its_line(rig):
    text = "sample_rate = 3000\n" + TRIANGLE.format(
        lower=0, upper=20, start="lower", frequency=2, cycles=2
    )
    with pytest.raises(LimitError) as caught:
        plan_of(text, rig)
    assert caught.value.code == "limit-rate"
    assert caught.value.what.startswith("test.toml:1: ")


@pytest.mark.parametrize(
    ("mistake", "line", "key"),
    [
        ("cycels = 10", 8, "cycels"),
        ("cycles = 'ten'", 8, "cycles"),
        ("cycles = 0", 8, "cycles"),
        ("cycles = 10\nwobble = 3", 9, "wobble"),
        ("cycles = nan", 8, "cycles"),
    ],
)
def test_a_mistake_is_reported_with_line_and_key(mistake, line, key, rig):
    text = TRIANGLE.format(
        lower=0, upper=20, start="lower", frequency=2, cycles=10
    ).replace("cycles = 10", mistake).replace("\nschema", "schema", 1)
    with pytest.raises(InputError) as caught:
        plan_of(text, rig)
    assert caught.value.exit_status == 2
    assert f"test.toml:{line}" in caught.value.what
    assert key in caught.value.what


@settings(max_examples=150, derandomize=True, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_a_protocol_or_a_clear_error(text):
    try:
        parse_protocol(Document(text, "fuzz.toml", "protocol"))
    except PiezoRigError as error:
        assert error.exit_status == 2


VALUES = st.one_of(
    st.integers(-10, 100), st.floats(), st.booleans(), st.text(max_size=5),
    st.lists(st.integers(-5, 90), max_size=3),
)
KEYS = st.sampled_from(
    ["waveform", "lower_v", "upper_v", "start", "frequency_hz", "cycles", "slew_v_per_s",
     "duration_s", "levels_v", "hold_s", "points_v", "level_v", "segments", "name"]
)


@settings(max_examples=150, derandomize=True, deadline=None)
@given(
    st.sampled_from(["triangle", "sine", "hold", "blank", "steps", "turning-points", "sequence"]),
    st.dictionaries(KEYS, VALUES, max_size=8),
)
def test_any_condition_is_planned_within_limits_or_refused(waveform, keys):
    def toml(value):
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, str):
            return '"' + "".join(c for c in value if c.isalnum()) + '"'
        return repr(value)

    keys["waveform"] = waveform
    text = 'schema = "piezo-rig/protocol/1"\n[[condition]]\n' + "\n".join(
        f"{k} = {toml(v)}" for k, v in keys.items()
    )
    rig = load_rig()
    try:
        plan = plan_of(text, rig)
    except PiezoRigError as error:
        assert error.exit_status in (2, 3)
    else:
        drive = plan.sweeps[0].wave.drive_v
        assert drive.min() >= -1e-3
        assert drive.max() <= 75.001


def test_a_missing_protocol_lists_the_shipped_ones(tmp_path: Path):
    with pytest.raises(InputError) as caught:
        find("protocols", "thesis_matrx")
    assert "thesis_matrix" in caught.value.remedy
