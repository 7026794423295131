"""Rate laws of shapes that no descent leads to from one another."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import diagnose, late
from piezo_rig.diagnosis.fit import Point
from piezo_rig.run_file import Sweep

RATE, NOISE_UM = 2000.0, 3e-3
THRESHOLDS = np.sort(np.random.default_rng(41).weibull(1.2, 90) * 12.0)
WEIGHTS = np.random.default_rng(42).gamma(2.0, 1.0, 90) * np.exp(-THRESHOLDS / 22.0)
WEIGHTS *= 0.03 / WEIGHTS.sum()


def of_a_share(speed):
    """Wider by 3 % of themselves for every e-folding of 1 and the speed over 300 V/s."""
    return THRESHOLDS * (1.0 + 0.03 * np.log1p(speed / 300.0))


def by_volts(speed):
    """All wider by 0.35 V at 300 V/s, by the power 0.4 of the speed."""
    return THRESHOLDS + 0.35 * (speed / 300.0) ** 0.4


def moved(drive, speed, thresholds):
    """A spring and play operators whose thresholds are those of the speed (n,) at hand."""
    state, out = np.zeros(THRESHOLDS.size), np.empty(drive.size)
    for k, v in enumerate(drive):
        r = thresholds(speed[k])
        state = np.clip(state, v - r, v + r)
        out[k] = 0.12 * v + WEIGHTS @ state
    return out


def followed(rate, within_s):
    """The size of a rate (n,) taken over so many seconds."""
    out, now, share = np.empty(rate.size), 0.0, -np.expm1(-1.0 / RATE / within_s)
    for k, r in enumerate(rate):
        now += (r - now) * share
        out[k] = now
    return np.abs(out)


def session(waves, thresholds, noise, within_s=None):
    """Every wave twice, from rest."""
    out = []
    for number, (name, drive) in enumerate(2 * waves):
        rate = np.gradient(drive) * RATE
        speed = np.abs(rate) if within_s is None else followed(rate, within_s)
        x = moved(drive, speed, thresholds) + noise(drive.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", drive, x - x[0], RATE, 1.0, 0.0, 1.0, 1, 0.0, name,
            number // len(waves) + 1, "virgin", 20.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


def sines():
    """1, 4 and 16 Hz over the whole range and over half of it."""
    return [
        (f"0-{top:g} V {hertz:g} Hz",
         top * (0.5 - 0.5 * np.cos(2.0 * np.pi * hertz * np.arange(samples) / RATE)))
        for top in (75.0, 40.0) for hertz, samples in ((1.0, 4000), (4.0, 2500), (16.0, 1500))
    ]  # fmt: skip


def triangles():
    """Four speeds."""
    time = np.arange(4000) / RATE
    return [
        (f"{hertz:g} Hz", 70.0 * (1.0 - np.abs(2.0 * ((hertz * time) % 1.0) - 1.0)))
        for hertz in (1.0, 4.0, 10.0, 20.0)
    ]


def white(seed):
    rng = np.random.default_rng(seed)
    return lambda n: NOISE_UM * rng.standard_normal(n)


def slow(seed):
    """AR(0.95) of the same size."""
    rng = np.random.default_rng(seed)

    def noise(n):
        out, now = np.empty(n), NOISE_UM * rng.standard_normal()
        for k, e in enumerate(NOISE_UM * np.sqrt(1.0 - 0.95**2) * rng.standard_normal(n)):
            now = 0.95 * now + e
            out[k] = now
        return out

    return noise


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_thresholds_that_widen_by_a_share_that_levels_off_are_named_down_to_the_noise(seed):
    out = diagnose(session(sines(), of_a_share, white(seed)))
    assert [f.cause for f in out.findings] == ["rate-dependence"]
    assert not out.unexplained.detected
    assert out.rungs[0].rms_nm > 1.15 * 1e3 * NOISE_UM
    assert out.rungs[-1].rms_nm < 1.03 * 1e3 * NOISE_UM


@pytest.mark.study
@pytest.mark.parametrize(("thresholds", "seed"), [
    (of_a_share, 2), (by_volts, 1), (of_a_share, 1), (by_volts, 2), (of_a_share, 3), (by_volts, 3),
])  # fmt: skip
def test_widening_thresholds_are_named_in_slow_noise(seed, thresholds):
    out = diagnose(session(triangles(), thresholds, slow(seed), 2e-3))
    assert [f.cause for f in out.findings] == ["rate-dependence"]
    assert not out.unexplained.detected


@pytest.mark.parametrize(("evidence", "error_nm", "noted"), [
    (-4.0, 2.0, True), (-9.0, 2.0, False), (-4.0, 2.1, False),
])  # fmt: skip
def test_a_delay_that_says_as_much_as_a_lag_is_noted_beside_it(
    monkeypatch, evidence, error_nm, noted
):
    lag = CAUSES["amplifier-lag"].of(None, tau=4e-5)
    model = Model((Maxwell.of(Elements.from_curve(np.array([1.0, 75.0]), np.array([0.1, 0.12]))),))
    model = model.with_stage(lag)
    fitted = SimpleNamespace(
        evidence=0.0, point=Point(model, (), (("amplifier-lag", "tau", 1e-6),))
    )
    begun = []

    def refit(space, point, held):
        begun.append(point)
        return SimpleNamespace(evidence=evidence, point=point)

    monkeypatch.setattr(late, "refit", refit)
    monkeypatch.setattr(late, "as_late", lambda space, there, id: there)
    offered = [SimpleNamespace(id=id) for id in ("creep", "amplifier-lag", "time-skew")]
    monkeypatch.setattr(late, "candidates", lambda space, less: (offered, {}))
    from piezo_rig.diagnosis.climb import Search
    from piezo_rig.diagnosis.ladder import Step

    search = SimpleNamespace(
        causes=["amplifier-lag"], steps=[Step("amplifier-lag", 0.0, fitted)], fitted=fitted,
        space=SimpleNamespace(longest={}), tell=lambda text: None,
        error=lambda _, f: 2.0 if f is fitted else error_nm,
    )  # fmt: skip
    search.as_good = lambda *a: Search.as_good(search, *a)
    late.note_the_other(search)
    assert ("time-skew" in search.steps[0].rivals) == noted
    (point,) = begun
    assert point.model.stage("amplifier-lag") is None
    assert point.model.stage("time-skew")["delay"] == pytest.approx(4e-5)
    assert point.sizes == (("time-skew", "delay", 1e-6),)
