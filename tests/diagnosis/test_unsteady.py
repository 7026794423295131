"""Gains that differ between recordings are no noise; noise of any colour is no gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.noise import Spectrum
from piezo_rig.diagnosis.unexplained import Unexplained, unexplained
from piezo_rig.diagnosis.unsteady import unsteady
from piezo_rig.diagnosis.whitening import CellWhitener
from piezo_rig.identification import prepare
from tests.diagnosis.two_drives import session


@pytest.mark.study
@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("gain", [
    lambda number, time: 0.004 * (number >= 4), lambda number, time: 0.006 * np.sin(0.9 * time),
], ids=["a step", "a wave"])  # fmt: skip
def test_what_follows_the_displacement_is_unexplained(colour, gain):
    found = diagnose(session(5, colour, gain)).unexplained
    assert found.detected
    assert "is not steady" in found.text
    assert {"displacement", "clock"} <= set(found.depends_on)


@pytest.mark.study
@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_is_not(colour, seed):
    assert "is not steady" not in diagnose(session(seed, colour, lambda *_: 0.0)).unexplained.text


def test_what_all_repeats_agree_on_is_unexplained_whatever_it_looks_like():
    """Errors of recordings that were left out, against what their repeats differ by."""
    plain = diagnose(session(7, "white", lambda *_: 0.0))
    assert not plain.unexplained.detected
    space, last, floor = plain.workings.space, plain.workings.last, plain.noise_floor_nm

    def of(held_out_nm: float) -> Unexplained:
        return unexplained(space, last, floor, 0.0, np.random.default_rng(0), held_out_nm)

    assert not of(1.1 * floor).detected
    found = of(2.0 * floor)
    assert found.detected
    assert found.rms_nm == pytest.approx(np.sqrt(3.0) * floor)
    assert found.depends_on


def test_where_nothing_moves_nothing_is_unsteady():
    sweeps = session(1, "white", lambda *_: 0.0)
    groups = group_tracks(prepare(sweeps), sweeps)
    model = starting_model(groups, (), "classical")
    still = groups.with_([replace(g, drive_v=np.full_like(g.drive_v, 5.0)) for g in groups.groups])
    white = CellWhitener(Spectrum(np.array([1e-6, 0.5]), np.log([4e-6, 4e-6]), np.zeros(2)))
    found = unsteady(still, white, model)
    assert found.p_value == 1.0
    assert found.rms_nm == 0.0
