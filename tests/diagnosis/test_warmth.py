"""An actuator that its own losses make warm: no cause of the catalogue, and none is named."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.chain import Signal
from piezo_rig.diagnosis import diagnose, warmth
from piezo_rig.diagnosis.warmth import Warmth
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, NOISE_UM, SECONDS = 1000.0, 3e-3, 3.0
SPEEDS_HZ = (1.0, 2.0, 4.0, 8.0)
LIMITS = np.sort(np.random.default_rng(5).uniform(0.5, 34.0, 40))


def triangles(hz: float, top: float) -> np.ndarray:
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    return top * (1.0 - np.abs(2.0 * ((hz * time) % 1.0) - 1.0))


def warm_um(volts: np.ndarray, tau_s: float, power: float) -> np.ndarray:
    """Length by its temperature, after losses that go with a power of the speed."""
    loss = np.abs(np.gradient(volts) * RATE / 300.0) ** power
    keep = np.exp(-1.0 / RATE / tau_s)
    return lfilter([0.0, 1.0 - keep], [1.0, -keep], loss)


def crept_um(x: np.ndarray) -> np.ndarray:
    """After the displacement, in three relaxations a decade apart."""
    out = np.zeros_like(x)
    for tau_s in (0.03, 0.3, 3.0):
        keep = np.exp(-1.0 / RATE / tau_s)
        out += lfilter([1.0 - keep], [1.0, -keep], x)
    return out


def session(seed: int, changed) -> list[Sweep]:
    """Four speeds and two tops, twice each; ``changed(x, volts)`` is what happens."""
    rng, out = np.random.default_rng(seed), []
    drives = [triangles(hz, 70.0 if k % 2 else 50.0) for k, hz in enumerate(SPEEDS_HZ)]
    for number in range(2 * len(drives)):
        volts = drives[number % len(drives)]
        x = changed(play(volts, LIMITS, 0.0016), volts)
        seen = x + NOISE_UM * rng.standard_normal(x.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen - seen[0], RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"{SPEEDS_HZ[number % len(drives)]:g} Hz", number // len(drives) + 1, "virgin",
            60.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


@pytest.mark.study
@pytest.mark.parametrize(("seed", "tau_s", "power"), [
    (1, 2.2, 1.0), (3, 1.3, 1.0), (2, 5.0, 2.0),
])  # fmt: skip
def test_warmth_is_no_law_of_turning_points_and_no_asymmetry(seed, tau_s, power):
    found = diagnose(session(seed, lambda x, v: x + 6e-3 * warm_um(v, tau_s, power)))
    assert [f.cause for f in found.findings] == []
    assert found.unexplained.detected
    assert {"frequency", "clock"} & set(found.unexplained.depends_on)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2])
def test_what_creeps_at_those_speeds_is_still_a_creep(seed):
    found = diagnose(session(seed, lambda x, v: x + 0.001 * crept_um(x)))
    assert [f.cause for f in found.findings] == ["creep"]
    assert not found.unexplained.detected


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_creep_of_a_warm_actuator_is_named_and_its_warmth_is_not(seed):
    """The creep is found beside a law that was taken in for the warmth, and that goes again."""
    found = diagnose(session(
        seed, lambda x, v: x + 6e-3 * warm_um(v, 2.2, 1.0) + 0.001 * crept_um(x)
    ))  # fmt: skip
    assert [f.cause for f in found.findings] == ["creep"]
    assert found.unexplained.detected


@pytest.mark.parametrize(("lasts_s", "may"), [(0.4, False), (3.0, True)])
def test_warmth_is_not_told_from_a_drift_while_recordings_are_over_before_it_comes(
    monkeypatch, lasts_s, may
):
    monkeypatch.setattr(warmth, "context_of", lambda *_: SimpleNamespace(several_speeds=True))
    monkeypatch.setattr(warmth, "warmth", lambda _, fitted: fitted.says)
    space = SimpleNamespace(scales=SimpleNamespace(longest_s=lasts_s))
    point, plain = SimpleNamespace(fixed=(), model=None), SimpleNamespace(unknown=None)
    here, fitted = (
        SimpleNamespace(point=point, evidence=e, linear=plain, says=w)
        for e, w in ((0.0, 200.0), (60.0, 140.0))
    )  # fmt: skip
    assert warmth.still_warm(space, here) == may
    assert (warmth.of_warmth(space, here, fitted, "thermal-drift") is not None) == may


def test_warmth_approaches_what_a_steady_speed_makes_of_it():
    """1 - exp(-t / tau) of the loss, here (100 V/s / 250 V/s)^2, until the drive turns and on."""
    volts = triangles(1.0, 50.0)
    time = np.arange(volts.size) / RATE
    stage = Warmth.of(None, size=0.02, slew=250.0, tau=1.7, power=2.0)
    x = stage.act(Signal(time, volts, 0.1 * volts)).displacement_um - 0.1 * volts
    assert x == pytest.approx(0.02 * 0.16 * -np.expm1(-time / 1.7), abs=1e-12)
