"""Gram matrices about a point, piece by piece: what every decision is made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.cells import Cells

FloatArray = NDArray[np.float64]
Key = tuple[object, ...]


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
class Layout:
    """Where which columns are: base, powers, fine, generic, trials.

    ``twice`` : how many of the powers the base holds already, as coefficients of a bend. Projected
    off once more they would take along what rounding makes of them.
    """

    base: int
    powers: int
    fine: int
    generic: int
    trials: int
    twice: int = 0

    def part(self, name: str) -> slice:
        at = 0
        for key in ("base", "powers", "fine", "generic", "trials"):
            n = int(getattr(self, key))
            if key == name:
                return slice(at, at + n)
            at += n
        raise KeyError(name)


class Rows(NamedTuple):
    """Base columns of one piece: those of the bands, shared, and the others of a point."""

    bands: Bands
    white: FloatArray
    raw: FloatArray


@dataclass(frozen=True, eq=False)
class Linear:
    """Gram matrices about one point, per piece.

    Attributes
    ----------
    white : k of shape (c, c), columns as `Layout` says
    residual : k of shape (c + 1,), its products with the columns, and with itself
    raw : k of shape (p + 1, p + 1), unwhitened base columns and residual, um^2 summed over samples
    count : shape (k,), recordings x thinned samples
    law : shape (generic,), variance of each dictionary column that the freedom of the accepted
        causes' assumed laws gives it, um^2
    most : variances of fine thresholds and of the dictionary that are not exceeded
    made_for : which columns of the space they are about
    rows : per piece the whitened and the unwhitened base columns, for another residual
    axes : of `likelihood.reduce`, which do not depend on the residual
    """

    layout: Layout
    white: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    raw: tuple[FloatArray, ...]
    count: FloatArray
    law: FloatArray
    rows: tuple[Rows, ...] = ()
    made_for: Key = ()
    most: tuple[float, float] = (np.inf, np.inf)
    axes: dict[Key, Any] = field(default_factory=dict)


def summed(parts: Sequence[FloatArray], pieces: Sequence[int] | None = None) -> FloatArray:
    """The sum over some of the pieces, or all; never one of them itself."""
    first, *others = range(len(parts)) if pieces is None else pieces
    out = parts[first].copy()
    for k in others:
        out += parts[k]
    return out


def no_bands(samples: int, fixed: int) -> Bands:
    none, empty = np.zeros((0, samples)), np.zeros((0, 0))
    return Bands(none, none, empty, empty, np.zeros((0, fixed)))


def assembled(own: FloatArray, cross: FloatArray, fixed: FloatArray, p: int) -> FloatArray:
    """Columns in the order base, fixed, trials."""
    m = fixed.shape[0]
    out = np.empty((own.shape[0] + m, own.shape[0] + m))
    base, theirs, rest = slice(0, p), slice(p, p + m), slice(p + m, None)
    for mine, here in ((base, slice(0, p)), (rest, slice(p, None))):
        out[mine, base], out[mine, rest] = own[here, :p], own[here, p:]
        out[mine, theirs] = cross[here]
        out[theirs, mine] = cross[here].T
    out[theirs, theirs] = fixed
    return out


def joined(first: FloatArray, cross: FloatArray, second: FloatArray) -> FloatArray:
    """Gram matrix of two sets of columns together, from theirs and their products (a, b)."""
    a = first.shape[0]
    out = np.empty((a + second.shape[0], a + second.shape[0]))
    out[:a, :a], out[:a, a:], out[a:, :a], out[a:, a:] = first, cross, cross.T, second
    return out
