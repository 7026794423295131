"""Where in the recordings a break is likeliest, about, for every kind of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.chances import normal_above
from piezo_rig.diagnosis.early.mended import DROP, JUMP, STEP_UM, Break
from piezo_rig.diagnosis.early.traces import Stretch, Whitened, own_part, spectrum
from piezo_rig.diagnosis.flats import bridged, standing
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.noise import Whitener
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
GRID = 96  # instants at which the size of a signature is computed; between them it is smooth
EDGE = 0.02  # of its largest size that a signature must have left off what the nuisance can do
FINE = 0.35  # standard error, in steps or samples, with which whole numbers can be told apart
PLAIN = 12.0  # standard errors, from which on a break is plain
PART = 0.3  # of a step or sample
CORNER_S = 0.01  # so near to a turning point a model may be wrong by as much
CORNER = 0.2  # but no more than this share of a usual half loop
BEGIN, END = 2, 20  # thinned samples; where the drive ends, lost samples show no velocity


@dataclass(frozen=True)
class Peak:
    """A break about where it is; ``count`` has a sign for jumps."""

    cause: str
    stretch: int
    row: int
    at: int  # full-rate sample of the mended record
    count: int
    gained: float  # log-likelihood


@dataclass(frozen=True, eq=False)
class Search:
    """One round: the recordings, mended as far as is known."""

    groups: Groups
    predicted: list[FloatArray]
    stretches: list[Stretch]
    white: list[Whitened]
    breaks: list[Break]
    sweeps: Sequence[Sweep]
    tried: int  # instants

    def chance(self, gained: float) -> float:
        """Of as much by noise at any of the instants, for either cause."""
        return min(1.0, 4.0 * self.tried * normal_above(float(np.sqrt(2.0 * max(gained, 0.0)))))

    def own(self, stretch: Stretch, row: int) -> FloatArray:
        """What a recording has of its own in a stretch, thinned."""
        return stretch.thinned(self.whole(stretch.group, row)[stretch.begin : stretch.end])

    def whole(self, g: int, row: int) -> FloatArray:
        """What a recording has of its own, shape (n,), but for where the sensor ends."""
        own = own_part(self.groups.groups[g], row, self.predicted[g])
        return bridged(own, self.standing[g])

    @cached_property
    def standing(self) -> list[NDArray[np.bool_]]:
        """Of every group, where the sensor ends, shape (n,)."""
        return [standing(g) for g in self.groups.groups]


def search_of(
    groups: Groups, predicted: list[FloatArray], found: list[Stretch], breaks: list[Break],
    sweeps: Sequence[Sweep],
) -> Search:  # fmt: skip
    """The recordings as far as they are mended, and the noise that they then have."""
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


def left_of(search: Search, g: int, of: int | None = None) -> float:
    """What recordings of one drive have of their own, as a negative log-likelihood.

    ``of`` : the only stretch of it that counts
    """
    out, repeats = 0.0, search.groups.groups[g].repeats
    for k, stretch in enumerate(search.stretches):
        if stretch.group == g and of in (None, k):
            own = [search.white[k].project(search.own(stretch, row)) for row in range(repeats)]
            out += 0.5 * float(sum(x @ x for x in own)) / max(repeats - 1, 1)
    return out


def find_peaks(search: Search) -> list[Peak]:
    """The likeliest break of each kind in every stretch of every recording."""
    out = []
    for k, (stretch, white) in enumerate(zip(search.stretches, search.white, strict=True)):
        group = search.groups.groups[stretch.group]
        sizes = _sizes(white)
        away = _away(group.time_s, group.drive_v, stretch) if group.repeats < 2 else None
        for row in range(group.repeats):
            back = white.back(white.project(search.own(stretch, row)))
            for (cause, template), size in zip(_templates(stretch), sizes, strict=True):
                usable = np.ones(size.size, bool) if away is None or cause == JUMP else away
                peak = _best(cause, k, row, back * template, size, usable, stretch)
                if peak is not None:
                    out.append(peak)
    return out


def find_pair(search: Search, k: int) -> Peak | None:
    """The first of two lost samples of a stretch, one in each of its two recordings.

    Between the two the recordings are one sample apart, and then no longer: neither shows as a
    break that lasts.
    """
    stretch, white = search.stretches[k], search.white[k]
    m = stretch.velocity.size
    at = np.unique(np.linspace(1, m - 2, GRID).astype(int))
    lost = white.project((np.arange(m) >= at[:, None]) * stretch.ways[0])
    number = lost @ white.project(search.own(stretch, 0))
    gram = lost @ lost.T
    size = np.diag(gram)
    apart = size[:, None] + size - 2.0 * gram  # squared size of a loss at a row, mended at a column
    later = np.triu(apart > max(EDGE * float(size.max()), FINE**-2), 1)
    share = np.where(later, (number[:, None] - number) / np.maximum(apart, 1e-300), 0.0)
    gained = np.where(np.abs(share) > PART, 0.5 * share**2 * apart, 0.0)
    first = int(np.argmax(gained.max(axis=1)))
    best = float(gained[first].max())
    if best <= 0.0:
        return None
    row = 0 if share[first, int(np.argmax(gained[first]))] > 0 else 1
    return Peak(DROP, k, row, stretch.begin + int(at[first]) * stretch.factor, 1, best)


def _templates(stretch: Stretch) -> list[tuple[str, FloatArray]]:
    """What one step, and one lost sample (of few or many), add from an instant on; um."""
    step = np.full(stretch.velocity.size, STEP_UM)
    return [(JUMP, step), *((DROP, way) for way in stretch.ways)]


def _sizes(white: Whitened) -> list[FloatArray]:
    """Squared size of the signature of every instant, off the nuisance; shape (m,) each."""
    m = white.stretch.velocity.size
    at = np.unique(np.linspace(1, m - 2, GRID).astype(int))
    after = np.arange(m) >= at[:, None]
    out = []
    for _, template in _templates(white.stretch):
        seen = white.project(after * template.astype(np.float32))  # of a size, digits enough
        out.append(np.interp(np.arange(m), at, np.einsum("ij,ij->i", seen, seen)))
    return out


def _away(time: FloatArray, drive: FloatArray, stretch: Stretch) -> NDArray[np.bool_]:
    """Which thinned samples lie away from every turning point; shape (m,)."""
    cut = slice(stretch.begin, stretch.end)
    way = np.sign(np.gradient(drive[cut]))
    corner = np.append(np.diff(way) != 0, False)
    half = max(1, round(CORNER_S / max(float(np.median(np.diff(time[cut]))), 1e-12)))
    turned = np.flatnonzero(corner)
    if turned.size > 1:
        half = max(1, min(half, round(CORNER * float(np.median(np.diff(turned))))))
    near = np.convolve(corner, np.ones(2 * half + 1), mode="same") > 0
    return stretch.thinned(near.astype(float)) == 0.0


def _best(
    cause: str, k: int, row: int, shares: FloatArray, size: FloatArray,
    usable: NDArray[np.bool_], stretch: Stretch,
) -> Peak | None:  # fmt: skip
    number = np.cumsum(shares[::-1])[::-1]
    share = number / np.maximum(size, 1e-300)
    if cause == DROP:
        share = np.maximum(share, 0.0)  # samples can be lost, not won
    # of many it is plain that there are some before it is how many
    told = (size > FINE**-2) | (share**2 * size > PLAIN**2)
    usable = usable & (size > EDGE * float(size.max())) & told
    usable[:BEGIN] = usable[-END:] = False
    if not usable.any():
        return None
    # an instant inside a thinned sample shows as two parts of a step
    gained = np.where(usable & (np.abs(share) > PART), 0.5 * share**2 * size, 0.0)
    best = int(np.argmax(gained))
    if gained[best] <= 0.0:
        return None
    count = int(np.sign(share[best]) * max(1.0, np.rint(np.abs(share[best]))))
    at = stretch.begin + best * stretch.factor
    return Peak(cause, k, row, at, count, float(gained[best]))
