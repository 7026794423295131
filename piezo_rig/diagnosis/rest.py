"""What nobody has a name for: looks at what is left, of which none needs to know of another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from piezo_rig.diagnosis.bands import Band, shared_band
from piezo_rig.diagnosis.bursts import Bursts, bursts
from piezo_rig.diagnosis.early import find_line
from piezo_rig.diagnosis.early.lines import Line
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.in_turns import InTurns
from piezo_rig.diagnosis.levels import Levels, levels
from piezo_rig.diagnosis.ripples import AnyRipple, find_drive_ripple, find_ripple
from piezo_rig.diagnosis.rungs import Rung, by_laws_nm
from piezo_rig.diagnosis.scan import LEVEL
from piezo_rig.diagnosis.slips import Slips, open_nm, slips
from piezo_rig.diagnosis.unexplained import (
    Unexplained,
    unexplained,
    with_band,
    with_bursts,
    with_drifting,
    with_gain,
    with_levels,
    with_line,
    with_ripple,
    with_slips,
    with_wandering,
)
from piezo_rig.diagnosis.unsteady import Unsteady, unsteady_cycles
from piezo_rig.diagnosis.wandering import AGEING, WANDERS, wandering
from piezo_rig.diagnosis.warming import Drifting, drifting


class Seen(NamedTuple):
    """What the looks find. ``line`` stands with a ripple, if that was looked for; ``of_cycles`` is
    a gain that wanders (share, nm) where ageing was refused for that.
    """

    line: tuple[Line | None, AnyRipple | None]
    gain: Unsteady | None
    of_cycles: Unsteady | tuple[float, float] | None
    drifting: Drifting | None
    bursts: Bursts | None
    levels: Levels | None
    slips: tuple[Slips | None, float]
    band: Band | None


def looks(
    turns: InTurns, clean: Groups, refused: Mapping[str, str]
) -> list[Callable[[], object]]:
    """One for each of `Seen`, which may be done in any order.

    Parameters
    ----------
    clean : the recordings, on the scale of those that the ladder was climbed on
    refused : causes that were not taken in, with the reason
    """
    space, last = turns.search.space, turns.search.ladder.last
    model = last.point.model

    def line() -> tuple[Line | None, AnyRipple | None]:
        found = find_line(clean, model)
        # a ripple is a line at one speed
        if turns.aside is None and (found is None or found.p_value > LEVEL):
            return found, find_ripple(clean, model) or find_drive_ripple(clean, model)
        return found, turns.aside

    def of_cycles() -> Unsteady | tuple[float, float] | None:
        if refused.get(AGEING) == WANDERS:
            return wandering(space, last)
        return unsteady_cycles(space.groups, space.whitener, model)

    def apart() -> Drifting | None:
        once = [g.at_one_time(model) for g in space.groups.groups]
        return drifting(space.groups.with_(once), model)

    return [
        line,
        lambda: turns.search.unsteady(space.groups),
        of_cycles,
        apart,
        lambda: bursts(space.groups, model),
        lambda: levels(clean),
        lambda: (slips(space, last), open_nm(space, last)),
        lambda: shared_band(clean, model),
    ]


def rest_of(turns: InTurns, clean: Groups, rungs: Sequence[Rung], seen: Seen) -> Unexplained:
    """The verdict, with all that was seen."""
    search = turns.search
    space, last, floor = search.space, search.ladder.last, search.floor_nm
    left_nm = rungs[-1].rms_nm
    noise_nm = floor or min(left_nm, space.sample_noise_nm)
    rest = unexplained(space, last, noise_nm, by_laws_nm(rungs), turns.rng, left_nm)
    line, ripple = seen.line
    rest = with_line(rest, line, floor, _frequencies(clean))
    rest = with_ripple(rest, ripple, floor or space.sample_noise_nm)
    rest = with_gain(rest, seen.gain, floor or 0.0, by_laws_nm(rungs, AGEING))
    if isinstance(seen.of_cycles, tuple):
        rest = with_wandering(rest, *seen.of_cycles)
    else:
        rest = with_gain(rest, seen.of_cycles, noise_nm, by_laws_nm(rungs, AGEING), "cycles")
    rest = with_drifting(rest, seen.drifting)
    if seen.bursts is not None and not seen.bursts.all_at(_happened(turns)):
        rest = with_bursts(rest, seen.bursts, floor)
    rest = with_levels(rest, seen.levels)
    rest = with_slips(rest, seen.slips[0], noise_nm, seen.slips[1])
    return with_band(rest, seen.band, noise_nm)


def _happened(turns: InTurns) -> list[tuple[str, float]]:
    """Condition and seconds since its begin, of jumps and lost samples that were found."""
    groups = turns.raw.groups
    return [
        (groups[b.group].condition, b.index / turns.raw.rate)
        for early in turns.early for b in early.breaks
    ]  # fmt: skip


def _frequencies(groups: Groups) -> list[float]:
    """Of the drives, Hz: what most half loops are half a period of."""
    halves = [(g.time_s[g.loops.stop] - g.time_s[g.loops.start]) for g in groups.groups]
    return [0.5 / max(float(np.median(h)), 1e-9) for h in halves if h.size]
