"""Lost samples of an actuator whose reversible strain is bent, which the baseline's is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from piezo_rig.causes import named_model
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.in_turns import InTurns
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded

STUDY = pytest.param(3, 2, marks=pytest.mark.study)
RATE, SECONDS, BEND_UM = 2000.0, 12.0, 1.2


def walk(seed: int, samples: int) -> np.ndarray:
    """A smooth walk with holds, from 0 V; volts."""
    rng = np.random.default_rng(seed)
    noise = sosfiltfilt(butter(2, 1.5, fs=RATE, output="sos"), rng.standard_normal(samples + 4000))
    drive = 37.0 + 35.0 * np.tanh(0.8 * noise[2000 : samples + 2000] / noise.std())
    begins = np.linspace(0.0, drive[0], 400)
    return np.concatenate([begins, drive])[:samples]


@pytest.mark.parametrize(("seed", "lost"), [(2, 2), STUDY, (5, 0)])
def test_losses_are_told_beside_a_base_that_has_its_bend(seed, lost):
    samples = int(RATE * SECONDS)
    drive = walk(seed, samples + 10)
    moved = play(drive, np.linspace(0.5, 36.0, 10), 0.0216)
    moved += BEND_UM * (drive / 75.0) * (drive / 75.0 - 1.0)
    at = samples // 2 + int(np.argmax(np.abs(np.gradient(drive))[samples // 2 : -3000]))
    kept = np.delete(np.arange(samples + lost), np.s_[at : at + lost])
    seen = moved[kept] + 3e-3 * np.random.default_rng(seed).standard_normal(samples)
    sweeps = [recorded(drive[:samples], seen, RATE)]
    raw = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    start = plainly(raw, Point(starting_model(raw, named_model("classical"), "classical")))
    turns = InTurns(raw, sweeps, start, np.random.default_rng(0), lambda *_: None, False)
    turns._begin()
    (found,) = turns.early if lost else [None]
    if found is None:
        assert turns.early == []
    else:
        assert found.cause == "dropped-samples"
        assert [(b.count, abs(b.index - at) < 5) for b in found.breaks] == [(lost, True)]
    assert turns.start.point.model.stage("bend") is None  # the ladder's to find
