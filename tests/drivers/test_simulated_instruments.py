"""The simulated instruments, driven by a plain socket that knows nothing of the drivers."""

from __future__ import annotations

import struct
import time

import numpy as np
import pytest

from drivers.clock import BenchClock, RealClock
from drivers.simulated.bench import SimulatedBench


def triangle(points: int) -> np.ndarray:
    ramp = np.linspace(-32767, 32767, points // 2 + 1)
    return np.rint(np.concatenate([ramp, ramp[-2::-1]])).astype(np.int16)


def upload(dac, name: str, codes: np.ndarray, order: str = "<") -> None:
    payload = codes.astype(f"{order}i2").tobytes()
    head = f"SOUR1:DATA:ARB:DAC {name},#{len(str(len(payload)))}{len(payload)}"
    dac.send(head.encode() + payload + b"\n")


def play_ready(dac, codes: np.ndarray) -> None:
    """The sequence of the instrument's guide, message by message."""
    dac.send(b"*CLS\nOUTP1:LOAD INF\nFORM:BORD SWAP\nSOUR1:DATA:VOL:CLE\n")
    upload(dac, "sweep", codes)
    dac.send(b"SOUR1:FUNC:ARB sweep; :FUNC ARB; :FUNC:ARB:SRAT 5000; :FUNC:ARB:FILT STEP\n")
    dac.send(b"SOUR1:VOLT:HIGH 0; :VOLT:LOW -10\n")
    dac.send(b"SOUR1:BURS:MODE TRIG; :BURS:NCYC 1; :BURS:STAT ON\n")
    dac.send(b"TRIG1:SOUR BUS; :OUTP:TRIG:SLOP POS; :OUTP:TRIG ON\nOUTP1 ON\n")
    assert dac.ask("SYST:ERR?") == '+0,"No error"'


def test_serial_numbers_begin_with_sim(client):
    for name in ("waveform_dac", "digitizer", "clock"):
        assert client(name).ask("*IDN?").split(",")[2].startswith("SIM")


def test_a_generator_at_power_on_is_off_and_the_stack_at_75_volts(client, plant):
    dac = client("waveform_dac")
    assert dac.ask("OUTP?") == "0"
    assert dac.ask("FUNC?;FREQ?").startswith("SIN;+1.0")
    assert float(dac.ask("OUTP:LOAD?")) == 50
    assert float(dac.ask("VOLT?")) == pytest.approx(0.1)
    assert plant.stack_v(0.0) == 75


def test_levels_double_when_the_load_is_infinite(client):
    dac = client("waveform_dac")
    dac.send(b"VOLT 0.5;VOLT:OFFS 0.25\nOUTP1:LOAD INF\n")
    assert float(dac.ask("VOLT?")) == pytest.approx(1.0)
    assert float(dac.ask("VOLT:OFFS?")) == pytest.approx(0.5)
    assert float(dac.ask("OUTP:LOAD?")) == pytest.approx(9.9e37)


def test_minus_ten_to_zero_sits_exactly_on_the_limit(client):
    dac = client("waveform_dac")
    dac.send(b"OUTP1:LOAD INF\nVOLT:HIGH 0;LOW -10\n")
    assert dac.ask("SYST:ERR?") == '+0,"No error"'
    assert float(dac.ask("VOLT:HIGH?")) == pytest.approx(0, abs=1e-9)
    assert float(dac.ask("VOLT:LOW?")) == pytest.approx(-10)
    dac.send(b"VOLT:OFFS -5.1\n")
    assert dac.ask("SYST:ERR?").startswith("-222")


def test_a_wrong_level_moves_the_other_one_and_is_told(client):
    dac = client("waveform_dac")
    dac.send(b"OUTP1:LOAD INF;:VOLT:HIGH 1;LOW -1;HIGH -3\n")
    assert dac.ask("SYST:ERR?").startswith("-221")
    assert float(dac.ask("VOLT:HIGH?")) == pytest.approx(-3)
    assert float(dac.ask("VOLT:LOW?")) < -3


@pytest.mark.parametrize(
    "message",
    [
        b"SOURce1:VOLTage:LEVel:IMMediate:HIGH 2\n",
        b":sour:volt:high +2.0E0\n",
        b"volt:high 2000 mV\r\n",
        b"  VOLT:HIGH   2V  \n",
        b"*CLS;:SOUR1:VOLT:LOW -1;HIGH 2\n",
    ],
)
def test_a_command_may_be_written_in_many_ways(client, message):
    dac = client("waveform_dac")
    dac.send(b"OUTPut1:LOAD INFinity\n" + message)
    assert float(dac.ask("VOLT:HIGH?")) == pytest.approx(2)
    assert dac.ask("SYST:ERR?") == '+0,"No error"'


def test_a_command_may_come_in_pieces_and_several_in_one_packet(client):
    dac = client("waveform_dac")
    for byte in b"OUTP1:LOAD INF\nVOLT:HI":
        dac.send(bytes([byte]))
    time.sleep(0.02)
    dac.send(b"GH 3\nVOLT:HIGH?\n*ESR?\n")
    assert float(dac.line()) == pytest.approx(3)
    assert dac.line() == "+0"


def test_mistakes_are_numbered_and_counted_in_the_status_register(client):
    dac = client("waveform_dac")
    wrong = {
        b"NO:SUCH:THING 1\n": -113,
        b"VOLT:HIGH\n": -109,
        b"VOLT:HIGH 1,2\n": -108,
        b"FORM:BORD MAYBE\n": -224,
        b"SOUR1:FUNC:ARB:SRAT 1e12\n": -222,
        b"@\n": -102,
        b"*TRG\n": -211,
    }
    for message in wrong:
        dac.send(message)
    codes = [int(dac.ask("SYST:ERR?").split(",")[0]) for _ in wrong]
    assert codes == list(wrong.values())
    assert int(dac.ask("*ESR?")) == (1 << 5) | (1 << 4)
    assert dac.ask("*ESR?") == "+0"


def test_the_error_queue_holds_twenty_and_is_cleared_but_not_reset(client):
    dac = client("waveform_dac")
    dac.send(b"BAD\n" * 25 + b"*RST\n")
    codes = [int(dac.ask("SYST:ERR?").split(",")[0]) for _ in range(21)]
    assert codes == [-113] * 19 + [-350, 0]
    dac.send(b"BAD\n*CLS\n")
    assert dac.ask("SYST:ERR?") == '+0,"No error"'


def test_a_syntax_error_drops_the_rest_of_its_message(client):
    dac = client("waveform_dac")
    dac.send(b"BAD;:OUTP1 ON\n")
    assert dac.ask("OUTP?") == "0"


def test_an_existing_waveform_is_not_overwritten(client):
    dac = client("waveform_dac")
    dac.send(b"FORM:BORD SWAP\n")
    upload(dac, "same", triangle(100))
    upload(dac, "SAME", triangle(100))
    assert "already exists" in dac.ask("SYST:ERR?")


def test_dc_cannot_be_bursted(client):
    dac = client("waveform_dac")
    dac.send(b"FUNC DC;:BURS:STAT ON\n")
    assert dac.ask("SYST:ERR?").startswith("-221")
    assert dac.ask("BURS:STAT?") == "0"


@pytest.mark.parametrize(("border", "order"), [("SWAP", "<"), ("NORM", ">")])
def test_both_byte_orders_play_the_same_volts(client, plant, border, order):
    dac = client("waveform_dac")
    codes = triangle(200)
    dac.send(f"OUTP1:LOAD INF;:FORM:BORD {border}\n".encode())
    upload(dac, "sweep", codes, order)
    dac.send(b"FUNC:ARB sweep;:FUNC ARB;:FUNC:ARB:SRAT 5000;:VOLT:HIGH 0;LOW -10\n")
    dac.send(b"BURS:STAT ON;:TRIG:SOUR BUS;:OUTP ON\n*TRG\n")
    assert dac.ask("*OPC?") == "1"
    _, played, rate = next(event for event in reversed(plant.events) if event[1].size > 1)
    assert rate == 5000
    assert played == pytest.approx(-5 + 5 * (codes / 32767), abs=1e-9)


def test_opc_jumps_to_the_end_of_the_burst_on_a_virtual_clock(client, clock):
    dac = client("waveform_dac")
    play_ready(dac, triangle(25_000))
    begun, wall = clock.now(), time.monotonic()
    dac.send(b"*TRG\n")
    assert dac.ask("*OPC?") == "1"
    assert clock.now() - begun == pytest.approx(25_001 / 5000)
    assert time.monotonic() - wall < 1


def test_opc_waits_on_a_real_clock_while_the_others_are_served(plant, plain):
    with SimulatedBench(plant, RealClock()) as bench:
        dac, digitizer = (plain(bench.addresses[name]) for name in ("waveform_dac", "digitizer"))
        play_ready(dac, triangle(2500))
        begun = time.monotonic()
        dac.send(b"*TRG\n*OPC?\n")
        assert digitizer.ask("*IDN?")
        assert time.monotonic() - begun < 0.3
        assert dac.line() == "1"
        assert time.monotonic() - begun == pytest.approx(0.5, abs=0.2)


def set_up_digitizer(digitizer, count: int) -> None:
    digitizer.send(
        f"CONF:ACQ:SRAT 5000;SCO {count};SPR 0;REC 1;:CONF:CHAN:RANG (@1),128;RANG (@2),16;"
        "COUP (@1,2),DC;:CONF:ARM:SOUR IMM;:CONF:TRIG:SOUR EXT;:CONF:EXT:INP POS;"
        ":FORM:DATA:REAL REAL,32\n".encode()
    )
    assert digitizer.ask("SYST:ERR?") == '+0,"No error"'


def test_the_trigger_output_starts_the_digitizer_with_the_burst(client):
    dac, digitizer = client("waveform_dac"), client("digitizer")
    codes = triangle(2000)
    play_ready(dac, codes)
    set_up_digitizer(digitizer, 2000)
    digitizer.send(b"INIT\n")
    assert digitizer.ask("SYST:ERR?") == '+0,"No error"'
    dac.send(b"*TRG\n")
    assert dac.ask("*OPC?") == "1"
    payload = digitizer.ask_block("FETC:WAV:VOLT? (@1,2),0,2000,(@1)")
    volts = np.frombuffer(payload, ">f4").reshape(2000, 2)  # big-endian unless asked otherwise
    stack = 75 + 7.5 * (-5 + 5 * (codes[:2000] / 32767))
    assert np.abs(volts[:, 0] - stack).max() <= 0.51 * 128 / 32767
    assert np.abs(volts[:, 1] + 0.1 * stack).max() <= 0.51 * 16 / 32767


def test_codes_times_range_are_the_volts_in_both_byte_orders(client):
    dac, digitizer = client("waveform_dac"), client("digitizer")
    play_ready(dac, triangle(400))
    set_up_digitizer(digitizer, 400)
    digitizer.send(b"INIT\n")
    digitizer.ask("*ESR?")
    dac.send(b"*TRG\n")
    dac.ask("*OPC?")
    big = np.frombuffer(digitizer.ask_block("FETC:WAV:ADC? (@1),10,50,(@1)"), ">i2")
    digitizer.send(b"FORM:BORD SWAP\n")
    little = np.frombuffer(digitizer.ask_block("FETC:WAV:ADC? (@1),10,50,(@1)"), "<i2")
    volts = np.frombuffer(digitizer.ask_block("FETC:WAV:VOLT? (@1),10,50,(@1)"), "<f4")
    assert list(big) == list(little)
    assert volts == pytest.approx(little * (128 / 32767), rel=1e-6)


def test_without_a_trigger_there_is_no_data(client):
    digitizer = client("digitizer")
    set_up_digitizer(digitizer, 8)
    digitizer.send(b"INIT\n")
    payload = digitizer.ask_block("FETC:WAV:VOLT? (@1,2),0,8,(@1)")
    assert payload == struct.pack(">f", 9.91e37) * 16
    codes = digitizer.ask_block("FETC:WAV:ADC? (@2),0,4,(@1)")
    assert codes == struct.pack(">h", -32768) * 4


@pytest.mark.parametrize(
    "missing", [b"OUTP:TRIG OFF\n", b"OUTP:TRIG:SLOP NEG\n", b"OUTP1:TRIGger:STATe 0\n"]
)
def test_no_pulse_or_the_wrong_edge_triggers_nothing(client, missing):
    dac, digitizer = client("waveform_dac"), client("digitizer")
    play_ready(dac, triangle(400))
    dac.send(missing)
    set_up_digitizer(digitizer, 8)
    digitizer.send(b"INIT\n")
    digitizer.ask("*ESR?")
    dac.send(b"*TRG\n")
    dac.ask("*OPC?")
    payload = digitizer.ask_block("FETC:WAV:ADC? (@1),0,8,(@1)")
    assert payload == struct.pack(">h", -32768) * 8


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (b"CONF:ACQ:SRAT 3000\n", -224),
        (b"CONF:ACQ:SRAT 100\n", -222),
        (b"CONF:ACQ:SCO 4\n", -222),
        (b"CONF:ACQ:SCO 10\n", -224),
        (b"CONF:CHAN:RANG (@1),3\n", -224),
        (b"CONF:CHAN:RANG (@7),4\n", -222),
        (b"CONF:CHAN:RANG 1,4\n", -171),
        (b"TRIG:IMM\n", -211),
        (b"INIT;INIT\n", -213),
    ],
)
def test_the_digitizer_refuses_what_it_does_not_have(client, message, code):
    digitizer = client("digitizer")
    digitizer.send(b"CONF:TRIG:SOUR SOFT\n" + message)
    assert int(digitizer.ask("SYST:ERR?").split(",")[0]) == code


def test_switching_the_output_off_puts_75_volts_on_the_stack(client, plant, clock):
    dac = client("waveform_dac")
    play_ready(dac, triangle(400))
    assert plant.stack_v(clock.now()) == pytest.approx(0)
    dac.send(b"OUTP1 OFF\n")
    dac.ask("*OPC?")
    assert plant.stack_v(clock.now()) == 75


def test_clearing_the_memory_under_the_output_moves_it(client, plant, clock):
    dac = client("waveform_dac")
    play_ready(dac, triangle(400))
    dac.send(b"SOUR1:DATA:VOL:CLE\n")
    assert "EXP_RISE" in dac.ask("FUNC:ARB?")
    assert plant.stack_v(clock.now()) == pytest.approx(37.5)  # the built-in one begins at mid-scale


def test_the_clock_port_tells_the_time_and_lets_it_pass(bench, clock):
    remote = BenchClock(bench.addresses["clock"])
    remote.sleep(12.5)
    assert remote.now() == pytest.approx(12.5)
    assert clock.now() == pytest.approx(12.5)
    remote.close()


def test_a_serial_number_that_could_be_real_is_refused(plant, clock):
    with pytest.raises(ValueError, match="SIM"):
        SimulatedBench(plant, clock, serial_numbers={"digitizer": "MY12345"})
