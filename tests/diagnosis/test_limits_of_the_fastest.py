"""A slew limit that only the fastest half loop reaches, and hardly."""

import numpy as np
import pytest

from piezo_rig.diagnosis.forms import walked
from piezo_rig.diagnosis.put_in import refitted
from piezo_rig.diagnosis.refit import refit, settle
from piezo_rig.diagnosis.scan import extended, scan
from tests.diagnosis.small_bench import RATE, recordings
from tests.diagnosis.spaces import begun, with_member

PLAYED = (("0-30", 0.0, 30.0, 4.0), ("0-50", 0.0, 50.0, 2.0), ("0-75", 0.0, 75.0, 20.0))
FASTEST = 2.0 * 75.0 * 20.0


def limited(drive, limit):
    out = drive.copy()
    for i in range(1, out.size):
        out[i] = out[i - 1] + np.clip(drive[i] - out[i - 1], -limit / RATE, limit / RATE)
    return out


def test_it_is_begun_at_its_whole_size():
    """A share of whichever limit has the same shape: the linear look may like a far lower one."""
    share = 0.99
    sweeps = recordings(conditions=PLAYED, before=lambda v: limited(v, share * FASTEST))
    space, plain = begun(sweeps)
    here = refit(space, plain)
    settle(space, here.point)
    found = scan(space, here, np.random.default_rng(0))
    i = found.result.ids.index("slew-limit")
    columns, trials = min(
        found.forms["slew-limit"], key=lambda f: abs(f[1][0]["limit"] - 0.85 * FASTEST)
    )
    point = extended(space, here, found.candidates[i], columns, found.likelihood, trials)
    begins = point.model.stage("slew-limit")["limit"]
    assert FASTEST - begins < 1.5 * (1.0 - share) * FASTEST
    fitted = refitted(space, here, found, i)
    below = FASTEST - fitted.point.model.stage("slew-limit")["limit"]
    assert below == pytest.approx((1.0 - share) * FASTEST, rel=0.15)


ONE_SPEED = (("0-70", 0.0, 70.0, 2.0),)  # one sweep from rest


def late(drive):
    t = np.arange(drive.size) / RATE
    return np.interp(t - 0.0013, t, drive)


@pytest.mark.parametrize(("plant", "expected"), [
    (lambda v: limited(v, 0.99 * 280.0), "slew-limit"), (late, "time-skew"),
])  # fmt: skip
def test_a_first_rise_tells_a_limit_from_a_delay_at_one_speed(plant, expected):
    """Later cycles are late by as much either way; the first rise begins on time by a limit."""
    space, plain = begun(recordings(conditions=ONE_SPEED, before=plant, repeats=1))
    here = refit(space, plain)
    settle(space, here.point)
    found = scan(space, here, np.random.default_rng(0))
    gained = {}
    for id in ("slew-limit", "time-skew"):
        fitted = refitted(space, here, found, found.result.ids.index(id))
        gained[id] = -np.inf if fitted is None else fitted.evidence - here.evidence
    assert max(gained, key=lambda id: gained[id]) == expected
    assert gained[expected] > 50.0


FOUR = tuple((f"0-{high:g}", 0.0, high, 4.0) for high in (18.75, 37.5, 56.25, 75.0))


@pytest.mark.study
def test_a_large_one_is_walked_to():
    """Most of the error is where it is not yet: the base has bent to that, and a descent hangs."""
    limit = 470.0  # of 600 V/s
    space, plain = begun(
        recordings(conditions=FOUR, before=lambda v: limited(v, limit), repeats=1)
    )
    off = refit(space, with_member(plain, "slew-limit", {"limit": limit / 50.0},
                                   limit=0.93 * limit), held=True)  # fmt: skip
    descended = refit(space, off.point, held=True)
    assert descended.point.model.stage("slew-limit")["limit"] < 0.97 * limit
    there = walked(space, descended, "slew-limit")
    assert there.point.model.stage("slew-limit")["limit"] == pytest.approx(limit, rel=1e-3)
