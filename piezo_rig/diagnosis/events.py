"""Single events of recordings, one by one: spikes, jumps, lost samples. When, where, how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from piezo_rig.causes.fringe_jump import STEP_NM

LISTED = ("step", "time", "index", "count", "sweep")  # parameters that the events say one by one


@dataclass(frozen=True)
class Event:
    """One event of one recording.

    Attributes
    ----------
    number : which of the sweeps given, from 1
    sweep, condition, repeat, recording : that sweep's name, what it is of, and its file's name
    index : sample of the sweep at which it begins
    time_s, between_s : of that sample since the sweep's first; earliest and latest that it may be
    size, unit : nm that it jumps or stands off its neighbours, or samples that are missing
    place : (group, recording, sample) in the groups that it was found in
    """

    number: int
    sweep: str
    condition: str
    repeat: int
    recording: str
    index: int
    time_s: float
    between_s: tuple[float, float]
    size: float
    unit: str
    place: tuple[int, int, int]


def size_text(cause: str, event: Event) -> str:
    """How large an event is, in words."""
    if event.unit == "samples":
        return f"{event.size:.0f} sample{'' if event.size == 1 else 's'} lost"
    text = f"{event.size:+.4g} nm"
    steps = round(abs(event.size) / STEP_NM)
    if cause == "fringe-jump":
        text += f" ({steps} step{'' if steps == 1 else 's'} of {STEP_NM:g} nm)"
    return text


def where_text(event: Event, many: bool) -> str:
    """In which sweep an event is; ``many``: there are several recordings, and names count on."""
    of = f"{event.condition or 'a drive without a name'}, repeat {event.repeat}"
    return f"{event.recording if many else event.sweep}: {of}"


def in_all(events: Sequence[Event]) -> str:
    """How many there are, in how many sweeps, and between which sizes."""
    sweeps = len({e.number for e in events})
    text = f"{len(events)} event{'' if len(events) == 1 else 's'} in {sweeps} sweep"
    text += "" if sweeps == 1 else "s"
    sizes = sorted(e.size for e in events)
    unit = events[0].unit
    if unit == "samples":
        return f"{text}, {sum(sizes):.0f} sample{'' if sum(sizes) == 1 else 's'} lost in all"
    if sizes[0] == sizes[-1]:
        return f"{text}, {sizes[0]:+.4g} {unit}{'' if len(events) == 1 else ' each'}"
    return f"{text}, {sizes[0]:+.4g} to {sizes[-1]:+.4g} {unit}"
