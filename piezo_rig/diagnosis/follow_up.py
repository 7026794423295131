"""What to play next: the shipped protocol under which a confused set is told apart best.

An actuator that rests within a sweep recovers in part, and no cause of the catalogue says how. So
a protocol with such rests is taken only where no other one would do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import half_loops
from piezo_rig.config import DEFAULT_RIG, load_rig
from piezo_rig.diagnosis.confusion import APART
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import PiezoRigError
from piezo_rig.protocol import Plan, build_plan, load_protocol
from piezo_rig.protocol.plan import REST_DRIVE_V
from piezo_rig.resources import find, shipped_names

FloatArray = NDArray[np.float64]
THIN = 25
FAINT = 6.0  # d' from which on anything is found
ENOUGH = float(np.sqrt(1.0 - (APART / FAINT) ** 2))  # cosine at which even that is told apart
AS_FAR = 0.2  # by which a protocol may go beyond the data, of their highest drive or its own
RESTS_S = 1.0  # at rest within a sweep: an actuator recovers from it, in part


@dataclass(frozen=True)
class FollowUp:
    """The protocol, which causes it separates, and the predicted cosine under it.

    ``scaled`` : how, where it goes elsewhere than the data, in words
    """

    protocol: str
    separates: list[str]
    cosine: float
    scaled: str = ""


@dataclass(frozen=True)
class Decision:
    """What a follow-up settled.

    Attributes
    ----------
    kept : causes of the confused set that are found in all data together
    fell : causes of it that are neither found nor an alternative any more
    still : causes that still cannot be told from one that is kept
    text : the same in a sentence
    """

    kept: list[str]
    fell: list[str]
    still: list[str]
    text: str

    @property
    def decided(self) -> bool:
        return bool(self.kept) and not self.still


def decide(separates: Sequence[str], joined: Mapping[str, Sequence[str]]) -> Decision:
    """Which of a confused set survive a diagnosis of everything.

    Parameters
    ----------
    separates : the set, as `FollowUp` has it
    joined : finding -> its alternatives, of the joined diagnosis
    """
    kept = [c for c in joined if c in separates]
    open_ = {a for c in kept for a in joined[c]} | {
        a for c in joined if c not in separates for a in joined[c] if a in separates
    }
    still = sorted(open_ - set(kept))
    fell = [c for c in separates if c not in kept and c not in still]
    if not kept and not still:
        text = "undecided: in all data together none of them is found"
    elif not kept:
        text = f"undecided: {', '.join(still)} is possible, but another cause is found first"
    elif still:
        text = f"undecided: {', '.join(kept)} still cannot be told from {', '.join(still)}"
    elif len(kept) > 1:
        text = f"decided: {' and '.join(kept)} are there, side by side"
    else:
        text = f"decided: {kept[0]}"
    return Decision(kept, fell, still, text)


def follow_up(space: Space, fitted: Fitted, alternatives: dict[str, list[str]]) -> FollowUp | None:
    """None when nothing is confounded."""
    confused = {c: a for c, a in alternatives.items() if a}
    if not confused:
        return None
    cause = max(confused, key=lambda c: len(confused[c]))
    rivals = confused[cause]
    context = context_of(space, fitted.point.model)
    best: dict[bool, FollowUp] = {}  # with rests within a sweep, and without
    for name in shipped_names("protocols"):
        try:
            plan = build_plan(load_protocol(find("protocols", name)), load_rig(DEFAULT_RIG))
            groups = _played(plan, space)
        except PiezoRigError:
            continue
        if not groups:
            continue
        rests = any(rest_s(w.drive_v, plan.sample_rate) > RESTS_S for _, w in plan.conditions())
        worst = max(_cosine(groups, fitted, cause, rival, context) for rival in rivals)
        if rests not in best or worst < best[rests].cosine - 1e-6:
            top = max(float(w.drive_v.max()) for _, w in plan.conditions())
            best[rests] = FollowUp(name, [cause, *rivals], worst, _scaled(top, space))
    if False in best and best[False].cosine <= ENOUGH:
        return best[False]
    return min(best.values(), key=lambda f: f.cosine, default=None)


def rest_s(drive_v: FloatArray, rate: float) -> float:
    """Longest stay at rest after the first motion of a sweep (n,), s."""
    resting = np.abs(drive_v - REST_DRIVE_V) < 1e-9
    resting[: int(np.argmin(resting))] = False
    ends = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(int), [0]])))
    return float(np.max(ends[1::2] - ends[::2], initial=0)) / rate


def _scaled(top_v: float, space: Space) -> str:
    """How a protocol from 0 to ``top_v`` must be scaled to stay where the data were."""
    low, high = space.groups.ends_v
    if low <= AS_FAR * top_v and top_v <= (1.0 + AS_FAR) * high:  # nowhere new
        return ""
    return (f"scaled to the {low:.3g} to {high:.3g} V of these recordings, for it goes up to "
            f"{top_v:.3g} V")  # fmt: skip


def _played(plan: Plan, space: Space) -> list[Group]:
    """The drives of a plan, scaled to the data's own range."""
    top = max(float(w.drive_v.max()) for _, w in plan.conditions())
    if top <= 0:
        return []
    out = []
    for condition, wave in plan.conditions():
        drive = space.scales.low_v + space.scales.span_v * wave.drive_v / top
        step = max(1, drive.size // 20_000)
        drive = np.ascontiguousarray(drive[::step])
        time = np.arange(drive.size) * step / plan.sample_rate
        if np.ptp(drive) == 0:
            continue
        out.append(Group(
            time, drive, np.zeros((1, drive.size)), np.zeros(1), "virgin", ((0, drive.size),),
            half_loops(drive), condition.name, ((0,),),
        ))  # fmt: skip
    return out


def _cosine(groups: list[Group], fitted: Fitted, cause: str, rival: str, context: Context) -> float:
    """Cosine of two causes' signatures, every tenth of the base's tangent projected off."""
    model = fitted.point.model
    less = model.without(cause)
    kind = CAUSES[rival]
    assert issubclass(kind, Cause)
    variants = kind.variants(replace(context, model=less))
    trials = [trial for form in variants for trial in form]
    base, delta, other = [], [], []
    for g in groups:
        plain = g.predicted(less)
        delta.append(_cut(g.predicted(model) - plain))
        other.append(np.array([_cut(g.predicted(less.with_stage(t)) - plain) for t in trials]))
        base.append(_base(g))
    b, d, o = np.concatenate(base, 1), np.concatenate(delta), np.concatenate(other, 1)
    q, s, _ = np.linalg.svd(b.T, full_matrices=False)
    q = q[:, s > 1e-8 * s[0]]
    d = d - q @ (q.T @ d)
    o = o.T - q @ (q.T @ o.T)
    size = float(np.sqrt(d @ d))
    if size < 1e-9:
        return 1.0
    norm = np.sqrt(np.sum(o**2, axis=0))
    u, s, _ = np.linalg.svd(o / np.where(norm > 0, norm, 1.0), full_matrices=False)
    inside = u[:, s > 1e-3 * max(s[0], 1e-300)].T @ d
    return float(np.sqrt(inside @ inside)) / size


def _cut(values: FloatArray) -> FloatArray:
    cut = values[: values.size // THIN * THIN].reshape(-1, THIN).mean(axis=1)
    return cut - cut.mean()


def _base(group: Group) -> FloatArray:
    from piezo_rig.diagnosis.dictionary import _plays

    half = 0.5 * float(np.ptp(group.drive_v))
    r = half * np.arange(0, 25) / 25.0
    return np.array([_cut(x) for x in _plays(group.drive_v, r)])
