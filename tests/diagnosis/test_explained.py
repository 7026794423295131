"""What a linear look leaves in doubt is taken in where it explains much of what is amiss."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.held_out import held_out_errors
from piezo_rig.diagnosis.in_doubt import explained
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.scan import scan
from tests.diagnosis.small_bench import RATE, recordings
from tests.diagnosis.spaces import begun

NOISE_NM = 2.0


def late(x, drive, t):
    return np.interp(t - 0.6 / RATE, t, x)


@pytest.fixture(scope="module")
def looked():
    space, plain = begun(recordings(late))
    first = refit(space, plain)
    return space, first, scan(space, first, np.random.default_rng(0))


def tried(looked, doubted: str, noise_nm: float = NOISE_NM) -> tuple[bool, list[str]]:
    """Whether anything is taken in, and what, if one cause alone has a chance of 0.004."""
    space, first, found = looked
    held_out = [(partial(lambda f, space: held_out_errors(space, f, "sweep").rms_nm, space=space),
                 1.03)]  # fmt: skip
    search = Search(space, first, np.random.default_rng(0), lambda text: None, held_out, noise_nm,
                    0, lambda less, fitted: True)  # fmt: skip
    family = np.array([0.004 if id == doubted else 1.0 for id in found.result.ids])
    return explained(search, first, found, family, of_the_rest=1.0), search.causes


def test_the_cause_that_is_there_is_taken_in(looked):
    assert tried(looked, "time-skew") == (True, ["time-skew"])


@pytest.mark.parametrize("wrong", ["initiation-stage", "periodic-nonlinearity", "cycle-aging"])
def test_one_that_explains_little_is_not(looked, wrong):
    assert tried(looked, wrong) == (False, [])


def test_nor_is_any_where_nothing_is_amiss(looked):
    space, first, _ = looked
    error_nm = held_out_errors(space, first, "sweep").rms_nm
    assert tried(looked, "time-skew", noise_nm=0.95 * error_nm) == (False, [])
