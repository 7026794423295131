"""What the data at hand are like, for causes to say what could show in them."""

from __future__ import annotations

import numpy as np

from piezo_rig.causes.cause import Context
from piezo_rig.causes.clock_ratio import pauses
from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.space import Space

STANDS = 1e-3  # of the largest change from sample to sample, below which a drive stands still
SOON, SHARP = 2, 0.5  # samples after a turning point; of the usual speed, reached by then
LEAST_HELD, MANY_STOPS, HELD_SHARE = 20, 4, 0.1  # samples; stops; of all samples
LEAST_SWING, SAME_TIME = 0.02, 1.2  # of the range of all drives; of the time of half loops
STEEP_S = 0.002  # over which the drive's slew is taken


def context_of(space: Space, model: Model) -> Context:
    """What the data are like."""
    slews, longest = [], 0.0
    for g in space.groups.groups:
        seconds = g.time_s[g.loops.stop] - g.time_s[g.loops.start]
        volts = np.abs(g.drive_v[g.loops.stop] - g.drive_v[g.loops.start])
        slews.append(volts[seconds > 0] / seconds[seconds > 0])
        longest = max(longest, float(g.time_s[-1] - g.time_s[0]))
    return Context(
        model,
        space.groups.travel_um,
        space.groups.span_v,
        np.concatenate(slews),
        1.0 / space.groups.rate,
        longest,
        space.groups.finest_rate,
        space.groups.offset_v,
        space.groups.session_s,
        space.groups.ends_v,
        _ends_um(space.groups, model),
        _steepest(space.groups),
        space.groups.noise_v,
        max((float(g.played.max()) for g in space.groups.groups if g.played is not None),
            default=0.0),
        space.groups.has_first_rise,
        _holds(space.groups),
        _corners(space.groups),
        space.groups.repeats > 1,
        any(pauses(g.time_s).size for g in space.groups.groups),
    )  # fmt: skip


def at_one_frequency(groups: Groups) -> bool:
    """Whether half loops take about the same time however far they go: how fast one is then says
    how far it goes.
    """
    ends = [(g, g.loops.start, g.loops.stop) for g in groups.groups]
    times = np.concatenate([g.time_s[b] - g.time_s[a] for g, a, b in ends])
    far = np.concatenate([
        np.abs(g.drive_v[b] - g.drive_v[a]) > LEAST_SWING * groups.span_v for g, a, b in ends
    ])  # fmt: skip
    if not far.any():
        return False
    low, high = np.percentile(times[far], [5, 95])
    return bool(high < SAME_TIME * low)


def at_one_range(groups: Groups) -> bool:
    """Whether all half loops but first rises go equally far, from the same drive: what depends on
    how far they go shows in first rises alone.
    """
    drives = [
        (g.drive_v[a], g.drive_v[b]) for g in groups.groups
        for a, b in zip(g.loops.start[g.virgin :], g.loops.stop[g.virgin :], strict=True)
    ]  # fmt: skip
    if not drives:
        return False
    ends = np.sort(np.array(drives), axis=1)
    return bool(np.all(np.ptp(ends, axis=0) < LEAST_SWING * groups.span_v))


def _corners(groups: Groups) -> bool:
    """Whether the drive mostly turns from one sample to the next, at once at full speed."""
    turns, sharp = 0, 0
    for g in groups.groups:
        stop = np.asarray(g.loops.stop[:-1])
        on = (np.asarray(g.loops.stop[1:]) - stop > SOON) & (stop + SOON < g.drive_v.size)
        stop, end = stop[on], np.asarray(g.loops.stop[1:])[on]
        usual = np.abs(g.drive_v[end] - g.drive_v[stop]) / (end - stop)
        first = np.abs(g.drive_v[stop + SOON] - g.drive_v[stop + SOON - 1])
        turns += stop.size
        sharp += int(np.sum(first > SHARP * usual))
    return sharp > 0.5 * turns


def _holds(groups: Groups) -> bool:
    """Whether the drive stops, and stands still for long, again and again."""
    stops, still, samples = 0, 0, 0
    for g in groups.groups:
        change = np.abs(np.diff(g.drive_v))
        stands = change < STANDS * float(change.max(initial=0.0))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(np.int8), [0]])))
        begins, ends = edges[::2], edges[1::2]
        long = (ends - begins >= LEAST_HELD) & (begins > 0)
        stops += int(long.sum())
        still += int((ends - begins)[long].sum())
        samples += change.size
    return stops >= MANY_STOPS and still > HELD_SHARE * samples


def _ends_um(groups: Groups, model: Model) -> tuple[float, float]:
    """How far the sensor goes below and above where a sweep begins by a model.

    That is its first sample, but for a recording of unknown history: what it brought along is not
    in the model.
    """
    low = high = 0.0
    for g in groups.groups:
        seen = g.measured_um.mean(axis=0)
        begun = seen[0]
        if not g.virgin:
            predicted = g.predicted(model)
            off = np.concatenate([(seen - predicted)[a:b] for a, b in g.blocks])
            begun = predicted[0] + off.mean()
        cut = np.concatenate([seen[a:b] for a, b in g.blocks]) - begun
        low, high = min(low, float(cut.min())), max(high, float(cut.max()))
    return low, high


def _steepest(groups: Groups) -> float:
    """Largest |dV/dt| over some milliseconds."""
    apart = max(1, round(STEEP_S * groups.rate))
    steps = [np.abs(g.drive_v[apart:] - g.drive_v[:-apart]) for g in groups.groups]
    return max((float(s.max()) for s in steps if s.size), default=0.0) * groups.rate / apart
