"""A given model that lacks causes is asked for gain and sensitivity, by its own recordings."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, recordings, relaxation

from piezo_rig.causes import load_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.since import compared, lacks_causes
from piezo_rig.errors import InputError
from piezo_rig.identification import identify, prepare, save_model


def creeping(share):
    """An actuator that goes on moving for seconds after each step: no springs and sliders do."""
    def effect(x, drive, t):
        return x + share * sum(relaxation(x, tau) for tau in (0.02, 0.06, 0.2, 0.6, 2.0))

    return effect


BEFORE = creeping(0.02)
PLAYED = CONDITIONS[1:]


def groups_of(sweeps):
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """A classical model, from a file, of recordings that it cannot follow."""
    model = identify(recordings(BEFORE, seed=3, conditions=PLAYED), "classical").model
    return load_model(save_model(model, tmp_path_factory.mktemp("reference") / "m.json"))


def test_the_reference_is_far_off_and_says_so(reference):
    assert reference.provenance["rms_nm"] > 20.0  # of 2 nm of noise
    groups = groups_of(recordings(BEFORE, seed=3, conditions=PLAYED))
    assert lacks_causes(reference, 2.0, groups)
    assert not lacks_causes(reference, 0.5 * reference.provenance["within_nm"], groups)
    beside_a_bend = reference.provenance | {"bent": {"rms_nm": 2.1, "stages": []}}
    assert not lacks_causes(reference.with_(provenance=beside_a_bend), 2.0, groups)


@pytest.mark.study
@pytest.mark.parametrize(
    ("cause", "changed"),
    [("sensor-scale", {"sensor": lambda x, t, rng: x / 1.01}),
     pytest.param("drive-gain", {"before": lambda drive: 1.01 * drive}, marks=pytest.mark.study)],
)  # fmt: skip
def test_gain_and_scale_are_named_and_told_apart(reference, cause, changed):
    found = diagnose(recordings(BEFORE, seed=3, conditions=PLAYED, **changed), reference)
    first, *others = found.findings
    assert first.cause == cause
    assert first.alternatives == []
    assert first.parameters["ratio"].value == pytest.approx(1.01, abs=3e-4)
    assert "creep" in [f.cause for f in others]  # what it lacked all the time
    assert [r.added for r in found.rungs[:3]] == ["classical", cause, "refitted"]
    assert found.rungs[0].finding is None
    assert found.rungs[1].finding == 0
    assert found.rungs[-1].rms_nm < 2.6
    # the extended model describes the recordings as they are
    for models, rung in ((found.rung_models[-1], found.rungs[-1]), (found.model, found.rungs[-1])):
        off = []
        for sweep in recordings(BEFORE, seed=3, conditions=PLAYED, **changed):
            left = sweep.displacement_um - models.simulate(sweep.time_s, sweep.drive_v, "virgin")
            off.append(left - left.mean())
        assert 1e3 * np.sqrt(np.mean(np.concatenate(off) ** 2)) < 1.1 * rung.rms_nm


@pytest.mark.study
def test_a_session_with_nothing_new_has_neither(reference):
    found = diagnose(recordings(BEFORE, seed=3, conditions=PLAYED), reference)
    assert not {"drive-gain", "sensor-scale"} & {f.cause for f in found.findings}
    assert any("it lacks causes" in note for note in found.notes)
    assert found.rungs[1].added == "refitted"


def test_what_is_neither_is_not_taken_for_one(reference):
    later = recordings(creeping(0.03), seed=3, conditions=PLAYED)
    both = compared(groups_of(later), later, reference)
    assert both.changed_um > 5e-3
    assert not both.like_a_scale


def test_drives_that_were_not_recorded_then_are_not_compared(reference):
    slower = recordings(BEFORE, seed=3, conditions=[(*c, 0.5) for c in PLAYED])
    assert compared(groups_of(slower), slower, reference) is None
    mixed = [s for s in recordings(BEFORE, seed=3, conditions=PLAYED) if s.condition != "0-50"]
    both = compared(groups_of(mixed), mixed, reference)
    assert len(both.blocks) == len(PLAYED) - 1
    assert both.scale == pytest.approx(1.0, abs=3e-4)


@pytest.mark.parametrize("damage", ["text", "short", "missing"])
def test_damaged_recordings_in_a_model_file_are_said(reference, tmp_path, damage):
    path = save_model(reference, tmp_path / "m.json")
    body = json.loads(path.read_text())
    entry = body["provenance"]["recorded"][0]
    if damage == "missing":
        del entry["drive_v"]
    else:
        entry["drive_v"] = entry["drive_v"][:5] if damage == "short" else "none"
    path.write_text(json.dumps(body))
    later = recordings(BEFORE, seed=3)
    with pytest.raises(InputError, match="damaged"):
        compared(groups_of(later), later, load_model(path))
