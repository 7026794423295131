"""The independent bench: its physics against closed forms, its oracle against algebra."""

from __future__ import annotations

from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.scoring.oracle import Oracle, base_columns
from piezo_rig.studies import diagnosis, diagnosis_case
from piezo_rig.studies.diagnosis_document import write
from piezo_rig.studies.hidden import PROTOCOLS, draw, kernels
from piezo_rig.studies.hidden.body import Body, Law, random_body
from piezo_rig.studies.hidden.confounded import left_off, not_told
from piezo_rig.studies.hidden.effects import EFFECTS, Creep
from piezo_rig.studies.hidden.locked import locked
from piezo_rig.studies.hidden.noise import noise_of
from piezo_rig.studies.hidden.protocols import Condition


def test_branches_with_a_memory_are_play_operators():
    rng = np.random.default_rng(1)
    drive = np.append(0.0, np.cumsum(rng.normal(0.0, 2.0, 3000)))
    body = random_body(rng)
    assert np.allclose(body.displacement(drive), body.rate_dependent(drive, np.zeros(drive.size)),
                       rtol=0, atol=1e-12)  # fmt: skip


def test_bodies_travel_ten_micrometres_in_a_loop_of_ten_to_fifteen_percent():
    drive = np.concatenate([np.linspace(0, 75, 500), np.linspace(75, 0, 500)] * 2)
    for seed in range(5):
        x = random_body(np.random.default_rng(seed)).displacement(drive)
        down, up = x[500:1000][::-1], x[1000:1500]
        assert 8.9 < np.ptp(x[1000:]) < 11.1
        assert 0.09 < np.max(down - up) / np.ptp(up) < 0.16


def test_the_thesis_law_by_hand():
    # elements k1 = 2 V/um that slides at 0.3 um, rest 8 V/um: s1 = 10, break at 3 V, then 1/8
    body = Body(0.1, np.array([3.0]), np.array([0.025]), (0.0, 0.0), "by hand")
    assert body.first_spring == pytest.approx(2.0)
    assert body.first_break_um == pytest.approx(0.3)
    x = body.displacement(np.array([0.0, 43.0, 33.0, 3.0, 18.0]), Law(per_range=0.01))
    assert x[1] == pytest.approx(0.3 + 40 / 8)  # the first rise: nothing behind it
    # down after 43 V: k1 = 2.43, s1 = 10.43 for 0.6 um = 6.258 V, then 8 V/um
    assert x[1] - x[2] == pytest.approx(0.6 + (10 - 6.258) / 8)
    assert x[1] - x[3] == pytest.approx(0.6 + (40 - 6.258) / 8)
    # up after 40 V: k1 = 2.4, s1 = 10.4 for 0.6 um = 6.24 V
    assert x[4] - x[3] == pytest.approx(0.6 + (15 - 6.24) / 8)
    x = body.displacement(np.array([0.0, 43.0, 23.0, 33.0]), Law(per_extremum=0.02))
    assert x[1] - x[2] == pytest.approx(0.6 + (20 - 0.6 * (8 + 2 + 0.86)) / 8)
    assert x[3] - x[2] == pytest.approx(0.6 + (10 - 0.6 * (8 + 2 + 0.46)) / 8)


def test_creep_after_a_step_goes_by_the_same_amount_in_every_decade():
    time = np.concatenate([np.linspace(0, 1e-3, 5)[:-1], np.geomspace(1e-3, 120.0, 4000)])
    x = np.minimum(time / 1e-3, 1.0)
    crept = Creep.drawn(np.random.default_rng(0), "A").sized(0.02).on_actuator(time, x, x) - x
    at = np.interp([0.1, 1.0, 10.0], time, crept)
    assert np.diff(at) == pytest.approx(0.02, rel=0.01)


def test_a_lag_is_exact_on_a_ramp():
    time = np.linspace(0.0, 1.0, 7)
    lagged = kernels.first_order(time, 300.0 * time, 0.2)
    assert lagged == pytest.approx(300.0 * (time - 0.2 * (1 - np.exp(-time / 0.2))))


@pytest.mark.parametrize("kind", ["white", "ar", "1/f"])
def test_noise_is_as_loud_as_stated_and_whitened_by_its_covariance(kind):
    noise = noise_of(kind, 2000.0)
    rng = np.random.default_rng(2)
    drawn = np.array([noise.drawn(300, rng) for _ in range(2000)])
    assert 1e3 * drawn.std() == pytest.approx({"white": 2.0, "ar": 5.0, "1/f": 10**0.5}[kind], 0.05)
    lags = np.arange(300)
    auto = sum((s**2 * d**lags for d, s in zip(noise.decays, noise.sigmas, strict=True)),
               np.zeros(300))  # fmt: skip
    covariance = auto[np.abs(lags[:, None] - lags)] + noise.white**2 * np.eye(300)
    columns = rng.standard_normal((300, 3))
    white = noise.whitened(columns)
    assert white.T @ white == pytest.approx(columns.T @ np.linalg.solve(covariance, columns))


def test_a_null_holds_its_body_and_the_stated_noise_only():
    case = draw("null", 3, "rates", "ar")
    n = len(case.conditions)
    assert case.truth.cause == "none"
    assert len(case.sweeps) == 2 * n
    differences = np.concatenate([
        a.sensor_v - b.sensor_v for a, b in zip(case.sweeps[:n], case.sweeps[n:], strict=True)
    ])  # fmt: skip
    assert 1e3 * 15.48 * differences.std() / np.sqrt(2) == pytest.approx(5.0, rel=0.15)
    fresh = case.again(1)[0]
    assert np.array_equal(fresh.drive_v, case.sweeps[0].drive_v)
    assert not np.any(fresh.sensor_v == case.sweeps[0].sensor_v)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_case_is_small_begins_at_rest_and_comes_in_clock_time(protocol):
    for repeats in (1, 2, 3):
        case = draw("null", 5, protocol, repeats=repeats)
        assert sum(s.samples for s in case.sweeps) <= 50_000
        assert all(abs(s.drive_v[0]) < 1e-9 and s.history == "virgin" for s in case.sweeps)
        ends = [s.start_time + s.time_s[-1] for s in case.sweeps]
        assert all(
            b.start_time > a + 50 for a, b in zip(ends[:-1], case.sweeps[1:], strict=True)
        )  # fmt: skip


def test_d_prime_is_that_of_generalised_least_squares():
    drive = np.concatenate([np.linspace(0, 30, 40), np.linspace(30, 0, 40)])
    conditions = [Condition("0-30", 500.0, drive), Condition("0-15", 500.0, 0.5 * drive)]
    noise = noise_of("ar", 500.0)
    oracle = Oracle.of([c.drive_v for c in conditions], noise, 2)
    rng = np.random.default_rng(4)
    delta = [rng.standard_normal(80) * 1e-3 for _ in range(4)]
    one = 25e-6 * 0.95 ** np.abs(np.arange(80)[:, None] - np.arange(80))
    root = np.kron(np.eye(4), np.linalg.inv(np.linalg.cholesky(one)))
    base = np.vstack([base_columns(c.drive_v, 30.0) for c in conditions] * 2)
    base = np.hstack([base, np.kron(np.eye(4), np.ones((80, 1)))])
    y, a = root @ np.concatenate(delta), root @ (base / np.linalg.norm(base, axis=0))
    left = y - a @ np.linalg.lstsq(a, y, rcond=1e-9)[0]
    assert oracle.d_prime(delta) == pytest.approx(np.linalg.norm(left), rel=1e-3)


@pytest.mark.parametrize("cause", [c for c in EFFECTS if c != "outliers"])
def test_effects_have_the_d_prime_that_was_asked_for(cause):
    case = draw(cause, 2, "rates", "1/f", d_prime=25.0)
    assert case.truth.reached
    assert case.truth.d_prime[0] == pytest.approx(25.0, rel=0.02)
    assert case.truth.sizes[0] > 0
    # nothing is left of an effect of size 0
    c = case.conditions[0]
    gone = locked(case.body, (case.effects[0].sized(0.0),), c.time_s, c.drive_v)
    assert gone == pytest.approx(locked(case.body, (), c.time_s, c.drive_v), abs=1e-9)


def test_spikes_stand_out_and_are_as_frequent_as_stated():
    case = draw("outliers", 2, "shuffled", "white", d_prime=5.0)
    known = np.concatenate([np.append(0.0, k) for k in case.known_um()])
    events = np.count_nonzero(np.diff((known != 0).astype(int)) == 1)
    seconds = sum(s.samples / s.sample_rate for s in case.sweeps)
    expected = case.truth.parameters["outliers"]["per_second"] * seconds
    assert abs(events - expected) < 4 * np.sqrt(expected)
    assert np.abs(known[known != 0]).min() > 0.014
    assert case.truth.d_prime[0] > 20


def test_strangers_and_pairs_are_drawn_and_the_same_seed_gives_the_same_case():
    a, b = draw("pair", 1), draw("pair", 1)
    assert len(a.truth.causes) == 2
    assert np.array_equal(a.sweeps[3].sensor_v, b.sweeps[3].sensor_v)
    assert draw("stranger", 1).truth.cause.startswith("stranger:")
    with pytest.raises(ValueError, match="not one of"):
        draw("witchcraft", 1)


@pytest.mark.parametrize("kind", ["creep+rate-dependence", "time-skew+creep+rate-dependence"])
def test_of_several_effects_each_is_as_plain_as_asked_off_the_others(kind):
    case = draw(kind, 2, "rates", "white", d_prime=40.0)
    assert case.truth.reached
    assert len(case.truth.causes) == 1 + kind.count("+")
    base, rows = [], []
    for k, c in enumerate(case.conditions):
        offsets = np.zeros((c.drive_v.size, len(case.conditions)))
        offsets[:, k] = 1.0
        span = max(d.drive_v.max() for d in case.conditions)
        base.append(np.hstack([base_columns(c.drive_v, span), offsets]))
        bare = locked(case.body, (), c.time_s, c.drive_v)
        rows.append([locked(case.body, (e,), c.time_s, c.drive_v) - bare for e in case.effects])
    known, changes = np.vstack(base), np.concatenate(rows, axis=1)
    sigma = 1e-3 * case.noise.rms_nm / np.sqrt(case.repeats)
    for j, own in enumerate(changes):
        rest = np.column_stack([known, *np.delete(changes, j, axis=0)])
        rest /= np.linalg.norm(rest, axis=0)
        left = own - rest @ np.linalg.lstsq(rest, own, rcond=1e-9)[0]
        assert np.linalg.norm(left) / sigma > 0.97 * 40.0


def test_who_knows_the_effect_predicts_a_drive_that_was_never_measured():
    case = draw("creep", 1, "minor_loops", "white", d_prime=100.0)
    unseen = case.unseen()
    effect = np.std(unseen.with_effect_um - unseen.without_um)
    error = np.std(case.best_unseen_um() - unseen.with_effect_um)
    assert error < 0.2 * effect


def _row(cause, findings, **more):
    return {
        "kind": cause, "seed": 0, "protocol": "matrix", "noise": "white", "d_prime": 40.0,
        "error": None, "seconds": 2.0, "gains_again": [50.0], "unseen": None,
        "truth": {"cause": cause, "causes": [] if cause == "none" else cause.split("+"),
                  "parameters": {"creep": {"rate_per_decade": 0.01}}, "form": "A, discrete",
                  "reached": True},
        "findings": [
            {"cause": c, "alternatives": alt, "gain": 48.0, "gain_ci95": [45.0, 51.0],
             "parameters": {"rate_per_decade": {"value": 0.011, "ci95": [0.009, 0.013]}}}
            for c, alt in findings
        ],
        "unexplained": {"detected": False},
    } | more  # fmt: skip


def test_the_summary_counts_alarms_names_and_intervals():
    rows = [
        _row("none", []),
        _row("none", [("creep", [])]),
        _row("creep", [("creep", [])]),
        _row("creep", [("thermal-drift", ["creep"])]),
        _row("creep", [("outliers", [])]),
        _row("stranger:stick", [], unexplained={"detected": True}),
        _row("creep+mains-hum", [("mains-hum", []), ("creep", [])]),
        _row("creep+mains-hum", [("mains-hum", []), ("time-skew", ["amplifier-lag"])]),
    ]
    said = diagnosis.summary(rows)
    assert "| matrix, white | 2 | 1 | 0 | creep |" in said
    assert "| creep A | 40 | 3 | 3 | 2 | 1 | 2 | 1 | 0 | outliers 1 |" in said
    assert "| stranger:stick | 40 | 1 | 1 | 0 |" in said
    assert "| 2 | all | 40 | 2 | 3 | 1 | 1 | 0.750 | 2 | 1 | 0 |" in said
    assert "| 2 | matrix |" not in said  # which is all that was played
    elsewhere = _row("creep+mains-hum", [("creep", [])]) | {"protocol": "walk"}
    apart = diagnosis.summary([*rows, elsewhere])
    assert "| 2 | matrix | 40 | 2 | 3 | 1 | 1 | 0.750 | 2 | 1 | 0 |" in apart
    assert "| 2 | walk | 40 | 1 | 1 | 1 | 0 |" in apart
    assert "| 2 | all | 40 | 3 | 4 | 2 | 1 |" in apart
    assert "| creep rate_per_decade | 2 | 100 |" in said


def test_a_set_may_hold_what_the_oracle_cannot_tell_either():
    found = [("creep", []), ("time-skew", ["amplifier-lag", "rate-dependence"])]
    strict = _row("creep+time-skew", found)
    for also, fits in (
        ({}, 0), ({"creep": [], "time-skew": ["amplifier-lag"]}, 0),
        ({"creep": ["thermal-drift"], "time-skew": ["amplifier-lag"]}, 1),
    ):  # fmt: skip
        said = diagnosis.summary([strict | {"not_told": also}])
        assert f"| 2 | all | 40 | 1 | 2 | 0 | 0 | 1.000 | 1 | 0 | 0 | {fits} |" in said


def test_a_stranger_counts_where_much_of_it_is_left_off_every_known_cause():
    rows = [
        _row("stranger:stick", [], unexplained={"detected": True}, off_known=59.0),
        _row("stranger:stick", [("creep", [])], off_known=41.0),
        _row("stranger:stick", [("creep", [])], off_known=12.0),
    ]
    said = diagnosis.summary(rows)
    assert "| stranger:stick | 40 | 3 | 1 | 2 | creep 2 | 41 |" in said
    assert "off every known cause unexplained: 1/2" in said
    # of ageing that saturates with the travel little is left off ageing that does with cycles
    ageing = draw("stranger:travel-gain", 9800, "rates", "white", 60.0)
    (left,) = left_off(ageing).values()
    assert min(left, key=left.get) == "cycle-aging"
    assert left["cycle-aging"] < 20.0 < 55.0 < left["mains-hum"]


def test_the_oracle_cannot_tell_a_lag_from_a_delay_where_the_drive_is_slow_and_smooth():
    # of w = 2 pi f tau a lag makes a phase of -w + w^3 / 3 and an amplitude of 1 - w^2 / 2
    smooth = not_told(draw("time-skew", 9802, "multisine", "1/f"))["time-skew"]
    assert "amplifier-lag" in smooth
    assert not {"creep", "mains-hum", "thermal-drift", "direction-asymmetry"} & set(smooth)
    assert not_told(draw("time-skew", 9802, "matrix", "white", 400.0)) == {"time-skew": []}


def test_a_file_of_cases_is_resumed(tmp_path, monkeypatch):
    out = tmp_path / "cases.jsonl"
    ran = []

    def case(spec):
        ran.append(spec.seed)
        return _row("none", []) | asdict(spec)

    monkeypatch.setattr(diagnosis, "run_case", case)
    diagnosis.main(["run", "--seeds", "0:2", "--out", str(out)])
    out.write_text(out.read_text() + '{"kind": "nu')
    diagnosis.main(["run", "--seeds", "0:3", "--out", str(out)])
    assert ran == [0, 1, 2]
    assert len(diagnosis.read(out)) == 3


def test_gains_are_checked_on_a_second_session_and_an_unseen_drive(monkeypatch):
    case = draw("creep", 4, "minor_loops", "white", d_prime=200.0)

    class Known:  # knows the body; with or without the effect
        stages = ()
        remembering = ()

        def __init__(self, effects):
            self.effects = effects

        def simulate(self, time_s, drive_v, history):
            return locked(case.body, self.effects, time_s, drive_v)

    def found(sweeps, baseline):
        models = [Known(())] + ([Known(case.effects)] if sweeps is case.sweeps else [])
        said = SimpleNamespace(cause="creep")
        rungs = [SimpleNamespace(finding=None if i == 0 else i - 1) for i in range(len(models))]
        return SimpleNamespace(rung_models=models, rungs=rungs, findings=[said][: len(models) - 1])

    monkeypatch.setattr(diagnosis_case, "diagnose", found)
    said = diagnosis_case._checked(case, found(case.sweeps, "classical"), "classical")
    effect = np.concatenate([k - k.mean() for k in case.known_um()])
    before = np.sqrt(np.mean(effect**2) * 1e6 + 4.0)
    assert said["gains_again"] == [pytest.approx(100 * (1 - 2.0 / before), abs=0.5)]
    assert said["unseen"]["before_nm"] == pytest.approx(said["unseen"]["effect_nm"])
    assert said["unseen"]["after_nm"] == pytest.approx(0.0, abs=1e-6)
    assert said["unseen"]["possible_nm"] == pytest.approx(0.0, abs=1e-6)


def test_what_stands_by_hand_in_the_document_is_kept(tmp_path):
    page, by_hand = tmp_path / "diagnosis.md", "\n## What it still gets wrong\n\nMuch.\n"
    write([_row("none", [])], page)
    page.write_text(page.read_text() + by_hand)
    write([_row("none", [("creep", [])])], page)
    assert page.read_text().endswith(by_hand)
    assert "| matrix, white | 1 | 1 | 0 | creep |" in page.read_text()
