"""Members that the data cannot tell from what looks the same come to nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Context
from piezo_rig.diagnosis import needed


@pytest.mark.parametrize(("slews", "nothing"), [((250.0, 250.0), True), ((250.0, 60.0), False)])
def test_so_does_a_slew_limit_just_below_the_only_speed(slews, nothing, monkeypatch):
    stage = CAUSES["slew-limit"].of(None, limit=249.9)
    model = SimpleNamespace(stage=lambda id: stage, without=lambda id: None)
    point = SimpleNamespace(model=model, names=[("slew-limit", "limit")])
    context = Context(None, 8.0, 60.0, np.array(slews), 1e-3, 1.0, 1e3)
    monkeypatch.setattr(needed, "context_of", lambda *_: context)
    monkeypatch.setattr(needed, "playable", lambda *_: False)  # the member does much
    assert needed.does_nothing(SimpleNamespace(), point, "slew-limit") == nothing
