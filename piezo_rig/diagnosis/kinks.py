"""Break points of the base put where the data have theirs.

A table begins with elements at even places. An actuator that is one of springs and sliders, as the
thesis's are, has its kinks elsewhere: between two break points its curve is off by as much as the
slope changes there times an eighth of the distance, in every half loop. That is no cause, but it
is far above the noise of an average, and what laws do is smaller. So a band of the table is halved
where the recordings say plainly that its two halves differ, and again where they still do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Elements, Stage
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.linear import Linear, summed
from piezo_rig.diagnosis.refit import Fitted, refit, settle
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
ROUNDS, MOST = 4, 120  # of halving; bands that are added at most
PLAIN = 12.0  # log-likelihood that two halves of a band must say more than the whole
WORTH = 60.0  # the same, of all of a round
SHARE = 0.5  # of what is left beyond noise that is to be kinks; else causes come first
ALIKE = 1e-6  # squared length of a candidate, of what it was, that is no direction any more


def with_kinks(space: Space, first: Fitted) -> Point | None:
    """A fitted baseline with bands halved where they are no straight lines; None if all are.

    Only of a table that is free and the only one, and only where little else is amiss: as long as
    much is, more elements follow that as well as they can, and take their time.
    """
    point, added = first.point, 0
    if point.fixed or len(point.tables) != 1:
        return None
    for n in range(ROUNDS):
        finer = _halved(point, np.ones(point.compliances, bool))
        settle(space, finer)
        apart = _apart(space.linear(finer), MOST - added, 0.0 if n else SHARE)
        if not apart.any():
            break
        added += int(apart.sum())
        point = refit(space, _halved(point, apart)).point
    return point if added else None


def _halved(point: Point, which: NDArray[np.bool_]) -> Point:
    """The same curve with some of its bands in two halves each."""
    (table,) = point.tables
    assert table.elements is not None
    knots, compliance = table.elements.knots_v, 1.0 / table.elements.slopes
    middle = knots - 0.5 * np.diff(knots, prepend=0.0)
    order = np.argsort(np.concatenate([knots, middle[which]]), kind="stable")
    knots = np.concatenate([knots, middle[which]])[order]
    compliance = np.concatenate([compliance, compliance[which]])[order]
    return _with_table(point, knots, compliance)


def _with_table(point: Point, knots: FloatArray, compliance: FloatArray) -> Point:
    (table,) = point.tables
    stage: Stage = type(table)(table.parameters, Elements.from_curve(knots, compliance))
    stages = tuple(stage if s.id == table.id else s for s in point.model.stages)
    return replace(point, model=point.model.with_(stages=stages))


def as_in(point: Point, other: Point) -> Point:
    """A point with the break points of another, whose bands are halves of its own."""
    (table,), (finer,) = point.tables, other.tables
    assert table.elements is not None
    assert finer.elements is not None
    knots, end = finer.elements.knots_v, table.elements.knots_v
    band = np.minimum(np.searchsorted(end, knots - 1e-9 * end[-1]), end.size - 1)
    return _with_table(point, knots, (1.0 / table.elements.slopes)[band])


def _apart(linear: Linear, most: int, share: float) -> NDArray[np.bool_]:
    """Which bands the data want in two, shape (b,), from products about all halves.

    What whole bands and the point's other numbers can do is projected off. The plainest comes
    first, and what it explains is taken off the others; what is left is reckoned as noise.

    ``share`` : of what is beyond noise, that they are to explain at least
    """
    count, behind = linear.frame.compliances, linear.layout.base - linear.frame.compliances
    residual, beside = summed(linear.residual), summed(linear.cross)[:, :count]
    gram = np.block([[summed([b.gram for b in linear.frame.bands]), beside.T],
                     [beside, summed(linear.own)]])  # fmt: skip
    with_data = np.concatenate([residual[:count], residual[-1 - behind : -1]])
    whole, half = np.zeros((count // 2 + behind, len(gram))), np.zeros((count // 2, len(gram)))
    for k in range(count // 2):
        whole[k, 2 * k : 2 * k + 2] = 1.0
        half[k, 2 * k : 2 * k + 2] = 1.0, -1.0
    whole[count // 2 :, count:] = np.eye(behind)
    base = whole @ gram @ whole.T
    base += 1e-9 * np.diag(np.diag(base)) + 1e-300 * np.eye(len(base))
    follows = np.linalg.solve(base, np.column_stack([whole @ gram @ half.T, whole @ with_data]))
    cross = half @ gram @ whole.T
    own = half @ gram @ half.T - cross @ follows[:, :-1]
    along = half @ with_data - cross @ follows[:, -1]
    least = ALIKE * np.diag(half @ gram @ half.T)
    left = float(residual[-1]) - float(whole @ with_data @ follows[:, -1])
    samples = sum(rows.left.size for rows in linear.rows)
    beyond = left - samples
    found, gained = np.zeros(count // 2, bool), 0.0
    while found.sum() < most:
        size = np.diag(own)
        usable = (size > least) & ~found
        square = np.where(usable, along**2 / np.where(usable, size, 1.0), 0.0)
        best = int(np.argmax(square))
        noise = max(1.0, (left - square[best]) / max(samples, 1))
        if 0.5 * square[best] / noise < PLAIN:
            break
        found[best] = True
        gained += 0.5 * square[best] / noise
        left -= square[best]
        column = own[:, best] / np.sqrt(size[best])
        along = along - column * along[best] / np.sqrt(size[best])
        own = own - np.outer(column, column)
    enough = gained > WORTH and beyond - (left - samples) > share * beyond
    return found if enough else np.zeros_like(found)
