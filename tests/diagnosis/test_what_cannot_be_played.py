"""What cannot be played beside the model at hand ends no diagnosis."""

from types import SimpleNamespace

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import offsets
from piezo_rig.diagnosis import scan as scans
from piezo_rig.diagnosis.refit import refit, settle
from piezo_rig.errors import InputError
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun


def test_an_example_that_cannot_be_played_is_left_out_of_a_scan(monkeypatch):
    space, plain = begun(recordings())
    fitted = refit(space, plain)
    settle(space, fitted.point)
    creep = CAUSES["creep"].of(None, rate_per_decade=0.002)
    backwards = CAUSES["range-dependence"].of(None, slope=-100.0, offset=0.0)
    tried = [
        scans.Candidate("range-dependence", ((backwards,),)), scans.Candidate("creep", ((creep,),)),
    ]
    monkeypatch.setattr(scans, "candidates", lambda space, model: (tried, {}))
    found = scans.scan(space, fitted, np.random.default_rng(0)).result
    assert found.ids == ("creep",)
    assert "not even a small one" in found.refused["range-dependence"]


def test_offsets_are_those_of_all_recordings_where_one_alone_says_too_little(monkeypatch):
    sweeps = [s.with_(source=f"{s.name}.csv") for s in recordings()]
    space, plain = begun(sweeps)
    fitted = refit(space, plain)

    def beyond(drive_v, history):
        raise InputError("slope-not-positive", "too far out", "", "")

    alone = SimpleNamespace(model=SimpleNamespace(place_um=beyond))
    monkeypatch.setattr(offsets, "refold", lambda *_: alone)
    found = dict(offsets.recording_offsets(space, space.groups, fitted, sweeps))
    assert len(found) == len(sweeps)
    assert max(abs(v) for v in found.values()) < 0.01  # noise of 2 nm, and what is not known yet
