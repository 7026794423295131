"""The rate of a creep whose decades have rates of their own, against closed forms."""

import numpy as np
import pytest

from piezo_rig.causes.creep import FAST, SHARES, Creep, mean_rate
from piezo_rig.chain import Signal


def test_rates_that_agree_are_weighed_by_what_is_known_of_each():
    known = np.array([0.02, 0.02, 0.2])  # standard deviations: the third says next to nothing
    rates = np.array([1.0, 1.01, 1.3])
    mean, deviation, part = mean_rate(rates, np.diag(known**2))
    weight = 1.0 / known**2
    assert mean == pytest.approx(weight @ rates / weight.sum(), rel=1e-6)
    assert deviation == pytest.approx(weight.sum() ** -0.5, rel=1e-3)
    assert part == pytest.approx(weight / weight.sum(), rel=1e-3)


def test_rates_that_are_truly_unlike_leave_their_mean_as_open_as_they_scatter():
    rates = np.array([0.5, 0.8, 1.1, 1.4, 1.7, 0.9, 1.3])
    mean, deviation, _ = mean_rate(rates, 1e-8 * np.eye(7))
    assert mean == pytest.approx(rates.mean(), rel=1e-6)
    assert deviation == pytest.approx(rates.std(ddof=1) / np.sqrt(7), rel=0.06)


def test_a_common_scale_that_is_open_is_no_error_of_the_rate():
    """The rate and its shares are known as products only; the products are known well."""
    shares = np.array([1.2, 1.0, 0.9, 1.1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    model = Creep.of(None, rate_per_decade=0.02, **dict(zip(SHARES, shares, strict=True)))
    common = np.array([0.02, *(-shares)])  # along which no product changes
    known = np.diag([0.0, *np.full(5, 0.02), *np.full(6, 1.0)]) ** 2
    said = model.reported(known + 0.5**2 * np.outer(common, common))
    low, high = said["rate_per_decade"].ci95
    assert low < 0.02 * shares[:5].mean() < high
    assert high - low < 0.25 * 0.02
    scale = 0.02 / said["rate_per_decade"].value
    for name, share in zip(SHARES[:5], shares[:5], strict=True):
        assert said[name].value == pytest.approx(share * scale)
        assert np.ptp(said[name].ci95) < 0.4
    assert np.ptp(said["share_1000s"].ci95) > 3.0


def test_a_creep_without_shares_of_its_own_keeps_its_interval():
    model = Creep.of(None, rate_per_decade=0.02)
    said = model.reported(np.array([[1e-6]]))
    assert said["rate_per_decade"].ci95 == pytest.approx((0.02 - 1.96e-3, 0.02 + 1.96e-3))


def test_what_relaxes_before_10_ms_does_so_by_its_own_shares_and_is_no_part_of_the_rate():
    shares = dict.fromkeys(SHARES, 1.0) | {"share_1ms": 0.6, "share_3.2ms": 0.3}
    model = Creep.of(None, rate_per_decade=0.02, **shares)
    time = np.arange(400) * 1e-4
    step = np.where(time > 0.0, 1.0, 0.0)
    more = model.act(Signal(time, step, step)).displacement_um
    less = Creep.of(None, rate_per_decade=0.02).act(Signal(time, step, step)).displacement_um
    # half of the rate for each, two to a decade; a ramp over the first step, then relaxing on
    h, held, expected = 1e-4, time[:-1], 0.0
    for tau, share in ((1e-3, 0.6), (10**-2.5, 0.3)):
        lag = 1.0 - tau / h * -np.expm1(-h / tau)
        expected = expected + 0.5 * 0.02 * share * (1.0 - (1.0 - lag) * np.exp(-held / tau))
    assert more[1:] - less[1:] == pytest.approx(expected, abs=1e-12)
    said = model.reported(1e-4 * np.eye(14))
    assert said["rate_per_decade"].value == pytest.approx(0.02)
    assert [said[n].value for n in FAST] == pytest.approx([0.6, 0.3])
