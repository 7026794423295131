"""One run, one kill, and a look at what is left: the file, and the stack.

The bench is served by a process of its own, and judged by its own record of the voltage on the
stack. Before every run the generator is reset, which puts 75 V on the stack; every run begins by
taking that away.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import BenchClock, RealClock
from drivers.scpi_instrument import ScpiInstrument
from drivers.transport import open_transport
from piezo_rig.config import load_rig
from piezo_rig.guard.lock import hold
from piezo_rig.protocol import Plan, build_plan, load_protocol
from piezo_rig.run_file.close import recover
from piezo_rig.run_file.layout import PART_SUFFIX
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify import verify
from piezo_rig.studies.kill_judge import Verdict, judge, read_record

PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "kills"
repeats = 3
[[condition]]
waveform = "triangle"
lower_v = 5
upper_v = [65, 75]
frequency_hz = 5
cycles = 2
"""
# The triangles stay above 5 V, so that the stack is at 0 V only before and after a burst.

STATES = (
    "going to rest", "preparing", "recovering", "loading", "arming", "starting", "playing",
    "fetching", "storing", "closing",
)
IN_BURST = ("starting", "playing", "fetching")
GRACE_S = 1.0
CLOSING_S = 0.1
"""The last state ends with the process, long after the run is closed."""
LONGEST_RUN_S = 60.0


@dataclass(frozen=True)
class Aim:
    """When the runner is killed: ``delay_s`` after the ``nth`` time that it comes to a state.

    ``hesitate_s`` is how long it stands still there, so that the delay falls into the state.
    """

    state: str
    nth: int
    delay_s: float
    hesitate_s: float = 0.0


@dataclass
class Outcome:
    """What one kill left behind."""

    clock: str
    aim: Aim
    state: str = ""  # that it was really in; empty when the run had ended before
    stored: int = 0  # sweeps that the runner had stored when it was killed
    recovered: int = -1  # sweeps in the recovered run; -1 without a run
    faults: list[str] = field(default_factory=list)
    verdict: Verdict | None = None
    guard_s: float = 0.0  # from the kill to the guard's end, real time
    largest_planned_slew: float = 0.0

    @property
    def was_killed(self) -> bool:
        return bool(self.state)

    @property
    def intact(self) -> bool:
        return not self.faults and max(0, self.recovered) >= self.stored

    @property
    def rested(self) -> bool:
        v = self.verdict
        return v is not None and v.late_s <= GRACE_S and abs(v.end_v) < 0.01


class ServedBench:
    """`piezo-rig bench` in a process of its own, and a study's own lines to it."""

    def __init__(self, folder: Path, clock: str, recovery_s: float | None = None) -> None:
        self.config, self.record = folder / "served.toml", folder / "stack.csv"
        self.clock_name = clock
        self.process = subprocess.Popen(
            [sys.executable, "-m", "piezo_rig", "bench", "--clock", clock, "--record",
             str(self.record), "--config-out", str(self.config)],
            stdout=subprocess.PIPE, text=True,
        )
        assert self.process.stdout is not None
        where = {}
        for line in self.process.stdout:
            name, _, address = line.strip().partition(": ")
            where[name] = address
            if line.startswith("serving"):
                break
        self.address = where["waveform_dac"]
        self._clock = BenchClock(where["clock"])
        self._generator = ScpiInstrument(open_transport(self.address, "waveform_dac"))
        if recovery_s is not None:
            text = self.config.read_text(encoding="utf-8").replace(
                "recovery_s = 30.0", f"recovery_s = {recovery_s}"
            )
            self.config.write_text(text, encoding="utf-8")

    def now(self) -> float:
        return self._clock.now()

    def reset_generator(self) -> None:
        """As after a power cut: output off, 75 V on the stack."""
        self._generator.write("*RST")
        self._generator.query("*OPC?")
        self._clock.sleep(0.05)  # the jump that this was is over when somebody looks

    def recorded_until(self, instant_s: float) -> tuple[Any, Any]:
        """The record, once it reaches this instant of bench time."""
        until = time.monotonic() + 20.0
        while True:
            rows = read_record(self.record)
            if rows[0].size and rows[0][-1] >= instant_s:
                return rows
            if time.monotonic() > until:
                raise TimeoutError(f"the bench recorded up to {rows[0][-1:]} s, not {instant_s} s")
            RealClock().sleep(0.05)

    def close(self) -> None:
        self._clock.close()
        self._generator.close()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(20)
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextmanager
def served(folder: Path, clock: str, recovery_s: float | None = None) -> Iterator[ServedBench]:
    """A bench while it is needed."""
    bench = ServedBench(folder, clock, recovery_s)
    try:
        yield bench
    finally:
        bench.close()


class Player:
    """A runner in a process of its own that says what it does."""

    def __init__(
        self, bench: ServedBench, protocol: Path, out: Path, aim: Aim, silence_s: float = 5.0
    ) -> None:
        listen, tell = os.pipe()
        words = [sys.executable, "-m", "piezo_rig.studies.kill_player", str(tell), aim.state,
                 str(aim.nth), str(aim.hesitate_s), str(silence_s), "--",
                 "run", str(protocol), "--rig", str(bench.config), "--out", str(out)]
        self.process = subprocess.Popen(
            words, pass_fds=(tell,), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        os.close(tell)
        self.steps: list[tuple[float, str]] = []
        self._aim = aim
        self.reached = threading.Event()
        self._listener = threading.Thread(target=self._listen, args=(listen,), daemon=True)
        self._listener.start()

    def _listen(self, pipe: int) -> None:
        seen = 0
        with os.fdopen(pipe) as lines:
            for line in lines:
                name = line.strip()
                self.steps.append((time.monotonic(), name))
                seen += name.startswith(self._aim.state)
                if seen >= self._aim.nth:
                    self.reached.set()
        self.reached.set()

    def kill(self, number: int = signal.SIGKILL) -> str:
        """Kill it; the step that it was in, empty when it had ended."""
        os.kill(self.process.pid, number)  # not waited for yet: the pid is still its own
        code = self.process.wait(LONGEST_RUN_S)
        self._listener.join(LONGEST_RUN_S)
        assert self.process.stderr is not None
        self.process.stderr.close()
        return self.steps[-1][1] if code == -number and self.steps else ""

    def ended(self) -> tuple[int, str]:
        """Its exit status and what it said on stderr, when it ends by itself."""
        assert self.process.stderr is not None
        said = self.process.stderr.read()
        self.process.stderr.close()
        code = self.process.wait(LONGEST_RUN_S)
        self._listener.join(LONGEST_RUN_S)
        return code, said

    @property
    def stored(self) -> int:
        """How many sweeps it had stored: it went on to something else afterwards."""
        return sum(name.startswith("storing") for _, name in self.steps[:-1])


def kill_once(bench: ServedBench, protocol: Path, out: Path, aim: Aim) -> Outcome:
    """One run, one kill, and a look at what is left."""
    rig = load_rig(str(bench.config))
    plan = build_plan(load_protocol(protocol), rig)
    outcome = Outcome(bench.clock_name, aim, largest_planned_slew=planned_slew(plan))
    bench.reset_generator()
    player = Player(bench, protocol, out, aim)
    player.reached.wait(LONGEST_RUN_S)
    RealClock().sleep(aim.delay_s)
    killed_s, killed_at = bench.now(), time.monotonic()
    outcome.state = player.kill()
    outcome.stored = player.stored
    os.close(hold(bench.address))  # the guard has let go
    outcome.guard_s = time.monotonic() - killed_at
    rows = bench.recorded_until(bench.now())
    if outcome.was_killed:
        in_burst = outcome.state.startswith(IN_BURST)
        burst_s = max(s.samples for s in plan.sweeps) / plan.sample_rate if in_burst else 0.0
        outcome.verdict = judge(*rows, killed_s, burst_s)
        _look_at_file(out, plan, outcome)
    return outcome


def planned_slew(plan: Plan) -> float:
    """Largest slew of a plan, V/s."""
    return max(
        float(np.abs(np.diff(wave.drive_v)).max()) for _, wave in plan.conditions()
    ) * plan.sample_rate


def _look_at_file(out: Path, plan: Plan, outcome: Outcome) -> None:
    recover(out)
    if list(out.glob("*" + PART_SUFFIX + "*")):
        outcome.faults.append("was not recovered")
        return
    runs = list(out.glob("*.h5"))
    if not runs:
        return  # killed before there was anything to record
    (path,) = runs
    run = Run(path)
    outcome.recovered = len(run.sweep_names)
    _, found = verify(path)
    outcome.faults += [v.text for v in found if v.fault and not v.text.endswith("were played")]
    for sweep, planned in zip(run.sweeps(), plan.sweeps, strict=False):
        if not np.array_equal(sweep.command_v, planned.wave.command_v):
            outcome.faults.append(f"{sweep.name} is not what was planned")
    if outcome.recovered < outcome.stored:
        outcome.faults.append(f"{outcome.stored} stored, {outcome.recovered} recovered")


def durations(bench: ServedBench, protocol: Path, out: Path) -> dict[str, list[float]]:
    """How long the runner is in each state, s of real time, from one run that is not killed."""
    player = Player(bench, protocol, out, Aim("nothing", 1, 0.0))
    code, said = player.ended()
    if code:
        raise RuntimeError(said)
    found: dict[str, list[float]] = {state: [] for state in STATES}
    ends = [*(begin for begin, _ in player.steps[1:]), player.steps[-1][0] + CLOSING_S]
    for (begin, name), end in zip(player.steps, ends, strict=True):
        found[next(s for s in STATES if name.startswith(s))].append(end - begin)
    return found
