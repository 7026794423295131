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


@pytest.mark.parametrize(("exponent", "window_s", "but", "at_one"), [
    (0.1, 0.027, "", True),  # its lowest: nearly no rate law at all
    (0.11, 0.027, "", False),
    (0.7, 1e-5, "", True),
    (0.7, 1e-5, "window_s", False),  # which has been looked for by itself
])  # fmt: skip
def test_a_law_that_has_run_into_a_limit_is_known_by_it(exponent, window_s, but, at_one):
    law = CAUSES["rate-dependence"].of(
        None, lag_um=0.01, exponent=exponent, window_s=window_s, widens=1.0
    )
    names = [("rate-dependence", n) for n in ("lag_um", "exponent", "window_s")]
    point = SimpleNamespace(model=SimpleNamespace(stage=lambda id: law), names=names)
    assert needed.at_a_limit(point, "rate-dependence", but) == at_one
