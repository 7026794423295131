"""A delay or a lag where all half loops are equally fast shows just after corners alone.

Elsewhere it is a loop that is a little wider. While a delay lasts the displacement goes on after
the drive has turned, which no loop does.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis import diagnose, refusals
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play
from tests.more import first_of

RATE, FINER, HZ, HIGH, CYCLES, REPEATS, NOISE_UM = 5000.0, 4, 5.0, 68.0, 6, 3, 1.6e-3
REST_S = 0.02


def late(drive: np.ndarray, tau: float) -> np.ndarray:
    """What a first-order lag makes of straight lines between samples of a finer grid."""
    step = 1.0 / (RATE * FINER)
    decay = np.exp(-step / tau)
    rise = tau / step * (1.0 - decay)
    return lfilter([1.0 - rise, rise - decay], [1.0, -decay], drive)


def triangle(time: np.ndarray) -> np.ndarray:
    return HIGH * (1.0 - np.abs(2.0 * ((HZ * time) % 1.0) - 1.0))


def sine(time: np.ndarray) -> np.ndarray:
    return 0.5 * HIGH * (1.0 - np.cos(2.0 * np.pi * HZ * time))


def sweeps(seed: int, tau: float = 0.0, delay: float = 0.0, of=triangle) -> list[Sweep]:
    rng = np.random.default_rng(seed)
    time = np.arange(int(CYCLES / HZ * RATE * FINER) + 1) / (RATE * FINER)
    drive = of(time)
    rest = int(REST_S * RATE * FINER)
    played = np.concatenate([np.zeros(rest), drive])
    moved = play(late(played, tau) if tau else played, np.linspace(0.5, 36.0, 72), 0.0025)
    finer = np.arange(moved.size) / (RATE * FINER)
    moved = np.interp(finer - delay, finer, moved)[rest:][::FINER]
    return [
        Sweep(
            f"sweep_{k + 1:04d}", drive[::FINER],
            moved - moved[0] + NOISE_UM * rng.standard_normal(moved.size), RATE, 1.0, 0.0, 1.0, 1,
            0.0, "a", k + 1, "virgin", 60.0 * k, "IMPORTED",
        ) for k in range(REPEATS)
    ]  # fmt: skip


@pytest.mark.study
@pytest.mark.parametrize("tau", [4e-4, 8e-4])
def test_a_lag_is_found(tau):
    found = diagnose(sweeps(1, tau=tau))
    assert [f.cause for f in found.findings] == ["amplifier-lag"]
    assert found.findings[0].parameters["tau"].value == pytest.approx(tau, rel=0.08)
    assert not found.unexplained.detected


@pytest.mark.study
@pytest.mark.parametrize("delay", [3.4e-4, 2.1e-3])
def test_a_delay_is_found(delay):
    found = diagnose(sweeps(2, delay=delay))
    assert [f.cause for f in found.findings] == ["time-skew"]
    assert found.findings[0].parameters["delay"].value == pytest.approx(delay, rel=0.03)
    assert not found.unexplained.detected


@pytest.mark.parametrize("seed", first_of(1, [3, 4, 5]))
def test_nothing_is_found_in_a_loop_that_is_only_a_loop(seed):
    found = diagnose(sweeps(seed))
    assert list(found.findings) == []
    assert not found.unexplained.detected


def test_one_sine_cannot_show_a_delay_and_the_program_says_so():
    found = diagnose(sweeps(6, of=sine))
    assert list(found.findings) == []
    for cause in ("amplifier-lag", "time-skew", "rate-dependence"):
        assert "rate_sweep" in found.refused[cause]


@pytest.mark.parametrize(("gained", "left_over", "after_nm", "refused"), [
    (30.0, 5.0, 2.9, False),  # in slow noise most of what is held out is noise
    (30.0, 5.0, 2.1, False),
    (20.0, 5.0, 2.9, True),  # sharp sliders between elements say as much
    (30.0, 40.0, 2.9, True),  # it stands in for something
    (20.0, 5.0, 2.1, False),
])  # fmt: skip
def test_what_shows_at_corners_alone_says_or_explains_most_of_what_is_amiss(
    monkeypatch, gained, left_over, after_nm, refused
):
    monkeypatch.setattr(
        refusals, "context_of", lambda space, model: SimpleNamespace(several_speeds=False)
    )
    here, fitted = (
        SimpleNamespace(evidence=e, point=SimpleNamespace(model=None))
        for e in (-100.0, gained - 100.0)
    )
    errors = {id(here): 3.0, id(fitted): after_nm}
    search = SimpleNamespace(
        space=None, noise_nm=2.0, error=lambda k, f: errors[id(f)], left_over=lambda f: left_over
    )
    why = refusals.of_a_corner(search, fitted, here, "time-skew")
    assert why == (refusals.OF_A_CORNER if refused else None)
