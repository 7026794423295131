"""The amplifier over a pseudo terminal, and the instruments that have no link."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import tty

import pytest

from drivers.amplifier import ManualAmplifier, ThorlabsMDT69x
from drivers.errors import InstrumentError
from drivers.interferometer import EXACT_UM_PER_V, PRINTED_UM_PER_V, SiosSPS120
from drivers.simulated.bench import SimulatedBench


def test_the_amplifier_tells_who_it_is_and_how_it_is_set(bench, line):
    amplifier = ThorlabsMDT69x(line(bench.addresses["amplifier"]))
    identity = amplifier.connect()
    assert identity.model == "MDT694B"
    assert identity.is_simulated
    assert amplifier.set_voltage() == 75.0
    assert amplifier.voltage_limit() == 75.0
    assert set(amplifier.settings()) == {"xvoltage?", "vlimit?"}


@pytest.mark.parametrize(
    ("adjusted", "named"),
    [({"set_voltage_v": 60.0}, "xvoltage"), ({"voltage_limit_v": 150.0}, "vlimit")],
)
def test_an_amplifier_adjusted_otherwise_is_not_used(plant, clock, line, adjusted, named):
    with SimulatedBench(plant, clock, **adjusted) as bench:
        amplifier = ThorlabsMDT69x(line(bench.addresses["amplifier"]))
        with pytest.raises(InstrumentError, match=f"{named} should be 75 V") as failure:
            amplifier.connect()
        amplifier.close()
    assert failure.value.code == "instrument-setting"


def test_the_simulated_set_voltage_is_the_plants_offset(bench, line, plant):
    serial = line(bench.addresses["amplifier"])
    serial.write(b"XVOLTAGE=42.5\r")
    serial.read_until(b"> ")
    assert plant.offset == 42.5
    serial.write(b"xvoltage=90\r")
    assert b"CMD_ARG_INVALID" in serial.read_until(b"> ")
    assert plant.offset == 42.5


def test_a_prompt_between_echo_and_answer_is_understood(line):
    """As in a transcript of an MDT693B with firmware 1.05."""
    near, far = os.openpty()
    tty.setraw(far)

    def unit():
        os.read(near, 100)
        os.write(near, b"vlimit?\r*[ 100]\r*")

    thread = threading.Thread(target=unit)
    thread.start()
    amplifier = ThorlabsMDT69x(line(os.ttyname(far)))
    assert amplifier.voltage_limit() == 100.0
    thread.join()
    amplifier.close()
    os.close(near)
    os.close(far)


def test_a_manual_amplifier_is_what_the_config_says():
    amplifier = ManualAmplifier(75.0, 75.0, "M001")
    assert amplifier.connect().is_manual
    assert not amplifier.identity.is_simulated
    assert amplifier.set_voltage() == 75.0


def test_the_printed_sensitivities_are_the_powers_of_four_rounded():
    assert PRINTED_UM_PER_V == (0.24, 0.97, 3.87, 15.48, 61.9, 247.61, 990.44)
    assert EXACT_UM_PER_V[0] == pytest.approx(0.2418, abs=5e-5)
    assert EXACT_UM_PER_V[1] == pytest.approx(0.9672, abs=5e-5)


def test_the_switch_counts_only_when_the_operator_confirms_it():
    asked = []
    yes = SiosSPS120(lambda question: asked.append(question) or True)
    assert yes.set_switch(2) == 3.87
    assert yes.set_switch(2) == 3.87
    assert len(asked) == 1
    assert "2" in asked[0]
    with pytest.raises(InstrumentError) as failure:
        SiosSPS120(lambda question: False).set_switch(3)
    assert failure.value.code == "instrument-setting"
    with pytest.raises(ValueError, match="0 to 6"):
        yes.set_switch(7)


def test_importing_the_drivers_loads_no_instrument_library():
    code = (
        "import sys, drivers.clock, drivers.errors, drivers.transport, drivers.scpi_instrument;"
        "heavy = {'pyvisa', 'serial', 'numba', 'numpy'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
