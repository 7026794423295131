"""The public benchmark: cases from a seed, sealed, played through the drivers."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
from contextlib import redirect_stdout

import numpy as np
import pytest
from scipy.stats import chi2

from drivers.simulated.plant import Plant
from piezo_rig import diagnosis
from piezo_rig.challenge import contest
from piezo_rig.challenge.case import BLOCK, draw, kind_of
from piezo_rig.challenge.hiding import CAUSES, QUIET, merged
from piezo_rig.challenge.judge import Judge
from piezo_rig.challenge.noises import NOISES, PLANT, noise_of
from piezo_rig.challenge.play import beside
from piezo_rig.challenge.rehearsal import Rehearsal
from piezo_rig.cli import main
from piezo_rig.run_file.reader import Run
from piezo_rig.scoring.oracle import base_columns

SHORT = """
schema = "piezo-rig/protocol/1"
name = "short"
sample_rate = 1000
repeats = 2
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [30, 60]
frequency_hz = 4
cycles = 2
"""


@pytest.fixture(scope="module")
def short():
    return Rehearsal.of(SHORT)


SEED = next(s for s in range(99) if [kind_of(s, i)[0] for i in (0, 1)] == ["null", "one"])


# ------------------------------------------------------------------------ cases


def test_a_case_comes_from_seed_and_number_alone(held):
    again = draw(SEED, 0)
    first, second = (json.loads((held[0] / "truth" / f"case_000{k}.json").read_text())
                     for k in (1, 2))  # fmt: skip
    assert again.document() == first
    assert again.protocol == (held[0] / "truth" / "case_0001.toml").read_text()
    assert first["plant"]["stack"] != second["plant"]["stack"]


def test_every_eight_cases_hold_the_same_sorts_and_every_cause_comes_before_any_comes_again():
    sorts = [kind_of(9, i) for i in range(48)]
    for block in range(6):
        assert sorted(s for s, _ in sorts[8 * block : 8 * block + 8]) == sorted(BLOCK)
    assert [n for s, n in sorts if s == "one"] == list(range(24))
    assert len(CAUSES) < 24


def test_the_truth_is_as_visible_as_the_oracle_says(short):
    """d' from a whitening matrix that is written out, against the oracle's filters."""
    plant = merged([QUIET, {"seed": 1}])
    bare = short.displacements(plant)
    change = [a - b for a, b in zip(
        short.displacements(merged([plant, {"thermal_drift": {"on": True, "rate": 20.0}}])), bare,
        strict=True)]  # fmt: skip
    judge = Judge(short, noise_of("ar", short.rate))
    step = 15.48 * 20.0 / 2**16
    white, decay, sigma = step**2 / 12.0, 0.95**5, 5e-3
    square = 0.0
    rows, bases = [], []
    for row, drive in zip(change, short.drives_v * 2, strict=True):
        lag = np.abs(np.subtract.outer(np.arange(row.size), np.arange(row.size)))
        root = np.linalg.cholesky(sigma**2 * decay**lag + white * np.eye(row.size))
        columns = base_columns(drive, 60.0)
        one = np.linalg.solve(root, np.ones(row.size))
        one /= np.linalg.norm(one)
        both = np.linalg.solve(root, np.column_stack([row, columns]))
        both -= np.outer(one, one @ both)
        rows.append(both[:, 0])
        bases.append(both[:, 1:])
    base, seen = np.vstack(bases), np.concatenate(rows)
    fitted = np.linalg.lstsq(base / np.linalg.norm(base, axis=0), seen, rcond=1e-7)[0]
    left = seen - base / np.linalg.norm(base, axis=0) @ fitted
    square = float(left @ left)
    assert judge.d_prime(change) == pytest.approx(np.sqrt(square), rel=1e-3)


@pytest.mark.parametrize("kind", NOISES)
def test_the_oracle_knows_the_noise_of_the_bench(short, kind):
    """What it whitens has unit variance and no correlation between neighbours."""
    parts = []
    noise = noise_of(kind, short.rate)
    for seed in range(1, 5):
        plant = merged([QUIET, PLANT[kind], {"seed": seed}])
        noisy, clean = (short.displacements(plant, clean) for clean in (False, True))
        for a, b in zip(noisy, clean, strict=True):
            row = noise.whitened((a - b)[:, None])[:, 0]
            one = noise.whitened(np.ones((a.size, 1)))[:, 0]
            parts.append(row - one * (one @ row) / (one @ one))  # a sweep begins at its own zero
    every = np.concatenate(parts)
    # 1/f noise of the bench is straight lines between knots, for which processes stand in
    low, high = (0.8, 1.25) if kind in ("1/f", "mixed") else chi2.interval(0.9999, every.size)
    scale = 1.0 if kind in ("1/f", "mixed") else every.size
    assert low < float(every @ every) / every.size * scale < high
    neighbours = float(np.mean([p[1:] @ p[:-1] / p.size for p in parts]))
    assert abs(neighbours) < 0.06


def test_the_oracle_finds_what_is_there_and_nothing_else(short):
    rng = np.random.default_rng(2)
    noise = noise_of("white", short.rate)
    judge = Judge(short, noise)
    shapes = {f"wave {k}": [np.sin(2 * np.pi * (3 * k + 7) * np.arange(v.size) / v.size)
                            for v in short.drives_v * 2] for k in range(4)}  # fmt: skip
    silence = [noise.drawn(v.size, rng) for v in short.drives_v * 2]
    assert judge.findings(silence, shapes)[0] == []
    seen = [n + 2e-3 * w for n, w in zip(silence, shapes["wave 2"], strict=True)]
    (finding, *more), alternatives = judge.findings(seen, shapes)
    assert finding[0] == "wave 2"
    assert more == []
    assert alternatives == {"wave 2": []}
    same = shapes | {"its twin": [1.5 * w for w in shapes["wave 2"]]}
    (finding, *_), alternatives = judge.findings(seen, same)
    assert {finding[0], *alternatives[finding[0]]} == {"wave 2", "its twin"}


# ------------------------------------------------------------- the command line


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """Two cases on disk, a null and a cause, drawn by a seed that begins with them; and the
    status and output of the challenge that made them. One condition is diagnosed, for speed."""
    real = diagnosis.diagnose

    def some(sweeps):
        return real([s for s in sweeps if s.condition == sweeps[0].condition])

    folder = tmp_path_factory.mktemp("challenge") / "cases"
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        patch.setattr(diagnosis, "diagnose", some)
        status = main(["challenge", "--cases", "2", "--seed", str(SEED), "--jobs", "1",
                       "--out", str(folder)])  # fmt: skip
    return folder, status, said.getvalue()




def test_a_challenge_seals_plays_scores_and_draws(held):
    folder, status, said = held
    assert status in (0, 1)
    assert "| false alarms: nulls in which something is found | " in said
    truth = folder / "truth" / "case_0001.json"
    digest = hashlib.sha256(truth.read_bytes()).hexdigest()
    assert said.index(f"sealed case_0001  sha256 {digest}") < said.index("1 of 2: ")
    assert (folder / "answers" / "isolation.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("aside", "at", "agrees"), [
    ([], [], True),
    ([0.005], [7], True),  # a voltage on the edge of two steps
    ([0.005, -0.005], [7, 900], True),
    ([0.005], [slice(1, None)], True),  # the first sample is the one on the edge
    ([0.005], [slice(500, 550)], False),  # a hundredth of the samples is no accident
    ([0.004], [7], False),  # no step
    ([0.010], [7], False),  # two
    ([0.004], [slice(None)], False),
])  # fmt: skip
def test_a_run_may_lie_a_step_of_the_sensor_beside_its_rehearsal_where_it_is_rounded(
    aside, at, agrees
):
    off = np.random.default_rng(0).uniform(-2e-4, 2e-4, 5000)
    for size, where in zip(aside, at, strict=True):
        off[where] += size
    if agrees:
        assert beside(off, 4e-4, 0.005) == 0.0
    else:
        assert beside(off, 4e-4, 0.005) == pytest.approx(max(aside), abs=4e-4)


def test_the_recordings_are_what_the_sealed_plant_does(held):
    folder, _, _ = held
    truth = json.loads((folder / "truth" / "case_0002.json").read_text())
    rehearsal = Rehearsal.of((folder / "truth" / "case_0002.toml").read_text())
    expected = rehearsal.displacements(truth["plant"], clean=False)
    for sweep, row, start in zip(
        rehearsal.plan.sweeps, expected, rehearsal.starts_s, strict=True
    ):
        path = folder / "cases" / "case_0002" / f"{sweep.condition.name} test {sweep.repeat}.csv"
        assert path.read_text().startswith("time_s,drive_v,displacement_um\n")
        time_s, drive, um = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
        np.testing.assert_allclose(time_s, start + np.arange(row.size) / rehearsal.rate, atol=1e-6)
        np.testing.assert_allclose(drive, sweep.wave.drive_v, atol=1e-6)
        np.testing.assert_allclose(um, row, atol=2e-3)  # um; four steps of the digitizer


def test_the_run_is_imported_with_its_conditions_and_repeats(held, tmp_path, capsys):
    folder, _, _ = held
    files = sorted(str(p) for p in (folder / "cases" / "case_0001").glob("*.csv"))
    run = tmp_path / "case.h5"
    assert main(["import", *files, "--history", "virgin", "--out", str(run)]) == 0
    sweeps = Run(run).sweeps()
    assert {s.repeat for s in sweeps} == {1, 2}
    assert len({(s.condition, s.repeat) for s in sweeps}) == len(files)
    assert sorted(f"{s.condition} test {s.repeat}" for s in sweeps) == sorted(
        p.stem for p in (folder / "cases" / "case_0001").glob("*.csv")
    )


def test_anybodys_answers_are_scored(held, tmp_path, capsys):
    folder, _, _ = held
    truth = json.loads((folder / "truth" / "case_0002.json").read_text())
    right = tmp_path / "right"
    right.mkdir()
    (right / "case_0001.json").write_text('{"findings": []}')
    (right / "case_0002.json").write_text(
        json.dumps({"findings": [{"cause": c} for c in truth["causes"]]})
    )
    assert main(["challenge", "--score", str(right), "--out", str(folder)]) == 0
    assert "| first: the first finding is hidden | 1/1 |" in capsys.readouterr().out
    (right / "case_0002.json").write_text("no answer")
    assert main(["challenge", "--score", str(right), "--out", str(folder)]) == 1
    assert "| failures | 1 |" in capsys.readouterr().out


def change_truth(folder):
    path = folder / "truth" / "case_0001.json"
    path.write_text(path.read_text().replace('"none"', '"creep"'))
    return path


def drop_truth(folder):
    path = folder / "truth" / "case_0001.json"
    path.unlink()
    return path


def add_truth(folder):
    path = folder / "truth" / "case_0003.json"
    shutil.copy(folder / "truth" / "case_0001.json", path)
    return path


def change_recording(folder):
    path = min((folder / "cases" / "case_0002").glob("*.csv"))
    path.write_text(path.read_text().replace(",0.0", ",0.1", 1))
    return path


def drop_recordings(folder):
    path = min((folder / "cases" / "case_0002").glob("*.csv"))
    shutil.rmtree(path.parent)
    return path


@pytest.mark.parametrize("harm", [
    change_truth, drop_truth, add_truth, change_recording, drop_recordings,
])  # fmt: skip
def test_a_challenge_that_is_not_what_was_sealed_is_refused(harm, held, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(held[0], folder)
    path = harm(folder)
    assert main(["challenge", "--score", str(folder / "answers"), "--out", str(folder)]) == 2
    said = capsys.readouterr()
    assert said.err.startswith(f"error[challenge-seal]: {path}: ")
    assert "| cases |" not in said.out


def test_a_challenge_that_was_stopped_before_it_was_played_is_scored(held, tmp_path, capsys):
    """Its truths are sealed, its recordings are not yet; no answer is a failure."""
    folder = tmp_path / "copy"
    shutil.copytree(held[0] / "truth", folder / "truth")
    sums = (held[0] / "SHA256SUMS").read_text().splitlines(keepends=True)
    (folder / "SHA256SUMS").write_text("".join(s for s in sums if "  truth/" in s))
    (folder / "answers").mkdir()
    assert main(["challenge", "--score", str(folder / "answers"), "--out", str(folder)]) == 1
    assert "| failures | 2 |" in capsys.readouterr().out


@pytest.mark.parametrize("text", [None, "", "0123 truth/case_0001.json\n"])
def test_a_folder_without_its_hashes_is_no_challenge(text, held, tmp_path, capsys):
    if text is not None:
        (tmp_path / "SHA256SUMS").write_text(text)
    assert main(["challenge", "--score", str(held[0] / "answers"), "--out", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err.splitlines()[0]


def test_a_folder_that_holds_something_is_left_alone(held, capsys):
    assert main(["challenge", "--cases", "1", "--out", str(held[0])]) == 2
    assert capsys.readouterr().err.startswith("error[folder-exists]")


def test_a_case_that_breaks_does_not_stop_the_rest(monkeypatch, tmp_path):
    def breaks(seed, index):
        if index == 0:
            raise RuntimeError("on purpose")
        return draw(seed, index)

    monkeypatch.setattr(contest, "draw", breaks)
    monkeypatch.setattr(contest, "_perform", lambda folder, names, which: 1 / 0)
    rows = contest.contest(SEED, 2, tmp_path, 1, lambda line: None)
    assert sorted(r["error"] for r in rows) == [
        "RuntimeError: on purpose", "ZeroDivisionError: division by zero"
    ]  # fmt: skip


def test_a_process_that_dies_is_a_failure():
    assert dict(contest._each(os._exit, [1], 2)) == {1: contest.Failed("its process died")}


@pytest.mark.parametrize(("seed", "index"), [(41, 10), (3, 1)])  # the first once drifted out of it
def test_no_case_leaves_the_range_of_the_sensor(seed, index):
    case = draw(seed, index)
    plan = case.rehearsal.plan
    stack = Plant(case.truth.plant)
    stack.set_level(0.1, plan.rig.rest_command_v)
    for sweep, start_s in zip(plan.sweeps, case.rehearsal.starts_s, strict=True):
        stack.play(start_s, sweep.wave.command_v, plan.sample_rate)
        shown_v = stack.record(start_s, plan.sample_rate, sweep.samples).sensor_v
        assert np.max(np.abs(shown_v)) < plan.rig.digitizer.sensor_range_v
