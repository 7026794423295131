"""Clocks and the event log: every sweep in its place, one after the other."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

from piezo_rig.errors import InputError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify.verdict import Verdict

_SLACK_S = 1e-3


def check_times(run: Run, read: dict[str, dict[str, Any]]) -> list[Verdict]:
    """Start times that grow, without overlap, and that agree with the event log.

    ``read`` holds the attributes of every sweep that has them, by name in the order of the file.
    """
    if run.origin == "IMPORTED":
        return []
    found = _order(run, read)
    try:
        events = run.events()
    except InputError as error:
        return [*found, Verdict("", True, f"event_log: {error.what}")]
    played = {
        str(e.get("sweep")): e for e in events if e["event"] == "playing" and "condition" in e
    }
    for name, a in read.items():
        event = played.get(name)
        if event is None:
            continue
        for key in ("condition", "repeat"):
            if a[key] != event.get(key, a[key]):
                text = f"{key} is {a[key]!r}, the event log says {event[key]!r}"
                found.append(Verdict(name, True, text))
        if a["start_time"] < event["time_s"] - _SLACK_S:
            found.append(Verdict(
                name, True, f"starts at {a['start_time']:.6g} s, the event log says that it was "
                f"not played before {event['time_s']:.6g} s",
            ))
    return found


def events_of(run: Run) -> list[dict[str, Any]]:
    """The event log; nothing where it cannot be read, which `check_times` has said."""
    try:
        return run.events()
    except InputError:
        return []


def _order(run: Run, read: dict[str, dict[str, Any]]) -> list[Verdict]:
    """Sweeps that do not start after the one before them; as few as explain the order."""
    names = list(read)
    starts = [float(read[n]["start_time"]) for n in names]
    kept = _longest_growing(starts)
    found = []
    for i, name in enumerate(names):
        if i not in kept:
            found.append(Verdict(
                name, True, f"starts at {starts[i]:g} s, not after the one before and before the "
                "one after",
            ))
    return found


def _longest_growing(values: list[float]) -> set[int]:
    """Indices of a longest strictly growing subsequence."""
    tails: list[float] = []
    at: list[int] = []
    before: list[int] = []
    for i, value in enumerate(values):
        place = bisect_right(tails, value)
        if place and tails[place - 1] == value:
            place -= 1
        before.append(at[place - 1] if place else -1)
        if place == len(tails):
            tails.append(value)
            at.append(i)
        else:
            tails[place], at[place] = value, i
    kept: set[int] = set()
    i = at[-1] if at else -1
    while i >= 0:
        kept.add(i)
        i = before[i]
    return kept
