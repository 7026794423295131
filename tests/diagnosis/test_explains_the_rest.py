"""Causes beside others whose laws are only assumed: what leaves nothing is no misfit of theirs."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import diagnose, refusals, spare
from piezo_rig.studies.hidden import draw
from tests.diagnosis.sliders import play, recorded

RATE, NOISE_NM = 2000.0, 2.0
LIMITS = np.sort(np.random.default_rng(20).uniform(0.2, 28.0, 40))


def noisy(x, seed):
    return x - x[0] + 1e-3 * NOISE_NM * np.random.default_rng(seed).standard_normal(x.size)


def aged(x, cycles, per_decade):
    """Every step as large as the cycle that it is in makes it, by the decade of cycles."""
    gain = 1.0 + per_decade * np.log10(cycles)
    return np.concatenate([[0.0], np.cumsum(gain[1:] * np.diff(x))])


@pytest.mark.parametrize(("with_it_nm", "without_nm", "refused"), [
    (2.0, 9.0, False),  # it takes all
    (2.0, 3.0, True),  # of what is hardly there
    (5.0, 9.0, True),  # some of it
])  # fmt: skip
def test_a_small_effect_is_a_misfit_of_a_law_unless_it_leaves_nothing(
    monkeypatch, with_it_nm, without_nm, refused
):
    table = Elements.from_curve(np.array([1.0, 75.0]), np.array([0.1, 0.12]))
    model = Model((Maxwell.of(table),), {}, "")
    model = model.with_stage(CAUSES["direction-asymmetry"].of(None, ratio=0.99, reach=0.2))
    model = model.with_stage(CAUSES["cycle-aging"].of(None, rate_per_decade=0.005))
    monkeypatch.setattr(refusals, "wanders", lambda *_: None)
    monkeypatch.setattr(refusals, "of_warmth", lambda *_: None)
    monkeypatch.setattr(refusals, "settle", lambda *_: None)
    monkeypatch.setattr(
        refusals, "strengths", lambda *_: {"cycle-aging": 1.0, "direction-asymmetry": 100.0}
    )
    with_it, without = SimpleNamespace(point=SimpleNamespace(model=model)), SimpleNamespace()
    search = SimpleNamespace(
        space=SimpleNamespace(groups=SimpleNamespace(travel_um=7.0, span_v=75.0)),
        causes=["direction-asymmetry"], noise_nm=NOISE_NM,
        error=lambda _, fitted: with_it_nm if fitted is with_it else without_nm,
    )  # fmt: skip
    assert refusals.of_a_law(search, with_it, "cycle-aging") is not None
    told = refusals.of_a_law(search, with_it, "cycle-aging", without)
    assert (told is not None) == refused


@pytest.mark.parametrize(("with_it_nm", "without_nm", "kept"), [
    (3.0, 12.0, True),  # nearly all of what was held out
    (3.0, 4.0, False), (6.0, 12.0, False),  # some of it
    (2.8, 2.85, False),  # of hardly more than noise
])  # fmt: skip
def test_what_foretells_nearly_all_that_was_held_out_is_kept(with_it_nm, without_nm, kept):
    """A drift that a few cycles hardly show, though nothing stands out of what they leave."""
    with_it, without = object(), object()
    search = SimpleNamespace(
        fitted=with_it, noise_nm=2.8, helps=lambda less, fitted: True,
        error=lambda _, fitted: with_it_nm if fitted is with_it else without_nm,
        left_over=lambda fitted=None: 0.0,
    )  # fmt: skip
    assert spare._explains_the_rest(search, without) == kept


@pytest.mark.parametrize(("gained", "harms", "kept"), [
    (300.0, False, True), (300.0, True, False), (20.0, False, False),
])  # fmt: skip
def test_what_says_much_is_dropped_only_if_it_does_harm_beyond_doubt(gained, harms, kept):
    """A delay is far below the error of a sample, which something else rules."""
    with_it, without = SimpleNamespace(evidence=gained), SimpleNamespace(evidence=0.0)
    search = SimpleNamespace(fitted=with_it, helps=lambda *_: harms)
    assert spare._plain(search, without) == kept


@pytest.mark.parametrize(("with_it_nm", "kept"), [(3.152, False), (3.07, True)])
def test_a_table_that_predicts_worse_is_not_kept_for_what_it_says(monkeypatch, with_it_nm, kept):
    """A knock on the table at the beginning of a recording is like a first rise of its own."""
    with_it, without = SimpleNamespace(evidence=300.0), SimpleNamespace(evidence=0.0)
    monkeypatch.setattr(spare, "certainties", lambda *_: {"initiation-stage": 40.0})
    search = SimpleNamespace(
        fitted=with_it, helps=lambda *_: False, noise_nm=3.07, space=None,
        error=lambda _, fitted: with_it_nm if fitted is with_it else 3.131,
    )  # fmt: skip
    assert spare._plain(search, without, "initiation-stage") == kept
    assert spare._plain(search, without)


@pytest.mark.parametrize(("with_it_nm", "without_nm", "gained", "kept"), [
    (140.0, 300.0, 9000.0, True),  # the micromanipulator's delay, of noise of 75 nm
    (140.0, 300.0, 20.0, False),  # which nothing but that says
    (140.0, 160.0, 9000.0, False),  # some of it
    (70.0, 74.0, 9000.0, False),  # there is nothing beside the noise, with it or without
])  # fmt: skip
def test_what_takes_most_of_it_is_kept_however_few_the_recordings(
    with_it_nm, without_nm, gained, kept
):
    """Of two recordings the interval of a gain of 53 % went from -25 to 88 %."""
    with_it, without = SimpleNamespace(evidence=gained), SimpleNamespace(evidence=0.0)
    search = SimpleNamespace(
        fitted=with_it, noise_nm=75.0,
        error=lambda _, fitted: with_it_nm if fitted is with_it else without_nm,
    )  # fmt: skip
    assert spare._takes_most(search, without) == kept


@pytest.mark.parametrize(("with_it_nm", "without_nm", "d_prime", "kept"), [
    (2.024, 2.064, 32.0, True),  # a first rise over two walks, of noise of 2.02 nm
    (2.024, 2.064, 15.0, False),  # not plain
    (2.044, 2.064, 32.0, False),  # half of it is left
    (2.064, 2.024, 32.0, False),  # it does harm
])  # fmt: skip
def test_a_plain_first_rise_that_takes_nearly_all_of_it_is_kept(
    monkeypatch, with_it_nm, without_nm, d_prime, kept
):
    with_it, without = object(), object()
    monkeypatch.setattr(spare, "certainties", lambda *_: {"initiation-stage": d_prime})
    search = SimpleNamespace(
        fitted=with_it, noise_nm=2.02, space=None,
        error=lambda _, fitted: with_it_nm if fitted is with_it else without_nm,
    )  # fmt: skip
    assert spare._takes_the_rest(search, without, "initiation-stage") == kept


@pytest.mark.study
def test_a_first_rise_beside_a_drift_over_walks():
    """The case that asked for it: bends stood for what happens once in every walk."""
    out = diagnose(draw("pair", 9800, "walk", "white", 40.0).sweeps)
    assert {f.cause for f in out.findings} == {"initiation-stage", "thermal-drift"}


@pytest.mark.study
@pytest.mark.parametrize(("protocol", "noise", "seed"), [
    ("ramps", "1/f", 9801), ("walk", "1/f", 9802),
])  # fmt: skip
def test_an_asymmetry_that_gains_on_every_turn_is_no_drift(protocol, noise, seed):
    """The cases that asked for what laws leave open: see test_what_laws_leave_open.py."""
    out = diagnose(draw("pair", seed, protocol, noise, 40.0).sweeps)
    assert "direction-asymmetry" in {f.cause for f in out.findings}
    assert "thermal-drift" not in {c for f in out.findings for c in (f.cause, *f.alternatives)}


@pytest.mark.study
@pytest.mark.parametrize(("protocol", "seed"), [("walk", 9611), ("holds", 9610)])
def test_a_delay_beside_what_rules_the_error(protocol, seed):
    """The cases that asked for it: a direction law, and a lag as long as it beside a bend."""
    case = draw("pair", seed, protocol, "white", 40.0, repeats=1)
    out = diagnose(case.sweeps)
    named = [{f.cause, *f.alternatives} for f in out.findings]
    assert len(named) == 2
    assert all(any(cause in found for found in named) for cause in case.truth.causes)
    assert not out.unexplained.detected


@pytest.mark.study
def test_a_drift_that_alone_says_nothing_beside_an_extremum_law():
    """The case that asked for it: each hides the other over ramps, and the dictionary has both."""
    out = diagnose(draw("pair", 9700, "ramps", "white", 40.0).sweeps)
    assert {f.cause for f in out.findings} == {"thermal-drift", "extremum-dependence"}
    assert not out.unexplained.detected


@pytest.mark.study
def test_an_ageing_and_a_drift_are_no_creep_and_asymmetry():
    """80 sines in one sweep: a creep and loops that do not close take most of both."""
    time = np.arange(round(20.0 * RATE)) / RATE
    drive = 37.5 * (1.0 - np.cos(2.0 * np.pi * 4.0 * time))
    moved = aged(play(drive, LIMITS, 7e-4), np.floor(4.0 * time) + 1.0, 0.006)
    found = diagnose([recorded(drive, noisy(moved + 4e-3 * time, 1), RATE, "unknown")])
    told = {f.cause: f for f in found.findings}
    assert set(told) == {"cycle-aging", "thermal-drift"}
    assert not found.unexplained.detected
    assert told["thermal-drift"].parameters["rate"].value == pytest.approx(4.0, rel=0.05)
    ageing = told["cycle-aging"].parameters["rate_per_decade"].value
    assert ageing == pytest.approx(0.006, rel=0.1)


@pytest.mark.study
def test_an_ageing_of_a_tenth_of_a_percent_behind_a_clock_is_told():
    time = np.arange(round(15.0 * RATE)) / RATE
    late = time * (1.0 + 40e-6)
    drive, seen_at = (37.5 * (1.0 - np.cos(2.0 * np.pi * 4.0 * t)) for t in (time, late))
    moved = aged(play(seen_at, LIMITS, 7e-4), np.floor(4.0 * late) + 1.0, 0.001)
    found = diagnose([recorded(drive, noisy(moved, 2), RATE, "unknown")])
    assert {f.cause for f in found.findings} == {"clock-ratio", "cycle-aging"}
    assert not found.unexplained.detected


@pytest.mark.study
def test_samples_that_are_lost_beside_a_drift_are_counted_once_that_is_known():
    rng = np.random.default_rng(3)
    turns = np.concatenate([[0.0], rng.uniform(5.0, 75.0, 100), [0.0]])
    steps = [max(round(abs(b - a) / rng.uniform(100.0, 400.0) * RATE), 2)
             for a, b in pairwise(turns)]  # fmt: skip
    at = np.concatenate([[0], np.cumsum(steps)])
    drive = np.interp(np.arange(at[-1] + 1), at, turns)
    moved = play(drive, LIMITS, 7e-4) + 5e-3 * np.arange(drive.size) / RATE
    kept = np.delete(np.arange(drive.size), np.arange(drive.size // 3, drive.size // 3 + 9))
    n = kept.size
    found = diagnose([recorded(drive[:n], noisy(moved[kept], 4), RATE, "unknown")])
    assert {f.cause for f in found.findings} == {"dropped-samples", "thermal-drift"}
    assert not found.unexplained.detected
    events = next(f.events for f in found.findings if f.cause == "dropped-samples")
    assert sum(e.size for e in events) == 9


@pytest.mark.study
def test_one_law_alone_may_stand_in_for_two_causes():
    """The case that asked for it: an extremum law did for an initiation stage and a range law."""
    case = draw("pair", 2005, "bipolar_sine", "1/f", 40.0)
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == set(case.truth.causes)
