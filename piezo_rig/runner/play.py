"""Plays a Plan on a Bench into a run.

    connect -> rest -> settings -> ( recover -> play -> store )* -> rest -> closed

Whatever happens on the way, the last things that are done are: the stack goes
to rest, and the run file is closed with everything that was recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from piezo_rig.bench import SECONDS_PER_SAMPLE, Bench
from piezo_rig.errors import LimitError, PiezoRigError
from piezo_rig.protocol import Plan, PlannedSweep
from piezo_rig.run_file.writer import RunWriter
from piezo_rig.runner.headers import run_header, sweep_header
from piezo_rig.runner.resume import Seam
from piezo_rig.runner.safe import LONGEST_CLOSING_S, make_safe
from piezo_rig.runner.stop import Stop
from piezo_rig.runner.wire import Wire
from piezo_rig.sweep_watch import watch

Tell = Callable[[str], None]


def new_run_path(folder: Path, name: str, now: datetime | None = None) -> Path:
    """A name that no file has: ``folder/NAME_20260131T120000Z.h5``."""
    stamp = (now or datetime.now(UTC)).strftime("%Y%m%dT%H%M%SZ")
    stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    for extra in range(1000):
        path = folder / (f"{stem}_{stamp}.h5" if not extra else f"{stem}_{stamp}-{extra}.h5")
        if not any(folder.glob(path.stem + ".*")):
            return path
    raise LimitError("run-name", f"no free name for a run in {folder}", "a thousand runs a second",
                     "wait a second")


def play(
    plan: Plan, bench: Bench, path: Path, wire: Wire, tell: Tell = lambda text: None,
    seam: Seam | None = None, quiet: bool = False,
) -> Path:
    """Play the sweeps of a plan; returns the run.

    Parameters
    ----------
    plan, bench : what, and on what
    path : the run file to be made; with ``seam`` the one to go on with
    wire : the observer that the bench's transports were opened with
    tell : takes one line of progress
    seam : what is left to be played of a run that exists
    quiet : say nothing on the terminal of flags and of the way to rest; for a bench of records

    Raises
    ------
    BenchError, Aborted : with ``piezo`` filled in; what was recorded is in the run
    """
    sweeps = seam.sweeps if seam else plan.sweeps
    shift_s = seam.shift_s(bench.clock.now()) if seam else 0.0

    def now() -> float:
        """Seconds on the clock of the run, which goes on across a seam."""
        return bench.clock.now() + shift_s

    wire.clock_now = now
    stop, writer = Stop(), None
    with stop.watching():
        try:
            moved = bench.rest()
            stop.check()
            first = sweeps[0]
            bench.step("preparing the run")
            bench.load(first.name, first.wave, plan.sample_rate)
            bench.instruments = bench.read_settings()  # as they are while the run plays
            headers = [sweep_header(plan, s, seam) for s in sweeps]
            writer = RunWriter(path, run_header(plan, bench, now()), headers, seam is not None)
            wire.attach(writer)
            writer.log(now(), "connected, at rest", origin=bench.origin,
                       **{k: round(v, 3) for k, v in moved.items()})
            if seam:
                writer.log(now(), "resumed", **seam.event(now()))
            session = _Session(plan, bench, writer, tell, stop, shift_s, quiet)
            session.play(sweeps)
            return writer.finish()
        except PiezoRigError as error:
            make_safe(bench, writer, error, now, quiet)
            raise
        except BaseException:
            make_safe(bench, writer, None, now, quiet)
            raise


class _Session:
    """Sweep after sweep, from the first to the rest after the last."""

    def __init__(
        self, plan: Plan, bench: Bench, writer: RunWriter, tell: Tell, stop: Stop, shift_s: float,
        quiet: bool,
    ) -> None:
        self.plan = plan
        self.bench = bench
        self.writer = writer
        self.tell = tell
        self.stop = stop
        self.shift_s = shift_s
        self.quiet = quiet

    def play(self, sweeps: tuple[PlannedSweep, ...]) -> None:
        rate, wait_s = self.plan.sample_rate, self.bench.rig.recovery_s
        durations = [s.samples / rate + wait_s * (s.history == "virgin") for s in sweeps]
        for index, sweep in enumerate(sweeps):
            self._check()
            self.tell(_status(index, sweeps, sum(durations[index:])))
            if sweep.history == "virgin":
                self._recover(sweep)
            self._check()
            self.writer.require_room(index)
            self._play(index, sweep)
        self._check()
        moved = self.bench.rest()
        self.writer.log(self._now(), "finished", stack_v=round(moved["to_v"], 3))
        self.bench.step("closing the run", LONGEST_CLOSING_S)

    def _now(self) -> float:
        return self.bench.clock.now() + self.shift_s

    def _check(self) -> None:
        self.stop.check()
        self.bench.check_guard()

    def _recover(self, sweep: PlannedSweep) -> None:
        """Rest until the actuator has forgotten, in steps short enough for Ctrl-C to be heard."""
        left = self.bench.rig.recovery_s
        self.bench.step(f"recovering before {sweep.name}", left)
        while left > 0:
            self._check()
            self.bench.clock.sleep(min(1.0, left))
            left -= 1.0

    def _play(self, index: int, sweep: PlannedSweep) -> None:
        duration_s = sweep.samples / self.plan.sample_rate
        self.stop.doing = f"{sweep.name} ({duration_s:.1f} s)"
        self.writer.log(self._now(), "playing", sweep=sweep.name, condition=sweep.condition.name,
                        repeat=sweep.repeat)
        recorded = self.bench.play(sweep.name, sweep.wave, self.plan.sample_rate)
        self.bench.step(f"storing {sweep.name}", recorded.sensor_v.size * SECONDS_PER_SAMPLE)
        self.writer.write_sweep(
            index, sweep.wave.command_v, recorded.sensor_v, recorded.monitor_v,
            recorded.start_time + self.shift_s,
        )
        self.stop.doing = ""
        watch(self.bench.rig, sweep.wave.drive_v, recorded, partial(self.writer.log, self._now()),
              sweep.name, _nothing if self.quiet else _flag)


def _flag(line: str) -> None:
    print(line, flush=True)


def _nothing(line: str) -> None:
    """Where nobody is to be told."""


def _status(index: int, sweeps: tuple[PlannedSweep, ...], left_s: float) -> str:
    minutes, seconds = divmod(max(0, round(left_s)), 60)
    sweep = sweeps[index]
    return (
        f"sweep {index + 1} of {len(sweeps)}: {sweep.condition.name}, repeat "
        f"{sweep.repeat}; {minutes} min {seconds:02d} s of bench time left"
    )
