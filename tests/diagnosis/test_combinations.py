"""Several effects at once: each is named, and nothing else."""

from __future__ import annotations

import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw


@pytest.mark.parametrize(
    ("kind", "seed", "protocol", "noise"),
    [
        ("pair", 907, "holds", "1/f"),  # a law and a drift: neither carries over alone
        ("pair", 906, "matrix", "white"),  # a lag under spikes
    ],
)
def test_effects_that_hide_each_other_are_all_named(kind, seed, protocol, noise):
    case = draw(kind, seed, protocol, noise)
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == set(case.truth.causes)
    assert not found.unexplained.detected
