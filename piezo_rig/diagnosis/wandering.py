"""A gain that wanders along a recording, which an ageing would be taken for.

An ageing goes with the logarithm of the count of cycles. A compliance that changes at some time or
a sensitivity that breathes with the room has a part that does, too, and much more that does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import ClassVar

import numpy as np

from piezo_rig.chain import Signal, Stage
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, settle
from piezo_rig.diagnosis.space import Space

AGEING = "cycle-aging"
WANDERS = "the gain changes along the recording otherwise than with the count of its cycles"
PARTS = 20  # of a recording, each with a gain of its own
GAIN = 1e-4  # of an example
PLAINLY = 30.0  # log-likelihood beyond what noise makes of them, that these gains must be worth
SHARE = 0.3  # of what the ageing is worth


class PartGain(Stage):
    """A gain of its own between two times."""

    id = "part-gain"
    place = "sensor"
    together = True
    units: ClassVar[Mapping[str, str]] = {"from_s": "s", "to_s": "s", "gain": "1"}

    def act(self, signal: Signal) -> Signal:
        inside = (signal.time_s >= self["from_s"]) & (signal.time_s < self["to_s"])
        return signal.with_displacement(signal.displacement_um * (1.0 + self["gain"] * inside))


def wanders(space: Space, fitted: Fitted, id: str) -> str | None:
    """Why an ageing is refused: the gain changes along the only recording by far more than it says.
    """
    rate = (AGEING, "rate_per_decade")
    if id != AGEING or len(space.groups.groups) > 1 or rate not in fitted.point.names:
        return None
    (group,), k = space.groups.groups, fitted.point.names.index(rate)
    settle(space, fitted.point)
    model = fitted.point.model
    edges = np.linspace(group.time_s[0], group.time_s[-1], PARTS + 1)
    pairs = [
        (model, model.with_stage(PartGain.of(None, from_s=a, to_s=b, gain=GAIN)))
        for a, b in pairwise(edges[1:])  # of the first the table says all
    ]
    likelihood = Likelihood(reduce(space.linear(fitted.point, pairs)))
    parts = likelihood.evidence(range(len(pairs))) - likelihood.evidence() - 0.5 * len(pairs)
    told = 0.5 * fitted.point.values()[fitted.point.linear + k] ** 2 / fitted.covariance[k, k]
    if parts > told or parts > max(PLAINLY, SHARE * told):
        return WANDERS
    return None


def wandering(space: Space, fitted: Fitted) -> tuple[float, float]:
    """How far the gain of the only recording wanders, rms, and what that does, nm rms.

    Parts count by how far they move: at rest a gain is of noise alone.
    """
    (group,) = space.groups.groups
    moved = group.predicted(fitted.point.model)
    off = group.measured_um.mean(axis=0) - moved
    edges = np.linspace(group.blocks[0][0], group.blocks[-1][1], PARTS + 1).astype(int)
    gains, square = np.zeros(PARTS), np.zeros(PARTS)
    for k, (a, b) in enumerate(pairwise(edges)):
        own = moved[a:b] - moved[a:b].mean()
        square[k] = float(own @ own) / own.size
        gains[k] = float(own @ off[a:b]) / max(float(own @ own), 1e-30)  # 0 at rest
    moves = square / max(float(square.sum()), 1e-30)
    gains -= moves @ gains
    return float(np.sqrt(moves @ gains**2)), 1e3 * float(np.sqrt(np.mean(square * gains**2)))
