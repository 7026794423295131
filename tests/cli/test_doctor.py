"""`piezo-rig doctor`: what it finds on a simulated bench; the stack is at rest after it."""

from __future__ import annotations

import socket

import pytest

from drivers.simulated.bench import SimulatedBench
from piezo_rig.cli import main
from piezo_rig.resources import shipped_folder

RIG = (shipped_folder("configs") / "simulated_bench.toml").read_text()


@pytest.fixture
def examined(tmp_path, capsys, monkeypatch):
    """A function: plant settings and instrument faults -> exit status and what was printed.

    The stack is looked at in the plant itself, whatever any instrument says.
    """
    served: list[SimulatedBench] = []

    def examine(plant="", faults=None, change=lambda text: text, disturb=None):
        def bench(*args, **options):
            made = SimulatedBench(*args, **{**options, "faults": faults or {}})
            served.append(made)
            if disturb:
                disturb(made)
            return made

        monkeypatch.setattr("drivers.simulated.bench.SimulatedBench", bench)
        path = tmp_path / "rig.toml"
        path.write_text(change(RIG) + plant)
        status = main(["doctor", "--rig", str(path)])
        said = capsys.readouterr()
        assert said.err == ""
        last = served[-1]
        return status, said.out, last.plant.stack_v(last.clock.now() + 0.01)  # past the lag

    return examine


def test_a_good_rig_is_ready(examined):
    status, said, stack_v = examined()
    assert status == 0, said
    assert said.endswith("no faults; the rig is ready\n")
    assert "FAULT" not in said
    assert "25.00 V at 25 V, 50.00 V at 50 V" in said
    assert abs(stack_v) < 0.01


FAULTY_PLANTS = {
    "drive_gain]\non = true\nratio = 1.03": ("25.75 V at 25 V, 51.50 V at 50 V", "gain is 7.7"),
    "drive_clipping]\non = true\nupper = 60.0": ("60.00 V where 75.00 V are due", "limit switch"),
    "drive_clipping]\non = true\nlower = 2.0": ("saturates at the lower rail", "set voltage"),
    "white_noise]\nrms = 40.0": ("noise at rest is", "weak beam"),
    "mains-hum]\non = true\namplitude = 20.0": ("noise at rest is", "mains hum at 50 Hz"),
    "outliers]\non = true\nper_second = 20.0\nheight = 800.0": ("noise at rest", "single spikes"),
    "sensor]\nswitch = 4": ("the stack moves 2.", "sensitivity switch"),
    "sensor]\npolarity = 1": ("the stack moves -", "set polarity = 1"),
    "sensor]\nzero_v = -0.9": ("the end of its range", "set its zero"),
    "sensor]\nlimit_v = 0.0": ("stands still at", "beam is interrupted"),
}


@pytest.mark.parametrize("plant", list(FAULTY_PLANTS))
def test_a_fault_of_the_bench_is_named_with_cause_and_remedy(examined, plant):
    status, said, stack_v = examined(f"\n[plant.{plant}\n")
    assert status == 1
    for words in FAULTY_PLANTS[plant]:
        assert words in said, said
    assert "cause:" in said
    assert "do:" in said
    assert abs(stack_v) < 0.01 + 2.0 * ("lower" in plant)  # the amplifier that cannot go lower


def test_an_instrument_that_does_not_answer_is_named_and_nothing_moves(examined):
    status, said, stack_v = examined(faults={"digitizer": {"refuse": True}})
    assert status == 1
    assert "FAULT  digitizer" in said
    assert "instrument-refused" in said
    assert "ok     waveform_dac" in said  # the others are looked at all the same
    assert "ok     amplifier" in said
    assert "nothing was moved" in said
    assert stack_v == 75.0  # as it was found: the generator is off


def test_a_trigger_cable_that_is_missing_is_named(examined):
    status, said, stack_v = examined(faults={"digitizer": {"no_trigger": True}})
    assert status == 1
    assert "FAULT  digitizer" in said
    assert "trigger" in said.split("cause:")[1]
    assert abs(stack_v) < 0.01


def test_a_setting_that_is_not_taken_is_named(examined):
    status, said, stack_v = examined(
        faults={"digitizer": {"setting_not_taken": ["CONF:ACQ:SRAT"]}}
    )
    assert status == 1
    assert "instrument-setting" in said
    assert "SRAT" in said
    assert abs(stack_v) < 0.01


def test_an_error_queue_that_is_not_empty_is_a_fault(examined):
    def disturb(bench):
        _, host, port, _ = bench.addresses["digitizer"].split("::")
        with socket.create_connection((host, int(port))) as line:
            line.sendall(b"NONSENSE 5\nSYST:VERS?\n*IDN?\n")
            line.recv(100)

    status, said, _ = examined(disturb=disturb)
    assert status == 1
    assert "FAULT  digitizer       its error queue is not empty" in said
    assert "-113" in said


def test_another_serial_number_than_the_configs_is_a_fault(examined):
    def change(text):
        return text.replace('driver = "keysight_l4532a"',
                            'driver = "keysight_l4532a"\nserial = "MY123"')

    status, said, _ = examined(change=change)
    assert status == 1
    assert "has serial number SIM00002, the config expects MY123" in said


def test_a_monitor_that_is_not_wired_is_said(examined):
    status, said, stack_v = examined(
        change=lambda text: text.replace("monitor_channel = 1 ", "monitor_channel = 0 ")
    )
    assert status == 0
    assert "skip   amplifier       the drive monitor is not wired" in said
    assert abs(stack_v) < 0.01


def test_an_amplifier_whose_limit_is_not_the_configs_is_named(examined):
    status, said, _ = examined(change=lambda text: text.replace(
        "drive_max_v = 75.0", "drive_max_v = 60.0"))
    # the amplifier's limit is found at 75 V, the config says 60 V
    assert status == 1
    assert "vlimit should be 60 V, answered 75 V" in said


def test_no_such_rig_is_bad_input(capsys):
    assert main(["doctor", "--rig", "no_such_rig"]) == 2
    assert capsys.readouterr().err.startswith("error[file-missing]: ")
