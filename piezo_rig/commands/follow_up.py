"""`diagnose --follow-up`: plays the protocol that separates confounded causes, on the same stack.

It goes the way of `run`: the plan is checked, the operator asked, the guard holds the line. The
bench's clock goes on where the data end, so that what is locked to the clock fits together.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.clock import Clock
    from piezo_rig.bench import Bench
    from piezo_rig.config import Rig
    from piezo_rig.diagnosis.follow_up import Decision, FollowUp
    from piezo_rig.protocol import Protocol
    from piezo_rig.run_file.sweep import Sweep

PAUSE_S = 60.0  # on a virtual clock, between the data and what follows them
SAME = ("actuator.", "plant.", "gain", "polarity")  # keys of a rig's config that must not differ


def play_follow_up(
    advice: FollowUp, rig_name: str, data: Sequence[str], sweeps: Sequence[Sweep], mixed: bool
) -> Path:
    """Play a protocol into a run beside the data; returns the run.

    Raises
    ------
    InputError : another stack than the data's, or another origin
    LimitError : the rig does not allow the protocol, or it goes elsewhere than the data
    BenchError, Aborted : as `run`
    """
    from piezo_rig.commands.run import make_room, record, recover_runs
    from piezo_rig.config import load_rig
    from piezo_rig.errors import LimitError
    from piezo_rig.protocol import build_plan
    from piezo_rig.runner import new_run_path

    rig = load_rig(rig_name)
    if advice.scaled:
        beyond = LimitError(
            "follow-up-range", f"{advice.protocol} was not played: it has to be {advice.scaled}",
            "the stack was never driven as far as the protocol goes",
            "copy the protocol file, change its voltages, `piezo-rig run` the copy, then diagnose "
            "everything together",
        )  # fmt: skip
        beyond.piezo = "not touched; nothing was played"
        raise beyond
    _check_stack(rig, data)
    plan = build_plan(_protocol(advice.protocol, sweeps[0].sample_rate), rig)
    folder = Path(data[0]).absolute().parent
    make_room(folder, plan)
    recover_runs(folder)
    origins = {s.origin for s in sweeps}

    def same_origin(bench: Bench) -> None:
        if not mixed and origins != {bench.origin}:
            raise _refused(
                f"the data are {' and '.join(sorted(origins))}, the bench is {bench.origin}",
                "give the rig that the data come from, or --mixed-origin if you mean it",
            )

    print(f"follow-up {advice.protocol}: to tell {' from '.join(advice.separates)}")
    return record(plan, rig, new_run_path(folder, plan.protocol.name), check=same_origin,
                  clock=_clock_after(rig, sweeps))  # fmt: skip


def _protocol(name: str, rate: float) -> Protocol:
    """A shipped protocol at the data's sample rate: sweeps of two rates cannot be joined."""
    import re

    from piezo_rig.config.toml_text import Document
    from piezo_rig.protocol.protocol_file import parse_protocol
    from piezo_rig.resources import find, read_text

    path = find("protocols", name)
    text = re.sub(r"(?m)^sample_rate\s*=.*$", f"sample_rate = {rate:.17g}",
                  read_text(path, "protocol file"))
    return parse_protocol(Document(text, str(path), "protocol"))


def _check_stack(rig: Rig, data: Sequence[str]) -> None:
    """Whether the runs among the data were played on this rig's stack."""
    from piezo_rig.commands.data_options import is_run
    from piezo_rig.run_file.reader import Run
    from piezo_rig.runner.resume import differences

    for name in data:
        if not is_run(name):
            continue
        recorded = Run(name).texts.get("rig_config")
        found = [d for d in differences(recorded, rig) if d.startswith(SAME)] if recorded else []
        if found:
            raise _refused(f"{name} was played on another stack: {'; '.join(found)}",
                           "give the rig's config that the run was played with")


def _refused(what: str, remedy: str) -> Exception:
    from piezo_rig.errors import InputError

    error = InputError("follow-up-bench", what, "another rig's config than the data's", remedy)
    error.piezo = "not touched; nothing was played"
    return error


def _clock_after(rig: Rig, sweeps: Sequence[Sweep]) -> Clock | None:
    """A clock that goes on where the data end; None for a bench whose clock goes on by itself."""
    from drivers.clock import RealClock, VirtualClock

    own = [s for s in sweeps if s.origin != "IMPORTED"]
    end_s = max((s.start_time + s.samples / s.sample_rate for s in own), default=0.0)
    if rig.clock == "virtual":
        return VirtualClock(start=end_s + PAUSE_S)
    return RealClock(start=end_s + PAUSE_S) if rig.clock == "real" else None


def lines(decision: Decision, run: Path) -> list[str]:
    """What the follow-up decided, for a technician."""
    out = [f"follow-up {run}", f"          {decision.text}"]
    if decision.fell:
        out.append(f"          no longer possible: {', '.join(decision.fell)}")
    return out
