"""Every way out of a run ends at rest: judged by the plant's own record of the stack."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import termios
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import RealClock
from drivers.errors import InstrumentError
from drivers.transport import Deadlines
from drivers.waveform_dac import Keysight33500B
from piezo_rig.bench import orders
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.guard import Keeper, Orders
from piezo_rig.guard.keeper import SLACK_S
from piezo_rig.guard.lock import hold, lock_path
from piezo_rig.guard.rest import bring_to_rest
from piezo_rig.guard.watch import asks
from piezo_rig.run_file.reader import Run
from piezo_rig.studies.kill_bench import (
    PROTOCOL,
    STATES,
    Aim,
    Player,
    ServedBench,
    kill_once,
    served,
)
from piezo_rig.studies.kill_judge import judge


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Iterator[ServedBench]:
    with served(tmp_path_factory.mktemp("served"), "virtual") as bench:
        yield bench


@pytest.fixture(scope="module")
def protocol(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("protocol") / "kills.toml"
    path.write_text(PROTOCOL)
    return path


def rested_since(bench: ServedBench, since_s: float) -> None:
    """The stack came to 0 V no faster than it may, and is there."""
    verdict = judge(*bench.recorded_until(bench.now()), since_s, 0.0)
    assert abs(verdict.end_v) < 0.01
    assert verdict.slew_v_per_s < 720  # of the bursts, 700; of ramps to rest 300


def orders_for(bench: ServedBench, silence_s: float = 5.0) -> Orders:
    rig = load_rig(str(bench.config))
    return replace(orders(rig, None), silence_s=silence_s)


def wait_for(folder: Path, pattern: str) -> None:
    """Until a file is there; the guard writes its report when the stack is at rest."""
    for _ in range(3000):
        if list(folder.glob(pattern)):
            return
        RealClock().sleep(0.01)
    raise TimeoutError(pattern)


def guard_of(player: Player) -> int:
    """The process that the runner has started."""
    pid = player.process.pid
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(child)


@pytest.mark.parametrize("state", [
    state if state in ("going to rest", "playing", "storing")
    else pytest.param(state, marks=pytest.mark.study) for state in STATES
])  # fmt: skip
def test_a_run_that_is_killed_rests_and_keeps_what_was_stored(bench, protocol, tmp_path, state):
    nth = 1 if state in ("going to rest", "preparing", "closing") else 3
    outcome = kill_once(bench, protocol, tmp_path, Aim(state, nth, 0.05, 30.0))
    assert outcome.state.startswith(state)
    assert outcome.rested
    assert outcome.intact
    assert outcome.verdict is not None
    if state == "going to rest":
        assert outcome.verdict.killed_v > 70
        assert outcome.verdict.slew_v_per_s < 303  # 225, and a step in 10 ms
    if state == "playing":
        assert outcome.verdict.killed_v > 5
        (path,) = tmp_path.glob("*.h5")
        recovered, guard = Run(path).events()[-2:]
        assert recovered["event"] == "recovered"
        assert guard["reason"] == "the runner is gone"
        assert guard["step"] == "playing sweep_0003"
        assert guard["at_rest"]
        assert not list(tmp_path.glob("*.guard.json"))
    if nth == 3:
        assert outcome.recovered == 2


def test_a_run_that_stands_still_is_taken_over_and_says_so_when_it_wakes(
    bench, protocol, tmp_path
):
    bench.reset_generator()
    began_s = bench.now()
    player = Player(bench, protocol, tmp_path, Aim("going to rest", 1, 0.0, 0.1), silence_s=0.5)
    player.reached.wait(60)
    os.kill(player.process.pid, signal.SIGSTOP)
    wait_for(tmp_path, "*.guard.json")
    rested_since(bench, began_s)
    os.kill(player.process.pid, signal.SIGCONT)
    code, said = player.ended()
    assert code == 4, said
    assert said.startswith("error[guard-took-over]: ")
    assert "the runner stood still (going to rest)" in said
    assert "at 0 V" in said


def test_a_step_that_never_ends_is_taken_for_a_hang(bench):
    keeper = Keeper(orders_for(bench, silence_s=0.3))
    dac = Keysight33500B(keeper.transport(None))
    dac.connect()
    keeper.arm(dac.identity.serial)
    bench.reset_generator()
    keeper.step("thinking", -SLACK_S)  # it has been too long already
    began_s = bench.now()
    assert keeper._process.wait(30) == 0
    rested_since(bench, began_s)
    with pytest.raises(InstrumentError, match="the runner stood still") as caught:
        keeper.check()
    assert caught.value.code == "guard-took-over"
    keeper.end(True)


def test_a_run_whose_guard_is_killed_rests_by_itself_and_names_it(bench, protocol, tmp_path):
    bench.reset_generator()
    player = Player(bench, protocol, tmp_path, Aim("playing", 2, 0.0, 0.1))
    player.reached.wait(60)
    began_s = bench.now()
    os.kill(guard_of(player), signal.SIGKILL)
    code, said = player.ended()
    assert code == 4, said
    assert said.startswith("error[guard-lost]: ")
    assert "at 0 V" in said
    rested_since(bench, began_s)
    (path,) = tmp_path.glob("*.h5")
    assert len(Run(path).sweep_names) == 1


def test_a_closed_terminal_ends_the_run_at_rest(bench, tmp_path):
    bench.reset_generator()
    long = tmp_path / "long.toml"
    long.write_text(PROTOCOL.replace("repeats = 3", "repeats = 40"))
    near, far = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "piezo_rig", "run", str(long), "--rig", str(bench.config),
         "--out", str(tmp_path)],
        stdin=far, stdout=far, stderr=far, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(far, termios.TIOCSCTTY, 0),
    )
    os.close(far)
    seen = b""
    while b"sweep " not in seen:
        seen += os.read(near, 1000)
    os.close(near)  # the terminal is gone; the kernel sends SIGHUP
    assert process.wait(60) == 5
    rested_since(bench, bench.now())
    (path,) = tmp_path.glob("*.h5")
    assert Run(path).events()[-1]["what"] == "stopped by SIGHUP"


def test_a_second_ctrl_c_changes_nothing(bench, protocol, tmp_path):
    bench.reset_generator()
    player = Player(bench, protocol, tmp_path, Aim("playing", 2, 0.0, 0.2))
    player.reached.wait(60)
    for _ in range(3):
        os.kill(player.process.pid, signal.SIGINT)
        RealClock().sleep(0.02)
    code, said = player.ended()
    assert code == 5, said
    assert "at 0 V" in said
    rested_since(bench, bench.now())
    (path,) = tmp_path.glob("*.h5")
    assert len(Run(path).sweep_names) == 2  # the burst was played to its end and stored


def test_a_stop_while_the_model_is_identified_leaves_run_and_piezo_alone(
    protocol, tmp_path, monkeypatch, capsys
):
    def slow(path: Path) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # as the command does
    monkeypatch.setattr("piezo_rig.commands.first_model.first_model", slow)
    try:
        assert main(["run", str(protocol), "--out", str(tmp_path)]) == 5
    finally:
        signal.signal(signal.SIGTERM, before)
    said = capsys.readouterr().err
    assert said.startswith("error[aborted]: ")
    assert "piezo: at 0 V" in said
    (path,) = tmp_path.glob("*.h5")
    assert str(path) in said
    assert Run(path).complete


def test_one_program_at_a_time_holds_a_generator(bench):
    held = hold(bench.address)
    with pytest.raises(InstrumentError, match="another program holds the generator") as caught:
        hold(bench.address, wait_s=0.0)
    assert caught.value.code == "bench-busy"
    os.close(held)
    os.close(hold(bench.address))


def test_a_link_in_the_place_of_a_lock_is_not_written_to(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    theirs = tmp_path / "theirs"
    theirs.write_text("kept")
    lock_path("somewhere").symlink_to(theirs)
    assert hold("somewhere", wait_s=0.0) == -1
    assert theirs.read_text() == "kept"


def test_a_guard_that_was_never_armed_touches_nothing(bench):
    bench.reset_generator()
    keeper = Keeper(orders_for(bench, silence_s=0.1))
    dac = Keysight33500B(keeper.transport(None))
    dac.connect()
    os.kill(keeper.pid, signal.SIGTERM)  # it is deaf to this
    assert dac.output_level() == 0.0
    keeper.end(False)  # the runner goes without a word
    os.close(hold(bench.address))
    _, volts = bench.recorded_until(bench.now())
    assert volts[-1] == 75.0


def test_a_generator_that_stays_away_is_given_up_in_the_end():
    line = DeadLine()
    with pytest.raises(InstrumentError, match="did not answer"):
        bring_to_rest(line, Orders("", 1.0, "real", -10.0, 40.0, 7.5, 75.0), "SIM1", 0.0)
    assert line.asked


class DeadLine(Deadlines):
    """A line on which nobody answers."""

    address, instrument, timeout_s, observer, asked = "nowhere", "waveform_dac", 1.0, None, 0

    def take_unasked(self) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        self.asked += 1
        raise InstrumentError("instrument-timeout", "waveform_dac", "did not answer")


def test_a_question_mark_inside_a_block_is_no_question():
    assert asks(b"*TRG;:SYST:ERR?\n")
    assert not asks(b"SOUR1:DATA:ARB:DAC PZ1,#14????\n")
    assert not asks(b"*CLS\n")


def test_the_judge_sees_a_late_rest_a_jump_and_a_stack_that_never_rests():
    time_s = np.arange(0.0, 4.0, 1e-3)
    ramp = np.clip(60.0 - 300.0 * (time_s - 1.0), 0.0, 60.0)
    good = judge(time_s, ramp, 0.9, 0.0)
    assert good.killed_v == 60.0
    assert good.late_s == pytest.approx(0.3, abs=2e-3)
    assert good.slew_v_per_s == pytest.approx(300.0, rel=1e-3)
    late = judge(time_s, np.interp(time_s - 1.5, time_s, ramp), 0.9, 0.0)
    assert late.late_s == pytest.approx(1.8, abs=2e-3)
    jump = judge(time_s, np.where(time_s < 1.0, 60.0, 0.0), 0.9, 0.0)
    assert jump.slew_v_per_s == pytest.approx(6000.0)
    stuck = judge(time_s, np.full(time_s.size, 75.0), 0.9, 0.0)
    assert stuck.end_v == 75.0
    assert stuck.late_s > 3.0
    burst = np.where((time_s > 0.5) & (time_s < 1.5), 30.0, 0.0)
    assert judge(time_s, burst, 0.9, 1.0).late_s == pytest.approx(0.0, abs=2e-3)
