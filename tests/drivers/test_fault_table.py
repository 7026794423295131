"""Every fault on every driver over every transport: named, in time, and nothing stale taken.

The instruments are the simulated ones, served on a socket or a pseudo terminal;
``plain-visa`` is a socket reached through PyVISA's public calls alone, the way a
USB instrument is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from drivers.amplifier import ThorlabsMDT69x
from drivers.clock import VirtualClock
from drivers.digitizer import KeysightL4532A
from drivers.errors import InstrumentError
from drivers.simulated.bench import SimulatedBench
from drivers.simulated.faults import KINDS, check_faults
from drivers.transport import VisaTransport, open_transport
from drivers.waveform_dac import Keysight33500B

TIMEOUT_S = 0.1
SLOW_TIMEOUT_S = 0.3  # where every byte is a call
RAMP = np.array([-32767, 0, 32767, 32767, 32767, 32767, 0, -32767], np.int16)
AT_REST = "OUTP1:LOAD INF;:FUNC DC;:VOLT 0.01;:VOLT:OFFS -10;:OUTP1 ON"  # as a person may leave it
TRANSPORTS = ("socket", "plain-visa", "pty")
DRIVERS = {
    "waveform_dac": Keysight33500B, "digitizer": KeysightL4532A, "amplifier": ThorlabsMDT69x,
}


@dataclass
class Rig:
    """One driver, ready, with the faults of its instrument."""

    name: str
    driver: Any
    clock: VirtualClock
    faults: dict[str, Any]

    def ask(self) -> Any:
        """A question whose answer is known."""
        if self.name == "waveform_dac":
            return self.driver.output_level()
        if self.name == "digitizer":
            return self.driver.settings()["CONF:ACQ:SCO?"]
        return self.driver.set_voltage()

    def set(self) -> None:
        """A setting."""
        if self.name == "waveform_dac":
            self.driver.load("sweep", RAMP, -10.0, -9.0, 5000)
        else:
            self.driver.configure(5000, 48, {1: 128.0, 2: 16.0}, trigger="IMM")

    def fetch(self) -> np.ndarray:
        """A record of 48 samples of the drive monitor, which stands at 75 V."""
        self.driver.configure(5000, 48, {1: 128.0, 2: 16.0}, trigger="IMM")
        self.driver.arm()
        self.clock.sleep(1.0)
        return self.driver.fetch([1, 2], 48)[1]

    @property
    def answer(self) -> Any:
        return {"waveform_dac": -10.0, "digitizer": "+48", "amplifier": 75.0}[self.name]


@pytest.fixture(params=TRANSPORTS)
def rig(request, plant, clock, monkeypatch) -> Iterator[Callable[..., Rig]]:
    """``rig(name, **faults)`` is a driver; with ``connect=False`` only its instrument is served."""
    if request.param == "plain-visa":
        monkeypatch.setattr(VisaTransport, "_find_socket", lambda self: None)
    kept: list[Any] = []

    def make(name: str, connect: bool = True, **faults: Any) -> Rig:
        if request.param == "plain-visa" and name != "digitizer":
            pytest.skip("one SCPI instrument is enough for this way, which reads byte by byte")
        served = {name: {} if connect else faults}
        serial_lines = (name,) if request.param == "pty" else ()
        bench = SimulatedBench(plant, clock, faults=served, serial_lines=serial_lines)
        kept.append(bench)
        driver = None
        if connect:
            transport = open_transport(bench.addresses[name], name, 2.0)
            kept.append(transport)
            driver = DRIVERS[name](transport, *((clock,) if name == "digitizer" else ()))
            driver.connect()
        ready = Rig(name, driver, clock, served[name])
        if driver is None:
            ready.driver = lambda: _open(bench.addresses[name], name, kept)
        else:
            if name == "waveform_dac":
                driver._link.command(AT_REST)
                driver.go_to_rest(-10.0, slew_v_per_s=5.0, clock=clock)
            if name != "amplifier":
                ready.set()
            transport.timeout_s = SLOW_TIMEOUT_S if request.param == "plain-visa" else TIMEOUT_S
        ready.faults.update(faults)
        return ready

    yield make
    for one in reversed(kept):
        one.close()


def _open(address: str, name: str, kept: list[Any]) -> None:
    transport = open_transport(address, name, TIMEOUT_S)
    kept.append(transport)
    DRIVERS[name](transport).connect()


@pytest.fixture
def over(request) -> str:
    return request.node.callspec.params["rig"]


def failure(act: Callable[[], Any]) -> InstrumentError:
    """The error that an action ends with, in time."""
    begun = time.monotonic()
    with pytest.raises(InstrumentError) as caught:
        act()
    assert time.monotonic() - begun < SLOW_TIMEOUT_S + 2.0
    assert caught.value.instrument in str(caught.value)
    return caught.value


# What happens to any answer, and what it is called. The hang-up of a peer looks like silence to
# plain VISA calls.
ANY = [
    ("silent", True, {"instrument-timeout"}),
    ("late_reply", 0.3, {"instrument-timeout"}),
    ("trickle", 0.03, {"instrument-timeout"}),
    ("hang_up", True, {"instrument-hangup"}),
    ("torn", True, {"instrument-timeout"}),
    ("garbage", True, {"instrument-garbage"}),
    ("endless", 200_000, {"instrument-garbage"}),
    ("answer", "nonsense", {"instrument-garbage", "instrument-timeout"}),  # waits for the rest
]


@pytest.mark.parametrize("name", DRIVERS)
@pytest.mark.parametrize(("kind", "value", "codes"), ANY, ids=[kind for kind, _, _ in ANY])
def test_a_spoilt_answer_is_named_and_never_taken_for_the_next(rig, over, name, kind, value, codes):
    ready = rig(name, **{kind: value})
    code = failure(ready.ask).code
    if over == "plain-visa" and code == "instrument-timeout":
        return  # the far end's state cannot be seen: silence is all there is
    if over == "pty" and kind == "endless":
        codes = {*codes, "instrument-timeout"}  # a terminal is slow
    assert code in codes
    for other in ("silent", "answer"):
        ready.faults.pop(other, None)
    if over == "pty" and kind in ("hang_up", "trickle", "endless"):
        return  # unplugged for good, or still busy with sending
    for _ in range(3):
        try:
            assert ready.ask() == pytest.approx(ready.answer) or ready.ask() == ready.answer
            return
        except InstrumentError:
            continue
    pytest.fail("the line did not come back")


@pytest.mark.parametrize("name", DRIVERS)
def test_answers_that_come_twice_are_noticed_before_the_next_is_read(rig, name):
    ready = rig(name, twice=True)

    def some() -> None:
        for _ in range(3):
            assert ready.ask() in (ready.answer, pytest.approx(ready.answer))

    assert failure(some).code == "instrument-garbage"


@pytest.mark.parametrize("name", DRIVERS)
def test_nobody_there_is_refused(rig, name):
    assert failure(rig(name, connect=False, refuse=True).driver).code in {
        "instrument-refused", "instrument-hangup",
    }


@pytest.mark.parametrize("name", DRIVERS)
@pytest.mark.parametrize(
    ("faults", "codes"),
    [
        ({"silent": True}, {"instrument-timeout"}),
        ({"garbage": True}, {"instrument-garbage"}),
        ({"answer": "Keysight,33521B,SIM1"}, {"instrument-garbage", "instrument-identity"}),
        ({"answer": "Somebody,else,SIM1,1"}, {"instrument-identity"}),
        ({"answer": "Sömebody,élse,SIM1,1"}, {"instrument-identity", "instrument-garbage"}),
    ],
    ids=["silent", "garbage", "three-fields", "somebody-else", "non-ascii"],
)
def test_whoever_answers_otherwise_is_not_connected(rig, name, faults, codes):
    assert failure(rig(name, connect=False, **faults).driver).code in codes


@pytest.mark.parametrize("name", ["waveform_dac", "digitizer"])
def test_a_line_that_is_dropped_at_once_is_named(rig, over, name):
    if over == "pty":
        pytest.skip("a terminal has no connections")
    code = failure(rig(name, connect=False, drop_at_once=True).driver).code
    assert code == ("instrument-timeout" if over == "plain-visa" else "instrument-hangup")


@pytest.mark.parametrize("name", ["waveform_dac", "digitizer"])
@pytest.mark.parametrize("kind", ["error_queue", "stuck_queue"])
def test_what_the_error_queue_holds_is_told(rig, name, kind):
    error = failure(rig(name, **{kind: '-310,"Broken"' if kind == "error_queue" else True}).set)
    assert error.code == "instrument-error-queue"
    assert "-310" in str(error)


@pytest.mark.parametrize(
    ("name", "header"), [("waveform_dac", "SOUR1:FUNC:ARB:SRAT"), ("digitizer", "CONF:ACQ:SCO")]
)
def test_a_setting_that_does_not_take_is_told(rig, name, header):
    ready = rig(name)
    ready.driver._link.command(f"{header} 400")  # as somebody at the front panel may do
    ready.faults["setting_not_taken"] = [header]
    error = failure(ready.set)
    assert error.code == "instrument-setting"
    assert header in str(error)


RECORDS = [
    ({"short_block": 8}, "instrument-no-trigger"),
    ({"short_block": {"value": 8, "times": 0}}, "instrument-no-trigger"),
    ({"wrong_length": 8}, "instrument-block"),
    ({"wrong_length": -8}, "instrument-block"),
    ({"wrong_length": 10**6}, "instrument-block"),
    ({"torn": {"message": "FETC"}}, "instrument-block"),
    ({"hang_up": {"message": "FETC"}}, "instrument-hangup"),
    ({"silent": {"message": "FETC"}}, "instrument-no-trigger"),
    ({"answer": {"value": "1.5,1.5", "message": "FETC"}}, "instrument-garbage"),
    ({"byte_order": True}, "instrument-garbage"),
    ({"no_data": 0}, "instrument-no-trigger"),
    ({"no_data": 40}, "instrument-no-data"),
    ({"no_data": 40, "no_data_as_codes": True}, "instrument-no-data"),
    ({"twice": {"message": "FETC"}}, "instrument-garbage"),
]


@pytest.mark.parametrize(("faults", "code"), RECORDS, ids=[str(faults) for faults, _ in RECORDS])
def test_a_record_that_is_not_whole_is_never_believed(rig, over, faults, code):
    if over == "pty" and list(faults) not in (["torn"], ["twice"], ["wrong_length"]):
        pytest.skip("what is inside a block does not depend on the line")
    ready = rig("digitizer", **faults)
    if faults == {"short_block": 8}:  # once: a record that was not complete when first looked at
        assert ready.fetch() == pytest.approx(np.full(48, 75.0), abs=0.01)
        return
    allowed = {code}
    if over == "plain-visa" and code == "instrument-hangup":
        allowed = {"instrument-block", "instrument-timeout"}
    assert failure(ready.fetch).code in allowed


def test_an_amplifier_adjusted_while_the_run_plays_is_told(rig):
    ready = rig("amplifier")
    ready.driver.check()
    ready.faults["adjusted"] = 60.0
    error = failure(ready.driver.check)
    assert error.code == "instrument-setting"
    assert "75 V when the run began and now 60 V" in str(error)


def test_another_instrument_after_a_failure_is_told(rig):
    ready = rig("digitizer", torn=True)
    failure(ready.ask)
    ready.faults["answer"] = {"value": "Agilent Technologies,L4532A,SIM99,1", "message": "*IDN?"}
    error = failure(ready.ask)
    assert error.code == "instrument-identity"
    assert "SIM99" in str(error)


@pytest.mark.parametrize(
    ("given", "path"),
    [
        ({"camera": {}}, "camera"),
        ({"digitizer": True}, "digitizer"),
        ({"digitizer": {"silnet": True}}, "digitizer.silnet"),
        ({"amplifier": {"no_trigger": True}}, "amplifier.no_trigger"),
        ({"digitizer": {"silent": {"after": 3}}}, "digitizer.silent.after"),
        ({"digitizer": {"silent": {"from_s": -1}}}, "digitizer.silent.from_s"),
        ({"digitizer": {"late_reply": "long"}}, "digitizer.late_reply"),
    ],
)
def test_a_slip_in_the_table_of_faults_is_named(given, path):
    with pytest.raises(ValueError, match=path):
        check_faults(given)


def test_every_fault_can_be_switched_on_as_true_from_a_config():
    for name, kind in KINDS.items():
        for instrument in kind.instruments:
            assert check_faults({instrument: {name: True}}) == {instrument: {name: True}}
