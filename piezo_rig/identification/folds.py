"""What is held out: conditions, else sweeps, else the last third of the cycles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification.data import Data
from piezo_rig.identification.normal import Normal, Piece, pieces_of
from piezo_rig.identification.smooth import inverse
from piezo_rig.identification.solve import UNSEEN, continuity, fill_unseen, solve_bounded

FloatArray = NDArray[np.float64]
MOST = 30  # folds
SAME = 1e-6  # of the largest: drive changes that differ by less are one level
NEW = 0.01  # share of held-out drive changes that must be new
FEW = 160  # levels: with fewer, much happens between them


@dataclass(frozen=True, eq=False)
class Folds:
    """Groups of pieces that are held out together.

    Attributes
    ----------
    kind : ``condition``, ``sweep``, ``cycles`` or ``none``
    groups : indices of the pieces held out in each fold
    levels : where what is held out has no drive change that the rest has not: how many there are
    """

    kind: str
    groups: tuple[tuple[int, ...], ...]
    levels: int = 0

    @property
    def warning(self) -> str:
        """What is to be said of them; empty where they hold out what they should."""
        if not 0 < self.levels < FEW:
            return ""
        return (
            f"warning: every cycle repeats the same {self.levels} drive changes (the drive's "
            "period is a whole number of samples): held-out cycles hold out noise and drift, not "
            "what happens between those levels; another drive may show more"
        )

    @classmethod
    def of(cls, data: Data) -> Folds:
        pieces = pieces_of(data)
        by_condition = _group(pieces, [data.conditions[p.sweep] for p in pieces])
        if len(by_condition) > 1:
            return cls("condition", by_condition)
        by_sweep = _group(pieces, [str(p.sweep) for p in pieces])
        if len(by_sweep) > 1:
            return cls("sweep", by_sweep)
        cycles = pieces_of(data, cycles=True)
        if len(cycles) >= 3:
            held = max(1, len(cycles) // 3)
            levels = _repeated(data, cycles, len(cycles) - held)
            return cls("cycles", (tuple(range(len(cycles) - held, len(cycles))),), levels)
        return cls("none", ())

    def held_out_power(
        self, normal: Normal, bounded: NDArray[np.bool_], floor: float, sizes: tuple[int, ...]
    ) -> float:
        """Mean square of what is held out when the rest is fitted, um^2.

        ``sizes``: number of bands of each curve, for those that the rest never visits.
        """
        all_gram, all_right = normal.gram.sum(axis=0), normal.right.sum(axis=0)
        groups = self.groups or (tuple(range(len(normal.pieces))),)
        whole = solve_bounded(all_gram, all_right, bounded, floor)
        whole = np.where(np.isfinite(whole), whole, 0.0)
        left = float(normal.power.sum() - 2.0 * all_right @ whole + whole @ all_gram @ whole)
        ends = np.cumsum((0, *sizes))
        runs = tuple((int(a), int(b)) for a, b in pairwise(ends))
        noise = max(left, 0.0) / float(normal.count.sum())
        all_gram = all_gram + continuity(whole, runs, all_gram, noise)
        total, count = 0.0, 0.0
        for group in groups:
            held = list(group)
            gram, right = normal.gram[held].sum(axis=0), normal.right[held].sum(axis=0)
            if self.groups:
                x = solve_bounded(all_gram - gram, all_right - right, bounded, floor)
            else:
                x = solve_bounded(all_gram, all_right, bounded, floor)
            x = np.concatenate([_filled(p) for p in np.split(x, np.cumsum(sizes)[:-1])])
            total += float(normal.power[held].sum() - 2.0 * right @ x + x @ gram @ x)
            count += float(normal.count[held].sum())
        return max(total, 0.0) / count

    def tied_power(self, normal: Normal, penalty: FloatArray) -> float:
        """The same with a penalty (p, p) on the unknowns, none of them bounded; um^2."""
        all_gram, all_right = normal.gram.sum(axis=0) + penalty, normal.right.sum(axis=0)
        total, count = 0.0, 0.0
        for group in self.groups:
            held = list(group)
            gram, right = normal.gram[held].sum(axis=0), normal.right[held].sum(axis=0)
            x = _solved(all_gram - gram, all_right - right)
            total += float(normal.power[held].sum() - 2.0 * right @ x + x @ gram @ x)
            count += float(normal.count[held].sum())
        return total / count


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import cho_factor, cho_solve

    diagonal = np.diag(gram)
    if diagonal.min() > UNSEEN * diagonal.max():
        try:
            return np.asarray(cho_solve(cho_factor(gram), right), float)
        except np.linalg.LinAlgError:
            pass
    return inverse(gram) @ right


def _repeated(data: Data, cycles: tuple[Piece, ...], first: int) -> int:
    """Different drive changes since the turning point, if pieces from ``first`` on add none."""
    kept: list[FloatArray] = []
    held: list[FloatArray] = []
    for i, piece in enumerate(cycles):
        track = data.tracks[piece.track]
        at = np.arange(piece.begin, piece.end)
        own = np.searchsorted(track.loops.start, at, side="right") - 1
        change = np.abs(track.drive_v[at] - track.drive_v[track.loops.start[own]])
        (held if i >= first else kept).append(change)
    old, new = np.concatenate(kept), np.concatenate(held)
    gap = SAME * float(old.max())
    old = np.unique(old)
    old = old[np.diff(old, prepend=-np.inf) > gap]
    near = np.searchsorted(old, new)
    above = np.abs(old[np.minimum(near, old.size - 1)] - new)
    below = np.abs(old[np.maximum(near - 1, 0)] - new)
    # chains of close levels count as one
    return int(old.size) if np.mean(np.minimum(above, below) > 2.0 * gap) < NEW else 0


def _filled(values: FloatArray) -> FloatArray:
    return fill_unseen(values) if np.any(np.isfinite(values)) else np.zeros(values.size)


def _group(pieces: tuple[Piece, ...], keys: list[str]) -> tuple[tuple[int, ...], ...]:
    found: dict[str, list[int]] = {}
    for i, key in enumerate(keys):
        found.setdefault(key, []).append(i)
    groups = [tuple(g) for g in found.values()]
    if len(groups) > MOST:  # many recordings: hold out several at a time
        groups = [tuple(i for g in groups[k::MOST] for i in g) for k in range(MOST)]
    return tuple(groups)
