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
from piezo_rig.diagnosis.early.followed import BY_ALL, MANY, by_all_that_follows, path_of
from piezo_rig.diagnosis.early.guesses import CLEAR, at_sight, guess_of, losses_of_pairs
from piezo_rig.diagnosis.early.mended import DROP, JUMP, STEP_UM, Break, lead, mended
from piezo_rig.diagnosis.early.of_repeats import of_repeats
from piezo_rig.diagnosis.early.passing import lasting
from piezo_rig.diagnosis.early.peaks import Peak, Search, find_peaks, left_of, search_of
from piezo_rig.diagnosis.early.place import at_rest, placed
from piezo_rig.diagnosis.early.plain_jumps import jumps_at_sight
from piezo_rig.diagnosis.early.traces import (
    Stretch,
    Whitened,
    stretches,
    sweep_bounds,
    way,
)
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
ROUNDS = 40  # of search; one break of every group is taken in each
OFF = 4.0  # standard errors that a size may be off a whole number
SLACK = 0.1  # of a step or sample, for what the model does not know
LONG, WIDE = 0.03, 0.2  # shares by which the way may be wrong, and a first count
AGAIN = 2  # times that place and count are looked for in turn
LEAST = 40  # samples that must be left to count lost ones
ENOUGH = 12  # samples to either side, that say how large a jump is
BESIDE = 4  # samples: so near to each other losses of two recordings are none
NEAR_S = 0.3, 0.03
FEWER = 4  # counts that are tried
LIKELIEST = 4  # peaks of a group, of either cause, that are looked at closely
REST = 0.1  # of what a loss gains, that it may gain once a jump in its place is mended
SPREAD = 60  # samples between which a loss may be
EDGE, STEEP = 8, 0.05  # samples to either side of a jump; of the drive's span, in an edge of it


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
    line_hz: float | None = None, lost: Sequence[Break] = (),
) -> Breaks:  # fmt: skip
    """Every jump and loss that is less likely by chance than ``level``.

    Parameters
    ----------
    model : predicts the velocity, and without repeats the displacement
    sweeps : the recordings that the groups are made of
    line_hz : of a hum in the recordings, not to be taken for anything else
    lost : what monitors show to be lost; then nothing else is
    """
    predicted = [g.predicted(model) for g in groups.groups]
    found = stretches(groups, predicted, sweeps, line_hz)
    breaks = list(lost)
    closed: set[int] = set()  # groups in which nothing more can be placed
    guessed: dict[int, int] = {}  # group -> how many breaks there were before one was guessed
    for turn in range(ROUNDS if found else 0):
        search = search_of(mended(groups, predicted, breaks), predicted, found, breaks, sweeps)
        plain = jumps_at_sight(search) if turn == 0 else []
        if plain:
            breaks += plain
            search = search_of(mended(groups, predicted, breaks), predicted, found, breaks, sweeps)
        peaks = [
            p for p in find_peaks(search)
            if search.chance(p.gained) < level and not (lost and p.cause == DROP)
        ]
        before, tried = len(breaks), len(guessed)
        for g in sorted({found[p.stretch].group for p in peaks} - closed):
            mine = sorted((p for p in peaks if found[p.stretch].group == g),
                          key=lambda p: -p.gained)  # fmt: skip
            mixed = any(p.cause == DROP for p in mine)
            exact = [
                e for p in _likely(mine)
                if (e := _exact(search, p, mixed)) is not None and not _of_memory(groups, e[1])
            ]  # fmt: skip
            gained, new = _likeliest(search, groups, exact)
            if new is not None and new.cause == JUMP and mine[0].cause == DROP and (
                mine[0].gained > gained and abs(mine[0].at - new.index) < NEAR_S[0] * groups.rate
            ):  # fmt: skip
                whole = mended(groups, predicted, [*breaks, new])
                after = search_of(whole, predicted, found, [*breaks, new], sweeps)
                if _loudest(after, mine[0]) > REST * mine[0].gained:
                    new = None  # a loss that could not be placed is no jump
            if new is not None and search.chance(gained) < level:
                breaks.append(new)
            elif lost or g in guessed or (guess := guess_of(search, mine[:LIKELIEST])) is None:
                closed.add(g)
            else:
                guessed[g] = len([b for b in breaks if b.group == g])
                breaks.append(guess)
        others = {s.group for s in found} - set(guessed) if not lost else set()
        for g in sorted(others) if len(breaks) == before else ():
            guess = guess_of(search, losses_of_pairs(search, g, level))
            if guess is not None:
                closed.discard(g)
                guessed[g] = len([b for b in breaks if b.group == g])
                breaks.append(guess)
        if len(breaks) == before and len(guessed) == tried:
            break
    for g, known in guessed.items():
        losses = [b for b in breaks if b.group == g]
        if not _borne_out(groups, predicted, found, breaks, sweeps, losses[known]):
            breaks = [b for b in breaks if b not in losses[known:]]
    if lost:
        return Breaks(tuple(breaks))
    breaks = _cancelled(breaks)
    placed_well = [b for b in breaks if b.high - b.low < SPREAD]  # else two are as good as one
    for several in [b for b in placed_well if b.cause == DROP and 1 < b.count <= FEWER]:
        breaks = _split(groups, predicted, found, breaks, sweeps, several)
    for g in sorted({s.group for s in found}):
        breaks = of_repeats(groups, predicted, found, breaks, sweeps, g, level)
    return Breaks(tuple(lasting(groups, _at_once(breaks))))


def _likely(peaks: Sequence[Peak]) -> list[Peak]:
    """The best of either cause: while the velocity stays what it is, one looks like the other."""
    each = ([p for p in peaks if p.cause == cause][:LIKELIEST] for cause in (JUMP, DROP))
    return sorted((p for few in each for p in few), key=lambda p: -p.gained)


def _loudest(search: Search, loss: Peak) -> float:
    """What a loss gains at most that is found where another one was, in any recording."""
    return max((
        p.gained for p in find_peaks(search)
        if p.cause == DROP and p.stretch == loss.stretch
        and abs(p.at - loss.at) < NEAR_S[0] * search.groups.rate
    ), default=0.0)  # fmt: skip


def _of_memory(groups: Groups, new: Break | None) -> bool:
    """Whether a jump is in an edge of the drive while nobody knows what the actuator remembers.

    Recordings that remember different things differ by that as soon as the drive has moved.
    """
    if new is None or new.cause != JUMP:
        return False
    group = groups.groups[new.group]
    if group.virgin or new.index >= group.blocks[0][0]:
        return False
    about = group.drive_v[max(new.index - EDGE, 0) : new.index + EDGE]
    return bool(np.ptp(about) > STEEP * np.ptp(group.drive_v))


def _likeliest(
    search: Search, groups: Groups, exact: Sequence[tuple[float, Break | None]]
) -> tuple[float, Break | None]:
    """Of breaks of a group that are placed the one that says most, and what it gains.

    A jump and a loss of many samples are counted by stretches that are not equally long: they are
    compared by what each leaves once it is mended.
    """
    best: dict[str, tuple[float, Break | None]] = {}
    for gained, new in sorted(exact, key=lambda e: e[0]):
        best[new.cause if new is not None else ""] = gained, new

    def left(b: Break) -> float:
        whole = mended(groups, search.predicted, [*search.breaks, b])
        return left_of(replace(search, groups=whole), b.group)

    if {JUMP, DROP} <= set(best):
        both = [best[JUMP], best[DROP]]
        return min(both, key=lambda e: left(e[1]) if e[1] is not None else np.inf)
    return max(best.values(), key=lambda e: e[0], default=(0.0, None))


def _cancelled(breaks: list[Break]) -> list[Break]:
    """Losses without those that both recordings of a drive are said to have at one place."""
    out = list(breaks)
    for b in breaks:
        for other in breaks:
            if b.cause == other.cause == DROP and b.group == other.group and b.row < other.row and (
                abs(b.index - other.index) <= BESIDE
            ):  # fmt: skip
                both = min(b.count, other.count)
                left = [replace(x, count=x.count - both) for x in (b, other) if x.count > both]
                out = [x for x in out if x is not b and x is not other] + left
    return out


def _at_once(breaks: Sequence[Break]) -> list[Break]:
    """Breaks with losses at one sample as the one loss that they are."""
    out = dict[tuple[str, int, int, int], Break]()
    for b in breaks:
        key = b.cause, b.group, b.row, b.index
        known = out.get(key)
        out[key] = b if known is None else replace(
            known, count=known.count + b.count, p_value=min(known.p_value, b.p_value)
        )  # fmt: skip
    return [b for b in out.values() if b.count]


def _split(
    groups: Groups, predicted: list[FloatArray], found: list[Stretch], breaks: list[Break],
    sweeps: Sequence[Sweep], several: Break,
) -> list[Break]:  # fmt: skip
    """Breaks with a loss of several samples as two losses, where that fits better."""
    others = [b for b in breaks if b is not several]
    at = several.index + lead(others, several.group, several.row, several.index)
    k = next((k for k, s in enumerate(found)
              if s.group == several.group and s.begin <= at < s.end), None)  # fmt: skip
    if k is None:
        return breaks

    def searched(tried: list[Break]) -> Search:
        whole = mended(groups, predicted, tried)
        return replace(basis, groups=whole, breaks=tried)

    basis = search_of(mended(groups, predicted, breaks), predicted, found, breaks, sweeps)
    best, least = breaks, left_of(basis, several.group, k) - CLEAR
    for count in range(1, several.count):
        fewer = [replace(b, count=count) if b is several else b for b in breaks]
        search = searched(fewer)
        peaks = [p for p in find_peaks(search)
                 if (p.stretch, p.row, p.cause) == (k, several.row, DROP)]  # fmt: skip
        for peak in sorted(peaks, key=lambda p: -p.gained)[:LIKELIEST]:
            exact = _exactly(search, replace(peak, count=several.count - count), True)
            if exact is None or exact[1] is None:
                continue
            both = [*fewer, exact[1]]
            if (worth := left_of(searched(both), several.group, k)) < least:
                best, least = both, worth
    return best


def _borne_out(
    groups: Groups, predicted: list[FloatArray], found: list[Stretch], breaks: Sequence[Break],
    sweeps: Sequence[Sweep], guess: Break,
) -> bool:  # fmt: skip
    """Whether a guessed loss is a whole number beside everything that was found after it."""
    others = [b for b in breaks if b is not guess]
    search = search_of(mended(groups, predicted, others), predicted, found, others, sweeps)
    at = guess.index + lead(others, guess.group, guess.row, guess.index)
    for k, stretch in enumerate(found):
        if stretch.group == guess.group and stretch.begin <= at < stretch.end:
            peak = Peak(DROP, k, guess.row, at, guess.count, 0.0)
            counted = _counted(search, stretch, search.white[k], peak, at, guess.count)
            return counted is not None and counted[0] == guess.count
    return False


def _exact(search: Search, peak: Peak, mixed: bool) -> tuple[float, Break | None] | None:
    """A break at its sample, in the recording that it belongs to, and what it gains.

    None where nothing begins at an instant there, or its size is no whole number. Where several
    losses follow each other the likeliest instant has the count of more than one of them.

    ``mixed`` : samples may be lost there too, which look like a jump for a while
    """
    counts = list(range(peak.count, max(peak.count - FEWER, 0), -1))
    if peak.cause == JUMP:  # several add up to a mean of them, far from each
        one = 1 if peak.count > 0 else -1
        counts = [c for c in (peak.count, peak.count - one, peak.count + one) if c]
        counts += [c for c in (at_sight(search, peak),) if c and c not in counts]
    for count in counts:
        found = _exactly(search, replace(peak, count=count), mixed)
        if found is not None:
            return found
    return None


def _exactly(search: Search, peak: Peak, mixed: bool) -> tuple[float, Break | None] | None:
    stretch, white = search.stretches[peak.stretch], search.white[peak.stretch]
    group, model = search.groups.groups[stretch.group], search.predicted[stretch.group]
    row, sign, own = peak.row, 1, search.whole(stretch.group, peak.row)
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
        path = path_of(search, peak, count)
        found = placed(own, path, peak.cause, at, count, stretch, group.repeats < 2)
        if found is None and peak.cause == DROP and group.repeats > 1:
            found = at_rest(model, at, stretch)
        if found is None and peak.cause == DROP and group.repeats < 2 and peak.gained > BY_ALL:
            found = by_all_that_follows(search, stretch, white, peak, at, count)
        if found is None:
            return None
        near, at = found, found[0]
        counted = None
        for within_s in (np.inf, *NEAR_S):  # others that follow hide what this one is
            counted = _counted(search, stretch, white, peak, at, count, within_s)
            if counted is not None:
                break
        if counted is None:
            return None
        if peak.cause == JUMP and within_s > NEAR_S[-1]:
            # what lies next to it says what it is, all else what it adds up to with others
            here = _counted(search, stretch, white, peak, at, count, NEAR_S[-1])
            counted = here if here is not None and here[0] != counted[0] else counted
        if np.isfinite(within_s) and mixed and peak.cause == JUMP:
            speed = float(np.gradient(model[at - 1 : at + 2])[1])
            missing = round(count * STEP_UM / speed) if speed else 0
            rival = missing > 0 and _counted(
                search, stretch, white, replace(peak, cause=DROP), at, missing, within_s
            )
            if rival and rival[1] > counted[1]:
                return None
        count, gained = counted
    if (group.repeats < 2 or peak.cause == JUMP) and near[3] < CLEAR:
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
    path = path_of(search, peak, count)[stretch.begin : stretch.end]
    after = np.arange(path.size) >= at - stretch.begin
    wide = 2 + int(WIDE * abs(count))
    within = within_s * search.groups.rate
    if peak.cause == DROP and abs(count) > MANY:  # where it goes on at the end nobody has seen
        within = min(within, stretch.end - at - abs(count) - wide)
    if within < (LEAST if peak.cause == DROP else ENOUGH):
        return None
    near = white.near(at, within)
    seen = near(search.own(stretch, peak.row))
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
