"""A target becomes a drive within a rig's limits, or an error that names the sample."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from inverted_models import EVERY, model_with

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, save_model
from piezo_rig.cli import main
from piezo_rig.compensation import Bounds, Target, compensate
from piezo_rig.errors import LimitError

STEP = 2e-4
RIG = Bounds(0.0, 75.0, 10_000.0)
HEADER = "time_s,displacement_um"


def spring(k=10.0):
    return Model((Maxwell.of(Elements(np.array([k]), np.array([1.0]))),))


def lines(*levels, points=500):
    parts = [np.linspace(a, b, points, endpoint=False) for a, b in pairwise(levels)]
    um = np.append(np.concatenate(parts), levels[-1])
    return Target(STEP * np.arange(um.size), um)


def written(path, um, header=HEADER, step=STEP):
    table = np.column_stack([step * np.arange(len(um)), um])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")
    return str(path)


@pytest.fixture
def model(tmp_path):
    return str(save_model(spring(), tmp_path / "model.json"))


def test_the_drive_of_a_spring_is_the_target_times_its_constant(tmp_path, model, capsys):
    target = lines(0.0, 6.0, 1.0, 4.0)
    out = tmp_path / "out.csv"
    path = written(tmp_path / "t.csv", target.displacement_um)
    assert main(["compensate", model, path, "--out", str(out)]) == 0
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "drive_v")
    np.testing.assert_allclose(table["time_s"], target.time_s, atol=1e-12)
    np.testing.assert_allclose(table["drive_v"], 10.0 * target.displacement_um, atol=1e-8)
    said = capsys.readouterr().out
    assert "inverted  maxwell (actuator)" in said
    assert said.splitlines()[-1] == f"compensation: {out}"


@pytest.mark.parametrize(
    ("um", "word"),
    [
        # 10 V/um: 75 V are 7.5 um, passed between samples 750 and 751 of steps of 0.01 um
        (0.01 * np.arange(1000), "sample 751 (0.1502 s) asks for 7.51 um"),
        # 10 kV/s are 2 V, 0.2 um, a sample
        (np.concatenate([np.zeros(5), np.full(5, 1.0)]),
         "sample 5 (0.001 s) asks for 1 um; within reach there are 0 .. 0.2 um"),
        (np.concatenate([np.zeros(5), np.full(5, -0.1)]), "sample 5 (0.001 s) asks for -0.1 um"),
    ],
)  # fmt: skip
def test_a_target_out_of_reach_names_its_sample(tmp_path, model, capsys, um, word):
    path = written(tmp_path / "t.csv", um)
    assert main(["compensate", model, path, "--out", str(tmp_path / "o.csv")]) == 3
    error = capsys.readouterr().err
    assert error.startswith("error[out-of-reach]: ")
    assert word in error
    assert not (tmp_path / "o.csv").exists()


def test_the_limits_are_those_of_the_rig(tmp_path, model, capsys):
    from piezo_rig.resources import shipped_folder

    text = (shipped_folder("configs") / "simulated_bench.toml").read_text()
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace("drive_max_v = 75.0", "drive_max_v = 30.0")
                   .replace("current_a = 0.05", "current_a = 0.00255"))  # fmt: skip
    words = ["--rig", str(rig), "--out", str(tmp_path / "o.csv")]
    slow = written(tmp_path / "slow.csv", 0.01 * np.arange(400))
    assert main(["compensate", model, slow, *words]) == 3
    assert "sample 301 " in capsys.readouterr().err
    # 2.55 mA into 1.5 uF x 1.7 are 1000 V/s: 0.02 um a sample
    fast = written(tmp_path / "fast.csv", 0.021 * np.arange(50))
    assert main(["compensate", model, fast, *words]) == 3
    error = capsys.readouterr().err
    assert "sample 1 " in error
    assert "1000 V/s" in error


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("time_s,displacement_nm\n0,0\n1,1\n", "table-header"),
        ("0,0\n1,1\n", "table-header"),
        ("time_s,displacement_um,drive_v\n0,0,0\n1,1,1\n", "table-header"),
        (f"{HEADER}\n", "target-short"),
        (f"{HEADER}\n0,0\n", "target-short"),
        (f"{HEADER}\n0,0\n1,nan\n2,1\n", "not-a-number"),
        (f"{HEADER}\n0,0\n1,inf\n2,1\n", "not-a-number"),
        (f"{HEADER}\n0,0\n2,1\n1,1\n", "time-order"),
        (f"{HEADER}\n0,0\n1,1\n1,1\n", "time-order"),
        (f"{HEADER}\n0,2\n1,2\n", "target-start"),
        (f"{HEADER}\n0,0\n1\n", "table-row"),
        (f"{HEADER}\n0,0\n1,one\n", "table-row"),
        (f"{HEADER}\n0,0\n0,5;1\n", "table-row"),
        ("", "table-header"),
    ],
)
def test_a_bad_target_is_refused_in_words(tmp_path, model, capsys, text, code):
    path = tmp_path / "t.csv"
    path.write_text(text)
    assert main(["compensate", model, str(path), "--out", str(tmp_path / "o.csv")]) == 2
    assert capsys.readouterr().err.startswith(f"error[{code}]: ")


def test_a_missing_target_and_one_that_would_be_overwritten(tmp_path, model, capsys):
    gone = str(tmp_path / "gone.csv")
    assert main(["compensate", model, gone, "--out", str(tmp_path / "o.csv")]) == 2
    assert "error[file-missing]" in capsys.readouterr().err
    path = written(tmp_path / "t.csv", [0.0, 0.1])
    assert main(["compensate", model, path, "--out", path]) == 2
    assert "error[overwrites-input]" in capsys.readouterr().err


def test_a_drive_that_would_have_to_go_below_its_lowest_is_explained():
    target = lines(0.0, 5.0, 0.0)
    with pytest.raises(LimitError) as out:
        compensate(model_with(), target, RIG)
    assert "hysteresis does not come back" in out.value.cause


@pytest.mark.parametrize(("row", "said"), [("nan", "gap"), ("-inf", "divided by zero")])
def test_a_number_that_is_missing_is_told_from_one_that_is_infinite(
    tmp_path, model, capsys, row, said
):
    path = tmp_path / "t.csv"
    path.write_text(f"{HEADER}\n0,0\n1,{row}\n2,1\n")
    assert main(["compensate", model, str(path), "--out", str(tmp_path / "o.csv")]) == 2
    assert said in capsys.readouterr().err


def test_a_target_below_the_beginning_is_not_taken_for_one_that_comes_back():
    with pytest.raises(LimitError) as out:
        compensate(model_with(), lines(0.0, -1.0), RIG)
    assert out.value.cause == "the target is below what the lowest drive gives"


def test_every_stage_is_said_to_be_inverted_led_or_left_out():
    model = model_with(*EVERY)
    for id, values in {
        "thermal-drift": {"rate": 1.0}, "periodic-nonlinearity": dict.fromkeys(
            ("sine", "cosine", "sine_2", "cosine_2"), 0.5),
        "sensor-scale": {"ratio": 1.01}, "time-skew": {"delay": 2e-4}, "clock-ratio": {"ppm": 20.0},
    }.items():  # fmt: skip
        model = model.with_stage(CAUSES[id].of(None, **values))
    done = compensate(model, lines(0.0, 4.0, 2.0, 3.0), RIG)
    assert {t.id: t.how for t in done.treatments} == {
        "maxwell": "inverted", **dict.fromkeys(EVERY, "inverted"),
        **dict.fromkeys(("thermal-drift", "periodic-nonlinearity", "sensor-scale", "clock-ratio"),
                        "left out"),
        "time-skew": "led",
    }  # fmt: skip
    assert all(t.why for t in done.treatments if t.how != "inverted")


def test_ageing_of_the_whole_strain_and_a_mode_that_carries_everything_are_left_out():
    ageing = CAUSES["cycle-aging"].of(None, rate_per_decade=0.01, whole=1.0)
    mode = CAUSES["resonance"].of(None, share=1.5, frequency=620.0, damping=0.03)
    model = spring().with_stage(ageing).with_stage(mode)
    done = compensate(model, lines(0.0, 4.0, 2.0), RIG)
    assert {t.id: t.how for t in done.treatments} == {
        "maxwell": "inverted", "cycle-aging": "left out", "resonance": "left out",
    }  # fmt: skip
    np.testing.assert_allclose(done.drive_v, 10.0 * lines(0.0, 4.0, 2.0).displacement_um, atol=1e-8)


def test_a_law_that_keeps_its_force_is_left_out_with_the_reason_and_foretold_all_the_same():
    law = CAUSES["extremum-dependence"].of(
        None, slope=0.01, offset=0.2, reach=0.5, closing=0.0, taper=0.0, carries=1.0, spring=0.5,
        at_force=0.0, from_rest=0.0,
    )  # fmt: skip
    target = lines(0.0, 4.0, 2.0)
    done = compensate(spring().with_stage(law), target, RIG)
    assert {t.id: t.how for t in done.treatments} == {
        "maxwell": "inverted", "extremum-dependence": "left out",
    }  # fmt: skip
    assert "force" in next(t.why for t in done.treatments if t.how == "left out")
    np.testing.assert_allclose(done.drive_v, 10.0 * target.displacement_um, atol=1e-8)
    assert np.abs(done.predicted_um - target.displacement_um).max() > 1e-3


def test_the_record_is_in_time_where_the_model_knows_its_delay():
    """10 V/um: a straight rise is led by delay x speed x 10 V/um; with --free-end it is not."""
    model = spring().with_stage(CAUSES["time-skew"].of(None, delay=3e-4))
    target = lines(0.0, 5.0)  # 50 um/s
    led, unled = compensate(model, target, RIG), compensate(model, target, RIG, free_end=True)
    rise = slice(1, -3)
    np.testing.assert_allclose((led.drive_v - unled.drive_v)[rise], 3e-4 * 50 * 10, atol=1e-8)
    np.testing.assert_allclose(led.predicted_um[3:-3], target.displacement_um[3:-3], atol=1e-8)
    np.testing.assert_allclose(unled.predicted_um, target.displacement_um, atol=1e-8)


def test_a_drag_that_would_outrun_the_drive_is_inverted_in_part_and_said():
    """0.02 um at 300 V/s over 0.5 ms: more than the 0.1 um/V x 300 V/s x 0.5 ms that moves it."""
    drag = {"lag_um": 0.02, "exponent": 0.5, "window_s": 5e-4}
    model = model_with("rate-dependence", **{"rate-dependence": drag})
    done = compensate(model, lines(0.0, 4.0, 2.0, 3.0), RIG)
    said = {t.id: t.why for t in done.treatments}
    assert "only in part" in said["rate-dependence"]
    assert np.abs(done.predicted_um - lines(0.0, 4.0, 2.0, 3.0).displacement_um).max() < 0.02
    assert np.abs(np.diff(done.drive_v, 2)).max() < 1.0  # it does not hunt


def test_a_noisy_target_is_followed_and_its_drive_said_to_be_rough():
    model = model_with("initiation-stage", "range-dependence")
    clean = lines(0.0, 5.0, 2.0, 4.0, points=3000)
    noise = 0.003 * np.random.default_rng(1).normal(size=clean.time_s.size)
    noise[0] = 0.0
    noisy = Target(clean.time_s, np.abs(clean.displacement_um + noise))
    done = compensate(model, noisy, Bounds(0.0, 75.0, 1e6))
    assert "rough" in done.warnings[0]
    assert np.abs(done.predicted_um - noisy.displacement_um).max() < 2e-3


def test_a_drive_that_is_clipped_below_begins_where_the_actuator_does():
    clipped = spring().with_stage(CAUSES["drive-clipping"].of(None, lower=5.0, upper=60.0))
    done = compensate(clipped, lines(0.0, 5.0, 0.0), RIG)
    assert done.drive_v[0] == 5.0
    np.testing.assert_allclose(done.drive_v, 5.0 + 10.0 * lines(0.0, 5.0, 0.0).displacement_um,
                               atol=1e-8)  # fmt: skip
    with pytest.raises(LimitError):  # the amplifier ends at 60 V, 5.5 um above
        compensate(clipped, lines(0.0, 5.6), RIG)


def test_a_small_reversal_is_a_half_loop_for_the_inverse_where_it_is_one_for_the_model():
    # 25 mV on the way to 40 V: above 0.05 % of what is played, below that of the rig's range
    model = model_with("initiation-stage", "range-dependence")
    drive = np.concatenate([
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in ((0.0, 30.0, 900), (30.0, 29.975, 30), (29.975, 40.0, 300), (40.0, 5.0, 900))
    ])  # fmt: skip
    time = STEP * np.arange(drive.size)
    target = Target(time, model.simulate(time, drive))
    done = compensate(model, target, Bounds(0.0, 75.0, 1e6))
    assert done.warnings == []
    assert np.abs(done.predicted_um - target.displacement_um).max() < 3e-4
    assert done.drive_v == pytest.approx(drive, abs=5e-3)


def slow_after_a_quick_rise():
    """Up by 2 um at 25 um/s, then on along a sine of 0.5 Hz that begins standing."""
    t = np.arange(10_000) / 5000.0
    slow = 4.0 - 2.0 * np.cos(np.pi * t)
    um = np.concatenate([np.linspace(0.0, 2.0, 400, endpoint=False), slow])
    return Target(np.arange(um.size) / 5000.0, um)


@pytest.mark.parametrize(("rate", "largest_v"), [(0.013, 0.018), (0.016, 0.026)])
def test_a_drive_waits_where_it_would_go_back_by_what_may_or_may_not_count(rate, largest_v):
    # creep is taken back after the rise; 0.05 % of 31.5 V are 0.016 V
    model = model_with("range-dependence", "creep", creep={"rate_per_decade": rate})
    target = slow_after_a_quick_rise()
    done = compensate(model, target, RIG)
    backwards = np.maximum.accumulate(done.drive_v[:5000]) - done.drive_v[:5000]
    assert backwards.max() == pytest.approx(0.9 * 0.0005 * np.ptp(done.drive_v), rel=0.02)
    assert f"by {largest_v:.2g} V at most; it waits" in done.warnings[0]
    # 0.19 um/V: not further off than what it does not go back
    off = np.abs(done.predicted_um - target.displacement_um).max()
    assert off < 0.19 * (largest_v - backwards.max()) + 2e-4


def test_a_drive_goes_back_where_that_counts_for_certain():
    model = model_with("range-dependence", "creep", creep={"rate_per_decade": 0.03})
    target = slow_after_a_quick_rise()
    done = compensate(model, target, RIG)
    backwards = np.maximum.accumulate(done.drive_v[:5000]) - done.drive_v[:5000]
    assert backwards.max() > 2.0 * 0.0005 * np.ptp(done.drive_v)
    assert done.warnings == []
    assert np.abs(done.predicted_um - target.displacement_um).max() < 1e-5


def test_a_target_too_fast_for_the_models_amplifier_is_not_laid_to_the_rig(tmp_path, capsys):
    slow = spring().with_stage(CAUSES["slew-limit"].of(None, limit=500.0))
    path = save_model(slow, tmp_path / "slow.json")
    um = np.concatenate([np.zeros(5), 0.02 * np.arange(1.0, 6.0)])  # 10 V/um: 1000 V/s
    out = tmp_path / "o.csv"
    assert main(["compensate", str(path), written(tmp_path / "t.csv", um), "--out", str(out)]) == 3
    error = capsys.readouterr().err
    assert "sample 5" in error
    assert "and 500 V/s" in error
    assert "the model's amplifier" in error
