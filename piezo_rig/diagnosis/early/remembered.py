"""Which first rises are none: an actuator that begins at rest may remember an excursion before.

Where nothing is said of the history, a first cycle that leaves behind what later ones do not is
taken for a first rise (decision 7). A memory of nearly all that is played then does that too, and
would be an initiation curve. One number says all of such a memory, how far the excursion went; an
initiation curve has a table. What lies beyond the excursion, later branches do not know: a memory
of much less than the drive is not recognised.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit
from piezo_rig.errors import InputError
from piezo_rig.identification import prepare
from piezo_rig.identification.data import Data, Track
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
EXCURSIONS = np.linspace(0.04, 1.0, 25)  # of the largest drive from where it begins
BETWEEN = np.linspace(-0.875, 0.875, 15)  # of a step between those
EXPLAINED = 1.5  # misfit of such a beginning, of the misfit further on, at most
WORSE = 2.0  # misfit of a virgin beginning, of that


def without_remembered(data: Data, sweeps: Sequence[Sweep], point: Point) -> Data:
    """The data, with beginnings that a memory explains not taken for first rises.

    ``point`` : the baseline to begin with. Of a model that is given, or that has an own curve for
    the first rise, nothing is asked
    """
    guessed = [t for t in data.tracks if t.virgin and sweeps[t.sweeps[0]].history != "virgin"]
    if not guessed or point.fixed or point.has_first_rise:
        return data
    names = frozenset(sweeps[t.sweeps[0]].name for t in guessed)
    try:
        settled = prepare(sweeps, first_rises=True, clipped=True, not_from_rest=names)
        groups = group_tracks(settled, sweeps)
        low = min(float(g.drive_v.min()) for g in groups.groups)
        model = point.model.with_stage(Bend.none(low, groups.span_v))
        model = refit(plain_space(groups, model), Point(model, (), point.sizes)).point.model
    except InputError:  # too little is left without the beginnings
        return data
    known = {t.sweeps: t for t in settled.tracks}
    kept = [
        sweeps[t.sweeps[0]].name for t in guessed
        if t.sweeps in known and _remembers(model, t, known[t.sweeps].blocks[0][0])
    ]
    if not kept:
        return data
    return prepare(sweeps, first_rises=True, clipped=True, not_from_rest=frozenset(kept))


def _remembers(model: Model, track: Track, begin: int) -> bool:
    """Whether some excursion explains a track up to a sample as well as what follows it."""
    if begin < 16:
        return False
    after = _misfit(model, track, 0.0, slice(begin, None))
    virgin = _misfit(model, track, 0.0, slice(0, begin))
    if virgin < WORSE * after:
        return False
    reach = track.drive_v[:begin] - track.drive_v[0]
    furthest = float(reach[np.argmax(np.abs(reach))])

    def misfit(share: float) -> float:
        return _misfit(model, track, share * furthest, slice(0, begin))

    near = min(EXCURSIONS, key=misfit)
    step = EXCURSIONS[1] - EXCURSIONS[0]
    return min(misfit(x) for x in near + step * BETWEEN) < EXPLAINED * after


def _misfit(model: Model, track: Track, excursion_v: float, part: slice) -> float:
    """Rms that is left of a part of a track, after an excursion from where it begins, um."""
    first = track.drive_v[0]
    drive = np.concatenate([[first, first + excursion_v, first], track.drive_v])
    try:
        moved = model.simulate(np.arange(drive.size, dtype=float), drive)[3:]
    except InputError:
        return np.inf
    return float(np.std((track.displacement_um - moved)[part]))
