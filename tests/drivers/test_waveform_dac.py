"""The waveform DAC's driver against the simulated generator: what the stack sees."""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import InstrumentError
from drivers.simulated.bench import SimulatedBench
from drivers.waveform_dac import Keysight33500B

SLEW = 2.0  # command volts per second


@pytest.fixture
def dac(bench, line):
    driver = Keysight33500B(line(bench.addresses["waveform_dac"]))
    driver.connect()
    return driver


@pytest.fixture
def resting(dac, clock):
    dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    return dac


def triangle(points: int = 1001) -> np.ndarray:
    there = 1 - np.abs(np.linspace(-1, 1, points))
    return np.rint(there * 65534 - 32767).astype(np.int16)


def steps_from(levels: list[float], start: float) -> np.ndarray:
    return np.abs(np.diff([start, *levels]))


def test_the_identity_says_that_it_is_simulated(dac):
    assert dac.identity.is_simulated
    assert dac.identity.model.startswith("335")


def test_an_output_that_is_off_is_zero_volts_of_command(dac):
    assert dac.output_level() == 0.0


def test_connecting_moves_nothing(dac, plant):
    assert [level for level in plant.levels if level != 0.0] == []


def test_from_off_the_output_walks_to_rest_without_a_jump(dac, plant, clock):
    before = len(plant.levels)
    moved = dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert moved["from_v"] == 0.0
    assert moved["to_v"] == pytest.approx(-10.0, abs=1e-3)
    assert moved["duration_s"] == pytest.approx(10 / SLEW, rel=0.01)
    levels = plant.levels[before:]
    assert levels[-1] == pytest.approx(-10.0, abs=1e-3)
    assert steps_from(levels, 0.0).max() <= 0.02 + 1e-9
    assert plant.stack_v(clock.now()) == pytest.approx(0.0, abs=0.01)


def test_the_walk_keeps_the_slew_limit(dac, plant, clock):
    dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    times = np.array([t for t, _, _ in plant.events])
    levels = np.array([values[0] for _, values, _ in plant.events])
    for earlier in range(0, len(times) - 60, 50):
        dv = abs(levels[earlier + 50] - levels[earlier])
        dt = times[earlier + 50] - times[earlier]
        assert dv <= SLEW * dt + 0.02 + 1e-9


def test_going_to_rest_again_moves_nothing(resting, plant, clock):
    before = len(plant.events)
    moved = resting.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert moved["duration_s"] == 0.0
    assert all(v[0] == pytest.approx(-10, abs=1e-6) for _, v, _ in plant.events[before:])


@pytest.mark.parametrize(
    "setup",
    [
        b"VOLT 0.2;VOLT:OFFS -3",
        b"VOLT 2;VOLT:OFFS -3",
        b"VOLT 0.002;VOLT:OFFS 1",
        b"VOLT 0.2;VOLT:OFFS -10",
    ],
)
def test_from_dc_the_output_walks_to_rest_without_a_jump(dac, plant, client, clock, setup):
    hand = client("waveform_dac")
    hand.send(b"OUTP:LOAD INF;:FUNC DC;:" + setup + b";:OUTP ON\n")
    assert hand.ask("SYST:ERR?") == '+0,"No error"'
    start = plant.levels[-1]
    assert start in (-3.0, 1.0, -10.0)
    before = len(plant.levels)
    moved = dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert moved["from_v"] == start
    assert moved["to_v"] == pytest.approx(-10.0, abs=1e-3)
    assert steps_from(plant.levels[before:], start).max() <= 0.02 + 1e-9
    # While FUNC changed the rest waveform ran free for a moment, close to rest.
    played = [values for _, values, _ in plant.events[2:] if values.size > 1]
    assert all(np.abs(values + 10).max() <= 0.0101 for values in played)


def test_dc_into_50_ohm_is_seen_at_the_volts_that_the_amplifier_sees(dac, client):
    client("waveform_dac").send(b"FUNC DC;:VOLT:OFFS -2;:OUTP ON\n")
    client("waveform_dac").ask("*OPC?")
    assert dac.output_level() == pytest.approx(-4.0)


def test_a_foreign_waveform_is_left_alone_and_named(dac, client, clock, plant):
    hand = client("waveform_dac")
    hand.send(b"OUTP ON\n")
    hand.ask("*OPC?")
    before = len(plant.events)
    with pytest.raises(InstrumentError, match="SIN") as refused:
        dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert refused.value.code == "bench-refused"
    with pytest.raises(InstrumentError):
        dac.load("x", triangle(), -10, 0, 5000)
    assert len(plant.events) == before


def test_a_sweep_is_played_as_loaded_and_ends_at_rest(resting, plant, clock):
    codes = triangle(1001)
    resting.load("0-75 V", codes, -10.0, 0.0, 5000)
    begun = clock.now()
    resting.start()
    resting.wait(1001 / 5000)
    assert clock.now() - begun == pytest.approx(1001 / 5000)
    t, played, rate = plant.events[-1]
    assert (t, rate) == (begun, 5000)
    assert played == pytest.approx(-10 + 10 * (codes.astype(float) + 32767) / 65534, abs=1e-9)
    assert resting.output_level() == pytest.approx(-10.0)


def test_between_sweeps_the_output_stays_at_rest(resting, plant, clock):
    before = len(plant.events)
    for number, high in enumerate((-9.0, 0.0, -8.0)):
        resting.load(f"sweep {number}", triangle(1001 + number), -10.0, high, 5000)
        resting.start()
        resting.wait(0.3)
    events = plant.events[before:]
    assert all(values[0] == pytest.approx(-10, abs=1e-6) for _, values, _ in events)
    assert sum(values.size > 1 for _, values, _ in events) == 3


def test_a_blank_sweep_plays_rest(resting, plant):
    resting.load("blank", np.full(2000, -32767, np.int16), -10.0, -10.0, 5000)
    resting.start()
    resting.wait(0.4)
    _, played, _ = plant.events[-1]
    assert played.size == 2000
    assert played == pytest.approx(np.full(2000, -10.0))


def test_a_sweep_smaller_than_the_smallest_span_keeps_its_volts(resting, plant):
    resting.load("tiny", triangle(1001), -10.0, -9.996, 5000)
    resting.start()
    resting.wait(0.2)
    _, played, _ = plant.events[-1]
    assert played.max() == pytest.approx(-9.996, abs=1e-6)


def test_a_waveform_that_does_not_span_the_converter_keeps_its_volts(resting, plant):
    half = (triangle(1001).astype(int) - 32767) // 2  # peaks at mid-scale, -5 V of -10..0
    resting.load("half", half.astype(np.int16), -10.0, 0.0, 5000)
    resting.start()
    resting.wait(0.2)
    _, played, _ = plant.events[-1]
    assert played.max() == pytest.approx(-5.0, abs=2e-4)


def test_many_sweeps_outgrow_the_memory_and_are_still_played(resting, plant):
    before = len(plant.events)
    for number in range(5):
        codes = triangle(250_000 + number)
        resting.load("big", codes, -10.0, -5.0, 5000)
        resting.start()
        resting.wait(51)
        assert plant.events[-1][1].size == codes.size
    # Clearing the memory brings another waveform up, but no further than the narrow span.
    assert all(v[0] == pytest.approx(-10, abs=0.0101) for _, v, _ in plant.events[before:])
    assert max(v.max() for _, v, _ in plant.events[before:]) == pytest.approx(-5.0)


def test_a_repeat_is_not_uploaded_again(bench, line, clock):
    sent = []
    driver = Keysight33500B(
        line(bench.addresses["waveform_dac"], observer=lambda way, data: sent.append((way, data)))
    )
    driver.connect()
    driver.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    driver.load("first", triangle(), -10.0, 0.0, 5000)
    sent.clear()
    driver.load("again", triangle(), -10.0, 0.0, 5000)
    assert not any(b"DATA:ARB:DAC" in data for way, data in sent if way == "out")


def test_nothing_that_could_jump_is_ever_sent(bench, line, clock):
    sent = []
    driver = Keysight33500B(
        line(bench.addresses["waveform_dac"], observer=lambda way, data: sent.append((way, data)))
    )
    driver.connect()
    driver.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    driver.load("s", triangle(), -10.0, 0.0, 5000)
    driver.start()
    driver.wait(1)
    driver.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    out = b"".join(data for way, data in sent if way == "out").upper()
    assert b"*RST" not in out
    assert b"OUTP1 OFF" not in out
    assert b"OUTP1 0" not in out
    assert out.count(b"OUTP1 ON") == 1


@pytest.mark.parametrize(
    "codes",
    [
        np.zeros(100, np.int16),
        np.append(triangle(100), np.int16(0)),
        np.full(7, -32767, np.int16),
        np.full(1_000_001, -32767, np.int16),
    ],
)
def test_waveforms_that_do_not_begin_and_end_at_rest_are_refused(resting, codes):
    with pytest.raises(ValueError, match=r"rest|points"):
        resting.load("x", codes, -10.0, 0.0, 5000)


def test_a_sweep_is_refused_while_the_output_is_elsewhere(resting):
    with pytest.raises(InstrumentError, match="-10 V") as refused:
        resting.load("x", triangle(), -9.0, 0.0, 5000)
    assert refused.value.code == "bench-refused"


@pytest.mark.parametrize("header", ["SOUR1:VOLT:HIGH", "SOUR1:FUNC:ARB:SRAT", "SOUR1:FUNC:ARB"])
def test_a_setting_that_is_not_taken_stops_the_sweep(resting, faults, header):
    faults["waveform_dac"]["setting_not_taken"] = [header]
    with pytest.raises(InstrumentError, match=header) as failure:
        resting.load("x", triangle(), -10.0, 0.0, 20_000)
    assert failure.value.code == "instrument-setting"


def test_a_stuck_offset_stops_the_walk_at_its_first_step(dac, faults, plant, clock):
    faults["waveform_dac"]["setting_not_taken"] = ["VOLT:OFFS"]
    with pytest.raises(InstrumentError, match="OFFS") as failure:
        dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert failure.value.code == "instrument-setting"
    assert plant.levels[-1] == pytest.approx(0.0, abs=1e-9)


def test_going_to_rest_waits_for_a_running_burst(resting, plant, clock, bench, line):
    resting.load("s", triangle(10_001), -10.0, 0.0, 5000)
    begun = clock.now()
    resting.start()
    second = Keysight33500B(line(bench.addresses["waveform_dac"]))  # as after a crash
    second.connect()
    second.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert clock.now() - begun >= 10_001 / 5000 - 1e-9
    assert plant.events[-1][1].size == 10_001 or plant.levels[-1] == pytest.approx(-10)
    second.load("next", triangle(), -10.0, -2.0, 5000)
    second.start()
    second.wait(1)
    assert plant.events[-1][1].max() == pytest.approx(-2.0)


def test_after_a_late_answer_the_driver_goes_on_with_a_fresh_line(resting, faults):
    resting._link.transport.timeout_s = 0.1
    faults["waveform_dac"]["late_reply"] = 0.3
    with pytest.raises(InstrumentError) as failure:
        resting.output_level()
    assert failure.value.code == "instrument-timeout"
    time.sleep(0.3)
    resting._link.transport.timeout_s = 5.0
    assert resting.output_level() == pytest.approx(-10.0)


def test_a_bench_that_is_not_there_is_refused(plant, line):
    faults = {"waveform_dac": {"refuse": True}}
    with (
        SimulatedBench(plant, VirtualClock(), faults=faults) as bench,
        pytest.raises(InstrumentError) as refused,
    ):
        line(bench.addresses["waveform_dac"])
    assert refused.value.code == "instrument-refused"


def test_a_digitizer_at_the_generators_address_is_an_identity_error(bench, line):
    driver = Keysight33500B(line(bench.addresses["digitizer"]))
    with pytest.raises(InstrumentError) as failure:
        driver.connect()
    assert failure.value.code == "instrument-identity"


def test_settings_are_told_as_read_back(resting):
    settings = resting.settings()
    assert settings["OUTP1?"] == "1"
    assert float(settings["SOUR1:VOLT:LOW?"]) == pytest.approx(-10)
    assert settings["TRIG1:SOUR?"] == "BUS"
