"""An NI card as waveform DAC and digitizer, against a stand-in for the nidaqmx package."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import InstrumentError
from drivers.kinds import make_dac, make_digitizer
from drivers.nidaqmx_card import CardTransport
from drivers.simulated.bench import SimulatedBench
from drivers.simulated.nidaqmx_stand_in import Task, stand_in
from drivers.simulated.plant import Plant
from drivers.simulated.wiring import Wiring
from drivers.transport import open_transport
from piezo_rig.guard import Orders
from piezo_rig.guard.rest import bring_to_rest

SLEW = 30.0  # V/s of command
ALLOWED_S = 5.0  # a machine that is busy may stand still for longer than a card takes


@pytest.fixture
def card(monkeypatch):
    """A card of this computer, straight: plant, clock, and the two drivers on one line."""
    plant, clock = Plant(), VirtualClock()
    package = stand_in(Wiring(plant, clock), 0xABC)
    monkeypatch.setitem(sys.modules, "nidaqmx", package)
    monkeypatch.setitem(sys.modules, "nidaqmx.system", package.system)
    line = open_transport("Dev1/ao0", "waveform_dac", ALLOWED_S)
    dac = make_dac("nidaqmx", line, clock)
    digitizer = make_digitizer("nidaqmx", None, dac, clock, "Dev1/ai0")
    dac.connect()
    digitizer.connect()
    yield SimpleNamespace(
        plant=plant, clock=clock, package=package, line=line, dac=dac, digitizer=digitizer,
        hardware=package.card,
    )
    clock.sleep(100.0)  # no burst is left to be waited for
    line.close()


def at_rest(card):
    card.dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)
    return card


def triangle(points: int = 1001) -> np.ndarray:
    codes = np.interp(np.arange(points), [0, points // 2, points - 1], [-32767, 32767, -32767])
    return np.rint(codes).astype(np.int16)


def stack(card, begin: float, end: float, step: float = 1e-3) -> np.ndarray:
    return np.array([card.plant.stack_v(t) for t in np.arange(begin, end, step)])


def code_of(action) -> str:
    with pytest.raises(InstrumentError) as caught:
        action()
    return caught.value.code


def arguments(file: str, function: str) -> set[str]:
    """Of a function in the package's own source, which takes seconds to import."""
    found = importlib.util.find_spec("nidaqmx")
    if found is None or found.origin is None:
        pytest.skip("the nidaqmx package is not installed")
    tree = ast.parse((Path(found.origin).parent / file).read_text(encoding="utf-8"))
    (node,) = {n.name: n for n in ast.walk(tree)
               if isinstance(n, ast.FunctionDef) and n.name == function}.values()
    return {a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)}


@pytest.mark.parametrize(("ours", "file", "theirs"), [
    *((getattr(Task, name), "task/_task.py", name)
      for name in ("write", "read", "start", "stop", "is_task_done")),
    (Task.close, "task/_task.py", "clear"),  # of which it is another name
    (Task._clock, "task/_timing.py", "cfg_samp_clk_timing"),
    (Task._add_output, "task/collections/_ao_channel_collection.py", "add_ao_voltage_chan"),
    (Task._add_input, "task/collections/_ai_channel_collection.py", "add_ai_voltage_chan"),
    (lambda self: 0, "system/device.py", "product_type"),
    (lambda self: 0, "system/device.py", "serial_num"),
    (lambda self: 0, "system/device.py", "is_simulated"),
    (lambda self: 0, "system/system.py", "driver_version"),
])
def test_the_stand_in_has_the_interface_of_the_package(ours, file, theirs):
    assert set(inspect.signature(ours).parameters) <= arguments(file, theirs)


def test_a_card_says_who_it_is_and_a_simulated_one_that_it_is_simulated(card):
    assert card.dac.identity.serial == "SIM00000ABC"
    assert card.dac.identity.is_simulated
    card.package.system.System.local().devices["Dev1"].is_simulated = False
    assert not card.dac.connect().is_simulated


def test_the_first_way_to_rest_begins_at_75_v_and_keeps_the_slew_limit(card):
    assert card.dac.output_level() == 0.0  # a card after power-up: 75 V on the stack
    begun = card.clock.now()
    moved = card.dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)
    assert (moved["from_v"], moved["to_v"]) == pytest.approx((0.0, -10.0), abs=1e-3)
    volts = stack(card, begun, card.clock.now() + 0.01)
    assert (volts[0], volts[-1]) == pytest.approx((75.0, 0.0), abs=0.01)
    assert np.abs(np.diff(volts)).max() <= 7.5 * SLEW * 1e-3 * 1.25  # steps of 0.2 ms
    assert moved["duration_s"] == pytest.approx(10.0 / SLEW, abs=0.01)


def test_a_sweep_is_played_and_recorded_at_the_same_instants(card):
    at_rest(card)
    codes = triangle()
    card.dac.load("sweep_0001", codes, -10.0, -5.0, 1000.0)
    card.digitizer.configure(1000.0, 1000, {2: 1.0})
    card.digitizer.arm()
    begun = card.clock.now()
    card.dac.start()
    card.dac.wait(1.001)
    volts = card.digitizer.fetch([2], 1000)[2]
    assert card.clock.now() == pytest.approx(begun + 1.001, abs=0.02)
    assert card.plant.stack_v(begun + 0.5005) == pytest.approx(37.5, abs=0.1)
    assert card.plant.stack_v(card.clock.now() + 1e-3) == pytest.approx(0.0, abs=0.01)
    # polarity -1: the sensor falls as the stack rises, and is lowest where the drive turns
    assert volts.shape == (1000,)
    assert abs(int(volts.argmin()) - 500) <= 3
    assert card.digitizer.overflows == {2: 0}


def test_a_frozen_output_is_found_where_it_is_and_brought_down(card):
    """What remains of a burst whose process was killed."""
    at_rest(card)
    card.dac.load("sweep_0001", triangle(), -10.0, 0.0, 1000.0)
    card.dac.start()
    card.clock.sleep(0.4)
    card.hardware.busy["ao"].stop()  # as NI-DAQmx does when the process ends
    stuck = card.plant.stack_v(card.clock.now() + 1.0)
    assert stuck == pytest.approx(60.0, abs=0.3)
    begun = card.clock.now()
    again = make_dac("nidaqmx", CardTransport("Dev1/ao0", "waveform_dac", ALLOWED_S), card.clock)
    again.connect()
    moved = again.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)
    assert moved["from_v"] == pytest.approx((stuck - 75) / 7.5, abs=0.01)
    volts = stack(card, begun, card.clock.now() + 0.01)
    assert np.abs(np.diff(volts)).max() <= 7.5 * SLEW * 1e-3 * 1.25
    assert volts[-1] == pytest.approx(0.0, abs=0.01)


def test_a_burst_that_plays_is_let_to_its_end(card):
    at_rest(card)
    card.dac.load("sweep_0001", triangle(3001), -10.0, 0.0, 1000.0)
    card.dac.start()
    card.clock.sleep(0.5)
    assert code_of(card.dac.output_level) == "bench-refused"
    begun = card.clock.now()
    card.dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)
    assert card.clock.now() >= begun + 2.5
    assert stack(card, begun, begun + 2.5).max() == pytest.approx(75.0, abs=0.1)


def test_the_guard_brings_a_card_to_rest(card):
    at_rest(card)
    with SimulatedBench(Plant(), card.clock, card=True) as bench:
        orders = Orders(
            address=bench.addresses["waveform_dac"], timeout_s=2.0, clock=bench.addresses["clock"],
            rest_command_v=-10.0, slew_v_per_s=SLEW, gain=7.5, offset_v=75.0, driver="nidaqmx",
        )
        line = open_transport(orders.address, "waveform_dac", 2.0)
        dac = make_dac("nidaqmx", line, card.clock)
        serial = dac.connect().serial
        dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)
        dac.load("sweep_0001", triangle(), -10.0, 0.0, 1000.0)
        dac.start()
        moved = bring_to_rest(line, orders, serial, give_up_s=0.0)
        assert moved["to_v"] == pytest.approx(0.0, abs=0.01)
        assert moved["duration_s"] >= 1.0  # the burst was waited for
        assert bench.plant.stack_v(card.clock.now()) == pytest.approx(0.0, abs=0.01)
        line.close()


def test_what_would_jump_or_break_a_limit_is_refused(card):
    def sends(*volts: float) -> None:
        card.dac._send(np.array(volts), 1000.0)

    sends(-5.0, -10.0)  # the output is at 0 V
    assert code_of(card.dac.start) == "instrument-error-queue"
    for beyond in ((0.0, 10.1), (0.0, np.nan)):
        assert code_of(lambda v=beyond: sends(*v)) == "instrument-error-queue"
    at_rest(card)
    card.dac.load("sweep_0001", triangle(), -10.0, -5.0, 1000.0)
    card.dac.start()
    assert code_of(card.dac.start) == "instrument-error-queue"
    assert code_of(lambda: sends(-10.0, -10.0)) == "instrument-error-queue"
    card.clock.sleep(2.0)
    up = triangle()
    up[-1] = 0
    with pytest.raises(ValueError, match="begins and ends at rest"):
        card.dac.load("sweep_0002", up, -10.0, -5.0, 1000.0)
    assert code_of(lambda: card.dac.load("s", triangle(), -9.0, -5.0, 1000.0)) == "bench-refused"


def test_an_input_without_its_clock_is_no_trigger(card):
    at_rest(card)
    card.dac.load("sweep_0001", triangle(), -10.0, -5.0, 1000.0)
    card.digitizer.configure(1000.0, 1000, {2: 1.0})
    card.digitizer.arm()
    assert code_of(lambda: card.digitizer.fetch([2], 1000)) == "instrument-no-trigger"
    card.dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=card.clock)  # the wait is given up


def test_what_a_card_does_not_have_is_refused(card):
    for ranges, rate in (({1: 1.0}, 1000.0), ({2: 128.0}, 1000.0), ({2: 1.0}, 5000.0)):
        with pytest.raises(ValueError, match=r"wired|range|clock"):
            card.digitizer.configure(rate, 1000, ranges)


def test_an_output_that_cannot_be_measured_is_not_played_on(card):
    other = card.package.Task()
    other.ai_channels.add_ai_voltage_chan("Dev1/ai3")
    other.timing.cfg_samp_clk_timing(1000.0)
    other.start()  # another program has the inputs
    with pytest.raises(InstrumentError, match="reserved") as caught:
        card.dac.output_level()
    assert caught.value.code == "bench-refused"
    assert "ao0,ai7" in caught.value.remedy


def test_a_clipped_sensor_is_counted(card):
    at_rest(card)
    card.dac.load("sweep_0001", triangle(), -10.0, 0.0, 1000.0)
    card.digitizer.configure(1000.0, 1000, {2: 0.1})
    card.digitizer.arm()
    card.dac.start()
    card.dac.wait(1.001)
    volts = card.digitizer.fetch([2], 1000)[2]
    assert card.digitizer.overflows[2] > 100
    assert np.abs(volts).max() <= 0.1 + 1e-9


@pytest.mark.parametrize("package", [None, SimpleNamespace(system=SimpleNamespace())])
def test_a_computer_without_card_or_package_says_what_is_missing(monkeypatch, package):
    monkeypatch.setitem(sys.modules, "nidaqmx", package)
    monkeypatch.setitem(sys.modules, "nidaqmx.system", getattr(package, "system", None))
    with pytest.raises(InstrumentError) as caught:
        open_transport("Dev1/ao0", "waveform_dac", ALLOWED_S)
    assert caught.value.code == "instrument-refused"
    assert "piezo-rig[nidaqmx]" in caught.value.remedy or "NI MAX" in caught.value.remedy
