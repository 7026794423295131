"""A law of the range before whose gain is given back further on: the loop ends where it would."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import diagnose
from tests.diagnosis.small_bench import recordings


def bump(um_per_v2):
    """What a half loop adds: u exp(-u / 8 V) along the volts u since it began, for every volt by
    which the one before it was longer or shorter than 40.
    """
    def effect(x, drive, t):
        out, steps = x.copy(), np.sign(np.diff(drive))
        turns = np.flatnonzero(np.diff(steps) != 0) + 1
        ends = [*turns, drive.size - 1]
        begin, before = 0, None
        for end in ends:
            if before is not None:
                u = np.abs(drive[begin : end + 1] - drive[begin])
                gained = um_per_v2 * (before - 40.0) * u * np.exp(-u / 8.0)
                out[begin : end + 1] += steps[begin] * gained
            before, begin = abs(drive[end] - drive[begin]), end
        return out

    return effect


@pytest.mark.study
@pytest.mark.parametrize(("kind", "seed"), [
    ("white", 0), *((k, s) for k in ("white", "1/f", "ar") for s in (1, 2)),
])  # fmt: skip
def test_it_is_named(kind, seed):
    size = 2e-4 if kind == "ar" else 7e-5  # in slow noise the smaller one does not show
    found = diagnose(recordings(bump(size), kind=kind, seed=seed))
    assert [f.cause for f in found.findings] == ["range-dependence"]
    assert found.findings[0].parameters["closing"].value == 1.0


def test_what_it_adds_is_taken_back_at_twice_the_reach():
    """Beside springs and no slider, a half loop is where it would be without the law."""
    table = Elements.from_curve(np.array([60.0]), np.array([0.1]))
    law = CAUSES["range-dependence"].of(
        None, slope=0.01, offset=0.0, reach=1.0, closing=1.0, taper=0.0
    )
    up = np.linspace(0.0, 60.0, 601)
    drive = np.concatenate([up, up[-2::-1], up[1:]])
    time = np.arange(drive.size) * 1e-3
    plain = Model((Maxwell.of(table),)).simulate(time, drive, "virgin")
    bent = Model((Maxwell.of(table), law)).simulate(time, drive, "virgin")
    moved = np.abs(plain - plain[600])[600:1200]
    added = np.abs(bent - plain)[600:1200]
    assert added[moved >= 2.2].max() < 1e-9
    assert added[(moved > 0.3) & (moved < 1.5)].min() > 1e-3
