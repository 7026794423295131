"""Recordings of unknown history that begin at rest, with a memory or with none."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import remembered
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep

RATE, NOISE_UM = 1000.0, 2e-3
R = np.linspace(0.5, 36.0, 72)


def play(volts: np.ndarray, stiffer: float = 0.0) -> np.ndarray:
    """Sliders after a spring, from rest; the first rise gives way less."""
    out, x = np.empty(volts.size), np.zeros(R.size)
    furthest = np.maximum.accumulate(np.abs(volts - volts[0]))
    for k, v in enumerate(volts - volts[0]):
        x = np.clip(x, v - R, v + R)
        out[k] = x.sum()
    moved = 0.08 * (volts - volts[0]) + 0.0007 * out
    return moved - stiffer * 0.08 * furthest


def recording(number: int, volts: np.ndarray, moved: np.ndarray) -> Sweep:
    noise = NOISE_UM * np.random.default_rng(number).standard_normal(volts.size)
    return Sweep(f"sweep_{number:04d}", volts, moved + noise, RATE, 1.0, 0.0, 1.0, 1, 0.0, "", 1,
                 "unknown", 100.0 * number, "IMPORTED")  # fmt: skip


def walk(seed: int) -> np.ndarray:
    """A smooth walk that begins at 0 V and comes to 70 V somewhere."""
    rng, time = np.random.default_rng(seed), np.arange(8000) / RATE
    v = sum(
        rng.normal() / f * (np.sin(2 * np.pi * f * time + phase) - np.sin(phase))
        for f, phase in zip((0.3, 0.7, 1.3, 2.2, 3.1), rng.uniform(0, 6.28, 5), strict=True)
    )
    v = np.abs(v)
    return 70.0 * v / v.max()


def triangle(number: int) -> np.ndarray:
    saw = np.abs(2.0 * ((0.75 * np.arange(4500) / RATE) % 1.0) - 1.0)
    return (1.0 - saw) * (80.0 - 10.0 * number)


def ridden(drive, excursion_v: float = 0.0, stiffer: float = 0.0) -> list[Sweep]:
    """Two drives after an excursion that nobody recorded."""
    out = []
    for number in (1, 2):
        volts, up = drive(number), np.linspace(0.0, excursion_v, 200)
        whole = np.concatenate([up, up[::-1], volts]) if excursion_v else volts
        moved = play(whole, stiffer)[-volts.size :]
        out.append(recording(number, volts, moved - moved[0]))
    return out


def taken_for_rises(sweeps: list[Sweep]) -> int:
    return sum("begins at rest" in said for said in prepare(sweeps, first_rises=True).left_out)


def test_a_memory_of_nearly_all_that_follows_is_no_initiation_curve(monkeypatch):
    sweeps = ridden(walk, 68.0)
    assert taken_for_rises(sweeps) == 1
    assert diagnose(sweeps).findings == []
    monkeypatch.setattr(remembered, "_remembers", lambda *_: False)
    assert [f.cause for f in diagnose(sweeps).findings] == ["initiation-stage"]


@pytest.mark.parametrize(("stiffer", "causes"), [(0.0, []), (0.1, ["initiation-stage"])])
def test_a_first_rise_is_no_memory(stiffer, causes):
    sweeps = ridden(triangle, stiffer=stiffer)
    assert taken_for_rises(sweeps) == 2
    assert [f.cause for f in diagnose(sweeps).findings] == causes


def test_what_is_said_to_be_virgin_is_taken_at_its_word():
    sweeps = [s.with_(history="virgin") for s in ridden(walk, 68.0)]
    data = prepare(sweeps, first_rises=True, clipped=True)
    assert remembered.without_remembered(data, sweeps, None) is data
