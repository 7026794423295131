"""The digitizer's driver, alone and triggered by the generator."""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers.digitizer import KeysightL4532A, range_for, rate_on_grid, record_length
from drivers.errors import InstrumentError
from drivers.waveform_dac import Keysight33500B

RANGES = {1: 128.0, 2: 16.0}


@pytest.fixture
def digitizer(bench, line, clock):
    driver = KeysightL4532A(line(bench.addresses["digitizer"]), clock)
    driver.connect()
    return driver


@pytest.fixture
def dac(bench, line, clock):
    driver = Keysight33500B(line(bench.addresses["waveform_dac"]))
    driver.connect()
    driver.go_to_rest(-10.0, slew_v_per_s=10.0, clock=clock)
    return driver


def triangle(points: int) -> np.ndarray:
    there = 1 - np.abs(np.linspace(-1, 1, points))
    return np.rint(there * 65534 - 32767).astype(np.int16)


def play(dac, digitizer, codes, rate=5000):
    dac.load("sweep", codes, -10.0, 0.0, rate)
    digitizer.arm()
    dac.start()
    dac.wait(codes.size / rate)


def test_the_grid_is_one_two_five_between_its_ends():
    assert [r for r in (500, 1e3, 2500, 5e3, 5e4, 3e5, 2e7, 5e7) if rate_on_grid(r)] == [
        1e3, 5e3, 5e4, 2e7,
    ]  # fmt: skip


def test_records_are_multiples_of_four_and_at_least_eight():
    assert [record_length(n) for n in (1, 8, 9, 25_000, 25_001)] == [8, 8, 12, 25_000, 25_004]


def test_the_range_is_the_smallest_that_holds_the_peak():
    assert range_for(75.0) == 128.0
    assert range_for(16.0) == 16.0
    with pytest.raises(ValueError, match="largest"):
        range_for(300.0)


def test_a_sweep_comes_back_in_volts_from_its_first_sample(dac, digitizer):
    codes = triangle(25_001)
    digitizer.configure(5000, codes.size, RANGES)
    play(dac, digitizer, codes)
    volts = digitizer.fetch([1, 2], codes.size)
    stack = 75 + 7.5 * (-10 + 10 * (codes.astype(float) + 32767) / 65534)
    assert volts[1].shape == volts[2].shape == (25_001,)
    assert np.abs(volts[1] - stack).max() <= 0.51 * 128 / 32767
    assert np.abs(volts[2] + 0.1 * stack).max() <= 0.51 * 16 / 32767
    assert digitizer.overflows == {1: 0, 2: 0}


def test_one_channel_alone_is_not_mixed_with_the_other(dac, digitizer):
    codes = triangle(401)
    digitizer.configure(5000, codes.size, RANGES)
    play(dac, digitizer, codes)
    assert list(digitizer.fetch([2], codes.size)) == [2]
    assert digitizer.fetch([2], codes.size)[2].min() == pytest.approx(-7.5, abs=0.001)


def test_a_long_record_comes_in_blocks_without_a_seam(bench, line, dac, clock):
    driver = KeysightL4532A(line(bench.addresses["digitizer"]), clock, block_samples=1000)
    driver.connect()
    codes = triangle(4_321)
    driver.configure(5000, codes.size, RANGES)
    play(dac, driver, codes)
    stack = 75 + 7.5 * (-10 + 10 * (codes.astype(float) + 32767) / 65534)
    assert np.abs(driver.fetch([1], codes.size)[1] - stack).max() <= 0.51 * 128 / 32767


def test_a_sensor_beyond_the_range_is_counted_as_overflow(dac, digitizer):
    codes = triangle(2001)
    digitizer.configure(5000, codes.size, {1: 128.0, 2: 4.0})
    play(dac, digitizer, codes)
    sensor = digitizer.fetch([1, 2], codes.size)[2]
    truth = 7.5 * (codes.astype(float) + 32767) / 65534
    assert digitizer.overflows[1] == 0
    assert digitizer.overflows[2] == int((truth >= 4.0 * (1 - 0.5 / 32767)).sum())
    assert sensor.min() == pytest.approx(-4.0)


def test_a_missing_trigger_cable_is_named(dac, digitizer, faults, clock):
    faults["digitizer"]["no_trigger"] = True
    codes = triangle(401)
    digitizer.configure(5000, codes.size, RANGES)
    play(dac, digitizer, codes)
    with pytest.raises(InstrumentError) as failure:
        digitizer.fetch([1, 2], codes.size, timeout_s=1.0)
    assert failure.value.code == "instrument-no-trigger"
    assert "trigger" in failure.value.cause
    faults["digitizer"].clear()
    play(dac, digitizer, codes)
    assert digitizer.fetch([1], codes.size)[1].max() == pytest.approx(75, abs=0.01)


def test_a_record_shorter_than_the_sweep_is_no_data(dac, digitizer):
    codes = triangle(801)
    digitizer.configure(5000, 400, RANGES)
    play(dac, digitizer, codes)
    with pytest.raises(InstrumentError, match=r"401 of 801.*number 400") as failure:
        digitizer.fetch([1, 2], codes.size, timeout_s=0.1)
    assert failure.value.code == "instrument-no-data"


def test_the_wrong_byte_order_is_noticed(dac, digitizer, client):
    codes = triangle(801)
    digitizer.configure(5000, codes.size, RANGES)
    play(dac, digitizer, codes)
    plain = client("digitizer")
    plain.send(b"FORM:BORD NORM\n")
    plain.ask("*OPC?")
    with pytest.raises(InstrumentError) as failure:
        digitizer.fetch([1, 2], codes.size, timeout_s=0.1)
    assert failure.value.code == "instrument-garbage"
    assert "byte order" in failure.value.cause


@pytest.mark.parametrize(("rate", "ranges"), [(3000, RANGES), (5000, {1: 3.0})])
def test_what_the_instrument_does_not_have_is_refused_before_it_is_sent(digitizer, rate, ranges):
    with pytest.raises(ValueError, match=r"grid|range"):
        digitizer.configure(rate, 100, ranges)


def test_more_samples_than_the_instrument_says_it_holds_are_refused(digitizer):
    with pytest.raises(InstrumentError, match="memory takes 33554432") as failure:
        digitizer.configure(5000, 10**9, RANGES)
    assert failure.value.code == "instrument-setting"


def test_a_range_that_is_not_taken_is_an_error(digitizer, faults):
    faults["digitizer"]["setting_not_taken"] = ["CONF:CHAN:RANG"]
    with pytest.raises(InstrumentError, match="RANG") as failure:
        digitizer.configure(5000, 100, RANGES)
    assert failure.value.code == "instrument-setting"


def test_a_hang_up_in_the_middle_of_a_record_is_told(dac, digitizer, faults):
    codes = triangle(25_001)
    digitizer.configure(5000, codes.size, RANGES)
    play(dac, digitizer, codes)
    faults["digitizer"]["hang_up"] = True
    with pytest.raises(InstrumentError) as failure:
        digitizer.fetch([1, 2], codes.size)
    assert failure.value.code == "instrument-hangup"
    assert digitizer.fetch([1], codes.size)[1].max() == pytest.approx(75, abs=0.01)


def test_settings_hold_every_channel(digitizer):
    digitizer.configure(5000, 100, RANGES)
    settings = digitizer.settings()
    assert float(settings["CONF:CHAN:RANG? (@1)"]) == 128
    assert float(settings["CONF:CHAN:RANG? (@2)"]) == 16
    assert float(settings["CONF:ACQ:SRAT?"]) == 5000


def test_a_five_second_sweep_takes_a_fraction_of_a_second(dac, digitizer):
    codes = triangle(25_001)
    begun = time.monotonic()
    for _ in range(3):
        codes[1] += 1  # a new waveform each time, so that it is uploaded
        digitizer.configure(5000, codes.size, RANGES)
        play(dac, digitizer, codes)
        digitizer.fetch([1, 2], codes.size)
    assert time.monotonic() - begun < 1.5
