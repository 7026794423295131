"""How large effects are made, so that an oracle sees each of them as plainly as was asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.scoring.noise import Noise
from piezo_rig.scoring.oracle import Oracle, size_for
from piezo_rig.studies.hidden.body import Body
from piezo_rig.studies.hidden.effects import Effect
from piezo_rig.studies.hidden.locked import locked
from piezo_rig.studies.hidden.protocols import Condition
from piezo_rig.studies.hidden.session import Session

FloatArray = NDArray[np.float64]
ROUNDS = 4  # in which effects are sized beside each other
NEAR = 0.01


def sized(
    effects: Sequence[Effect], wanted: float, body: Body, conditions: Sequence[Condition],
    noise: Noise, repeats: int, seed: int,
) -> tuple[list[Effect], list[float]]:  # fmt: skip
    """Effects of the size that is asked for, and the d' of each.

    Parameters
    ----------
    wanted : d' of each; of several, of what is left of it once the others are projected off
    seed : of the session whose clock and events are seen
    """
    if not effects:
        return [], []
    oracle = Oracle.of([c.drive_v for c in conditions], noise, repeats)
    change = changes_of(body, conditions, repeats, seed)

    out, seen = [], []
    for e in effects:

        def visible(size: float, e: Effect = e) -> float:
            return oracle.d_prime(change(e.sized(size)))

        size, here = size_for(wanted, visible, e.start, e.most)
        if size < e.least:
            size, here = e.least, visible(e.least)
        out.append(e.sized(size))
        seen.append(here)
    if len(out) == 1:
        return out, seen
    for _ in range(ROUNDS):
        seen = apart(oracle, [change(e) for e in out], repeats)
        if all(d > (1.0 - NEAR) * wanted or e.size >= e.most
               for d, e in zip(seen, out, strict=True)):  # fmt: skip
            break
        out = [e.sized(min(e.size * max(wanted / max(d, 1e-300), 1.0), e.most))
               for e, d in zip(out, seen, strict=True)]  # fmt: skip
    return out, apart(oracle, [change(e) for e in out], repeats)


def changes_of(
    body: Body, conditions: Sequence[Condition], repeats: int, seed: int
) -> Callable[[Effect], list[FloatArray]]:
    """What an effect changes, um, condition by condition; of every recording, if by the clock."""
    bare = [locked(body, (), c.time_s, c.drive_v) for c in conditions]

    def change(e: Effect) -> list[FloatArray]:
        if e.clock_locked:
            rng = np.random.default_rng([seed, 6])
            session = Session.of(tuple(conditions), repeats, (e,), rng)
            n = len(conditions)
            return [session.added(k, conditions[k % n], bare[k % n])
                    for k in range(len(session.starts_s))]  # fmt: skip
        return [locked(body, (e,), c.time_s, c.drive_v) - x
                for c, x in zip(conditions, bare, strict=True)]  # fmt: skip

    return change


def apart(oracle: Oracle, changes: Sequence[list[FloatArray]], repeats: int) -> list[float]:
    """d' of what is left of each change off the others."""
    most = max(len(c) for c in changes)
    whole = [c * repeats if len(c) < most else c for c in changes]
    gram = oracle.gram([np.column_stack(rows) for rows in zip(*whole, strict=True)])
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    apart = np.linalg.pinv(gram / np.outer(size, size), hermitian=True)
    return [float(d) for d in size / np.sqrt(np.maximum(np.diag(apart), 1.0))]
