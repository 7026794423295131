"""A fit with many bands, tied to their neighbours: what noisy data get unless `elements` is given.

How strongly they are tied is learnt from the data themselves (`smooth`): noise that tells little
makes a smooth curve of few effective elements, good data a detailed one.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import HalfLoops
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data, Track
from piezo_rig.identification.folds import Folds
from piezo_rig.identification.normal import Normal, Piece, finer, normal_equations
from piezo_rig.identification.polish import polish
from piezo_rig.identification.smooth import Prior, learnt
from piezo_rig.identification.solve import solve_bounded
from piezo_rig.identification.uncertainty import linearised, spread, units

FloatArray = NDArray[np.float64]
STIFFER = tuple(4.0**i for i in range(1, 9))
SOFTER = tuple(0.25**i for i in range(1, 9))
WORSE = 1.001  # held-out rms that differs by less does not differ
# of the first break, as shares of a coarse fit's, each with the width of the band after it: the
# objective has local minima about a band apart, and another one wherever bands begin elsewhere
STARTS = ((0.7, 0.6), (0.84, 0.8), (1.0, 1.0), (1.0, 0.5), (1.2, 0.7), (1.4, 0.9))
# by how much their log likelihoods are divided: those of grids that are all a little wrong tell
# less than they would of the truth (divided by 1, 80-90 % of the slopes' intervals cover)
TEMPER = 4.0
FINE_PIECES = 60  # into which data are cut for their uncertainty
NOISE = 1e-10  # of the travel: no data are better
TURNS = 8  # half loops of a condition with which first breaks are tried
ALIKE = 0.02  # of the largest: half loops whose drive changes differ by less are the same


def tied_linear(
    data: Data, start: Curves, pieces: tuple[Piece, ...], folds: Folds, floor: float
) -> tuple[FloatArray, Prior, Normal]:
    """Compliances (no laws) at the break points of ``start``, shape (p,), and what ties them.

    Also the normal equations, by the pieces of which uncertainty is made.
    """
    fine, owner = finer(data, pieces, FINE_PIECES)
    normal = normal_equations(data, start, fine)
    prior = prior_of(data, start, normal, np.zeros(normal.right.shape[1]))
    gram, right = normal.gram.sum(axis=0), normal.right.sum(axis=0)
    prior = weighed(prior, normal.joined(owner, pieces), folds)
    gram += prior.penalty(right.size)
    return solve_bounded(gram, right, start.bounded(False), floor), prior, normal


def beginnings(data: Data) -> Data:
    """The first half loops of tracks that go on repeating them."""
    return replace(data, tracks=tuple(_beginning(t) for t in data.tracks))


def _beginning(track: Track) -> Track:
    loops = track.loops
    known = int(np.searchsorted(loops.start, track.blocks[0][0]))
    count = known + TURNS
    if len(track.blocks) > 1 or len(track.sweeps) > 1 or len(loops) <= count:
        return track
    span = np.abs(track.drive_v[loops.stop] - track.drive_v[loops.start])
    apart = np.min(np.abs(span[count:, None] - span[known:count]), axis=1)
    end = int(loops.start[count]) + 1
    drive = track.drive_v[:end]
    room = ALIKE * float(np.ptp(track.drive_v))
    begin = track.blocks[0][0]  # what comes before is not fitted, however far it goes
    if np.max(apart) > room or np.ptp(drive[begin:]) < np.ptp(track.drive_v[begin:]) - room:
        return track
    return replace(
        track, drive_v=drive, displacement_um=track.displacement_um[:end], edges=(0, end),
        blocks=((track.blocks[0][0], end),),
        loops=HalfLoops(*(getattr(loops, f.name)[:count] for f in fields(loops))),
    )  # fmt: skip


def prior_of(data: Data, curves: Curves, normal: Normal, about: FloatArray) -> Prior:
    """What ties the compliances; ``about`` (p,): where ``normal.power`` is the sum of squares."""
    gram, right = normal.gram.sum(axis=0), normal.right.sum(axis=0)
    owner, _ = units(data, normal)
    found = spread(normal, about, owner)
    noise = max(found.variance, (NOISE * data.travel_um) ** 2)
    return learnt(gram, right, noise, curves.runs(), curves.pack(False))


def weighed(prior: Prior, normal: Normal, folds: Folds) -> Prior:
    """With the penalty that held-out data like best, where that is clearly not the likeliest one.

    Where the model itself is wrong, conditions disagree by more than noise, and likelihood, which
    takes all of that for noise, smooths away detail that they share.
    """
    if not folds.groups or folds.levels:  # nothing is held out that noise would not be
        return prior
    size = normal.right.shape[1]
    first = folds.tied_power(normal, prior.penalty(size))
    best, least = prior, first
    for ladder in (SOFTER, STIFFER):
        error = first
        for weight in ladder:
            tried = replace(prior, weight=weight)
            value = folds.tied_power(normal, tried.penalty(size))
            if value * WORSE**2 >= error:
                break
            error = value
            if value < least:
                best, least = tried, value
    return best


def tied_with_laws(
    data: Data, few: Data, curves: Curves, start: Curves, prior: Prior, folds: Folds,
    pieces: tuple[Piece, ...], few_pieces: tuple[Piece, ...],
) -> tuple[Curves, Prior]:
    """Laws and first break fitted as well.

    Parameters
    ----------
    data, pieces : everything
    few, few_pieces : one repeat, on which the fit is made before it sees everything
    curves : a tied fit without laws, and with what ties it (``prior``)
    start : a fit of few elements with the laws
    """
    tries = []
    for share, phase in STARTS:
        tried = _refined(curves, start, share, phase)
        own = replace(prior, runs=tried.runs()[-len(prior.runs) :])
        tries.append(polish(few, tried, few_pieces, False, steps=12, enough=1e-5, prior=own))
    tries.sort(key=lambda t: t[1])
    curves = tries[0][0]
    fine, owner = finer(data, pieces, FINE_PIECES)
    x, normal = curves.pack(False), linearised(data, curves, fine)
    prior = prior_of(data, curves, normal, x)
    residual = replace(normal, right=normal.right - normal.gram @ x)
    power = residual.power + (normal.right + residual.right) @ x
    prior = weighed(prior, replace(normal, power=power).joined(owner, pieces), folds)
    n0 = curves.first_c.size
    owned, _ = units(data, normal)
    law_rows = np.eye(x.size)[n0 + 1 : n0 + curves.q]
    noise = max(spread(normal, x, owned).variance_along(law_rows), prior.noise)
    errors = np.array([value for _, value in tries])
    weights = np.exp(-0.5 / TEMPER * few.samples * (errors**2 - errors[0] ** 2) / noise)
    weights /= weights.sum()
    others = tuple((float(w), c) for w, (c, _) in zip(weights, tries, strict=True))
    curves, _ = polish(data, curves, pieces, knots=False, prior=prior)
    return curves, replace(prior, others=others)


def _refined(curves: Curves, start: Curves, share: float, phase: float) -> Curves:
    """Bands of ``curves`` with laws and values of ``start``, its first break moved by a share.

    ``phase``: width of the first band after it, as a share of the others.
    """
    begin = share * float(start.later_knots[0])
    width = float(curves.later_knots[0])
    bands = max(2, int(np.ceil(curves.later_c.size - begin / width)))
    knots = begin + width * np.arange(float(bands))
    knots[1:] -= (1.0 - phase) * width
    at = np.searchsorted(start.later_knots, knots + 0.5 * width)
    return replace(
        start,
        first_knots=curves.first_knots,
        first_c=curves.first_c,
        later_knots=knots,
        later_c=np.append(start.later_c[0], start.later_c[np.maximum(at, 1)]),
    )
