"""Why a ladder refuses an extension that fits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.confusion import strengths
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.refit import Fitted, settle
from piezo_rig.diagnosis.scan import by_speed
from piezo_rig.diagnosis.wandering import wanders
from piezo_rig.diagnosis.warmth import of_warmth

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

NEAR = 1.1  # held-out error of a rival, of the best one's
HARDLY = 0.2  # of the noise: what rivals may leave beside it, and none is the better for it
OFF = 2.5  # an effect must be so many times what a law may be off by
FAR_OFF, HELPS = 2.0, 0.97  # so many times the noise; held-out error after a step, of that before
NOTHING = 0.4  # of the noise: what is left of nothing
PLAIN = 100.0  # log-likelihood of what is like nothing that a model gets wrong
MUCH = 0.8  # the same where a model is held fixed and lacks what the actuator has
OF_A_CORNER = "at one speed it shows just after corners alone, and explains little of what is amiss"
# squared error beyond the noise, of that before, with a cause that shows at corners alone; the
# log-likelihood that makes up for more
MOST_OF_IT, PLAIN_AT_CORNERS = 0.5, 25.0
BESIDE = "not needed beside "  # and the name of another
NEARLY_NOTHING = 0.05  # the same: what a cause leaves that is no warmth, whatever that says
SAYS_NO_MORE = "once refitted it says no more than the model without it"
CAME_TO_NOTHING = "once refitted it came out at a limit, or no different from nothing"
TOO_LONG = "once refitted it is larger than the drive monitor, which shows none, leaves room for"
FITS = "fits, but predicts data that it has not seen "  # and how much worse
OF_THE_MISFIT = FITS + "no better, while the model is still far off"


def carrying(
    search: Search, tried: list[tuple[float, int, Fitted]]
) -> list[tuple[float, int, Fitted]]:
    """Those rivals that predict data which they have not seen about as well as the best.

    Between effects as small as the noise this decides nothing, the evidence does. Between
    large ones it does: there the evidence hangs on what the model cannot do at all, and what
    the best of them leaves no more of than noise another one may not leave beyond doubt.
    """
    rivals = [t for t in tried if t[0] > 0.0]
    if len(rivals) < 2:
        return tried
    best = min((fitted for _, _, fitted in rivals), key=lambda f: search.error(0, f))
    least = search.error(0, best)
    hardly = float(np.hypot(least, HARDLY * search.noise_nm))

    def carries_over(fitted: Fitted) -> bool:
        error = search.error(0, fitted)
        if error <= hardly:
            return True
        # its evidence is of elements that give way backwards, and not to be had
        if fitted.point.at_their_least and not best.point.at_their_least:
            return False
        return error <= NEAR * least and not search.helps(fitted, best, False)

    return [t for t in tried if t[0] <= 0.0 or carries_over(t[2])]


def worse(
    search: Search, fitted: Fitted, than: Fitted, doubtful: bool = False, ways: int | None = None
) -> str | None:
    """Why an extension is refused: it does not carry over; None where it does.

    ``doubtful`` : the evidence is not overwhelming, and the extension must predict better;
    ``ways`` : only the first so many ways of holding out are asked
    """
    for k, (_, limit) in enumerate(search.held_out[:ways]):
        value, error = search.error(k, fitted), search.error(k, than)
        if value > (1.0 if doubtful and k == 0 else limit) * error:
            return f"{FITS}worse ({value:.3g} nm against {error:.3g} nm)"
    before = search.error(0, than)
    helps = MUCH if search.space.loose else HELPS
    if before > FAR_OFF * search.noise_nm and search.error(0, fitted) > helps * before:
        return None if like_no_other(fitted, than) else OF_THE_MISFIT
    return None


def like_no_other(fitted: Fitted, than: Fitted) -> bool:
    """Whether what an extension adds is plain, and like nothing that a model may get wrong."""
    known = {s.id for s in than.point.model.stages}
    new = [s for s in fitted.point.model.stages if s.id not in known]
    special = bool(new) and all(isinstance(s, Cause) and s.like_no_other for s in new)
    return special and fitted.evidence > than.evidence + PLAIN


def of_a_corner(search: Search, fitted: Fitted, here: Fitted, id: str) -> str | None:
    """Why a cause that shows just after corners alone is refused: elements that are too coarse
    are wrong there too. It has to explain most of what is amiss.
    """
    kind = CAUSES[id]
    if not (by_speed(id) or (issubclass(kind, Cause) and kind.at_corners)):
        return None
    if context_of(search.space, here.point.model).several_speeds:
        return None
    before, after = beyond_noise(search, here), beyond_noise(search, fitted)
    if after <= MOST_OF_IT * before or _says_most(search, fitted, here):
        return None
    return OF_A_CORNER


def beyond_noise(search: Search, fitted: Fitted) -> float:
    """Squared held-out error beyond the noise, nm^2."""
    return max(search.error(0, fitted) ** 2 - search.noise_nm**2, 0.0)


def _says_most(search: Search, fitted: Fitted, here: Fitted) -> bool:
    """Whether an extension says more than all that is then left, and plainly.

    In slow noise what is held out is off by more than a small effect does.
    """
    gained = fitted.evidence - here.evidence
    return gained > PLAIN_AT_CORNERS and search.left_over(fitted) < gained


def of_a_law(search: Search, fitted: Fitted, id: str, without: Fitted | None = None) -> str | None:
    """Why a small effect is refused beside a large one whose law is only assumed, and any one
    beside what no cause says.

    ``without`` : the model without it, if that is known. Where it was far off and the effect
    leaves nothing, it is no misfit: what a law gets wrong has a shape of its own.
    """
    if (wandering := wanders(search.space, fitted, id)) is not None:
        return wandering
    if without is not None and (
        beyond_noise(search, fitted) >= NEARLY_NOTHING * beyond_noise(search, without)
    ):
        warm = of_warmth(search.space, without, fitted, id)
        if warm is not None:
            return warm
    kind, model = CAUSES[id], fitted.point.model
    own, groups = model.stage(id), search.space.groups
    if isinstance(own, Cause):
        late_s = own.late_s(groups.travel_um / groups.span_v)
        for stage in model.stages:
            if isinstance(stage, Cause) and late_s < stage.as_late_s:
                return f"no longer than what {stage.id} leaves open by how fast it begins"
    if not issubclass(kind, Cause) or not kind.law:
        return None
    laws = {c: min(kind.law.values()) for c in search.causes
            if c != id and issubclass(kind := CAUSES[c], Cause) and kind.law}  # fmt: skip
    if not laws or (without is not None and _takes_all(search, fitted, without)):
        return None
    settle(search.space, fitted.point)
    found = strengths(search.space, fitted, [id, *laws])
    for other, share in laws.items():
        if found[id] < OFF * share * found[other]:
            return f"no larger than what the assumed law of {other} may be wrong by"
    return None


def _takes_all(search: Search, fitted: Fitted, without: Fitted) -> bool:
    """Whether an extension brings a model that is far off down to the noise."""
    before, after = search.error(0, without), search.error(0, fitted)
    return before > FAR_OFF * search.noise_nm and after < np.hypot(1.0, NOTHING) * search.noise_nm
