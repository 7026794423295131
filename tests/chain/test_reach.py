"""How far a drive goes along the curves of an actuator, by cases drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.chain.reach import reaches


@pytest.mark.parametrize(
    ("turns", "first", "later"),
    [
        # up from rest, down and up again on branches of the same length
        ([0, 10, 0, 10], [10, 0, 0], [0, 10, 10]),
        # beyond the largest past drive the first rise goes on
        ([0, 10, 0, 25], [10, 0, 25], [0, 10, 10]),
        # a minor loop is forgotten where it closes, and the branch from 10 goes on to its end
        ([0, 10, 4, 6, 0], [10, 0, 0, 0], [0, 6, 2, 10]),
        # through the mirror image of the largest drive the first rise goes on downwards
        ([0, 10, -30], [10, 30], [0, 20]),
        # a stop on the way is no turning point
        ([0, 4, 10, 5, 0], [4, 10, 0, 0], [0, 0, 5, 10]),
    ],
)
def test_legs_reach_along_the_branch_that_they_are_on(turns, first, later):
    for sign in (1.0, -1.0):
        got = reaches(sign * np.array(turns, dtype=float))
        np.testing.assert_allclose(got[0], first)
        np.testing.assert_allclose(got[1], later)
