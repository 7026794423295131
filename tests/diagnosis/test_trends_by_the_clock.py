"""A drift is seen beside what the base gets wrong by the drive, however much that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.refit import gained, refit, settle
from piezo_rig.diagnosis.scan import scan
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun

PLAYED = (("0-30", 0.0, 30.0, 4.0), ("0-50", 0.0, 50.0, 2.0), ("0-75", 0.0, 75.0, 2.0),
          ("75-25", 25.0, 75.0, 2.0))  # fmt: skip


def of_no_name(x, drive, t):
    """Waves of 15 nm along the drive, up and down the other way round: no cause does this."""
    up = np.sign(np.gradient(drive))
    return x + 0.015 * up * np.sin(2.0 * np.pi * drive / 9.0) * np.sin(np.pi * drive / 75.0)


@pytest.mark.parametrize(("rate", "seen"), [(0.0, False), (12.0, True)])
def test_nothing_that_goes_by_the_drive_hides_it(rate, seen):
    space, plain = begun(recordings(
        conditions=PLAYED, effect=of_no_name, repeats=1,
        sensor=lambda x, t, rng: x + 1e-3 * rate * (t - t[0]),
    ))  # fmt: skip
    here = refit(space, plain)
    settle(space, here.point)
    found = scan(space, here, np.random.default_rng(0)).result
    chance = found.p_family[found.ids.index("thermal-drift")]
    assert chance < 1e-6 if seen else chance > 0.1
    # fitted, it is all that goes by the clock, and known beside whatever is wrong
    drift = CAUSES["thermal-drift"].of(None, rate=1.0)
    point = replace(here.point, model=here.point.model.with_stage(drift),
                    sizes=(*here.point.sizes, ("thermal-drift", "rate", 1.0)))  # fmt: skip
    fitted = refit(space, point)
    # trends of the dictionary's, which took its place, are no evidence against it
    assert (gained(fitted, here) > 20.0) == seen
    k = fitted.point.names.index(("thermal-drift", "rate"))
    error = float(np.sqrt(fitted.covariance[k, k]))
    assert fitted.point.model.stage("thermal-drift")["rate"] == pytest.approx(rate, abs=4.0 * error)
    assert error < 2.0
