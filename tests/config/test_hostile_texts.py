"""Protocols, rigs, calibrations and models that were spoiled: one clear error or a right reading.

What broke in the campaigns of `make study-fuzz` stands here by itself.
"""

from __future__ import annotations

import random
import warnings

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezo_rig.errors import PiezoRigError
from piezo_rig.studies.fuzz.formats import FORMATS
from piezo_rig.studies.fuzz.mutate import spoiled

TEXTS = ("protocol", "rig", "calibration", "model")


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    return {name: FORMATS[name].seeds(folder) for name in TEXTS}


def outcome(name, path) -> str:
    """The code of the error, empty for none; any other exception fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            FORMATS[name].read(path)
        except PiezoRigError as error:
            assert error.what
            return error.code
    return ""


@pytest.mark.parametrize("name", TEXTS)
def test_good_files_are_read(seeds, tmp_path, name):
    path = tmp_path / f"good{FORMATS[name].suffix}"
    read = []
    for data in seeds[name]:
        path.write_bytes(data)
        read.append(outcome(name, path))
    assert "" in read


@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=60, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(number=st.integers(0, 2**32))
def test_any_damage(seeds, tmp_path, name, number):
    chance, format = random.Random(number), FORMATS[name]
    path = tmp_path / f"spoiled{format.suffix}"
    path.write_bytes(spoiled(chance, chance.choice(seeds[name]), seeds[name], format.words))
    outcome(name, path)


HEAD = b'schema = "piezo-rig/protocol/1"\n[[condition]]\n'
TRIANGLE = b'waveform = "triangle"\nlower_v = %s\nupper_v = 10\nfrequency_hz = %s\ncycles = 2\n'
BROKE = {
    "a period of ages": ("protocol", HEAD + TRIANGLE % (b"0", b"1e-320")),
    "a level beyond numbers": ("protocol", HEAD + TRIANGLE % (b"-1e308", b"2")),
    "a way of ages": (
        "protocol",
        HEAD + b'waveform = "turning-points"\npoints_v = [0, 1e308, 0]\nslew_v_per_s = 2\n',
    ),
    "a crawl to the start": (
        "protocol",
        HEAD.replace(b"[[", b"approach_slew_v_per_s = 1e-310\n[[") + TRIANGLE % (b"1", b"2"),
    ),
}


@pytest.mark.parametrize("what", list(BROKE))
def test_what_broke_in_a_campaign(tmp_path, what):
    name, data = BROKE[what]
    path = tmp_path / f"broke{FORMATS[name].suffix}"
    path.write_bytes(data)
    assert outcome(name, path) == name  # the code of the error
