"""The bend beside a named model: told where there is one, and the model stays what it is."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.causes import STAGES, load_model
from piezo_rig.chain.elements import Elements
from piezo_rig.chain.model_file import bent_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.held import own_um_of
from piezo_rig.errors import InputError
from piezo_rig.identification import identify, prepare, save_model
from piezo_rig.studies.hidden import draw


def bodies(bent):
    """Recordings of actuators with and without a bend, before anything was hidden in them."""
    for seed in range(50, 70):
        case = draw("null", seed, "rates", "white")
        if any(case.body.curvature) == bent:
            yield case


@pytest.fixture(scope="module")
def curved():
    case = next(bodies(True))
    return case, identify(case.sweeps, "classical").model


def test_a_named_model_stays_springs_and_sliders(curved):
    _, model = curved
    assert [s.id for s in model.stages] == ["maxwell"]


def test_beside_its_bend_the_fit_comes_down_to_the_noise(curved):
    case, model = curved
    told = model.provenance["bent"]
    assert [s["id"] for s in told["stages"]] == ["maxwell", "bend"]
    assert model.provenance["rms_nm"] > 1.3 * case.noise.rms_nm
    assert 0.9 * case.noise.rms_nm < told["rms_nm"] < 1.1 * case.noise.rms_nm


@pytest.mark.parametrize("older", [False, True])
def test_with_its_bend_a_model_is_held_to_what_both_were_off_by(curved, older):
    case, model = curved
    if older:  # a file by a version that did not tell what is within the drives from the rest
        told = {k: v for k, v in model.provenance["bent"].items() if k != "within_nm"}
        model = model.with_(provenance=model.provenance | {"bent": told})
    groups = group_tracks(prepare(case.sweeps, first_rises=True), case.sweeps)
    noise_um = 1e-3 * case.noise.rms_nm
    assert own_um_of(model, groups) > 1.3 * noise_um
    assert own_um_of(bent_model(model, STAGES), groups) == pytest.approx(noise_um, rel=0.1)


def test_both_together_do_what_the_actuator_does(curved):
    case, model = curved
    table, bend = model.provenance["bent"]["stages"]
    elements = Elements.from_rows(table["elements"], "maxwell")
    value = {n: p["value"] for n, p in bend["parameters"].items()}
    off = []
    for sweep in case.sweeps:
        play = np.zeros(sweep.samples)
        # springs and sliders in their own definition, one after the other
        drive, move = sweep.drive_v, np.zeros(sweep.samples)
        knots, slopes = elements.knots_v, 1.0 / elements.slopes
        for k, step in enumerate(np.diff(slopes, prepend=0.0)):
            width = 0.0 if k == 0 else knots[k - 1]
            at = 0.0
            for i, v in enumerate(drive[::10] - drive[0]):
                at = min(max(at, v - width), v + width)
                play[i * 10] = at
            move[::10] += step * play[::10]
        u = (drive - value["from_v"]) / value["over_v"]
        powers = {"square": 2, "cube": 3, "fourth": 4, "fifth": 5}
        move += sum(value[n] * u**p for n, p in powers.items())
        error = (sweep.displacement_um - move)[::10]
        off.append(error - error.mean())
    assert 1e3 * np.std(np.concatenate(off)) < 1.15 * case.noise.rms_nm


def test_nothing_is_told_where_there_is_no_bend():
    straight = bodies(False)
    for case in (next(straight), next(straight)):
        assert "bent" not in identify(case.sweeps, "classical").model.provenance


def test_a_damaged_bend_is_refused_in_words(curved, tmp_path):
    _, model = curved
    path = save_model(model, tmp_path / "m.json")
    body = json.loads(path.read_text())
    half = {"rms_nm": 1.0}
    for broken in ("no", half, {"rms_nm": "x", "stages": []}, half | {"stages": [3]}):
        body["provenance"]["bent"] = broken
        path.write_text(json.dumps(body))
        with pytest.raises(InputError, match=r"m\.json"):
            load_model(path)


def test_the_same_recordings_give_the_same_bend(curved):
    case, model = curved
    again = identify([replace(s) for s in case.sweeps], "classical").model
    assert again.provenance["bent"] == model.provenance["bent"]
