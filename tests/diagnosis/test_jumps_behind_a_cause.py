"""A jump in the only recording of a drive, that the baseline's own errors had hidden."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.in_turns import InTurns
from piezo_rig.identification import prepare
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.test_limits_of_the_fastest import PLAYED, limited

LIMIT = 2900.0  # V/s, of 3000 that are played


def jumping(x, t, rng):
    return x - 0.0791 * (np.arange(x.size) >= 0.3 * x.size) if np.ptp(x) > 9.0 else x


@pytest.mark.parametrize("sensor", [jumping, None])
def test_it_is_looked_for_once_more_beside_a_better_model(sensor):
    sweeps = recordings(
        conditions=PLAYED, before=lambda v: limited(v, LIMIT), sensor=sensor, repeats=1
    )
    raw = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    start = plainly(raw, Point(starting_model(raw, named_model("classical"), "classical")))
    turns = InTurns(raw, sweeps, start, np.random.default_rng(0), lambda *_: None, False)
    assert turns._cleaned()[0] == []
    turns.whole = turns.clean = raw
    stage = CAUSES["slew-limit"].of(None, limit=LIMIT)
    better = plainly(raw, Point(start.point.model.with_stage(stage)))
    step = SimpleNamespace(cause="slew-limit", fitted=better)
    ladder = SimpleNamespace(steps=[step], scans=[], last=better)
    turns.search = SimpleNamespace(monitored=[], ladder=ladder)
    assert turns._other_losses() == (sensor is not None)
    assert [(e.cause, len(e.events)) for e in turns.early] == (
        [("fringe-jump", 1)] if sensor is not None else []
    )
    # what was found stays to be found
    assert turns.start.point.model.stage("slew-limit") is None or sensor is None
