"""Lost samples by all that follows them: the way that was played, and where they were lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.guesses import CLEAR
from piezo_rig.diagnosis.early.mended import DROP
from piezo_rig.diagnosis.early.peaks import Peak, Search
from piezo_rig.diagnosis.early.traces import Stretch, Whitened, way

FloatArray = NDArray[np.float64]
BY_ALL = 300.0  # log-likelihood of a loss that the place itself need not show
ABOUT_S, EVERY = 0.12, 8  # to either side of a peak; samples between instants that are tried
MANY = 10  # lost samples, from which on the model does not know the way well enough


def path_of(search: Search, peak: Peak, count: int) -> FloatArray:
    """The way that was played, shape (n,): of many samples the other recordings know it better
    than the model, but for their noise.
    """
    stretch = search.stretches[peak.stretch]
    group, model = search.groups.groups[stretch.group], search.predicted[stretch.group]
    if group.repeats < 2:
        return model
    others = np.delete(group.measured_um, peak.row, axis=0).mean(axis=0)
    if abs(count) > MANY and peak.cause == DROP:
        return np.asarray(others)
    cut = slice(stretch.begin, stretch.end)
    return np.asarray(np.polyfit(model[cut], others[cut], 1)[0] * model)


def by_all_that_follows(
    search: Search, stretch: Stretch, white: Whitened, peak: Peak, at: int, count: int
) -> tuple[int, int, int, float] | None:  # fmt: skip
    """As `placed`, of a loss where the drive stands still for a moment: it begins as a kink does,
    and only what comes later says that it is none.
    """
    path = way(path_of(search, peak, count)[stretch.begin : stretch.end], count)
    whole = white.near(at, np.inf)
    seen = whole(search.own(stretch, peak.row))
    wide = round(ABOUT_S * search.groups.rate)
    begin = max(at - wide, stretch.begin + 1)
    tried = np.arange(begin, min(at + wide, stretch.end), EVERY)
    samples, worth = np.arange(stretch.begin, stretch.end), np.zeros(tried.size)
    for k, instant in enumerate(tried):
        template = whole(stretch.thinned((samples >= instant) * path))
        worth[k] = template @ seen - 0.5 * template @ template
    best = int(np.argmax(worth))
    along = (samples - samples[0]) / samples.size
    always = np.array([whole(stretch.thinned(x)) for x in (path, along * path)])
    clock = always @ seen  # a delay, and one that grows
    rival = 0.5 * float(clock @ np.linalg.pinv(always @ always.T, hermitian=True) @ clock)
    if not 0 < best < tried.size - 1 or worth[best] < max(BY_ALL, rival + CLEAR):
        return None
    good = tried[worth > worth[best] - CLEAR]
    return int(tried[best]), int(good[0]), int(good[-1]), float(worth[best])
