"""Gram matrices about a point, piece by piece: what every decision is made from.

Most columns are the same for many points: what the bands of the element tables do, and the fixed
ones. They make a `Frame`, with their products. A point brings its stage parameters, trials and the
residual along, a few columns, and their products with the frame and with each other: a `Linear`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.cells import Cells

FloatArray = NDArray[np.float64]
Key = tuple[object, ...]
Pieces = Sequence[int] | None  # None: all of them


@dataclass(frozen=True)
class Piece:
    """Thinned samples begin..end of one block of one group.

    ``fold`` is held out together; ``first`` : at which sample of the group it begins; ``cells`` :
    how it was thinned
    """

    group: int
    begin: int
    end: int
    fold: int
    first: int
    cells: Cells


@dataclass(frozen=True, eq=False)
class Fixed:
    """Columns that do not depend on the model's numbers, of one piece.

    ``white`` (m, n) whitened: powers, fine, generic; ``gram`` (m, m) of it; ``raw`` (m, n)
    unwhitened and centred, for sizes in nm.
    """

    white: FloatArray
    gram: FloatArray
    raw: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Bands:
    """What the bands of the element tables do in one piece, shapes (b, n), per unit of compliance.

    ``white`` whitened, ``raw`` unwhitened and centred; their Gram matrices, and ``cross`` (b, m)
    with the fixed columns.
    """

    white: FloatArray
    raw: FloatArray
    gram: FloatArray
    raw_gram: FloatArray
    cross: FloatArray


@dataclass(frozen=True, eq=False)
class Frame:
    """Columns that many points share, in the order bands, powers, fine, generic.

    Attributes
    ----------
    bands, fixed : piece by piece
    recordings : shape (k,), of each piece; unwhitened products count every one
    counts : how many powers, fine and generic columns there are
    reduced : of `likelihood.reduce`, for all points
    """

    bands: tuple[Bands, ...]
    fixed: tuple[Fixed, ...]
    recordings: tuple[int, ...]
    counts: tuple[int, int, int]
    reduced: dict[Key, Any] = field(default_factory=dict)
    _raw: dict[Key | None, FloatArray] = field(default_factory=dict)

    @property
    def compliances(self) -> int:
        """How many bands there are."""
        return len(self.bands[0].gram)

    def gram(self, pieces: Pieces = None) -> FloatArray:
        """Of the whitened columns, shape (b + m, b + m), over some of the pieces or all."""
        return joined(
            summed([b.gram for b in self.bands], pieces),
            summed([b.cross for b in self.bands], pieces),
            summed([f.gram for f in self.fixed], pieces),
        )

    def raw(self, pieces: Pieces = None) -> FloatArray:
        """Of the unwhitened bands, shape (b, b); not to be written to."""
        key = None if pieces is None else tuple(pieces)
        if key not in self._raw:
            each = zip(self.bands, self.recordings, strict=True)
            self._raw[key] = summed([times * b.raw_gram for b, times in each], pieces)
        return self._raw[key]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where which columns are: base, powers, fine, generic, trials.

    ``twice`` : how many of the base, those behind the bands, the powers hold already: the
    coefficients of a bend. Projected off once more they would take along what rounding makes of
    them
    """

    base: int
    powers: int
    fine: int
    generic: int
    trials: int
    twice: int = 0


class Rows(NamedTuple):
    """Base columns (k, n) of one piece behind the bands, and the residual (n,)."""

    white: FloatArray
    raw: FloatArray
    left: FloatArray
    raw_left: FloatArray


@dataclass(frozen=True, eq=False)
class Linear:
    """What a point adds to a frame, per piece.

    Its own columns are the base behind the bands (coefficients, stage parameters), then trials.

    Attributes
    ----------
    frame : what it shares with other points
    cross : shape (k, o, b + m), whitened own columns with those of the frame
    own : shape (k, o, o), with each other
    residual : shape (k, b + m + o + 1), the whitened residual with the frame, the own columns and
        itself
    raw_cross, raw_own : shapes (k, p - b, b) and (k, p - b, p - b), unwhitened base columns
    raw_residual : shape (k, p + 1), with the base and itself, um^2 summed over samples
    count : shape (k,), recordings x thinned samples
    law : shape (generic,), variance of each dictionary column that the freedom of the accepted
        causes' assumed laws gives it, um^2
    most : variances of fine thresholds and of the dictionary that are not exceeded
    unknown : shape (generic,), 0 for columns of the dictionary that the model has a name for, else
        1; None where it has none for any
    made_for : which columns of the space they are about
    rows : per piece the whitened and the unwhitened vectors
    model : which the residual is of
    axes : of `likelihood.reduce`, which do not depend on the residual
    """

    layout: Layout
    frame: Frame
    cross: FloatArray
    own: FloatArray
    residual: FloatArray
    raw_cross: FloatArray
    raw_own: FloatArray
    raw_residual: FloatArray
    count: FloatArray
    law: FloatArray
    rows: tuple[Rows, ...] = ()
    made_for: Key = ()
    model: Model | None = None
    most: tuple[float, float] = (np.inf, np.inf)
    unknown: FloatArray | None = None
    axes: dict[Key, Any] = field(default_factory=dict)

    def raw(self, pieces: Pieces = None) -> FloatArray:
        """Unwhitened base columns and residual with each other, shape (p + 1, p + 1)."""
        p, b = self.layout.base, self.frame.compliances
        out = np.empty((p + 1, p + 1))
        out[:b, :b] = self.frame.raw(pieces)
        out[b:p, :b] = summed(self.raw_cross, pieces)
        out[:b, b:p] = out[b:p, :b].T
        out[b:p, b:p] = summed(self.raw_own, pieces)
        out[p] = out[:, p] = summed(self.raw_residual, pieces)
        return out


def summed(parts: Sequence[FloatArray] | FloatArray, pieces: Pieces = None) -> FloatArray:
    """The sum over some of the pieces, or all; never one of them itself."""
    first, *others = range(len(parts)) if pieces is None else pieces
    out = parts[first].copy()
    for k in others:
        out += parts[k]
    return out


def no_bands(samples: int, fixed: int) -> Bands:
    none, empty = np.zeros((0, samples)), np.zeros((0, 0))
    return Bands(none, none, empty, empty, np.zeros((0, fixed)))


def no_columns(samples: int) -> Fixed:
    none = np.zeros((0, samples))
    return Fixed(none, np.zeros((0, 0)), none.astype(np.float32))


def joined(first: FloatArray, cross: FloatArray, second: FloatArray) -> FloatArray:
    """Gram matrix of two sets of columns together, from theirs and their products (a, b)."""
    a = first.shape[0]
    out = np.empty((a + second.shape[0], a + second.shape[0]))
    out[:a, :a], out[:a, a:], out[a:, :a], out[a:, a:] = first, cross, cross.T, second
    return out
