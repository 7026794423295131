"""What is reported is no more than is known: widths of intervals, and delays beside a creep."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, Parameter
from piezo_rig.diagnosis.chances import as_held
from piezo_rig.diagnosis.claimed import _no_finer
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.refusals import of_a_law

TABLE = Elements.from_curve(np.array([1.0, 75.0]), np.array([0.1, 0.12]))


def test_an_interval_is_wider_about_its_own_middle():
    assert as_held(1.0, 3.0) == pytest.approx((2.0 - 1.2, 2.0 + 1.2))


def test_an_interval_of_what_is_above_zero_stays_there():
    low, high = as_held(0.01, 1.0, logarithmic=True)
    assert low * high == pytest.approx(0.01 * 1.0)
    assert high / low == pytest.approx((1.0 / 0.01) ** 1.2)


@pytest.mark.parametrize(("ci95", "expected"), [
    ((519.99, 520.01), (519.948, 520.052)), ((519.0, 520.01), (519.0, 520.052)), (None, None),
])  # fmt: skip
def test_no_limit_is_known_better_than_instruments_agree(ci95, expected):
    found = _no_finer(Parameter(520.0, "V/s", ci95), 1e-4).ci95
    assert found == (expected and pytest.approx(expected))


@pytest.mark.parametrize("cause", ["slew-limit", "drive-clipping", "sensor-clipping"])
def test_limits_and_levels_are_such(cause):
    assert CAUSES[cause].known_to == 1e-4
    assert CAUSES["creep"].known_to == 0.0


def test_a_creep_that_begins_at_1_ms_and_not_at_10_is_late_by_what_it_adds():
    # relaxations of every time constant, of equal weight per decade: rate x the integral of tau
    # over the decade
    tau = np.logspace(-3.0, -2.0, 2001)
    late = 0.02 * np.trapezoid(tau, np.log10(tau))
    assert CAUSES["creep"].of(None, rate_per_decade=0.02).as_late_s == pytest.approx(late, rel=0.05)


@pytest.mark.parametrize(("cause", "name", "others"), [
    ("time-skew", "delay", {}), ("amplifier-lag", "tau", {}),
    # 10 um over 80 V are 37.5 um/s at 300 V/s
    ("rate-dependence", "lag_um", {"exponent": 0.9}),
])  # fmt: skip
@pytest.mark.parametrize(("seconds", "rate", "refused"), [
    (3e-5, 0.012, True), (8e-5, 0.012, False), (8e-5, 0.03, True), (3e-5, None, False),
])  # fmt: skip
def test_a_delay_is_no_finding_that_the_law_of_a_creep_leaves_open(
    cause, name, others, seconds, rate, refused
):
    model = Model((Maxwell.of(TABLE),), {}, "")
    size = 37.5 * seconds if name == "lag_um" else seconds
    model = model.with_stage(CAUSES[cause].of(None, **{name: size}, **others))
    if rate is not None:
        model = model.with_stage(CAUSES["creep"].of(None, rate_per_decade=rate))
    space = SimpleNamespace(groups=SimpleNamespace(travel_um=10.0, span_v=80.0))
    search = Search(space, None, np.random.default_rng(0), print, [], 1.0, 0, lambda a, b: True)
    why = of_a_law(search, SimpleNamespace(point=SimpleNamespace(model=model)), cause)
    assert (why is not None and "creep" in why) == refused
