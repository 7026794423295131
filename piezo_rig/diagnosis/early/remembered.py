"""Which first rises are none: an actuator that begins at rest may remember an excursion before.

Where nothing is said of the history, a first cycle that leaves behind what later ones do not is
taken for a first rise (decision 7). A memory of nearly all that is played then does that too, and
would be an initiation curve. One number says all of such a memory, how far the excursion went; an
initiation curve has a table. What lies beyond the excursion, later branches do not know: a memory
of much less than the drive is not recognised.

Of a sitting in which everything is played twice, only the first recording of all begins at rest.
It is compared with its repeat, and used from where both have the same memory. Where both begin
alike, they remember the same: a drift that settles leaves something behind in a first cycle too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.grouping import group_tracks, same_drive
from piezo_rig.errors import InputError
from piezo_rig.identification import prepare
from piezo_rig.identification.data import Data, Track
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
EXCURSIONS = np.linspace(0.04, 1.0, 25)  # of the largest drive from where it begins
BETWEEN = np.linspace(-0.875, 0.875, 15)  # of a step between those
EXPLAINED = 1.5  # misfit of such a beginning, of the misfit further on, at most
NEARLY_ALL, HARDLY_ANY = 0.9, 0.1  # of all that is played; of the misfit of a virgin beginning
PARTLY = np.linspace(0.9, 0.3, 13)  # of all that is played, as far as an excursion may have gone
APART = 3.0  # times what repeats differ by further on
SUDDEN = 0.3  # of the whole difference, within four samples: damage
STEEP, RINGS = 0.02, 500  # of the drive's span, within those: an edge of it; samples it rings for
REMEMBERS = "as after an earlier excursion that was not recorded"
AMONG = "it comes after others, most of which begin with a memory"
AFTER = "it comes after one that remembers an earlier excursion"
UNLIKE = "a repeat of it begins otherwise and goes on alike"
ALIKE = "a repeat of it that remembers what was before begins as it does"
WORSE = 2.0  # misfit of a virgin beginning, of that


def without_remembered(data: Data, sweeps: Sequence[Sweep], point: Point) -> Data:
    """The data, with beginnings that a memory explains not taken for first rises.

    ``point`` : the baseline to begin with. Of a model that is given, or that has an own curve for
    the first rise, nothing is asked
    """
    unlike: dict[str, str] = {}
    while True:  # one that comes after others may be the repeat that another is compared with
        guessed = [t for t in data.tracks if t.virgin and sweeps[t.sweeps[0]].history != "virgin"]
        guessed = [t for t in guessed if sweeps[t.sweeps[0]].name not in unlike]
        found = {
            sweeps[t.sweeps[0]].name: UNLIKE for t in guessed
            if any(_differs(t, o) for o in data.tracks if not o.virgin and same_drive(t, o, sweeps))
        }
        found |= _among(data, sweeps, [t for t in guessed if sweeps[t.sweeps[0]].name not in found])
        found |= {
            sweeps[t.sweeps[0]].name: ALIKE for t in guessed
            if sweeps[t.sweeps[0]].name not in found and any(
                _begins_alike(t, o)
                for o in data.tracks if not o.virgin and same_drive(t, o, sweeps)
            )
        }
        if not found:
            break
        unlike |= found
        data = prepare(sweeps, first_rises=True, clipped=True, not_from_rest=unlike)
    if not guessed or point.fixed or point.has_first_rise:
        return data
    names = unlike | {sweeps[t.sweeps[0]].name: REMEMBERS for t in guessed}
    try:
        settled = prepare(sweeps, first_rises=True, clipped=True, not_from_rest=names)
        groups = group_tracks(settled, sweeps)
        low = min(float(g.drive_v.min()) for g in groups.groups)
        model = point.model.with_stage(Bend.none(low, groups.span_v))
        model = plainly(groups, Point(model, (), point.sizes)).point.model
    except InputError:  # too little is left without the beginnings
        return data
    known = {t.sweeps: t for t in settled.tracks}
    kept = {
        sweeps[t.sweeps[0]].name: REMEMBERS for t in guessed
        if t.sweeps in known and _remembers(model, t, known[t.sweeps].blocks[0][0])
    }
    kept |= {  # of one drive, and both from rest: they cannot begin otherwise than each other
        sweeps[t.sweeps[0]].name: UNLIKE for t in guessed
        if any(
            o is not t and o.sweeps in known and same_drive(t, o, sweeps)
            and _differs(t, known[o.sweeps]) for o in guessed
        )
    }
    if not kept:
        return data
    left = [t for t in guessed if sweeps[t.sweeps[0]].name not in kept]
    unlike |= _among(data, sweeps, left) | _after(sweeps, left, kept)
    return prepare(sweeps, first_rises=True, clipped=True, not_from_rest=unlike | kept)


def _among(data: Data, sweeps: Sequence[Sweep], guessed: Sequence[Track]) -> dict[str, str]:
    """Those that are taken for first rises where most recordings begin with a memory, but for the
    first of a session, with what says so.

    A drive that lags, or an actuator that creeps, leaves something behind in its first cycle too.
    """
    if 2 * len(guessed) >= len(data.tracks):
        return {}
    begun = min(s.start_time for s in sweeps)
    members = [sweeps[t.sweeps[0]] for t in guessed]
    return {s.name: AMONG for s in members if s.start_time > begun}


def _after(
    sweeps: Sequence[Sweep], guessed: Sequence[Track], known: Mapping[str, str]
) -> dict[str, str]:
    """Those that come after one which remembers an earlier excursion: it is there in them too.

    ``known`` : what says that sweeps begin with a memory, by their names
    """
    begun = min((s.start_time for s in sweeps if known.get(s.name) == REMEMBERS), default=np.inf)
    members = [sweeps[t.sweeps[0]] for t in guessed]
    return {s.name: AFTER for s in members if s.start_time > begun}


def _differs(track: Track, repeat: Track) -> bool:
    """Whether a repeat that begins with a memory begins otherwise, and goes on alike.

    A step in what they differ by is damage, which one of the two has; but not within or
    soon after an edge of the drive, which asks at once for what they remember.
    """
    found = _apart(track, repeat)
    if found is None:
        return False
    early, later = found
    begin = early.size
    steep = np.abs(track.drive_v[4:begin] - track.drive_v[: begin - 4])
    at = np.arange(steep.size)
    edge = np.maximum.accumulate(np.where(steep > STEEP * np.ptp(track.drive_v), at, -RINGS))
    step = float(np.max(np.abs(early[4:] - early[:-4])[at - edge >= RINGS], initial=0.0))
    return bool(np.sqrt(np.mean(early**2)) > APART * later and step < SUDDEN * np.ptp(early))


def _begins_alike(track: Track, repeat: Track) -> bool:
    """Whether a repeat that begins with a memory differs no more at its beginning than later."""
    found = _apart(track, repeat)
    return found is not None and bool(np.sqrt(np.mean(found[0] ** 2)) < APART * found[1])


def _apart(track: Track, repeat: Track) -> tuple[FloatArray, float] | None:
    """What two recordings of one drive differ by, um, up to where the memory of the second is
    known, and from there on, rms; None where too little is on either side.
    """
    n, begin = min(track.drive_v.size, repeat.drive_v.size), repeat.blocks[0][0]
    if not 16 <= begin <= n - 16:
        return None
    off = track.displacement_um[:n] - repeat.displacement_um[:n]
    off -= off[begin:].mean()
    return off[:begin], float(np.std(off[begin:]))


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
    least = min(misfit(x) for x in near + step * BETWEEN)
    # what has been as far as this goes rises as later branches do, whatever they are off by
    if least < EXPLAINED * after or (near > NEARLY_ALL and least < HARDLY_ANY * virgin):
        return True
    return _rises_as_later_ones(model, track, begin, furthest, after)


def _rises_as_later_ones(
    model: Model, track: Track, begin: int, furthest_v: float, after_um: float
) -> bool:
    """Whether it rises as later branches do for a good part of its way, which no virgin one does.

    Up to where an excursion ended that is all there is to it, whatever lies beyond.
    """
    reach = (track.drive_v[:begin] - track.drive_v[0]) / furthest_v
    for share in PARTLY:
        end = int(np.argmax(reach > share))
        if end < 16:
            continue
        part = slice(0, end)
        if _misfit(model, track, furthest_v, part) < EXPLAINED * after_um:
            return _misfit(model, track, 0.0, part) > WORSE * EXPLAINED * after_um
    return False


def _misfit(model: Model, track: Track, excursion_v: float, part: slice) -> float:
    """Rms that is left of a part of a track, after an excursion from where it begins, um."""
    first = track.drive_v[0]
    drive = np.concatenate([[first, first + excursion_v, first], track.drive_v])
    try:
        moved = model.simulate(np.arange(drive.size, dtype=float), drive)[3:]
    except InputError:
        return np.inf
    return float(np.std((track.displacement_um - moved)[part]))
