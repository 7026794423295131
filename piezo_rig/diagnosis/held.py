"""What a model that is held fixed may be wrong by without anything being wrong.

A model that is refitted follows any memoryless bend with its powers and any density of thresholds
with its tables; both are projected off. A given model follows nothing, or nothing could be said
of a gain or a sensitivity. But whoever identified it without a bend fitted the bend as well as
springs and sliders can: what is left of a bend after that is what may be wrong, and no more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis import basis, dictionary
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.linear import Fixed, Piece
from piezo_rig.diagnosis.masks import runs
from piezo_rig.identification.data import Data, Track
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
RIDGE = 1e-8  # of the scaled Gram matrix
BEYOND = 0.02  # of the range of a model's drives: others that go further
SHORTEST, SAME = 8, 0.25  # samples of a stretch; of that, by which half loops go as far
SPARE = 2.0  # times what a model was off by itself; beyond that, what is wrong with it is news


def own_um_of(model: Model, groups: Groups) -> float:
    """How far off a given model was where it was identified; unbounded where it does not say.

    What it was off by for drives that went further than all others counts where these do.
    """
    return _own_um(model.provenance, _further(model, groups))


def best_um_of(model: Model, groups: Groups) -> float:
    """The same, with its bend beside it where that was nearer."""
    bent, further = model.provenance.get("bent"), _further(model, groups)
    beside = _own_um(bent, further) if isinstance(bent, dict) else np.inf
    return min(_own_um(model.provenance, further), beside)


def _own_um(said: Mapping[str, Any], further: bool) -> float:
    own = said.get("rms_nm") if further else said.get("within_nm", said.get("rms_nm"))
    return 1e-3 * float(own) if isinstance(own, int | float) and own > 0 else np.inf


def _further(model: Model, groups: Groups) -> bool:
    """Whether a drive goes beyond those that a model was identified from, if it says which."""
    ends = _ends_v(model)
    return ends is None or any(_beyond(g.drive_v, ends) for g in groups.groups)


def within_its_drives(sweeps: Sequence[Sweep], model: Model) -> tuple[list[Sweep], list[str]]:
    """Recordings that go no further than those a given model was identified from, and what is to
    be said of the others.

    What its elements do beyond is not known, and would be named as something new. All of them
    where none stays within, or where one carries on from another.
    """
    ends = _ends_v(model)
    if ends is None or any(s.history != "virgin" for s in sweeps):
        return list(sweeps), []
    beyond = [_beyond(s.drive_v, ends) for s in sweeps]
    if all(beyond) or not any(beyond):
        return list(sweeps), []
    names = list(dict.fromkeys(
        s.condition or s.name for s, out in zip(sweeps, beyond, strict=True) if out
    ))  # fmt: skip
    return [s for s, out in zip(sweeps, beyond, strict=True) if not out], [
        f"left out: {', '.join(names)}: they go beyond the {ends[0]:.4g} to {ends[1]:.4g} V that "
        "the given model was identified from, where it says nothing; identify it again with them"
    ]


def within_its_first_rise(data: Data, model: Model) -> tuple[Data, list[str]]:
    """Recordings without what is further up a first rise than a given model knows one, and what is
    to be said of it.

    A model of later branches alone knows a first rise of half their volts. What is above has an own
    offset, and is looked at from the turning point on.
    """
    known = model.provenance.get("known_v")
    most = known.get("first_rise") if isinstance(known, Mapping) else None
    if not isinstance(most, int | float) or isinstance(most, bool) or not most > 0:
        return data, []
    tracks = tuple(_up_to(track, float(most)) for track in data.tracks)
    cut = sum(new is not old for new, old in zip(tracks, data.tracks, strict=True))
    if not cut:
        return data, []
    return replace(data, tracks=tracks), [
        f"first rises of {cut} recordings are compared up to {most:.4g} V only: further up the "
        "given model does not know any; if the recordings that it is from began virgin, identify "
        "it again with --history virgin"
    ]


def _up_to(track: Track, most_v: float) -> Track:
    """Without stretches where a virgin actuator is further from where it began than in any half
    loop before, and than so many volts.
    """
    if not track.virgin:
        return track
    away, room = np.abs(track.drive_v - track.drive_v[0]), BEYOND * float(np.ptp(track.drive_v))
    starts = track.loops.start
    own = np.searchsorted(starts, np.arange(away.size), side="right") - 1
    before = np.maximum.accumulate(away)[starts][np.maximum(own, 0)]
    further = (away > most_v) & (away > before + SAME * room)
    if not np.any(away[further] > most_v + room):
        return track
    kept = [
        (a + i, a + j, unit)
        for (a, b), unit in zip(track.blocks, track.unit, strict=True)
        for i, j in runs(~further[a:b])
        if j - i >= SHORTEST and float(np.ptp(track.drive_v[a + i : a + j])) > room
    ]
    if not kept:
        return track
    return replace(
        track, blocks=tuple((a, b) for a, b, _ in kept), unit=tuple(unit for *_, unit in kept)
    )


def _ends_v(model: Model) -> tuple[float, float] | None:
    """Lowest and highest drive that a model was identified from; None where it does not say."""
    ends = model.provenance.get("drive_v")
    if not (isinstance(ends, list) and len(ends) == 2):
        return None
    if not all(isinstance(v, int | float) for v in ends):
        return None
    return float(ends[0]), float(ends[1])


def _beyond(drive_v: FloatArray, ends: tuple[float, float]) -> bool:
    low, high = ends
    room = BEYOND * (high - low)
    return bool(np.min(drive_v) < low - room or np.max(drive_v) > high + room)


def bends_left(
    groups: Groups, driven: Sequence[Group], model: Model, scales: Scales
) -> list[FloatArray]:
    """Powers of the drive less the best that the model's tables can make of them.

    Parameters
    ----------
    driven : the groups with the drive that reaches the actuator

    Returns
    -------
    per group, shape (powers, thinned samples)
    """
    bends = [groups.thinned(g, dictionary.powers(g, scales)) for g in driven]
    bands = [groups.thinned(g, basis.bands(model, g)) for g in groups.groups]
    gram = cross = np.zeros(0)
    for k, g in enumerate(groups.groups):
        for (a, b), cells in zip(groups.edges(g), groups.cells(g), strict=True):
            x, y = cells.centred(bands[k][:, a:b]), cells.centred(bends[k][:, a:b])
            more = g.repeats * x @ x.T, g.repeats * x @ y.T
            gram, cross = more if not gram.size else (gram + more[0], cross + more[1])
    size = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    ridged = gram * np.outer(size, size) + RIDGE * np.eye(size.size)
    shares = size[:, None] * np.linalg.solve(ridged, size[:, None] * cross)
    return [y - shares.T @ x for x, y in zip(bands, bends, strict=True)]


def most(
    pieces: Sequence[Piece], fixed: Sequence[Fixed],
    counts: tuple[int, int, int], own_um: float,
) -> tuple[float, float]:  # fmt: skip
    """Variances at which fine thresholds, and the dictionary, are as wrong as may be.

    Parameters
    ----------
    counts : of powers, fine thresholds and the dictionary in ``fixed``
    own_um : how far off the model was where it was identified, rms; infinite where not known
    """
    if not np.isfinite(own_um):
        return np.inf, np.inf
    bends, fine, _ = counts
    square, count = np.zeros(2), 0.0
    for piece, columns in zip(pieces, fixed, strict=True):
        rows = np.sum(np.square(columns.raw, dtype=float), axis=1)
        square += rows[bends : bends + fine].sum(), rows[bends + fine :].sum()
        count += float(piece.cells.share.sum())
    out = (SPARE * own_um) ** 2 * count / np.maximum(square, 1e-300)
    return float(out[0]), float(out[1])
