"""Breaks of recordings of one drive, by how these differ from each other once all are mended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.holds import losses_between_holds
from piezo_rig.diagnosis.early.mended import DROP, Break, mended
from piezo_rig.diagnosis.early.peaks import left_of, search_of
from piezo_rig.diagnosis.early.shifted import differing, plain_loss
from piezo_rig.diagnosis.early.traces import Stretch
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
PLAIN = 8  # losses of one drive that may be plain to see
LESS, SAME = 0.3, 1.05  # what they may leave of what others do; the same, where they are fewer
IN_HOLDS = 0.95  # what those of a drive that holds may leave of what others do


def of_repeats(
    groups: Groups, predicted: list[FloatArray], found: list[Stretch], breaks: list[Break],
    sweeps: Sequence[Sweep], g: int, level: float,
) -> list[Break]:  # fmt: skip
    """Breaks with others of one drive, where its recordings ask for them.

    Parameters
    ----------
    predicted : of every group, shape (n,), um
    found : the stretches that were searched
    breaks : of all groups, as they were found one by one
    g : number of the group
    level : chance of a false alarm
    """
    others = [b for b in breaks if b.group != g]

    def borne_out(mine: Sequence[Break]) -> list[Break] | None:
        """Losses with the chance of each, by what is then left as noise; None if one may be chance.
        """
        whole = mended(groups, predicted, [*others, *mine])
        quiet = search_of(whole, predicted, found, [*others, *mine], sweeps)
        kept = []
        for loss in mine:
            rest = mended(groups, predicted, [*others, *(b for b in mine if b is not loss)])
            chance = quiet.chance(left_of(replace(quiet, groups=rest), g) - left_of(quiet, g))
            if chance >= level:
                return None
            kept.append(replace(loss, p_value=chance))
        return kept

    def left(tried: Sequence[Break]) -> float:
        return differing(mended(groups, predicted, list(tried)).groups[g])

    if groups.groups[g].repeats < 2:
        return breaks
    before, known = left(breaks), len(breaks) - len(others)
    mine = _plain(groups, predicted, others, sweeps, g)
    after = left([*others, *mine]) if mine else np.inf
    if after <= LESS * before or (after <= SAME * before and len(mine) < known):
        kept = borne_out(mine)
        if kept is not None:
            breaks, before = [*others, *kept], after
    mine = losses_between_holds(groups.groups[g], g, predicted[g], sweeps)
    if mine and left([*others, *mine]) < IN_HOLDS * before:
        kept = borne_out(mine)
        if kept is not None:
            breaks = [*others, *kept]
    return _lasting(breaks, g, left)


def _plain(
    groups: Groups, predicted: list[FloatArray], others: Sequence[Break],
    sweeps: Sequence[Sweep], g: int,
) -> list[Break]:  # fmt: skip
    """The losses of a drive as its recordings show them laid over each other."""
    mine: list[Break] = []
    while len(mine) < PLAIN:
        whole = mended(groups, predicted, [*others, *mine])
        loss = plain_loss(whole.groups[g], g, sweeps, mine)
        if loss is None:
            break
        mine.append(loss)
    return mine


def _lasting(
    breaks: list[Break], g: int, left: Callable[[Sequence[Break]], float]
) -> list[Break]:
    """Breaks without losses of a drive after whose repair its recordings differ by more.

    A step of a few nm, up and down again at random, looks like a loss for as long as the velocity
    stays what it is; what follows then no longer fits.
    """
    here = left(breaks)
    while losses := [b for b in breaks if b.group == g and b.cause == DROP]:
        less = [[b for b in breaks if b is not loss] for loss in losses]
        worth = [left(tried) for tried in less]
        k = int(np.argmin(worth))
        if worth[k] >= here:
            break
        breaks, here = less[k], worth[k]
    return breaks
