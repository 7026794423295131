"""Plays a Plan on a Bench into a run.

    connect -> rest -> settings -> ( recover -> play -> store )* -> rest -> closed

Whatever happens on the way, the last things that are done are: the stack goes
to rest, and the run file is closed with everything that was recorded.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

from piezo_rig import __version__
from piezo_rig.bench import Bench
from piezo_rig.errors import Aborted, LimitError, PiezoRigError
from piezo_rig.protocol import Plan, PlannedSweep
from piezo_rig.run_file.layout import RunHeader, SweepHeader
from piezo_rig.run_file.writer import RunWriter

Tell = Callable[[str], None]


@dataclass
class Wire:
    """Carries bytes from the transports to the run; keeps those that come before it exists."""

    writer: RunWriter | None = None
    clock_now: Callable[[], float] = lambda: 0.0
    _early: list[tuple[float, str, str, bytes]] = field(default_factory=list)

    def __call__(self, instrument: str, direction: str, data: bytes) -> None:
        record = (self.clock_now(), instrument, direction, bytes(data))
        if self.writer is None:
            self._early.append(record)
        else:
            self.writer.wire(*record)

    def attach(self, writer: RunWriter) -> None:
        self.writer = writer
        for record in self._early:
            writer.wire(*record)
        self._early.clear()


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
) -> Path:
    """Play every sweep of a plan; returns the run.

    Parameters
    ----------
    plan, bench : what, and on what
    path : the run file to be made
    wire : the observer that the bench's transports were opened with
    tell : takes one line of progress

    Raises
    ------
    BenchError, Aborted : with ``piezo`` filled in; what was recorded is in the run
    """
    wire.clock_now = bench.clock.now
    stop, writer = Stop(), None
    with stop.watching():
        try:
            moved = bench.rest()
            first = plan.sweeps[0]
            bench.load(first.name, first.wave, plan.sample_rate)
            bench.instruments = bench.read_settings()  # as they are while the run plays
            writer = RunWriter(
                path, run_header(plan, bench), [sweep_header(plan, s) for s in plan.sweeps]
            )
            wire.attach(writer)
            writer.log(bench.clock.now(), "connected, at rest", origin=bench.origin,
                       **{k: round(v, 3) for k, v in moved.items()})
            _play_all(plan, bench, writer, tell, stop)
            return writer.finish()
        except PiezoRigError as error:
            _make_safe(bench, writer, error)
            raise
        except BaseException:
            _make_safe(bench, writer, None)
            raise


def _play_all(plan: Plan, bench: Bench, writer: RunWriter, tell: Tell, stop: Stop) -> None:
    clock = bench.clock
    left = plan.duration_s
    for index, sweep in enumerate(plan.sweeps):
        tell(_status(plan, index, sweep, left))
        if sweep.history == "virgin":
            _recover(bench, stop)
            left -= bench.rig.recovery_s
        stop.check()
        writer.require_room(index)
        stop.playing_until = f"{sweep.name} ({sweep.samples / plan.sample_rate:.1f} s)"
        writer.log(clock.now(), "playing", sweep=sweep.name, condition=sweep.condition.name,
                   repeat=sweep.repeat)
        recorded = bench.play(sweep.name, sweep.wave, plan.sample_rate)
        writer.write_sweep(
            index, sweep.wave.command_v, recorded.sensor_v, recorded.monitor_v,
            recorded.start_time,
        )
        stop.playing_until = ""
        left -= sweep.samples / plan.sample_rate
    stop.check()
    moved = bench.rest()
    writer.log(clock.now(), "finished", stack_v=round(moved["to_v"], 3))


def _recover(bench: Bench, stop: Stop) -> None:
    """Rest until the actuator has forgotten, in steps short enough for Ctrl-C to be heard."""
    left = bench.rig.recovery_s
    while left > 0:
        stop.check()
        bench.clock.sleep(min(1.0, left))
        left -= 1.0


def _make_safe(bench: Bench, writer: RunWriter | None, error: PiezoRigError | None) -> None:
    """Rest first, then the file; a failure of either does not hide the error that led here."""
    moved = None
    with suppress(PiezoRigError):
        moved = bench.rest()
    if error is not None:
        error.piezo = error.piezo or bench.piezo()
    if writer is None:
        return  # nothing was played
    with suppress(PiezoRigError):
        if moved:
            writer.log(bench.clock.now(), "made safe", **{k: round(v, 3) for k, v in moved.items()})
        if error is not None:
            writer.log(bench.clock.now(), "error", code=error.code, what=error.what)
    kept = writer.part
    with suppress(PiezoRigError):
        kept = writer.finish()
    with suppress(PiezoRigError):
        writer.release()
    if error is not None:
        error.remedy = (error.remedy + "; " if error.remedy else "") + f"what was recorded: {kept}"


def _status(plan: Plan, index: int, sweep: PlannedSweep, left_s: float) -> str:
    minutes, seconds = divmod(max(0, round(left_s)), 60)
    return (
        f"sweep {index + 1} of {len(plan.sweeps)}: {sweep.condition.name}, repeat "
        f"{sweep.repeat}; {minutes} min {seconds:02d} s of bench time left"
    )


class Stop:
    """Remembers that somebody wants the run to end; the runner looks between its steps.

    A signal never raises where it strikes: it could strike inside a driver or the HDF5 library.
    A burst that plays is waited for in any case, because it ends at rest.
    """

    def __init__(self) -> None:
        self.signal = ""
        self.playing_until = ""

    def catch(self, number: int, frame: FrameType | None) -> None:
        """Signal handler."""
        if not self.signal:
            self.signal = signal.Signals(number).name
            first = f"{self.playing_until} is played to its end, " if self.playing_until else ""
            text = f"\nstopping on {self.signal}: {first}then the stack rests\n"
            os.write(2 if os.isatty(2) else 1, text.encode())

    def check(self) -> None:
        """Raise Aborted if a signal has come."""
        if self.signal:
            raise Aborted(
                "aborted", f"stopped by {self.signal}", "the operator or the system",
                "start the run again",
            )

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Ctrl-C, SIGTERM and a closed terminal are noted, not obeyed on the spot."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
        before = [signal.signal(n, self.catch) for n in numbers]
        try:
            yield
        finally:
            for number, handler in zip(numbers, before, strict=True):
                signal.signal(number, handler)


def run_header(plan: Plan, bench: Bench) -> RunHeader:
    """What the run file says about itself."""
    rig = plan.rig
    stack = rig.actuator
    return RunHeader(
        title=plan.protocol.name, origin=bench.origin, protocol_text=plan.protocol.text,
        plan_hash=plan.hash, rig_config=rig.text, operator=rig.operator,
        actuator={
            "model": stack.model, "serial": stack.serial, "mounting": stack.mounting,
            "capacitance_f": stack.capacitance_f,
        },
        start_time=datetime.now(UTC).isoformat(timespec="seconds"),
        clock_start=bench.clock.now(), software_version=__version__, git_revision=git_revision(),
        instruments=bench.instruments, monitor=bool(rig.digitizer.monitor_channel),
        calibrations={
            rig.amplifier_calibration.path: rig.amplifier_calibration.sha256,
            rig.interferometer_calibration.path: rig.interferometer_calibration.sha256,
        },
        calibration_texts={
            rig.amplifier_calibration.path: rig.amplifier_calibration.text,
            rig.interferometer_calibration.path: rig.interferometer_calibration.text,
        },
    )


def sweep_header(plan: Plan, sweep: PlannedSweep) -> SweepHeader:
    """The attributes of one sweep that are known before it is played."""
    rig = plan.rig
    return SweepHeader(
        name=sweep.name, samples=sweep.samples, sample_rate=plan.sample_rate, gain=rig.gain,
        offset_v=rig.offset_v, sensitivity_um_per_v=rig.sensitivity_um_per_v,
        polarity=rig.polarity, condition=sweep.condition.name, repeat=sweep.repeat,
        history=sweep.history, oversampling=rig.digitizer.oversampling,
        details=dict(sweep.condition.details),
    )


def git_revision() -> str:
    """The revision of the checkout that runs, empty outside one."""
    package = Path(__file__).resolve().parent
    if not (package.parent / ".git").exists():
        return ""
    try:
        return subprocess.run(
            ["git", "-C", str(package.parent), "rev-parse", "HEAD"],
            capture_output=True, text=True, timeout=5, check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
