"""Actuators that are no Maxwell model, played as other people play them, from file to file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from recordings import sweep
from strangers import FAMILIES, bouc_wen, growing, minor_loops, sine, steps_and_holds

from piezo_rig.cli import main
from piezo_rig.identification import identify
from tests.more import first_of

DRIVES = {
    "bipolar sine, then growing": (sine(-100, 100, 20, 5000, 6), growing(90, 30, 5000, 6)),
    "growing, then a sine": (growing(100, 100, cycles=12), sine(-60, 60, 100)),
    "minor loops, then holds": (minor_loops(0, 150), steps_and_holds(0, 140)),
    "holds, then minor loops": (steps_and_holds(0, 3.6), minor_loops(0.2, 3.4)),
}
HEAD = "time_s,drive_v,displacement_um"


def recorded(family, drives, seed=0):
    """Two recordings of one actuator, one after the other, with noise and an offset."""
    (t, v), (t2, v2) = drives
    scale = 100 / np.ptp(v)  # the families are made for a hundred volts
    y = FAMILIES[family](np.concatenate([t, t2]), scale * np.concatenate([v, v2]))
    y = y + 3.7 + 0.002 * np.ptp(y) * np.random.default_rng(seed).standard_normal(y.size)
    return (t, v, y[: t.size]), (t2, v2, y[t.size :])


def written(path, recording, head=HEAD):
    np.savetxt(path, np.column_stack(recording), delimiter=",", header=head, comments="")
    return str(path)


def plays(v, r):
    out, state = np.empty(v.size), v[0]
    for i, x in enumerate(v):
        state = min(max(state, x - r), x + r)
        out[i] = state
    return out


def simple_fit(first, other):
    """Held-out rms in percent of travel of twenty plays by non-negative least squares."""
    from scipy.optimize import nnls

    (_, v, y), (_, v2, y2) = first, other
    radii = np.arange(20) * np.ptp(v) / 20
    states = np.stack([plays(np.concatenate([v, v2]), r) for r in radii], 1)
    begin = v.size // 3
    fitted = states[begin : v.size]
    w, _ = nnls(fitted - fitted.mean(0), y[begin:] - y[begin:].mean())
    return rest(y2, states[v.size :] @ w)


def rest(y, predicted):
    error = (y - predicted)[y.size // 4 :]
    return 100 * np.std(error) / np.ptp(y)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("family", first_of(2, ["bouc_wen", "backlash", "duhem", "linear"]))
def test_a_recording_predicts_another(family, drive):
    first, other = recorded(family, DRIVES[drive])
    time, v, y = first
    one = sweep(v, y, history="unknown").with_(sample_times_s=time)
    found = identify([one], "classical")
    predicted = found.model.simulate(other[0], other[1], history="unknown")
    assert rest(other[2], predicted) < 1.35 * simple_fit(first, other) + 0.2
    assert found.max_percent < 5


@pytest.mark.parametrize("model", first_of(2, ["initiation", "extremum", "range", "classical"]))
def test_from_file_to_file(tmp_path, capsys, model):
    first, other = recorded("preisach", DRIVES["minor loops, then holds"])
    a, b = written(tmp_path / "a.csv", first), written(tmp_path / "b.csv", other)
    m, out = str(tmp_path / "m.json"), str(tmp_path / "o.csv")
    assert main(["identify", a, "--model", model, "--out", m]) == 0
    assert main(["simulate", m, b, "--out", out, "--history", "unknown"]) == 0
    assert "warning" not in capsys.readouterr().out
    predicted = np.genfromtxt(out, delimiter=",", names=True)["displacement_um"]
    assert predicted.size == other[0].size
    assert rest(other[2], predicted) < 1.2


def test_held_out_cycles_larger_than_the_rest_are_not_wildly_extrapolated():
    (t, v, y), _ = recorded("bouc_wen", DRIVES["growing, then a sine"])
    for model in ("classical", "initiation"):
        found = identify([sweep(v, y, history="unknown").with_(sample_times_s=t)], model)
        assert found.held_out_kind == "cycles"
        assert found.max_percent < 2


T, V = sine(0, 75, 2, 1000, 6)
Y = bouc_wen(T, V) + 0.008 * np.random.default_rng(1).standard_normal(T.size)


def coarse(samples):
    t, v = sine(0, 75, 1, samples, 12)
    return v, bouc_wen(t, v)


@pytest.mark.parametrize(
    ("drive", "y"),
    [
        (V + 0.05 * np.random.default_rng(2).standard_normal(V.size), Y),
        (np.round(V / 0.4) * 0.4, Y),
        coarse(8),
        (V[:500], Y[:500]),
        (1e-6 * V, Y),
        (V, 1e-3 * Y),
        (V, 1e3 * Y),
        (V, Y + 1e4),
    ],
    ids=["noise on drive", "8 bits", "8 a cycle", "one cycle", "uV", "nm", "mm", "far away"],
)
def test_any_scale_and_sampling(drive, y):
    found = identify([sweep(drive, y, history="unknown")], "initiation")
    assert found.fitted.max_percent < 0.8


def test_many_cycles_of_one_sweep():
    y = np.concatenate([Y[:500], np.tile(Y[2000:2500], 299)])
    found = identify([sweep(np.tile(V[:500], 300), y, history="unknown")], "classical")
    assert found.held_out.max_percent < 0.6


def test_a_drive_beyond_what_was_identified_is_said(tmp_path, capsys):
    a = written(tmp_path / "a.csv", (T, V, Y))
    b = written(tmp_path / "b.csv", (T, 1.5 * V, Y))
    m, out = str(tmp_path / "m.json"), str(tmp_path / "o.csv")
    assert main(["identify", a, "--model", "classical", "--out", m]) == 0
    assert json.loads((tmp_path / "m.json").read_text())["provenance"]["drive_v"] == [0, 75]
    for model in (m, "thesis_range"):
        assert main(["simulate", model, b, "--out", out]) == 0
        assert "outside 0 .. 75 V" in capsys.readouterr().out


def test_a_falling_displacement_is_a_polarity(tmp_path, capsys):
    a = written(tmp_path / "a.csv", (T, (V - 75) / 7.5, Y), "time_s,command_v,sensor_v")
    read = ["identify", a, "--model", "classical", "--sensitivity", "1um/V",
            "--out", str(tmp_path / "m.json")]  # fmt: skip
    assert main(read) == 2
    error = capsys.readouterr().err
    assert "displacement-falls" in error
    assert "--polarity=+1" in error
    assert main([*read, "--polarity=+1"]) == 0
