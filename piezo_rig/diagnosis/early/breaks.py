"""Fringe jumps and dropped samples: what breaks a recording at one instant, for good.

A jump adds a whole multiple of 79.1 nm from some sample on, lost samples add a whole number of
samples' way: the velocity from some sample on. Both are sought by one generalised likelihood
ratio (over the instant and the whole number) in what single recordings have of their own, so
that they compete on equal terms: a step as from ten lost samples turns over with the velocity, a
jump does not. What fits neither whole number is neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.early.mended import DROP, JUMP, STEP_UM, Break, lead, mended
from piezo_rig.diagnosis.early.peaks import Peak, Search, find_peaks
from piezo_rig.diagnosis.early.place import at_rest, placed
from piezo_rig.diagnosis.early.traces import (
    Stretch,
    Whitened,
    own_part,
    spectrum,
    stretches,
    sweep_bounds,
    way,
)
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.noise import Whitener
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
ROUNDS = 40  # of search; one break of every group is taken in each
OFF = 4.0  # standard errors that a size may be off a whole number
SLACK = 0.1  # of a step or sample, for what the model does not know
LONG, WIDE = 0.03, 0.2  # shares by which the way may be wrong, and a first count
AGAIN = 2  # times that place and count are looked for in turn
CLEAR = 12.0  # log-likelihood that the instant itself must be worth where there are no repeats
MANY = 10  # samples
NEAR_S = 0.3
FEWER = 4  # counts that are tried
LIKELIEST = 4  # peaks of a group that are looked at closely


@dataclass(frozen=True, eq=False)
class Breaks:
    """All that was found, in the order in which it stood out."""

    breaks: tuple[Break, ...]

    def of(self, cause: str) -> list[Break]:
        """Those of one cause, in time."""
        mine = [b for b in self.breaks if b.cause == cause]
        return sorted(mine, key=lambda b: (b.group, b.row, b.index))


def find_breaks(
    groups: Groups, model: Model, sweeps: Sequence[Sweep], level: float,
    line_hz: float | None = None,
) -> Breaks:  # fmt: skip
    """Every jump and loss that is less likely by chance than ``level``.

    Parameters
    ----------
    model : predicts the velocity, and without repeats the displacement
    sweeps : the recordings that the groups are made of
    line_hz : of a hum in the recordings, not to be taken for anything else
    """
    predicted = [g.predicted(model) for g in groups.groups]
    found = stretches(groups, predicted, sweeps, line_hz)
    breaks: list[Break] = []
    closed: set[int] = set()  # groups in which nothing more can be placed
    for _ in range(ROUNDS if found else 0):
        search = _round(mended(groups, predicted, breaks), predicted, found, breaks, sweeps)
        peaks = [p for p in find_peaks(search) if search.chance(p.gained) < level]
        before = len(breaks)
        for g in sorted({found[p.stretch].group for p in peaks} - closed):
            mine = sorted((p for p in peaks if found[p.stretch].group == g),
                          key=lambda p: -p.gained)  # fmt: skip
            mixed = any(p.cause == DROP for p in mine)
            exact = [e for p in mine[:LIKELIEST] if (e := _exact(search, p, mixed)) is not None]
            gained, new = max(exact, key=lambda e: e[0], default=(0.0, None))
            if new is not None and new.cause == JUMP and mine[0].cause == DROP and (
                mine[0].gained > gained
            ):  # fmt: skip
                new = None  # a loss that could not be placed is no jump
            if new is None or search.chance(gained) >= level:
                closed.add(g)
            else:
                breaks.append(new)
        if len(breaks) == before:
            break
    return Breaks(tuple(breaks))


def _round(
    groups: Groups, predicted: list[FloatArray], found: list[Stretch], breaks: list[Break],
    sweeps: Sequence[Sweep],
) -> Search:  # fmt: skip
    search = Search(groups, predicted, found, [], breaks, sweeps, 0)
    own = {
        (k, row): search.own(s, row)
        for k, s in enumerate(found)
        for row in range(groups.groups[s.group].repeats)
    }
    whitener = Whitener(spectrum(groups, found, own))
    white = [Whitened.of(stretch, whitener) for stretch in found]
    tried = sum(values.size for values in own.values())
    return Search(groups, predicted, found, white, breaks, sweeps, tried)


def _exact(search: Search, peak: Peak, mixed: bool) -> tuple[float, Break | None] | None:
    """A break at its sample, in the recording that it belongs to, and what it gains.

    None where nothing begins at an instant there, or its size is no whole number. Where several
    losses follow each other the likeliest instant has the count of more than one of them.

    ``mixed`` : samples may be lost there too, which look like a jump for a while
    """
    for count in range(peak.count, max(peak.count - FEWER, 0), -1) if peak.cause == DROP else (0,):
        found = _exactly(search, replace(peak, count=count or peak.count), mixed)
        if found is not None:
            return found
    return None


def _exactly(search: Search, peak: Peak, mixed: bool) -> tuple[float, Break | None] | None:
    stretch, white = search.stretches[peak.stretch], search.white[peak.stretch]
    group, model = search.groups.groups[stretch.group], search.predicted[stretch.group]
    row, sign, own = peak.row, 1, own_part(group, peak.row, model)
    count = peak.count
    if peak.cause == JUMP and group.repeats == 2:
        # either may have jumped, the other way round: only one shows a step against the model
        worth = []
        for r, c in ((peak.row, count), (1 - peak.row, -count)):
            one = placed(group.measured_um[r] - model, model, JUMP, peak.at, c, stretch)
            worth.append(-np.inf if one is None else one[3])
        if worth[1] > worth[0]:
            row, sign = 1 - peak.row, -1
    at, gained, near = peak.at, 0.0, (0, 0, 0, 0.0)
    for _ in range(AGAIN):
        found = placed(own, model, peak.cause, at, count, stretch, group.repeats < 2)
        if found is None and peak.cause == DROP and group.repeats > 1:
            found = at_rest(model, at, stretch)
        if found is None:
            return None
        near, at = found, found[0]
        # where several follow each other, the next ones hide what this one is
        counted = _counted(search, stretch, white, peak, at, count)
        if counted is None:
            counted = _counted(search, stretch, white, peak, at, count, NEAR_S)
            if counted is not None and mixed and peak.cause == JUMP:
                speed = float(np.gradient(model[at - 1 : at + 2])[1])
                missing = round(count * STEP_UM / speed) if speed else 0
                rival = missing > 0 and _counted(
                    search, stretch, white, replace(peak, cause=DROP), at, missing, NEAR_S
                )
                if rival and rival[1] > counted[1]:
                    return None
        if counted is None:
            return None
        count, gained = counted
    if group.repeats < 2 and near[3] < CLEAR:
        return None
    before = lead(search.breaks, stretch.group, row, at)
    end = next(b for a, b in sweep_bounds(group, row, search.sweeps) if a <= at < b)
    index, low, high = (i - before for i in near[:3])
    p = search.chance(gained)
    return gained, Break(
        peak.cause, stretch.group, row, index, sign * count, low, high, end, p
    )  # fmt: skip


def _counted(
    search: Search, stretch: Stretch, white: Whitened, peak: Peak, at: int, count: int,
    within_s: float = np.inf,
) -> tuple[int, float] | None:  # fmt: skip
    """How many steps or samples it is, and what that gains in likelihood; None if no whole number.

    By all that follows, or by what lies no further than ``within_s`` away.
    """
    group, model = search.groups.groups[stretch.group], search.predicted[stretch.group]
    path = model[stretch.begin : stretch.end]
    if group.repeats > 1:  # the others know the way better than the model, but for their noise
        seen = np.delete(group.measured_um, peak.row, axis=0).mean(axis=0)
        seen = seen[stretch.begin : stretch.end]
        line = np.polyfit(path, seen, 1)
        path = seen if abs(count) > MANY else line[0] * path
    after = np.arange(path.size) >= at - stretch.begin
    near = white.near(at, within_s * search.groups.rate)
    seen = near(search.own(stretch, peak.row))
    wide = 2 + int(WIDE * abs(count))
    best: tuple[float, int, float, float] | None = None
    for size in range(max(1, abs(count) - wide), abs(count) + wide + 1):
        signed = size if count > 0 else -size
        change = np.full(path.size, signed * STEP_UM)
        if peak.cause == DROP:
            change = way(path, size)
        template = near(stretch.thinned(after * change))
        square, number = float(template @ template), float(template @ seen)
        gained = number - 0.5 * square
        if best is None or gained > best[0]:
            best = (gained, signed, number / max(square, 1e-300), square)
    assert best is not None
    gained, signed, share, square = best
    off = abs(share - 1.0) * abs(signed)  # in steps or samples
    slack = SLACK + (LONG * abs(signed) if peak.cause == DROP else 0.0)
    if gained <= 0.0 or off > OFF * abs(signed) / np.sqrt(square) + slack:
        return None
    return signed, gained
