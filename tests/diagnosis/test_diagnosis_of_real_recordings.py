"""Real recordings with known verdicts (not part of the project; skipped where absent)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from piezo_rig.cli import main

DATA = Path(__file__).parents[3] / "shared" / "data" / "micromanipulator"
pytestmark = [
    pytest.mark.shared,
    pytest.mark.skipif(not DATA.is_dir(), reason="reference data not here"),
]
SINE, LOOPS = "sine_1hz.csv", "decaying_and_holds.csv"
LAGS = {"time-skew", "amplifier-lag", "rate-dependence"}


def at_100_hz(name: str, folder: Path, samples: int | None = None) -> str:
    """Every second sample: as telling for a delay of 15 ms, and half the work."""
    head, *rows = (DATA / name).read_text().splitlines()
    path = folder / name
    path.write_text("\n".join([head, *rows[::2][:samples]]) + "\n")
    return str(path)


@pytest.mark.study
def test_from_one_sine_alone_no_lag_is_chosen_and_the_reason_is_said(tmp_path):
    out = tmp_path / "d.json"
    assert main(["diagnose", at_100_hz(SINE, tmp_path, 1000), "--json", str(out)]) == 0
    said = json.loads(out.read_text())
    assert not LAGS & {f["cause"] for f in said["findings"]}
    assert said["noise_floor_nm"] is None
    assert "several frequencies" in said["not_tried"]["time-skew"]


@pytest.mark.study
def test_with_minor_loops_a_delay_near_15_ms_halves_the_held_out_error(tmp_path):
    loops = at_100_hz(LOOPS, tmp_path, 3500)
    model = tmp_path / "m.json"
    halved(loops, out=tmp_path / "d.json", model=model)
    assert main(["simulate", str(model), loops, "--out", str(tmp_path / "s.csv")]) == 0


@pytest.mark.study
def test_beside_the_sine_it_is_one_of_three_all_of_it_at_its_full_rate(tmp_path):
    """With 100 nm that nobody has a name for, a delay is not told from a loop that opens."""
    out = tmp_path / "d.json"
    assert main(["diagnose", *(str(DATA / n) for n in (SINE, LOOPS)), "--json", str(out)]) == 0
    said = json.loads(out.read_text())
    (late,) = (f for f in said["findings"] if f["cause"] in LAGS)
    assert "time-skew" in {late["cause"], *late["alternatives"]}
    assert said["unexplained"]["detected"]
    assert said["extended"]["rms_nm"] < 0.5 * said["baseline"]["rms_nm"]
    assert -1.2 < said["data"]["recordings"][1]["offset_um"] < -0.3


@pytest.mark.study
@pytest.mark.parametrize("from_s", [0.0, 1.0])
def test_the_model_of_a_sine_is_as_good_as_its_ladder_says(tmp_path, from_s):
    """It bends far: a model was saved that was off by three times what its ladder said."""
    head, *rows = (DATA / SINE).read_text().splitlines()
    rows = [row for row in rows if float(row.split(",")[0]) >= from_s]
    data, out, model = (tmp_path / n for n in ("sine.csv", "d.json", "m.json"))
    data.write_text("\n".join([head, *rows]) + "\n")
    assert main(["diagnose", str(data), "--json", str(out), "--save-model", str(model)]) == 0
    said = json.loads(out.read_text())
    assert said["extended"]["rms_nm"] < 0.4 * said["baseline"]["rms_nm"]
    moved = tmp_path / "s.csv"
    assert main(["simulate", str(model), str(data), "--out", str(moved),
                 "--history", "unknown"]) == 0  # fmt: skip
    table = np.genfromtxt(moved, delimiter=",", names=True)
    measured = np.genfromtxt(data, delimiter=",", names=True)["displacement_um"]
    off = (measured - table["displacement_um"])[400:]  # behind what is not known
    assert 1e3 * np.std(off) < 2.0 * said["extended"]["rms_nm"]


def halved(*recordings: str, out: Path, model: Path) -> dict:
    """Diagnosed: one delay of 10 to 20 ms, and no other lag, halves the error."""
    assert main(["diagnose", *recordings, "--json", str(out), "--save-model", str(model)]) == 0
    said = json.loads(out.read_text())
    found = {f["cause"]: f for f in said["findings"]}
    late = found.get("time-skew") or found.get("amplifier-lag")
    assert late is not None
    (seconds,) = (p["value"] for p in late["parameters"].values())
    assert 0.010 <= seconds <= 0.020
    assert late["gain_percent"] > 40.0
    assert "rate-dependence" not in found
    assert said["extended"]["rms_nm"] < 0.5 * said["baseline"]["rms_nm"]
    return said
