"""What a broken run still lacks, and whether this plan and this bench may go on with it.

A sweep is known by its condition and its repeat. Sweeps that are played after
the seam get names that count on, so that the order of names stays the order of
time. The actuator remembers: a sweep that carries its history needs the sweep
before it, and a seam, or a sweep played out of its turn, breaks that chain;
its history is `unknown` then. A virgin sweep is virgin again, because the
runner waits for it.
"""

from __future__ import annotations

import json
import time
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from piezo_rig.bench import Bench
from piezo_rig.config import Rig
from piezo_rig.errors import InputError, LimitError
from piezo_rig.protocol import Plan, PlannedSweep
from piezo_rig.run_file.reader import Run

MAY_DIFFER = ("address", "timeout_s", "name")
"""Keys of a rig's config that do not touch the data; nor do the tables below."""
FREE_TABLES = ("bench", "environment")

Identity = tuple[str, int]


@dataclass(frozen=True)
class Seam:
    """Where a run is taken up again.

    Attributes
    ----------
    sweeps : what is to be played, in the order of the plan, under names that count on
    supersedes : name of a sweep to be played -> name of the one that it stands in for
    end_s : end of the last recorded sweep (of the log, where there is none), on the run's clock
    stored_at : when that was stored, s since 1970 (UTC)
    same_clock : the bench's clock is the one that the run was recorded with
    """

    sweeps: tuple[PlannedSweep, ...]
    supersedes: dict[str, str] = field(default_factory=dict)
    end_s: float = 0.0
    stored_at: float = 0.0
    same_clock: bool = False

    def shift_s(self, clock_s: float) -> float:
        """What the run's clock is ahead of the bench's, whose reading is ``clock_s``.

        A bench's clock that went on is the run's. Otherwise the pause is the wall clock's.
        """
        if self.same_clock and clock_s >= self.end_s:
            return 0.0
        return self.end_s + max(0.0, time.time() - self.stored_at) - clock_s

    def event(self, clock_s: float) -> dict[str, Any]:
        """For the log; ``clock_s`` on the run's clock."""
        return {
            "pause_s": round(clock_s - self.end_s, 3), "sweeps": len(self.sweeps),
            "superseding": sorted(self.supersedes.values()),
        }


def seam_of(run: Run, plan: Plan, only: str = "") -> Seam:
    """What is to be played of ``plan`` so that ``run`` is whole.

    Parameters
    ----------
    only : a condition that is played again, every repeat of it; otherwise what is missing

    Raises
    ------
    InputError : no such condition, or none of it was played yet
    """
    entries = run.entries()
    held = {(s.condition, s.repeat): s for s in entries if not s.superseded_by}
    wanted = [s for s in plan.sweeps if _identity(s) not in held]
    if only:
        wanted = [s for s in plan.sweeps if s.condition.name == only and _identity(s) in held]
        if not wanted:
            raise InputError(
                "resume-condition", f"{run.path} holds no sweep of a condition '{only}'",
                "a slip in the name, or it was not played yet",
                "give one of: " + ", ".join(sorted({c for c, _ in held})) if held
                else "leave out --only",
            )
    number = max((int(n.removeprefix("sweep_")) for n in run.sweep_names), default=0)
    sweeps = tuple(
        replace(sweep, name=f"sweep_{number + k + 1:04d}", history=history)
        for k, (sweep, history) in enumerate(zip(wanted, _histories(plan, wanted), strict=True))
    )
    supersedes = {s.name: held[_identity(s)].name for s in sweeps if _identity(s) in held}
    last = max(entries, key=lambda s: s.end_s, default=None)
    events = run.events()
    stored_at = run.path.stat().st_mtime if last is None else last.stored_at
    return Seam(
        sweeps, supersedes,
        end_s=last.end_s if last else events[-1]["time_s"] if events else 0.0,
        stored_at=stored_at or run.path.stat().st_mtime,
        same_clock=_is_same_clock(run.texts["rig_config"], plan.rig.clock),
    )


def _identity(sweep: PlannedSweep) -> Identity:
    return sweep.condition.name, sweep.repeat


def _histories(plan: Plan, wanted: Iterable[PlannedSweep]) -> list[str]:
    """A sweep carries its history only if the one before it in the plan was played before it."""
    place = {_identity(s): i for i, s in enumerate(plan.sweeps)}
    histories = []
    before = -2
    for sweep in wanted:
        at = place[_identity(sweep)]
        carries = sweep.history == "carried" and at != before + 1
        histories.append("unknown" if carries else sweep.history)
        before = at
    return histories


def _is_same_clock(recorded: str, clock: str) -> bool:
    """Whether both name one bench's clock that has an address; others start with the program."""
    then = str(tomllib.loads(recorded).get("bench", {}).get("clock", ""))
    return then.upper().startswith("TCPIP") and then.upper() == clock.upper()


def check_rig(run: Run, rig: Rig) -> None:
    """Whether the run was recorded with this rig, as far as its config and calibrations say.

    Raises
    ------
    InputError : resume-mismatch
    """
    sums = json.loads(run.texts["calibrations"]).values()
    calibrations = rig.amplifier_calibration, rig.interferometer_calibration
    found = differences(run.texts["rig_config"], rig)
    found += [f"calibration {c.path}" for c in calibrations if c.sha256 not in sums]
    if found:
        raise _mismatch(run, "; ".join(found))


def check_plan(run: Run, plan: Plan) -> None:
    """Whether the run was played from this plan.

    Raises
    ------
    InputError : resume-mismatch
    """
    if run.texts["plan_hash"] != plan.hash:
        raise _mismatch(run, f"plan {plan.hash[:16]}, was {run.texts['plan_hash'][:16]}")


def check_recorded(run: Run) -> None:
    """Whether this is a run that can be gone on with at all.

    Raises
    ------
    InputError : resume-mismatch; imported data
    """
    if run.origin == "IMPORTED" or "plan_hash" not in run.texts:
        raise InputError(
            "resume-mismatch", f"{run.path}: these data were not recorded by 'run'",
            "they were imported", "give a run that this program played",
        )


def _mismatch(run: Run, what: str) -> InputError:
    return InputError(
        "resume-mismatch", f"{run.path} was recorded with other settings: {what}",
        "the protocol, the rig's config or a calibration was changed since",
        "bring back what was changed, or begin a new run",
    )


def differences(recorded: str, rig: Rig) -> list[str]:
    """What the rig's config says that touches the data and is not as it was recorded."""
    before = tomllib.loads(recorded)
    then, now = _flat(before), _flat(tomllib.loads(rig.text))
    if not (before.get("bench", {}).get("simulated") and rig.simulated):
        # One of them is served by a process of its own: its config does not know the plant.
        then, now = _without_plant(then), _without_plant(now)
    return [
        f"{key} is {now.get(key, 'not given')}, was {then.get(key, 'not given')}"
        for key in sorted({*then, *now}) if then.get(key) != now.get(key)
    ]


def _flat(table: dict[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            if before or key not in FREE_TABLES:
                flat |= _flat(value, f"{before}{key}.")
        elif key not in MAY_DIFFER:
            flat[before + key] = value
    return flat


def _without_plant(flat: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in flat.items() if not k.startswith("plant.")}


def check_bench(run: Run, bench: Bench) -> None:
    """Whether these are the instruments that the run was recorded with.

    Raises
    ------
    LimitError : resume-instruments
    """
    then = {name: str(record.get("serial", "")) for name, record in run.instruments().items()}
    wrong = [
        f"{record.name} has serial number {record.serial or '(none)'}, "
        f"had {then[record.name] or '(none)'}"
        for record in bench.instruments
        if record.name in then and record.serial != then[record.name]
    ]
    if bench.origin != run.origin:
        wrong.append(f"the bench is {bench.origin}, the run {run.origin}")
    if wrong:
        raise LimitError(
            "resume-instruments", f"{run.path}: " + "; ".join(wrong),
            "instruments were exchanged since, or this is another bench",
            "connect the instruments of the run, or begin a new run",
        )


def config_path(run: Run) -> Path:
    """The rig's config that the run was played with.

    Raises
    ------
    InputError : the run does not say, or it is not there any more
    """
    path = Path(run.texts.get("rig_path", ""))
    if not path.is_file():
        raise InputError(
            "file-missing", f"{run.path} was played with the rig's config "
            f"{path if path.name else '(not recorded)'}, which is not there",
            "it was moved, or this is another computer", "give it with --rig",
        )
    return path
