"""Which stages of a model a compensation inverts, which it leaves out, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from piezo_rig.chain import Model, Stage
from piezo_rig.chain.increments import Operation
from piezo_rig.compensation.tables import increment_of, tables_of

IMPULSE = 4000  # samples
SETTLED = 1e-3
SLOW_V_PER_S = 1.0


@dataclass(frozen=True)
class Treatment:
    """What becomes of one stage: ``inverted``, ``led`` or ``left out``; ``why`` in words."""

    id: str
    place: str
    how: str
    why: str = ""


def treat(model: Model, step_s: float, free_end: bool) -> tuple[Model, float, list[Treatment]]:
    """The part of a model that is inverted, the lead, and what becomes of every stage.

    Parameters
    ----------
    step_s : of the target
    free_end : the actuator's own motion follows the target, whenever the record shows it

    Returns
    -------
    model : stages of drive and actuator that can be inverted
    lead_s : how much ahead of the record the drive has to be
    treatments : one for every stage, in order
    """
    branches = model.branches()
    kept: list[Stage] = []
    lead_s, treatments = 0.0, []
    for stage in model.stages:
        why = ""
        if stage.locked_to != "drive":
            why = "locked to the clock, not to the drive: nobody can foretell it"
        elif stage.id == "time-skew" and not free_end:
            lead_s += stage["delay"]
            treatments.append(Treatment(stage.id, stage.place, "led", (
                f"the drive is {1e3 * stage['delay']:.4g} ms ahead of the target, so that the "
                "record is in time; --free-end leaves it out")))  # fmt: skip
            continue
        elif stage.place in ("sensor", "acquisition"):
            why = "behind the free end of the actuator, which is what follows the target"
        elif stage.id == "remanence":
            why = "memory of recordings before this one; the start is virgin"
        else:
            increment = increment_of(stage, branches)
            if isinstance(increment, str):
                why = increment
            elif increment is not None and increment.operation is Operation.MODE:
                why = "" if _settles(increment.numbers, step_s) else (
                    "so large a share rides on the mode that its inverse would not come to rest")
        if why:
            treatments.append(Treatment(stage.id, stage.place, "left out", why))
        else:
            kept.append(stage)
            treatments.append(Treatment(stage.id, stage.place, "inverted"))
    kept_model = model.with_(stages=tuple(kept))
    slow = partly_below(kept_model)
    for i, t in enumerate(treatments):
        if t.how == "inverted" and t.id in slow:
            treatments[i] = replace(t, why=f"below {slow[t.id]:.3g} V/s only in part: there the "
                                    "drag of the model would outrun the drive")  # fmt: skip
    return kept_model, lead_s, treatments


def partly_below(model: Model) -> dict[str, float]:
    """Speeds of the drive, V/s, below which a stage's drag is bounded, by its id."""
    tables, branches = tables_of(model, steady=True), model.branches()
    ids = [s.id for s in model.stages if increment_of(s, branches) is not None]
    found = {}
    for id, n, cap in zip(ids, tables.numbers, tables.caps, strict=True):
        if not np.isfinite(cap) or n[0] <= 0.0 or (n[1] >= 1.0 and n[0] <= cap):
            continue
        speed = n[3] * (n[0] / cap) ** (1.0 / (1.0 - n[1])) if n[1] < 1.0 else np.inf
        if speed > SLOW_V_PER_S:
            found[id] = float(speed)
    return found


def _settles(numbers: tuple[float, ...], step_s: float) -> bool:
    """Whether the inverse of a mode comes to rest after an impulse, at this sampling."""
    from piezo_rig.compensation import operations

    n = np.zeros(24)
    n[: len(numbers)] = numbers
    cache, old, new = np.zeros(24), np.zeros(16), np.zeros(16)
    operations.prepare(operations.MODE, n, step_s, cache)
    path = np.zeros(IMPULSE)
    for k in range(1, IMPULSE):
        wanted = 1.0 if k == 1 else 0.0
        zero = operations.step(operations.MODE, n, 0.0, cache, old, new, 0.0, 0.0)
        one = operations.step(operations.MODE, n, 0.0, cache, old, new, 1.0, 0.0)
        if not one - zero > 1e-3:
            return False
        path[k] = (wanted - zero) / (one - zero)
        operations.step(operations.MODE, n, 0.0, cache, old, new, path[k], 0.0)
        old[:] = new
        if abs(path[k]) > 1e6:
            return False
    return bool(np.abs(path[-IMPULSE // 8 :]).max() < max(SETTLED, 0.5 * np.abs(path).max()))
