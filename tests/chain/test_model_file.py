"""Model files: the same bytes, and words for every damage."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_models import lawful, play, ride

from piezo_rig.causes import load_model
from piezo_rig.chain import save_model
from piezo_rig.errors import InputError


def test_a_model_comes_back_as_it_was_written(tmp_path):
    model = lawful("range-extremum")
    first = save_model(model, tmp_path / "a.json").read_bytes()
    again = load_model(tmp_path / "a.json")
    assert save_model(again, tmp_path / "b.json").read_bytes() == first
    drive = ride([0, 12, 0, 12, 3], 40)
    assert np.array_equal(play(model, drive), play(again, drive))


def damaged():
    yield "not JSON", lambda b: b[:-40]
    yield "binary", lambda b: b"\x89HDF\r\n\x00\xff"
    yield "empty", lambda b: b""
    yield "a list", lambda b: b"[]"
    yield "deep", lambda b: b"[" * 100000
    for key, value in (
        ("schema", "piezo-rig/model/9"),
        ("stages", None),
        ("stages", [{"id": "maxwell"}]),
        ("stages", []),
        ("stages", [{"id": "levitation"}]),
        ("stages", [{"id": ["maxwell"]}]),
        ("provenance", 3),
    ):
        yield (
            f"{key} {value}",
            lambda b, k=key, v=value: json.dumps(json.loads(b) | {k: v}).encode(),
        )
    for old, new in (
        (b'"value": 0.03', b'"value": "x"'),
        (b'"value": 0.03', b'"value": NaN'),
        (b'"value": 0.03', b'"value": 1e999'),
        (b'"unit": "V/um/V"', b'"unit": "mV"'),
        (b'"k_v_per_um": 5.0', b'"k_v_per_um": -5.0'),
        (b'"k_v_per_um": 5.0', b'"k_v_per_um": null'),
        (b'"slides_at_um": 0.6', b'"slides_at_um": 6.0'),
        (b'"f_v": 0.36', b'"f_v": 0.4'),
        (b'"place": "actuator"', b'"place": "actuator", "elements": 3'),
    ):
        yield f"{old} -> {new}", lambda b, o=old, n=new: b.replace(o, n)


@pytest.mark.parametrize(("what", "damage"), list(damaged()))
def test_damage_is_refused_in_words(tmp_path, what, damage):
    path = save_model(lawful("range"), tmp_path / "m.json")
    body = path.read_bytes()
    changed = damage(body)
    assert changed != body
    path.write_bytes(changed)
    if "elements" in what and "place" in what:
        load_model(path)  # the later, true table wins: JSON keeps the last of two equal keys
        return
    with pytest.raises(InputError, match=r"m\.json") as refused:
        load_model(path)
    assert refused.value.cause
    assert refused.value.remedy


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.json"):
        load_model(tmp_path / "nowhere.json")


def test_tables_of_springs_and_forces_can_be_typed_in(tmp_path):
    rows = [{"k_v_per_um": 2.0, "f_v": 1.0}, {"k_v_per_um": 6.0, "f_v": 6.0}]
    body = {"schema": "piezo-rig/model/1", "stages": [{"id": "maxwell", "elements": rows}]}
    path = tmp_path / "typed.json"
    path.write_text(json.dumps(body))
    y = play(load_model(path), np.array([0.0, 4.0, 10.0]))
    assert y == pytest.approx([0.0, 0.5, 1.5])
