"""A law of the first spring that is begun at its size leaves its constant part to the table."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.steep import _tabled

TABLE = Elements.from_curve(np.array([1.0, 4.0, 12.0, 30.0]), np.array([0.09, 0.1, 0.11, 0.13]))
UP_TO_V = np.array([60.0, 25.0, 75.0, 40.0])


def loops(number_of_samples=400):
    """Triangles from 0 V, each to another voltage."""
    way = np.linspace(0.0, 1.0, number_of_samples)
    drive = np.concatenate([np.concatenate([v * way, v * way[::-1]]) for v in UP_TO_V])
    return 1e-3 * np.arange(drive.size), drive


@pytest.mark.parametrize("id", ["range-dependence", "extremum-dependence"])
@pytest.mark.parametrize("offset", [-1.2, 0.8])
def test_with_its_constant_part_in_the_table_the_model_goes_on_as_before(id, offset):
    law = CAUSES[id].of(None, slope=0.02, offset=offset, reach=0.3, closing=0.0, taper=0.0)
    model = Model((Maxwell.of(TABLE), law))
    sizes = ((id, "slope", 0.02), (id, "offset", abs(offset)), (id, "reach", 0.03))
    tabled = _tabled(Point(model, sizes=sizes), id)
    assert tabled.model.stage(id)["offset"] == 0.0
    assert [name for _, name, _ in tabled.sizes] == ["slope", "reach"]
    time, drive = loops()
    later = slice(drive.size // UP_TO_V.size, None)  # a first rise has no turn behind it
    before, after = (
        m.simulate(time, drive, "virgin")[later] for m in (model, tabled.model)
    )
    moved = before - before[0] - (after - after[0])
    assert np.abs(moved).max() < 1e-9
    without = Model((Maxwell.of(TABLE), law.with_values(offset=0.0)))
    lost = without.simulate(time, drive, "virgin")[later]
    assert np.abs(before - before[0] - (lost - lost[0])).max() > 0.01
