"""Plays the drivers against the record of a run, session by session."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.errors import Aborted, BenchError, InputError, PiezoRigError
from piezo_rig.protocol import Plan, PlannedSweep
from piezo_rig.replay.past_bench import past_bench, plan_of
from piezo_rig.replay.tape import Comparison, TapeEnds
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.transcript import WireRecord, records
from piezo_rig.runner import Wire, play

# Errors that came over a line are in the record and come again; these came from elsewhere.
_NOT_OF_A_LINE = ("aborted", "disk", "run-")


@dataclass(frozen=True)
class Outcome:
    """What a replay found.

    Attributes
    ----------
    exchanges : messages that were sent exactly as then
    sessions : how often the bench was connected: once, and once more for every resumption
    differences : where the drivers now differ, one line each; empty when they do not
    notes : what else is to be said, as that a recording breaks off, or cannot be compared
    """

    exchanges: int
    sessions: int
    differences: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Session:
    """One connection of the bench: what was sent, what was played, how it ended.

    ``number`` counts the connections of the run from 1. ``ended`` is ``finished``, the code of
    an error, or empty where the program was killed.
    """

    number: int

    records: tuple[WireRecord, ...]
    playing: tuple[dict[str, Any], ...]
    ended: str


def replay(run: Run) -> Outcome:
    """Run the drivers against a run's transcript.

    Raises
    ------
    InputError : (replay, transcript) the run holds no transcript, or it or the plan is damaged
    """
    transcript = run.wire_transcript()
    if not transcript:
        raise InputError(
            "transcript", f"{run.path}: holds no wire transcript",
            "it was imported, or another program wrote it", "give a run from the bench",
        )
    found = sessions(list(records(transcript)), run.events(), run.path)
    plan = plan_of(run)
    differences: list[str] = []
    recorded_hash = run.texts.get("plan_hash", "")
    if plan.hash != recorded_hash:
        differences.append(
            f"the plan is another: {plan.hash[:16]} where {recorded_hash[:16]} was played"
        )
    exchanges, notes = 0, []
    for session in found:
        which = f"connection {session.number}: " if len(found) > 1 else ""
        if not session.records:
            notes.append(f"{which}killed before any of its transcript reached the disk; nothing "
                         "to compare")
            continue
        if not session.playing and session.number > 1:
            notes.append(f"{which}ended before its first sweep, and the run does not say which "
                         "that was to be; not compared")
            continue
        comparison = Comparison()
        broke_off = _play_again(run, plan, session, comparison)
        exchanges += comparison.exchanges
        differences += [which + difference for difference in comparison.differences]
        if broke_off:
            notes.append(f"{which}the recording breaks off where the program was killed")
    return Outcome(exchanges, len(found), tuple(differences), tuple(notes))


def sessions(
    transcript: Sequence[WireRecord], events: Sequence[dict[str, Any]], path: Path
) -> list[Session]:
    """The sessions of a run: each begins with the lines being opened, one after the other.

    The transcript of a program that was killed before it stored anything is lost; which ones
    there are is told by their times, which only grow over all connections of a run.

    Raises
    ------
    InputError : (transcript) transcript and event log do not belong together
    """
    starts = [i for i in range(len(transcript)) if _begins(transcript, i)]
    begun = [i for i, e in enumerate(events) if e["event"].startswith("connected")]
    parts = [
        tuple(transcript[start:stop])
        for start, stop in zip(starts, [*starts[1:], len(transcript)], strict=True)
    ]
    found = []
    for k, first in enumerate(begun):
        last = begun[k + 1] if k + 1 < len(begun) else len(events)
        mine = events[first:last]
        until_s = events[last]["time_s"] if last < len(events) else math.inf
        records = parts.pop(0) if parts and max(r.time_s for r in parts[0]) <= until_s else ()
        ended = next(
            (str(e.get("code", "finished")) for e in reversed(mine)
             if e["event"] in ("finished", "error")), "",
        )
        found.append(Session(
            k + 1, records, tuple(e for e in mine if e["event"] == "playing"), ended,
        ))
    if not starts or starts[0] != 0 or parts or any(s.ended and not s.records for s in found):
        raise InputError(
            "transcript",
            f"{path}: its wire transcript opens the generator's line {len(starts)} times, its "
            f"event log connects {len(begun)} times",
            "the transcript or the event log is damaged, or of an early version",
            "take the run from the backup",
        )
    return found


def _begins(transcript: Sequence[WireRecord], at: int) -> bool:
    """Whether a session begins here.

    The generator's line is opened alone when the runner goes on without its guard.
    """
    heads = [
        (r.instrument, r.direction == "event" and r.data.startswith(b"opened "))
        for r in transcript[at : at + 2]
    ]
    return heads == [("waveform_dac", True), ("digitizer", True)]


def _play_again(run: Run, plan: Plan, session: Session, comparison: Comparison) -> bool:
    """Play one session's sweeps; whether its recording broke off."""
    sweeps = _sweeps(plan, session, comparison)
    stop_at = len(sweeps)
    outside = session.ended.startswith(_NOT_OF_A_LINE)
    if outside:  # it ended before a further sweep began
        sweeps.append(replace(sweeps[-1], name="sweep_999999"))
    bench, tapes = past_bench(plan.rig, session.records, comparison)
    if not session.ended:
        for tape in tapes:
            tape.may_break_off()
    told = 0

    def tell(text: str) -> None:
        nonlocal told
        told += 1
        if outside and told > stop_at:
            kind = Aborted if session.ended == "aborted" else BenchError
            raise kind(session.ended, "as in the recording")

    ended, again = "finished", None
    with tempfile.TemporaryDirectory(prefix="piezo-rig-") as folder:
        try:
            bench.connect()
            again = play(
                replace(plan, sweeps=tuple(sweeps)), bench, Path(folder) / "again.h5", Wire(), tell,
                quiet=True,
            )
        except TapeEnds:
            return not session.ended
        except PiezoRigError as error:
            if error.code == "aborted" and session.ended != "aborted":
                raise  # now, not then
            ended = error.code
        if ended != session.ended and session.ended:
            comparison.differences.append(
                f"the drivers end with '{ended}', the recording with '{session.ended}'"
            )
        left = {tape.instrument: tape.left() for tape in tapes if tape.left()}
        for name, count in left.items():
            comparison.differences.append(f"{name}: {count} recorded messages are not sent now")
        if again is not None:
            comparison.differences += _volts(run, Run(again))
    return False


def _sweeps(plan: Plan, session: Session, comparison: Comparison) -> list[PlannedSweep]:
    """The sweeps that a session played, under the names that it gave them."""
    by_identity = {(s.condition.name, s.repeat): s for s in plan.sweeps}
    found = []
    for event in session.playing:
        condition, repeat = event.get("condition"), event.get("repeat")
        planned = by_identity.get((str(condition), repeat if isinstance(repeat, int) else 0))
        if planned is None:
            comparison.differences.append(
                f"{event.get('sweep')}: the plan has no repeat {event.get('repeat')} of "
                f"{event.get('condition')}"
            )
            break
        found.append(replace(planned, name=str(event.get("sweep"))))
    return found or [plan.sweeps[0]]


def _volts(then: Run, now: Run) -> list[str]:
    """Sweeps whose samples the drivers now make something else of."""
    differences = []
    for name in now.sweep_names:
        if name not in then.sweep_names:
            continue
        try:
            (before,), (after,) = then.sweeps([name]), now.sweeps([name])
        except InputError as error:
            differences.append(f"{name}: {error.what}")
            continue
        for channel in ("command_v", "sensor_v", "drive_monitor_v"):
            old, new = getattr(before, channel), getattr(after, channel)
            if (old is None) != (new is None) or (
                old is not None and not np.array_equal(old, new, equal_nan=True)
            ):
                differences.append(f"{name}: {channel} comes out otherwise than it was stored")
    return differences
