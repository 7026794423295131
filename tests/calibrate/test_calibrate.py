"""`piezo-rig calibrate`: from points on paper to a file that runs refer to by hash."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from piezo_rig.calibrate.line import bend, fit_line, student, worst_point
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.config.calibration import load_amplifier, load_interferometer
from piezo_rig.errors import InputError
from piezo_rig.resources import shipped_folder

SIMULATED = (shipped_folder("configs") / "simulated_bench.toml").read_text()

# JCGM 100:2008, table H.6: thermometer reading and correction, degrees Celsius
GUM_T = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010,
                  26.511])
GUM_B = np.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161,
                  -0.160])


def write(tmp_path: Path, header: str, rows: list) -> Path:
    path = tmp_path / "points.csv"
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def amplifier_rows(gain: float = 7.5, offset: float = 75.0, wiggle: float = 0.01) -> list:
    """Eleven levels; the scatter is a fixed alternation that leaves no bend."""
    signs = (1, -1, -1, 1, 1, -1, -1, 1, 1, -1, 0)
    return [(c, round(gain * c + offset + wiggle * s, 6))
            for c, s in zip(np.arange(-10.0, 1.0), signs, strict=True)]


def calibrate(points: Path, *words: str, out: str = "cal.toml") -> tuple[int, Path]:
    path = points.parent / out
    said = ["calibrate", str(points), "--out", str(path), "--date", "2026-03-04", *words]
    return main(said), path


def refused(points: Path, capsys, *words: str) -> str:
    status, path = calibrate(points, *words)
    assert status == 2
    assert not path.exists()
    said = capsys.readouterr().err
    assert said.startswith("error[calibration-")
    assert "cause:" in said
    return said.splitlines()[0] + said


# ------------------------------------------------------------------- statistics


def test_the_worked_example_of_the_guide_is_reproduced():
    line = fit_line(GUM_T - 20.0, GUM_B)
    # H.3.3: y1 = -0.1712(29), y2 = 0.00218(67), r = -0.930, s = 0.0035, 9 degrees of freedom
    assert line.intercept == pytest.approx(-0.1712, abs=5e-5)
    assert line.intercept_u == pytest.approx(0.0029, abs=5e-5)
    assert line.slope == pytest.approx(0.00218, abs=5e-6)
    assert line.slope_u == pytest.approx(0.00067, abs=5e-6)
    assert line.covariance / line.slope_u / line.intercept_u == pytest.approx(-0.930, abs=5e-4)
    assert line.residual == pytest.approx(0.0035, abs=5e-5)
    # H.3.4: the correction at 30 degrees, -0.1494(41)
    u30 = math.sqrt(line.intercept_u**2 + 100 * line.slope_u**2 + 20 * line.covariance)
    assert line.intercept + 10 * line.slope == pytest.approx(-0.1494, abs=5e-5)
    assert u30 == pytest.approx(0.0041, abs=5e-5)


def test_few_points_are_worth_what_students_table_says():
    # JCGM 100:2008, table G.2, 95 %
    for dof, factor in ((1, 12.71), (2, 4.30), (9, 2.26), (math.inf, 1.96)):
        assert student(0.975, dof) == pytest.approx(factor, abs=0.005)


def test_stated_uncertainties_are_weights():
    # two good points and a poor one: S = sum w, Sx, Sxx by hand, w = 1, 1, 1/4
    x, y, u = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]), np.array([1.0, 1.0, 2.0])
    s, sx, sxx, sy, sxy = 2.25, 1.5, 2.0, 1.75, 2.5
    d = s * sxx - sx**2
    line = fit_line(x, y, u)
    assert line.slope == pytest.approx((s * sxy - sx * sy) / d)
    assert line.intercept == pytest.approx((sxx * sy - sx * sxy) / d)
    assert (line.slope_u, line.intercept_u) == pytest.approx((math.sqrt(s / d), math.sqrt(sxx / d)))
    assert line.covariance == pytest.approx(-sx / d)
    assert line.birge == 1.0


def test_points_that_scatter_more_than_stated_enlarge_the_result():
    x, y = np.arange(5.0), np.array([0.0, 1.2, 1.8, 3.2, 3.8])
    loose, tight = fit_line(x, y), fit_line(x, y, np.full(5, 0.01))
    assert tight.birge > 10
    assert tight.slope_u == pytest.approx(loose.slope_u)


def test_the_references_scale_is_common_to_all_points():
    x, y = np.arange(5.0), 2.0 * np.arange(5.0) + 10.0
    line = fit_line(x, y, common=0.01)
    assert line.slope_u == pytest.approx(0.02)
    assert line.intercept_u == pytest.approx(0.1)
    assert line.covariance == pytest.approx(0.01**2 * 2.0 * 10.0)


def test_a_fit_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(5)
    x = np.linspace(-10, 0, 6)
    hits = 0
    for _ in range(400):
        line = fit_line(x, 7.5 * x + 75 + rng.normal(0, 0.1, x.size))
        hits += abs(line.slope - 7.5) < line.coverage * line.slope_u
    assert 0.92 < hits / 400 < 0.98


def test_an_outlier_and_a_bend_are_told_from_noise():
    rng = np.random.default_rng(6)
    x = np.linspace(-10, 0, 11)
    noise = [rng.normal(0, 0.05, x.size) for _ in range(200)]
    assert sum(worst_point(x, e).p_value < 0.01 for e in noise) <= 8
    assert sum(bend(x, e).p_value < 0.01 for e in noise) <= 8
    spike = noise[0] + 0.8 * (x == -4)
    assert worst_point(x, spike).index == 6
    assert bend(x, noise[0] + 0.02 * x**2).p_value < 1e-3


# ------------------------------------------------------------------- the file


def test_both_pairs_go_into_one_file_that_a_rig_uses(tmp_path, capsys):
    beam = [("", "", v, round(-15.52 * v + 0.002 * s, 6)) for v, s in
            zip(np.linspace(-0.8, 0.0, 6), (1, -1, 0, 0, -1, 1), strict=True)]
    rows = [(*r, "", "") for r in amplifier_rows(7.51, 75.03)] + beam
    points = write(tmp_path, "command_v,drive_v,sensor_v,displacement_um", rows)
    status, path = calibrate(points, "--amplifier-serial", "M1", "--operator", "Ada",
                             "--reference", "meter 7", "--interferometer-serial", "SP1")
    assert status == 0
    said = capsys.readouterr().out
    assert "polarity     -1" in said
    amplifier = load_amplifier(path)
    assert amplifier.gain == pytest.approx(7.51, abs=5 * amplifier.gain_u)
    assert amplifier.offset_v == pytest.approx(75.03, abs=5 * amplifier.offset_u_v)
    assert 0 < amplifier.gain_u < 0.005
    assert amplifier.covariance_v > 0  # all commands are negative
    assert (amplifier.serial, amplifier.date) == ("M1", "2026-03-04")
    sensor = load_interferometer(path, "printed")
    assert sensor.sensitivities_um_per_v[3] == pytest.approx(15.52, abs=0.01)
    assert 0 < sensor.sensitivities_u_um_per_v[3] < 0.01
    assert math.isnan(sensor.sensitivities_u_um_per_v[2])
    assert sensor.sensitivities_um_per_v[2] == 3.87
    assert (sensor.polarity, sensor.serial) == (-1, "SP1")
    rig = tmp_path / "rig.toml"
    rig.write_text(
        SIMULATED.replace('calibration = "amplifier"', 'calibration = "cal.toml"').replace(
            "sensitivity = 3 ", 'calibration = "cal.toml"\nsensitivity = 3 ')
    )
    loaded = load_rig(str(rig))
    assert loaded.gain == amplifier.gain
    assert loaded.sensitivity_um_per_v == sensor.sensitivities_um_per_v[3]
    assert main(["plan", "quick_look", "--rig", str(rig)]) == 0


def test_a_run_refers_to_the_file_by_its_hash_and_verifies(tmp_path, monkeypatch, capsys):
    import hashlib

    from piezo_rig.run_file.reader import Run

    points = write(tmp_path, "command_v,drive_v", amplifier_rows(7.5, 75.1))
    _, path = calibrate(points, "--set-voltage", "75")
    (tmp_path / "rig.toml").write_text(
        SIMULATED.replace('calibration = "amplifier"', 'calibration = "cal.toml"'))
    (tmp_path / "p.toml").write_text(
        'schema = "piezo-rig/protocol/1"\nname = "p"\nsample_rate = 1000\n[[condition]]\n'
        'waveform = "triangle"\nlower_v = 0\nupper_v = [40, 60]\nfrequency_hz = 5\ncycles = 3\n')
    monkeypatch.chdir(tmp_path)
    assert main(["run", "p.toml", "--rig", "rig.toml", "--out", "runs"]) == 0
    (run,) = (tmp_path / "runs").glob("*.h5")
    hashes = json.loads(Run(run).texts["calibrations"])
    assert hashlib.sha256(path.read_bytes()).hexdigest() in hashes.values()
    assert Run(run).sweeps()[0].offset_v == pytest.approx(75.1, abs=0.02)
    assert main(["verify", str(run)]) == 0
    assert main(["replay", str(run)]) == 0
    capsys.readouterr()
    assert main(["show", str(run)]) == 0
    assert hashlib.sha256(path.read_bytes()).hexdigest()[:16] in capsys.readouterr().out


def test_an_update_keeps_what_was_not_measured(tmp_path):
    points = write(tmp_path, "command_v,drive_v", amplifier_rows())
    _, first = calibrate(points, "--amplifier-serial", "M1", out="first.toml")
    for switch, value, out, old in ((3, 15.5, "second.toml", first), (2, 3.88, "third.toml", None)):
        beam = write(tmp_path, "sensor_v,displacement_um",
                     [(v, value * v + 0.001 * (v == 0.2)) for v in (0.0, 0.2, 0.4)])
        status, _ = calibrate(beam, "--sensitivity", str(switch), "--update",
                              str(old or tmp_path / "second.toml"), out=out)
        assert status == 0
    whole = tmp_path / "third.toml"
    assert load_amplifier(whole).gain_u == load_amplifier(first).gain_u
    assert load_amplifier(whole).serial == "M1"
    sensor = load_interferometer(whole, "exact")
    assert sensor.sensitivities_um_per_v[2:4] == pytest.approx((3.88, 15.5), rel=1e-3)
    assert sensor.polarity == 1
    measured = tomllib.loads(whole.read_text())["interferometer"]["measured"]
    assert [m["switch"] for m in measured] == [2, 3]


def test_a_calibration_that_begins_anew_says_which_noise_it_does_not_state(tmp_path, capsys):
    points = write(tmp_path, "sensor_v,displacement_um",
                   [(v, 15.5 * v + 0.001 * (v == 0.2)) for v in (0.0, 0.2, 0.4)])
    old = str(shipped_folder("calibration") / "sios_sp_s120.toml")
    for words, states in (((), False), (("--update", old), True)):
        status, path = calibrate(points, *words)
        said = capsys.readouterr().out
        assert status == 0
        assert ("noise_nm and output_noise_v are not in the file" in said) is not states
        assert math.isnan(load_interferometer(path, "printed").output_noise_v) is not states


def test_the_same_points_give_the_same_file(tmp_path):
    points = write(tmp_path, "command_v,drive_v", amplifier_rows())
    assert calibrate(points)[1].read_bytes() == calibrate(points, out="b.toml")[1].read_bytes()


def test_german_tables_are_read(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("# Messung\ncommand_v;drive_v\n" + "".join(
        f"{c};{d}\n".replace(".", ",") for c, d in amplifier_rows()))
    status, out = calibrate(path)
    assert status == 0
    assert load_amplifier(out).gain == pytest.approx(7.5, abs=0.005)


def test_a_row_may_begin_with_empty_cells_between_tabs(tmp_path):
    path = tmp_path / "points.csv"
    rows = [f"\t\t{v}\t{15.48 * v + 0.001 * (v == 0.2)}" for v in (0.0, 0.2, 0.4)]
    rows += [f"{c}\t{d}\t\t" for c, d in amplifier_rows()]
    path.write_text("\n".join(["command_v\tdrive_v\tsensor_v\tdisplacement_um", *rows]) + "\n")
    status, out = calibrate(path)
    assert status == 0
    assert load_interferometer(out, "printed").sensitivities_um_per_v[3] == pytest.approx(
        15.48, abs=0.01)
    assert load_amplifier(out).gain == pytest.approx(7.5, abs=0.005)


def test_a_polarity_that_contradicts_the_calibration_is_refused(tmp_path):
    beam = write(tmp_path, "sensor_v,displacement_um",
                 [(v, 15.48 * v + 0.001 * (v == 0.2)) for v in (0.0, 0.2, 0.4)])
    calibrate(beam)
    (tmp_path / "rig.toml").write_text(
        SIMULATED.replace("sensitivity = 3 ", 'calibration = "cal.toml"\nsensitivity = 3 '))
    with pytest.raises(InputError, match="polarity: is -1; the calibration"):
        load_rig(str(tmp_path / "rig.toml"))


def test_a_calibration_of_another_serial_number_is_refused(tmp_path):
    calibrate(write(tmp_path, "command_v,drive_v", amplifier_rows()), "--amplifier-serial", "M1")
    (tmp_path / "rig.toml").write_text(SIMULATED.replace(
        'calibration = "amplifier"', 'calibration = "cal.toml"\nserial = "M2"'))
    with pytest.raises(InputError, match="the calibration is of 'M1'"):
        load_rig(str(tmp_path / "rig.toml"))


@pytest.mark.parametrize(("offset", "rest_v"), [(75.3, 0.3), (74.9, 0.0)])
def test_rest_is_as_near_to_0_v_as_the_generator_comes(tmp_path, offset, rest_v):
    calibrate(write(tmp_path, "command_v,drive_v", amplifier_rows(7.5, offset, 0.0001)))
    (tmp_path / "rig.toml").write_text(
        SIMULATED.replace('calibration = "amplifier"', 'calibration = "cal.toml"'))
    rig = load_rig(str(tmp_path / "rig.toml"))
    assert rig.rest_drive_v == pytest.approx(rest_v, abs=1e-3)
    assert rig.rest_command_v >= -10.0


# ------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(("rows", "code", "says"), [
    (amplifier_rows()[:2], "few", "2 points"),
    ([(-5, 37.5), (-5, 37.6), (-5, 37.4)], "span", "-5 V"),
    ([(c, -d) for c, d in amplifier_rows()], "sign", "leads"),
    ([(1e3 * c, d) for c, d in amplifier_rows()], "units", "command_v is in mV"),
    ([(c, 1e3 * d) for c, d in amplifier_rows()], "units", "drive_v is in mV"),
    ([(d, c) for c, d in amplifier_rows()], "units", "exchanged"),
    ([(c, d + (c == -3) * 0.7) for c, d in amplifier_rows()], "outlier", "line 9"),
    ([(c, min(d, 52.0)) for c, d in amplifier_rows()], "bent", "bend"),
    ([(c, 30 + (i * 7 % 5)) for i, (c, _) in enumerate(amplifier_rows())], "slope", "follow"),
    ([(-10, 0), (-9, "7,5"), (0, 75)], "points", "line 3"),
    ([(-10, 0), (-9, ""), (0, 75)], "points", "line 3: drive_v is empty"),
    ([(-10, 0), (-9, "nan"), (0, 75)], "points", "not a number"),
    ([(-10, 0), (-9, "7" * 200_000), (0, 75)], "points", "line 3"),
    ([(-10, 0), (-9, "\0"), (0, 75)], "points", "line 3"),
])
def test_points_that_cannot_be_right_are_refused(tmp_path, capsys, rows, code, says):
    said = refused(write(tmp_path, "command_v,drive_v", rows), capsys)
    assert f"error[calibration-{code}]" in said
    assert says in said


@pytest.mark.parametrize(("factor", "words", "says"), [
    (15.48e-3, (), "mV"),
    (15.48e-3, ("--sensitivity", "3"), "sensor_v is in mV"),
    (15.48e3, ("--sensitivity", "3"), "displacement_um is in nm"),
    (1 / 15.48, ("--sensitivity", "3"), "exchanged"),
    (3.87, ("--sensitivity", "3"), "the switch stood at 2"),
])
def test_a_sensitivity_that_no_switch_has_is_refused(tmp_path, capsys, factor, words, says):
    rows = [(v, factor * v) for v in (0.0, 0.2, 0.4, 0.6)]
    said = refused(write(tmp_path, "sensor_v,displacement_um", rows), capsys, *words)
    assert "error[calibration-units]" in said
    assert says in said


@pytest.mark.parametrize("header", [
    "command_v,drive_mv", "command_v", "drive_v,drive_v", "command_v,drive_v,sensor_v", "-10,0",
])
def test_columns_that_are_not_known_are_refused(tmp_path, capsys, header):
    rows = [tuple(1 for _ in header.split(","))] * 3
    assert "error[calibration-points]" in refused(write(tmp_path, header, rows), capsys)


def test_uncertainties_of_two_units_in_one_column_are_refused(tmp_path, capsys):
    rows = [(c, d, 0.001 if c < -1 else 1e5) for c, d in amplifier_rows()]
    said = refused(write(tmp_path, "command_v,drive_v,drive_u_v", rows), capsys)
    assert "drive_u_v goes from 0.001 to 1e+05" in said


def test_warnings_are_printed(tmp_path, capsys):
    points = write(tmp_path, "command_v,drive_v,drive_u_v",
                   [(c, 10.0 * c + 90 + 0.05 * s, 0.001) for c, s in ((-9, 1), (-4, -2), (0, 1))])
    status, _ = calibrate(points)
    assert status == 0
    said = capsys.readouterr().out
    for words in ("7.5 V/V was expected", "offset is", "stated uncertainties allow"):
        assert words in said


def test_what_no_rig_would_read_is_not_written(tmp_path, capsys):
    points = write(tmp_path, "command_v,drive_v", amplifier_rows(1500.0))
    status, path = calibrate(points)
    assert status == 2
    assert not path.exists()
    assert "gain: 1500 is above 1000" in capsys.readouterr().err


def test_points_without_any_scatter_are_remarked_on(tmp_path, capsys):
    calibrate(write(tmp_path, "command_v,drive_v", amplifier_rows(wiggle=0.0)))
    assert "state drive_u_v or --reference-percent" in capsys.readouterr().out


def test_points_are_not_written_over(tmp_path, capsys):
    points = write(tmp_path, "command_v,drive_v", amplifier_rows())
    assert main(["calibrate", str(points), "--out", str(points)]) == 2
    assert "overwrites-input" in capsys.readouterr().err
