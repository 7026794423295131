"""What a given model was off by is at right angles to what its fit had free.

Whoever identified it left nothing that a factor to all of the displacement, or to all of the drive,
could take off. So what it may be wrong by has little of what the two have in common, as much as
other drives ask for otherwise, and a gain or a sensitivity that has changed since has all of it.
Columns that may mimic it would explain it as a hundred small things that happen to add up to one.
By what the two differ in such a model may be as wrong as in any other direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.linear import Piece

FloatArray = NDArray[np.float64]
STEP = 1e-3  # of a factor, for differences
LEFT = 0.25  # of a column's share in what both have: other drives than those it was fitted to
Kept = tuple[FloatArray, NDArray[np.float32]]  # columns, whitened and as they are less a mean


@dataclass(frozen=True, eq=False)
class Factor:
    """What more displacement, or more drive, would change, as far as the two are alike.

    ``white``, ``raw`` : per piece of the data, shape (n,), whitened; less its mean, um; ``square``
    of the latter over all pieces
    """

    white: list[FloatArray]
    raw: list[FloatArray]
    square: float

    def off(self, columns: Sequence[Kept]) -> list[Kept]:
        """Columns (k, n) of every piece, whitened and raw, less most of what is like it."""
        products = sum(np.asarray(c @ t) for (_, c), t in zip(columns, self.raw, strict=True))
        shares = (1.0 - LEFT) * products / max(self.square, 1e-300)
        return [
            (white - np.outer(shares, w), (raw - np.outer(shares, t)).astype(np.float32))
            for (white, raw), w, t in zip(columns, self.white, self.raw, strict=True)
        ]


def factor_of(
    groups: Groups, pieces: Sequence[Piece], model: Model,
    whiten: Callable[[FloatArray, int], FloatArray],
) -> Factor:  # fmt: skip
    """That of a given model, as all of its stages let it through.

    ``whiten`` : makes white rows of one piece, given its number
    """
    kinds = [k for k in CAUSES.values() if issubclass(k, Cause) and k.needs_fixed_model]
    more, changes = [_with_more(model, k) for k in kinds], []
    for g in groups.groups:
        plain = g.predicted(model)
        changes.append(groups.thinned(g, np.array([(g.predicted(m) - plain) / STEP for m in more])))
    cuts = [changes[p.group][:, p.begin : p.end] for p in pieces]
    raw = [p.cells.centred(cut) for p, cut in zip(pieces, cuts, strict=True)]
    gram = sum((t @ t.T for t in raw), np.zeros((len(more), len(more))))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    _, vectors = np.linalg.eigh(gram / np.outer(size, size))
    alike = vectors[:, -1] / size
    white = [alike @ whiten(cut, at) for at, cut in enumerate(cuts)]
    return Factor(white, [alike @ t for t in raw], float(alike @ gram @ alike))


def _with_more(model: Model, kind: type[Cause]) -> Model:
    known = model.stage(kind.id)
    if known is None:
        return model.with_stage(kind.of(None, ratio=1.0 + STEP))
    return model.with_stage(known.with_values(ratio=(1.0 + STEP) * known["ratio"]))
