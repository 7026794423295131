"""What must be found and taken off before the noise is measured, in this order.

Outliers, then what breaks a recording at one instant (jumps of the interferometer, lost samples),
then hum. Each is sought in recordings that are clean of those before it; a hum that is there is
left open while breaks are sought. After each the baseline is refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_rig.chain import Model, Parameter
from piezo_rig.diagnosis.chances import AS_HELD
from piezo_rig.diagnosis.early.breaks import SPREAD, Breaks, find_breaks
from piezo_rig.diagnosis.early.hum import Hum, find_hum, hum_of_residual, means_of, removed
from piezo_rig.diagnosis.early.mended import DROP, JUMP, Break, mended
from piezo_rig.diagnosis.early.recounted import PLAINLY, outright, recounted, square_of
from piezo_rig.diagnosis.early.reported import events_of, reported
from piezo_rig.diagnosis.early.running_off import rather_a_clock
from piezo_rig.diagnosis.early.spikes import find_spikes
from piezo_rig.diagnosis.events import Event
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.levels import levels
from piezo_rig.run_file.sweep import Sweep

HUM, OUTLIERS = "mains-hum", "outliers"
TRIED = (OUTLIERS, JUMP, DROP, HUM)
BETTER = 0.999  # squared error of the baseline after mending, of that before
ANOTHER = 5.0  # standard deviations between the frequencies of two lines
AGAIN = 3  # times that losses which show nowhere at once are placed anew
JOINTLY = 6  # turns of fitting base and hum
LEADS = 0.05  # of what is left, that such a line must be


@dataclass(frozen=True, eq=False)
class Early:
    """One cause that was found.

    ``p_value`` is family-wise, ``groups`` are clean of it, ``events`` are all of its events,
    ``breaks`` what had to be mended.
    """

    cause: str
    p_value: float
    parameters: dict[str, Parameter]
    groups: Groups
    events: tuple[Event, ...] = ()
    breaks: tuple[Break, ...] = ()


def _believed(
    groups: Groups, point: Point, breaks: Sequence[Break],
    refitted: Callable[[Groups, Point], Point],
) -> Breaks:  # fmt: skip
    """The breaks that are kept: without repeats, only if the baseline fits better once mended.

    A delay or a loop that the baseline lacks can look like lost samples, and mending those makes
    things worse; a clock that runs off can, and leaves less than losses do. Between repeats there
    is no such thing, and a single lost sample may be far smaller than what the baseline leaves.
    """
    alone = [b for b in breaks if groups.groups[b.group].repeats < 2]
    if not alone:
        return Breaks(tuple(breaks))
    whole = mended(groups, [g.predicted(point.model) for g in groups.groups], alone)
    members = {b.group for b in alone}
    after = square_of(whole, refitted(whole, point), members)
    if rather_a_clock(groups, point, alone, after, refitted):
        others = [b for b in breaks if b not in alone or b.cause != DROP]
        return _believed(groups, point, others, refitted)
    if after < BETTER * square_of(groups, point, members):
        return Breaks(tuple(breaks))
    return Breaks(tuple(b for b in breaks if b not in alone))


def _of_levels(groups: Groups, point: Point, breaks: Breaks) -> bool:
    """Whether noise that switches between two levels is taken for breaks: it still does so once
    they are mended. What a loss of many samples leaves of every half loop may look like steps, and
    is gone with it.
    """
    if levels(groups) is None:
        return False
    predicted = [g.predicted(point.model) for g in groups.groups]
    return levels(mended(groups, predicted, breaks.breaks)) is not None


def _placed_again(
    groups: Groups, point: Point, breaks: Breaks, refitted: Callable[[Groups, Point], Point],
    search: Callable[[Model], Breaks],
) -> Breaks:  # fmt: skip
    """Breaks as they show beside a base that has been fitted without them, if that leaves less.

    The base had followed as much of them as it could, and so moved the place of those that show
    nowhere at once.
    """
    members = {b.group for b in breaks.breaks}

    def left(found: Breaks, near: Point) -> tuple[float, Point]:
        whole = mended(groups, [g.predicted(near.model) for g in groups.groups], found.breaks)
        there = refitted(whole, near)
        return square_of(whole, there, members), there

    least, there = left(breaks, point)
    for _ in range(AGAIN):
        again = search(there.model)
        worth, near = left(again, there)
        if not worth < least:
            break
        breaks, least, there = again, worth, near
    return breaks


def clean_up(
    raw: Groups, sweeps: Sequence[Sweep], point: Point,
    refitted: Callable[[Groups, Point], Point], level: float, count: int,
    behind: float | None = None, enough: float = PLAINLY, lost: Sequence[Break] = (),
) -> tuple[list[Early], Point]:  # fmt: skip
    """Everything found, in order, and the baseline refitted to what is left.

    Parameters
    ----------
    point : the baseline, fitted to the raw recordings
    refitted : the baseline fitted to other recordings, from a point near by
    level : family-wise chance of a false alarm
    count : causes that are tried in all, for the correction
    behind : squared error of other causes that may stand for losses, um^2: see `outright`
    enough : what another number of losses must leave at most: see `recounted`
    lost : what drive monitors show to be lost; another instrument's channel may have lost none
    """
    clean, found = raw, list[Early]()
    if lost:
        whole = mended(raw, [g.predicted(point.model) for g in raw.groups], lost)
        there, members = refitted(whole, point), {b.group for b in lost}
        if square_of(whole, there, members) < square_of(raw, point, members):
            point = there
        else:
            lost = ()
    spikes = find_spikes(raw, point.model)
    if spikes.p_value * count < level:
        clean = spikes.groups
        found.append(Early(
            OUTLIERS, spikes.p_value * count, dict(spikes.stage().parameters), clean,
            events_of(raw, spikes.spikes, sweeps),
        ))  # fmt: skip
        point = refitted(clean, point)
    hum = find_hum(clean, point.model)
    line = hum.frequency if hum is not None and hum.p_value * count < level else None
    breaks = find_breaks(clean, point.model, sweeps, level / count, line, lost)
    if _of_levels(clean, point, breaks):
        breaks = Breaks(tuple(lost))
    else:
        known = recounted(clean, point, breaks.breaks, refitted, enough)
        if behind is not None and not lost:
            known = outright(clean, point, sweeps, known, refitted, behind)
        breaks = _believed(clean, point, known, refitted)
        if any(b.high - b.low >= SPREAD for b in breaks.breaks):
            breaks = _placed_again(clean, point, breaks, refitted, lambda model: find_breaks(
                clean, model, sweeps, level / count, line, lost
            ))  # fmt: skip
    if breaks.breaks:
        before = clean
        predicted = [g.predicted(point.model) for g in clean.groups]
        causes = list(dict.fromkeys(b.cause for b in breaks.breaks))
        for k, cause in enumerate(causes):
            known = [b for b in breaks.breaks if b.cause in causes[: k + 1]]
            clean = mended(before, predicted, known)
            mine = breaks.of(cause)
            p = min(1.0, min(b.p_value for b in mine) * count)
            events = events_of(before, mine, sweeps)
            found.append(Early(cause, p, reported(cause, events), clean, events, tuple(mine)))
        point = refitted(clean, point)
        # gaps follow the model, which the breaks had spoilt
        clean = mended(before, [g.predicted(point.model) for g in clean.groups], breaks.breaks)
        found[-1] = replace(found[-1], groups=clean)
        hum = find_hum(clean, point.model)
    if hum is None or not hum.p_value * count < level:
        hum = _given_back(clean, point, refitted)
    if hum is not None and hum.p_value * count < level:
        hum, point = _by_turns(clean, point, hum, refitted)
        parameters = dict(hum.stage().parameters)
        found.append(Early(HUM, hum.p_value * count, parameters, hum.groups))
    return found, point


def _by_turns(
    noisy: Groups, point: Point, hum: Hum, refitted: Callable[[Groups, Point], Point]
) -> tuple[Hum, Point]:
    """A hum and a model beside it: what the model took of the hum is given back."""
    for _ in range(JOINTLY):
        point = refitted(hum.groups, point)
        hum = removed(noisy, point.model, hum.frequency, hum.p_value, hum.spread_hz)
    return hum, point


def _given_back(
    noisy: Groups, point: Point, refitted: Callable[[Groups, Point], Point]
) -> Hum | None:
    """Hum that begins in step with every recording, beside a base that has not followed it.

    A base of many elements follows much of such a hum, in every drive another part, and what it
    makes of it is in all harmonics of the drive: the line that is left hardly stands out.
    """
    hum = hum_of_residual(noisy, point.model)
    if hum is None:
        return None
    for _ in range(JOINTLY):
        point = refitted(hum.groups, point)
        hum = hum_of_residual(noisy, point.model)
        if hum is None:
            return None
    square = np.concatenate([r.level**2 for r in means_of(noisy, point.model)])
    if 0.5 * hum.amplitude_nm**2 < LEADS * 1e6 * float(square.mean()):
        return None  # beside so much else it is looked for again once that is explained
    return hum


def credited(found: Sequence[Early]) -> tuple[int, int]:
    """How many samples are known to be lost, and less how many outliers there are: more is better.

    A base that was fitted to a recording with a loss in it is late before and early after, and a
    clock that runs off says most of that: beside a better one there may be more. And what such a
    base leaves is full of spikes that nobody recorded.
    """
    lost = sum(round(e.size) for early in found if early.cause == DROP for e in early.events)
    return lost, -sum(len(early.events) for early in found if early.cause == OUTLIERS)


def never_outliers(raw: Groups, found: Sequence[Early], model: Model) -> list[Early] | None:
    """What was found but outliers, if beside a better model there are none; None if there are any.

    A base that lacks a clock, or a mode that rings, leaves corners that look like some.
    """
    others = [early for early in found if early.cause != OUTLIERS]
    if len(others) == len(found) or any(early.cause == HUM for early in others):
        return None
    predicted, clean, known = [g.predicted(model) for g in raw.groups], raw, list[Break]()
    out = []
    for early in others:
        known += early.breaks
        clean = mended(raw, predicted, known)
        out.append(replace(early, groups=clean))
    return None if find_spikes(clean, model).spikes else out


def hum_behind(
    clean: Groups, point: Point, refitted: Callable[[Groups, Point], Point], level: float,
    count: int,
) -> Early | None:  # fmt: skip
    """Hum that what the baseline leaves had hidden, beside a better model."""
    hum = hum_of_residual(clean, point.model)
    if hum is None or not hum.p_value * count < level:
        return None
    hum, _ = _by_turns(clean, point, hum, refitted)
    return Early(HUM, hum.p_value * count, dict(hum.stage().parameters), hum.groups)


def hum_again(
    before: Groups, found: Early, point: Point, refitted: Callable[[Groups, Point], Point],
    level: float, count: int,
) -> Early | None:  # fmt: skip
    """The hum fitted once more, to what a better model leaves of recordings that still have it;
    None where that leaves none.

    ``refitted`` : the better model fitted to other recordings, from a point near by
    """
    heard = find_hum(before, point.model)
    if heard is None or not heard.p_value * count < level:
        return None
    told = found.parameters["frequency"]
    assert told.ci95 is not None
    spread_hz = (told.ci95[1] - told.ci95[0]) / (3.92 * AS_HELD)
    if abs(heard.frequency - told.value) > ANOTHER * float(np.hypot(spread_hz, heard.spread_hz)):
        hum, _ = _by_turns(before, point, heard, refitted)
        return Early(HUM, hum.p_value * count, dict(hum.stage().parameters), hum.groups)
    surest = min((spread_hz, told.value), (heard.spread_hz, heard.frequency))
    hum = removed(before, point.model, surest[1], found.p_value, surest[0])
    hum, _ = _by_turns(before, point, hum, refitted)
    parameters = dict(hum.stage().parameters)
    size = parameters["amplitude"].ci95
    if size is not None and not size[0] > 0.0:  # what was different from one repeat to the next
        return None
    return replace(found, parameters=parameters, groups=hum.groups)
