"""Which part of many recordings is looked at first, at full rate."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.chain import half_loops
from piezo_rig.diagnosis import part as room
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.part import part_of

RATE = 5000.0


def triangles(top, cycles):
    up = np.linspace(0.0, top, 1251)
    return np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), 0.0)


def group(top, cycles=10):
    drive = triangles(top, cycles)
    return Group(
        np.arange(drive.size) / RATE, drive, np.vstack([drive, drive]), np.zeros(2), "virgin",
        ((0, drive.size),), half_loops(drive), f"0-{top}", ((0,), (1,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def matrix():
    return Groups(tuple(group(top) for top in range(5, 80, 5)), RATE, 11)


def test_what_is_not_thinned_has_no_part(matrix):
    assert part_of(Groups(matrix.groups, RATE, 1)) is None
    assert part_of(Groups(matrix.groups, 10 * RATE, 10)) is None


def test_a_part_spans_all_ranges_at_full_rate_and_begins_where_they_begin(matrix):
    part = part_of(matrix)
    assert part.thinned_rate >= 4000.0
    tops = [g.drive_v.max() for g in part.groups]
    assert len(tops) >= 8
    assert max(tops) == 75.0
    assert min(tops) == 5.0
    assert sum(g.drive_v.size for g in part.groups) <= room.ENOUGH
    for g in part.groups:
        n = g.drive_v.size
        assert np.array_equal(g.drive_v, triangles(g.drive_v.max(), 10)[:n])
        assert g.measured_um.shape == (2, n)
        assert g.blocks == ((0, n),)
        assert g.loops.stop[-1] == n - 1
        assert g.drive_v[-1] in (0.0, g.drive_v.max())  # a turning point


def test_one_long_recording_keeps_its_beginning():
    part = part_of(Groups((group(75.0, 300),), RATE, 11))
    (only,) = part.groups
    assert 0.9 * room.ENOUGH < only.drive_v.size <= room.ENOUGH + 1
