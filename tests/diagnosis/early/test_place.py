"""Where a jump is, in a neighbourhood of many samples as in one of few."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.early.mended import JUMP, STEP_UM
from piezo_rig.diagnosis.early.place import placed
from piezo_rig.diagnosis.early.traces import NONE, Stretch


@pytest.mark.parametrize(("rate", "at"), [(1e3, 1000), (5e3, 3001), (5e4, 20_007)])
def test_a_jump_is_placed_to_the_sample_at_any_rate(rate, at):
    rng = np.random.default_rng(int(rate))
    n, factor = int(0.8 * rate), max(1, round(rate / 1000.0))
    at = min(at, n // 2)
    own = 0.005 * rng.standard_normal(n) + np.where(np.arange(n) >= at, -2.0 * STEP_UM, 0.0)
    stretch = Stretch(0, 0, n, factor, NONE[0], NONE, NONE)
    index, low, high, worth = placed(own, np.zeros(n), JUMP, at + 7 * factor, -2, stretch)
    assert low <= index <= high
    assert index == at
    assert worth > 100.0
    assert placed(own[: at - 1], np.zeros(at - 1), JUMP, at // 2, -2,
                  Stretch(0, 0, at - 1, factor, NONE[0], NONE, NONE)) is None  # fmt: skip
