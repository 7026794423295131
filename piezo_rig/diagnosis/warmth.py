"""What goes with how warm its losses make an actuator: no cause of the catalogue, and like many.

Where speeds differ a stack that heats itself is longer, or shorter, after a fast stretch than
after a slow one, for seconds. A law of turning points, an asymmetry or a drift says much of that.
A cause that says less than first-order responses to the speed and its square, and hardly anything
beside them, is not what happens.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.chain.stage import Signal, Stage
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, gained, settle
from piezo_rig.diagnosis.scan import of_base
from piezo_rig.diagnosis.space import Space

PLAINLY = 40.0  # log-likelihood by which warmth must say more: laws of other forms come to 34
HARDLY = 0.3  # of what a cause says, that it says beside warmth at most
OF_WARMTH = "what it does goes with how fast the drive was in the seconds before, as warmth does"
AFTER_S = (1.0, 3.0)  # an actuator is as warm as its losses make it; over longer all ways add up
POWERS = (1.0, 2.0)  # of the speed: what is lost in a cycle, in a resistance
SMALL_UM = 0.01


class Warmth(Stage):
    """``size`` um at the usual speed ``slew``, for as long as it takes: ``tau``."""

    id = "warmth"
    place = "actuator"
    units: ClassVar[Mapping[str, str]] = {"size": "um", "slew": "V/s", "tau": "s", "power": "1"}

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.relaxation import off

        time_s, drive_v = signal.time_s, signal.drive_v
        step_s = np.maximum(np.diff(time_s), 1e-12)
        loss = (np.abs(np.diff(drive_v)) / step_s / self["slew"]) ** self["power"]
        lost = np.append(0.0, np.cumsum(loss * step_s))
        warm = -off(time_s, lost, self["tau"]) / self["tau"]
        return signal.with_displacement(signal.displacement_um + self["size"] * warm)


def of_warmth(space: Space, here: Fitted, fitted: Fitted, id: str) -> str | None:
    """Why a model's newest member is refused: what it says, warmth says better."""
    if of_base(id) or not _may_show(space, fitted):
        return None
    says = gained(fitted, here)
    warm = warmth(space, here)
    if warm < says + PLAINLY:
        return None
    return OF_WARMTH if says + warmth(space, fitted) - warm < HARDLY * says else None


def still_warm(space: Space, fitted: Fitted) -> bool:
    """Whether warmth says plainly something beside a model."""
    return _may_show(space, fitted) and warmth(space, fitted) > PLAINLY


def _may_show(space: Space, fitted: Fitted) -> bool:
    """Whether warmth can be told from what goes on with every cycle: where speeds differ, and
    recordings last for as long as it takes to come and go.
    """
    if fitted.point.fixed or space.scales.longest_s < min(AFTER_S):
        return False
    return context_of(space, fitted.point.model).several_speeds


def warmth(space: Space, fitted: Fitted) -> float:
    """Log-likelihood that warmth says beside a model; what that is of the latest few is kept."""
    known = space.warm.get(id(fitted.point))
    if known is not None and known[0] is fitted.point:
        return known[1]
    model = fitted.point.model
    pairs = [
        (model, model.with_stage(Warmth.of(
            None, size=SMALL_UM, slew=space.scales.slew_v_per_s, tau=tau_s, power=power
        )))
        for tau_s in AFTER_S for power in POWERS
    ]  # fmt: skip
    settle(space, fitted.point)
    likelihood = Likelihood(reduce(space.linear(fitted.point, pairs)))
    says = likelihood.evidence(range(len(pairs))) - likelihood.evidence()
    while len(space.warm) >= space.most_kept:
        space.warm.pop(next(iter(space.warm)))
    space.warm[id(fitted.point)] = fitted.point, says
    return says
