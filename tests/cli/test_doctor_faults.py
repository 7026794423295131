"""`piezo-rig doctor` with faults from the rig's config, and on a bench behind sockets."""

from __future__ import annotations

import os
import re
from functools import partial

import pytest

import piezo_rig.bench
import piezo_rig.doctor.instruments
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.guard.lock import hold
from piezo_rig.resources import shipped_folder
from piezo_rig.studies.kill_bench import served

RIG = re.sub(
    r'(driver = "(?:keysight|thorlabs).*)', r"\1\ntimeout_s = 0.6",
    (shipped_folder("configs") / "simulated_bench.toml").read_text(),
)
MOVING_S = 2.0  # of bench time: the stack has been brought to rest, the checks go on


@pytest.fixture
def examined(tmp_path, capsys, monkeypatch):
    """A function: more of the config -> exit status, what was printed, volts on the stack."""
    make, plants = piezo_rig.bench.simulated_plant, []

    def kept(rig):
        plants.append(make(rig))
        return plants[-1]

    monkeypatch.setattr(piezo_rig.bench, "simulated_plant", kept)

    def examine(more: str):
        path = tmp_path / "rig.toml"
        path.write_text(f"{RIG}\n{more}\n")
        status = main(["doctor", "--rig", str(path)])
        said = capsys.readouterr()
        assert said.err == ""
        return status, said.out, plants[-1].stack_v(1e4)

    return examine


AT_ONCE = [
    ("waveform_dac", "refuse"), ("waveform_dac", "silent"), ("waveform_dac", "hang_up"),
    ("waveform_dac", "garbage"), ("waveform_dac", "twice"), ("waveform_dac", "error_queue"),
    ("digitizer", "drop_at_once"), ("digitizer", "torn"), ("digitizer", "stuck_queue"),
    ("digitizer", "answer"), ("amplifier", "refuse"), ("amplifier", "silent"),
    ("amplifier", "endless"), ("amplifier", "adjusted"),
]  # fmt: skip


@pytest.mark.parametrize(("instrument", "kind"), AT_ONCE)
def test_an_instrument_that_is_not_in_order_is_named_and_nothing_moves(examined, instrument, kind):
    status, said, _ = examined(f"[faults.{instrument}.{kind}]")
    assert status == 1
    assert re.search(rf"^  FAULT  {instrument} ", said, re.MULTILINE), said
    assert "nothing was moved, because an instrument is not in order" in said


UNDER_WAY = [
    ("digitizer", "no_trigger", 0.0, "instrument-no-trigger"),
    ("digitizer", "no_data", 0.0, "instrument-no-data"),
    ("digitizer", "byte_order", 0.0, "instrument-garbage"),
    ("digitizer", "silent", MOVING_S, "instrument-timeout"),
    ("digitizer", "hang_up", MOVING_S, "instrument-hangup"),
    ("waveform_dac", "hang_up", MOVING_S, "instrument-hangup"),
    ("waveform_dac", "late_reply", MOVING_S, "instrument-timeout"),
    ("amplifier", "garbage", MOVING_S, "instrument-garbage"),
]


@pytest.mark.parametrize(("instrument", "kind", "from_s", "code"), UNDER_WAY)
def test_one_that_fails_while_the_stack_is_moved_is_named_and_the_stack_rests(
    examined, instrument, kind, from_s, code
):
    status, said, stack_v = examined(f"[faults.{instrument}.{kind}]\nfrom_s = {from_s}")
    assert status == 1
    assert re.search(rf"^  FAULT  {instrument} .*\[{code}\]", said, re.MULTILINE), said
    assert "ok     piezo           at rest, 0.00 V" in said
    assert abs(stack_v) < 0.01


def test_a_generator_that_stays_away_is_said_with_what_to_do(examined):
    status, said, _ = examined(f"[faults.waveform_dac.silent]\nfrom_s = {MOVING_S}")
    assert status == 1
    assert "FAULT  piezo           NOT known to be at 0 V: switch the amplifier off by hand" in said


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with served(tmp_path_factory.mktemp("served"), "virtual") as bench:
        yield bench


def test_a_bench_behind_sockets_is_examined_and_left_at_rest(bench, capsys):
    bench.reset_generator()
    assert main(["doctor", "--rig", str(bench.config)]) == 0, capsys.readouterr().out
    said = capsys.readouterr().out
    assert "found at 75.0 V on the stack, brought to rest" in said
    assert "ok     piezo           at rest, 0.00 V" in said
    _, stack_v = bench.recorded_until(bench.now())
    assert abs(stack_v[-1]) < 0.01


def test_a_generator_that_another_program_holds_is_not_even_asked(bench, capsys, monkeypatch):
    monkeypatch.setattr(piezo_rig.doctor.instruments, "hold", partial(hold, wait_s=0.0))

    def refuse(*args, **options):
        raise AssertionError("a line was opened")

    lock = hold(load_rig(str(bench.config)).waveform_dac.address)
    try:
        monkeypatch.setattr("drivers.transport.VisaTransport._open", refuse)
        assert main(["doctor", "--rig", str(bench.config)]) == 1
    finally:
        os.close(lock)
    said = capsys.readouterr().out
    assert "[bench-busy]" in said
    assert "nothing was moved" in said
