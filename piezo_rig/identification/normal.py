"""Normal equations of a fit, kept apart for every piece of the data.

Pieces are what is held out or drawn again: sweeps, or whole cycles where
there is one sweep. Once the pieces' Gram matrices exist, a refit on any
selection of them is a small linear problem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data, Track

FloatArray = NDArray[np.float64]
MOST_CYCLES = 48  # pieces of one block
CHUNK = 20_000  # segments whose columns are held at once


@dataclass(frozen=True)
class Piece:
    """Samples begin..end of one block of one track; ``sweep`` is its index among those given."""

    track: int
    block: int
    begin: int
    end: int
    sweep: int


@dataclass(frozen=True, eq=False)
class Normal:
    """Per piece, offsets taken out: Gram (m, p, p), right-hand side (m, p), sum y^2 and n (m,)."""

    gram: FloatArray
    right: FloatArray
    power: FloatArray
    count: FloatArray
    pieces: tuple[Piece, ...]

    def reduced(self, matrix: FloatArray) -> Normal:
        """The same equations for unknowns x with columns = matrix @ x."""
        gram = matrix.T @ self.gram @ matrix
        return Normal(gram, self.right @ matrix, self.power, self.count, self.pieces)

    def folded(self) -> Normal:
        """The same equations where the second half of the unknowns equals the first."""
        n = self.right.shape[1] // 2
        gram = self.gram[:, :n, :n] + self.gram[:, n:, n:]
        cross = self.gram[:, :n, n:]
        gram += cross
        gram += cross.transpose(0, 2, 1)
        return replace(self, gram=gram, right=self.right[:, :n] + self.right[:, n:])

    def joined(self, owner: NDArray[np.int64], pieces: tuple[Piece, ...]) -> Normal:
        """The same equations with pieces added up; ``owner``: the new piece of every old one."""

        def total(values: FloatArray) -> FloatArray:
            out = np.zeros((len(pieces), *values.shape[1:]))
            np.add.at(out, owner, values)
            return out

        return Normal(
            total(self.gram), total(self.right), total(self.power), total(self.count), pieces
        )


def pieces_of(data: Data, cycles: bool = False) -> tuple[Piece, ...]:
    """One piece per block, or with ``cycles`` one per full cycle (or a few)."""
    out = []
    for t, track in enumerate(data.tracks):
        for b, (begin, end) in enumerate(track.blocks):
            edges = [begin, end]
            if cycles:
                turns = track.loops.start[(track.loops.start > begin) & (track.loops.start < end)]
                turns = turns[1:-1:2]
                if turns.size > MOST_CYCLES:  # several at a time
                    turns = turns[np.linspace(0, turns.size - 1, MOST_CYCLES).astype(int)]
                edges = [begin, *(int(i) for i in turns), end]
            sweep = track.sweeps[track.unit[b]]
            out += [Piece(t, b, i, j, sweep) for i, j in pairwise(edges)]
    return tuple(out)


def finer(
    data: Data, pieces: tuple[Piece, ...], most: int
) -> tuple[tuple[Piece, ...], NDArray[np.int64]]:
    """Pieces cut at turning points, about ``most`` in all, and for each the one that it is of.

    A piece with one half loop alone is cut into quarters.
    """
    out: list[Piece] = []
    owner: list[int] = []
    parts = max(1, most // len(pieces))
    for i, piece in enumerate(pieces):
        turns = data.tracks[piece.track].loops.start
        inside = turns[(turns > piece.begin) & (turns < piece.end)]
        if inside.size == 0:
            inside = np.linspace(piece.begin, piece.end, 5).astype(int)[1:-1]
        kept = inside[np.linspace(0, inside.size, parts + 1)[1:-1].astype(int)]
        for a, b in pairwise([piece.begin, *sorted({int(k) for k in kept}), piece.end]):
            out.append(replace(piece, begin=a, end=b))
            owner.append(i)
    return tuple(out), np.array(owner)


def normal_equations(
    data: Data,
    curves: Curves,
    pieces: tuple[Piece, ...],
    targets: list[FloatArray] | None = None,
    knots: bool = False,
) -> Normal:
    """Normal equations at given break points.

    Parameters
    ----------
    targets : for every track what is to be fitted, shape (n,); the displacement by default
    knots : with columns for the break points
    """
    from piezo_rig.identification import sums

    narrow = curves.narrow(knots)
    knots = knots or curves.dx_um > 0
    m, p = len(pieces), curves.wide_size(knots)
    gram, right = np.zeros((m, p, p)), np.zeros((m, p))
    power, count = np.zeros(m), np.zeros(m)
    totals, heights = np.zeros((m, p)), np.zeros(m)
    branches = curves.branches()
    for t, track in enumerate(data.tracks):
        mine = [i for i, piece in enumerate(pieces) if piece.track == t]
        if not mine:
            continue
        y = track.displacement_um if targets is None else targets[t]
        walked = branches.walk(track.drive_v, track.loops)
        law = curves.law_derivatives(track.loops) if curves.by_law else np.zeros((1, 0))
        parts = {}
        for i in mine:
            piece = pieces[i]
            middle = float(np.mean(y[piece.begin : piece.end]))
            parts[i] = y[piece.begin : piece.end] - middle
            n = float(piece.end - piece.begin)
            count[i], heights[i] = n, middle * n
            power[i] = float(parts[i] @ parts[i]) + n * middle * middle
        state = np.zeros(p)
        for first in range(0, walked.ints.shape[0], CHUNK):
            ints, floats = walked.ints[first : first + CHUNK], walked.floats[first : first + CHUNK]
            begin, active, rate = sums.columns(
                ints, floats, curves.first_c.size, curves.first_c, curves.later_c[1:],
                branches.first_break_um, law, curves.by_law, knots, state,
            )  # fmt: skip
            for i in mine:
                piece = pieces[i]
                low, high = _segments(ints, piece)
                if high <= low:
                    continue
                s = sums.segment_sums(
                    track.drive_v[piece.begin : piece.end], parts[i],
                    ints[low:high], floats[low:high], piece.begin,
                )  # fmt: skip
                b = begin[low:high]
                moving, r, total = sums.slopes_part(
                    b, active[low:high], rate[low:high], s, curves.first_c.size, curves.q
                )
                gram[i] += b.T @ (s[:, :1] * b) + moving + moving.T
                right[i] += r + heights[i] / count[i] * total
                totals[i] += total
    _centre(pieces, gram, right, power, count, totals, heights)
    normal = Normal(gram, right, power, count, pieces)
    if narrow is None:
        return normal
    return normal.reduced(narrow) if knots else normal.folded()


def _segments(ints: NDArray[np.int64], piece: Piece) -> tuple[int, int]:
    low = int(np.searchsorted(ints[:, 1], piece.begin, side="right"))
    high = int(np.searchsorted(ints[:, 0], piece.end, side="left"))
    return low, high


def _centre(
    pieces: tuple[Piece, ...],
    gram: FloatArray,
    right: FloatArray,
    power: FloatArray,
    count: FloatArray,
    totals: FloatArray,
    heights: FloatArray,
) -> None:
    """Take the free offset of every block out of its pieces."""
    blocks: dict[tuple[int, int], list[int]] = {}
    for i, piece in enumerate(pieces):
        blocks.setdefault((piece.track, piece.block), []).append(i)
    for members in blocks.values():
        n = count[members].sum()
        mean, height = totals[members].sum(axis=0) / n, heights[members].sum() / n
        for i in members:
            t, m = totals[i], mean
            cross = np.outer(t, m)
            gram[i] += count[i] * np.outer(m, m) - cross - cross.T
            right[i] += count[i] * m * height - t * height - m * heights[i]
            power[i] += count[i] * height * height - 2.0 * height * heights[i]


def residuals(data: Data, curves: Curves) -> list[FloatArray]:
    """Measured minus predicted, um, for every track; offsets of the blocks not taken out."""
    branches = curves.branches()
    return [
        t.displacement_um - branches.displacement(t.drive_v, branches.walk(t.drive_v, t.loops))
        for t in data.tracks
    ]


def centred(track: Track, values: FloatArray) -> list[FloatArray]:
    """The values of every block less their mean."""
    return [values[a:b] - values[a:b].mean() for a, b in track.blocks]


def rms(data: Data, values: list[FloatArray]) -> float:
    """Root mean square over all blocks, offsets taken out."""
    parts = [b for t, v in zip(data.tracks, values, strict=True) for b in centred(t, v)]
    return float(np.sqrt(sum(float(b @ b) for b in parts) / sum(b.size for b in parts)))
