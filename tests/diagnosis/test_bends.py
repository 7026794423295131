"""When a memoryless bend is taken into the base."""

from __future__ import annotations

import numpy as np

from piezo_rig.diagnosis.climb import climb
from piezo_rig.diagnosis.held_out import held_out_errors
from piezo_rig.diagnosis.refit import refit
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun


def bent(x, drive, t):
    u = drive / 75.0
    return x - 0.42 * u**2 + 0.08 * u**3


def ladder(second):
    """Of what is climbed with a second way of holding out."""
    space, plain = begun(recordings(bent))
    found = climb(
        space, refit(space, plain), np.random.default_rng(0), lambda text: None,
        [(lambda f: held_out_errors(space, f, "sweep").rms_nm, 1.1), (second, 2.0)], 2.0,
    )  # fmt: skip
    return [step.cause for step in found.steps]


def test_a_bend_is_taken_in_though_the_first_cycles_alone_do_not_foretell_it():
    """One loop says little of what is bend and what is table; repeats say all of it."""
    assert ladder(lambda f: 238.0 if f.point.model.stage("bend") else 36.0) == ["bend"]
