"""The stack's physics against closed forms and the thesis's figures."""

from itertools import pairwise

import numpy as np
import pytest

from drivers.simulated.plant import Plant, PlantConfig

RATE = 5000.0
REVERSIBLE = PlantConfig().stack.reversible
NO_NOISE = {name: {"on": False} for name in ("white_noise", "one_over_f_noise", "quantisation")}
# A body of walls alone: what remains is a Prandtl-Ishlinskii operator.
WALLS_ONLY = {
    **NO_NOISE,
    **{
        name: {"on": False}
        for name in (
            "amplifier_lag",
            "initiation_stage",
            "range_dependence",
            "direction_asymmetry",
            "creep",
            "resonance",
        )
    },
}


def command_of(drive):
    return (np.asarray(drive, dtype=float) - 75.0) / 7.5


def triangle(low, high, cycles, samples=2500):
    up = np.linspace(low, high, samples // 2 + 1)
    return np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), low)


def displacement(plant, t, count, rate=RATE):
    return -15.48 * plant.record(t, rate, count).sensor_v


def rested(config=None, seed=None):
    """A plant that has rested at 0 V for twice its recovery time, at bench time 50 s."""
    plant = Plant({**NO_NOISE, **(config or {})}, seed=seed)
    plant.set_level(0.0, -10.0)
    return plant


def played(config, drive, t=50.0):
    plant = rested(config)
    plant.play(t, command_of(drive), RATE)
    return displacement(plant, t, len(drive))


def along(config, turning_points):
    """Displacement at turning points of the drive, V, joined by ramps of 100 samples."""
    parts = [np.linspace(a, b, 101)[:-1] for a, b in pairwise(turning_points)]
    drive = np.append(np.concatenate(parts), turning_points[-1])
    return played(config, drive)[::100]


# ------------------------------------------------------------------ travel, thesis


# Appendices A and B (initiation, later cycles) and C (the classical model, of the same
# actuator) are not from one computation: by B a later half loop of 65 V is 8.247 um, by C 8.828.
# The classical model can only err by the thesis's 7-10 % where later cycles are as in C and the
# first rise stays behind them, so half way up it is lower here than by A.
@pytest.mark.parametrize(
    ("top", "travel", "within"),
    [(37.7, 4.814, 0.06), (65.0, 9.195, 0.015), (75.0, 10.880, 0.015)],
    ids=str,
)
def test_the_first_rise_is_as_long_as_in_the_thesis(top, travel, within):
    assert played({}, triangle(0.0, top, 1))[1250] == pytest.approx(travel, rel=within)


@pytest.mark.parametrize(
    ("top", "appendix_b", "appendix_c"),
    [(10.0, 1.027, 0.988), (25.0, 2.709, 2.793), (65.0, 8.247, 8.828)],
    ids=str,
)
def test_later_half_loops_are_as_long_as_in_the_thesis(top, appendix_b, appendix_c):
    x = played({}, triangle(0.0, top, 4))
    low, high = sorted((appendix_b, appendix_c))
    assert 0.98 * low < x[8750] - x[7500] < 1.02 * high


def test_the_loop_is_12_to_15_percent_wide():
    drive = triangle(0.0, 65.0, 4)
    x = played({}, drive)
    up, down = slice(5000, 6251), slice(6250, 7501)
    at = np.linspace(1.0, 64.0, 64)
    gap = np.interp(at, drive[down][::-1], x[down][::-1]) - np.interp(at, drive[up], x[up])
    assert 0.12 < gap.max() / (x[6250] - x[5000]) < 0.15


def test_ascending_branches_begin_steeper_than_descending_ones():
    x = played({}, triangle(0.0, 65.0, 4))
    assert x[5100] - x[5000] > x[6250] - x[6350]


# ------------------------------------------------------------------------ memory


def test_a_wiped_out_excursion_leaves_no_trace():
    direct = along(WALLS_ONLY, [0.0, 60.0])
    detour = along(WALLS_ONLY, [0.0, 40.0, 15.0, 30.0, 20.0, 60.0])
    assert detour[-1] == pytest.approx(direct[-1], abs=1e-9)


def test_minor_loops_of_walls_close_and_are_congruent():
    x = along(WALLS_ONLY | {"stack": {"curvature": 0.0}}, [0.0, 60.0, 40.0, 60.0, 0.0, 30.0, 10.0])
    assert x[3] == pytest.approx(x[1], abs=1e-9)
    assert x[1] - x[2] == pytest.approx(x[5] - x[6], abs=1e-9)


def test_displacement_follows_the_drive_monotonically_and_without_jumps():
    rng = np.random.default_rng(3)
    turns = np.concatenate([[0.0], rng.uniform(0.0, 75.0, 60)])
    drive = np.concatenate([np.linspace(a, b, 200)[1:] for a, b in pairwise(turns)])
    quiet = {"creep": {"on": False}, "resonance": {"on": False}, "amplifier_lag": {"on": False}}
    x = played({**quiet, "range_dependence": {"size": 0.6}}, drive)
    dx, dv = np.diff(x), np.diff(drive)
    assert np.all(dx * dv >= 0.0)
    assert np.all(np.abs(dx) < 0.3 * np.abs(dv) + 1e-9)


def test_a_vanishing_wiggle_changes_nothing_in_a_range_dependent_stack():
    config = WALLS_ONLY | {"range_dependence": {"on": True, "size": 0.5}}
    plain = along(config, [0.0, 50.0, 20.0, 60.0])
    wiggle = along(config, [0.0, 50.0, 20.0, 40.0, 39.99, 60.0])
    # A real turn of 30 V there moves the end by more than 10 nm.
    turned = along(config, [0.0, 50.0, 20.0, 40.0, 10.0, 60.0])
    assert wiggle[-1] == pytest.approx(plain[-1], abs=1e-3)
    assert abs(turned[-1] - plain[-1]) > 1e-2


def test_a_jump_of_the_drive_ends_where_a_ramp_does():
    config = WALLS_ONLY | {"range_dependence": {"on": True, "size": 0.5}}
    ramp = along(config, [0.0, 70.0, 10.0, 40.0])
    jump = played(config, np.array([0.0, 70.0, 10.0, 40.0, 40.0]))
    assert jump[3] == pytest.approx(ramp[3], abs=2e-3)


def test_range_dependence_makes_long_excursions_start_back_less_steeply():
    config = WALLS_ONLY | {"range_dependence": {"on": True, "size": 0.3, "fade": 1e6}}
    with_it = along(config, [0.0, 75.0, 74.7])
    without = along(WALLS_ONLY, [0.0, 75.0, 74.7])
    lost = (without[1] - without[2]) - (with_it[1] - with_it[2])
    assert lost == pytest.approx(0.3 * REVERSIBLE * 0.3, rel=0.05)


def test_extremum_dependence_follows_the_turning_point():
    config = WALLS_ONLY | {"extremum_dependence": {"on": True, "size": 0.3}}
    change = []
    for top in (75.0, 37.5):
        turns = [0.0, top, top - 0.3]
        a, b = along(config, turns), along(WALLS_ONLY, turns)
        change.append((b[1] - b[2]) - (a[1] - a[2]))
    assert change[0] == pytest.approx(0.3 * REVERSIBLE * 0.3, rel=0.3)
    assert change[1] == pytest.approx(0.5 * change[0], rel=0.05)


def test_direction_asymmetry_is_the_ratio_of_first_slopes_and_closes():
    config = WALLS_ONLY | {
        "direction_asymmetry": {"on": True, "ratio": 1.2},
        "stack": {"curvature": 0.0, "irreversible": 0.0},
    }
    x = along(config, [0.0, 60.0, 59.9, 0.0, 0.1, 60.0, 0.0])
    assert (x[4] - x[3]) / (x[1] - x[2]) == pytest.approx(1.2, rel=0.01)
    assert x[6] == pytest.approx(x[3], abs=1e-9)


def test_the_first_rise_has_its_own_strain_that_later_cycles_lack():
    config = WALLS_ONLY | {"initiation_stage": {"on": True, "size": 0.5, "scale": 30.0}}
    turns = [0.0, 60.0, 0.0, 60.0]
    extra = along(config, turns) - along(WALLS_ONLY, turns)
    expected = 0.5 * (1.0 - np.exp(-4.0))
    np.testing.assert_allclose(extra, [0.0, expected, expected, expected], atol=1e-9)


def test_ageing_changes_the_travel_by_its_rate_per_decade_of_cycles():
    config = WALLS_ONLY | {"cycle-aging": {"on": True, "rate_per_decade": 0.05}}
    x = played(config, triangle(0.0, 60.0, 11, samples=500))
    travel = x[250::500][:11] - x[500::500]
    assert travel[9] / travel[0] == pytest.approx(1.05, rel=1e-6)


def test_cycles_are_counted_from_one_after_a_rest_of_the_recovery_time():
    config = WALLS_ONLY | {"cycle-aging": {"on": True, "rate_per_decade": 0.05}}
    config["recovery"] = {"on": True}
    x = played(config, triangle(0.0, 60.0, 11, samples=500), t=25.0)  # 20 s make it virgin
    travel = x[250::500][:11] - x[500::500]
    assert travel[9] / travel[0] == pytest.approx(1.05, rel=1e-4)


# -------------------------------------------------------------------------- rest


def test_rest_makes_the_actuator_virgin():
    plant = rested()
    drive = triangle(0.0, 65.0, 2)
    plant.play(50.0, command_of(drive), RATE)
    first = displacement(plant, 50.0, drive.size)
    assert first[-1] > 0.5, "a unipolar stack does not come back at once"
    begin = 50.0 + drive.size / RATE + 20.0
    assert abs(plant.displacement_um(begin)) < 1e-4
    plant.play(begin, command_of(drive), RATE)
    second = displacement(plant, begin, drive.size)
    np.testing.assert_allclose(second, first, atol=1e-4)


def test_the_turning_point_of_a_triangle_is_no_rest():
    plant = rested()
    drive = triangle(0.0, 65.0, 1)
    end = 50.0 + drive.size / RATE
    plant.play(50.0, command_of(drive), RATE)
    left = plant.displacement_um(end)
    # Logarithmic creep alone moves it in the half second that follows.
    assert plant.displacement_um(end + 0.5) == pytest.approx(left, rel=0.3)


def test_remanence_is_the_share_of_memory_that_rest_leaves():
    left = []
    for remanence in ({}, {"remanence": {"on": True, "fraction": 0.25}}):
        plant = rested({**WALLS_ONLY, **remanence})
        drive = triangle(0.0, 65.0, 1)
        plant.play(100.0, command_of(drive), RATE)
        left.append((plant.displacement_um(100.52), plant.displacement_um(200.0)))
    assert left[0][1] == pytest.approx(0.0, abs=1e-9)
    assert left[1][1] == pytest.approx(0.25 * left[1][0], rel=1e-6)


# -------------------------------------------------------------------------- time


def test_creep_grows_by_its_rate_per_decade():
    config = WALLS_ONLY | {"creep": {"on": True, "rate_per_decade": 0.012}}
    plant, bare = rested(config), rested(WALLS_ONLY)
    for p in (plant, bare):
        p.set_level(5000.0, -4.0)
    step = bare.displacement_um(5000.1) - bare.displacement_um(4999.9)
    decades = [plant.displacement_um(5000.0 + t) for t in (0.1, 1.0, 10.0, 100.0)]
    np.testing.assert_allclose(np.diff(decades) / step, 0.012, rtol=0.1)


def test_a_step_rings_at_the_mode_and_dies_with_its_damping():
    frequency, damping = 500.0, 0.02
    mode = {"on": True, "frequency": frequency, "damping": damping, "participation": 0.1}
    plant = rested(WALLS_ONLY | {"resonance": mode})
    plant.set_level(50.0, -9.0)
    t = np.arange(2000) / 100_000.0
    x = displacement(plant, 50.0, 2000, 100_000.0)
    omega = 2.0 * np.pi * frequency
    fast = omega * np.sqrt(1.0 - damping**2)
    ring = np.cos(fast * t) + damping / np.sqrt(1.0 - damping**2) * np.sin(fast * t)
    still = rested(WALLS_ONLY)
    still.set_level(50.0, -9.0)
    step = still.displacement_um(50.1)
    expected = step * (1.0 - 0.1 * np.exp(-damping * omega * t) * ring)
    np.testing.assert_allclose(x, expected, atol=1e-9)


def test_viscosity_lags_by_its_size_at_300_v_per_second():
    lag = {"on": True, "lag_um": 0.05, "exponent": 0.6}
    ramps = {300.0: 0.05, 75.0: 0.05 * 0.25**0.6}
    for slew, expected in ramps.items():
        drive = np.linspace(0.0, 60.0, int(60.0 / slew * RATE) + 1)
        late = played(WALLS_ONLY, drive) - played(WALLS_ONLY | {"rate-dependence": lag}, drive)
        assert late[-1] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("rate", [50_000.0, 1_000.0, 3_700.0])
def test_the_motion_does_not_depend_on_how_it_is_sampled(rate):
    drive = triangle(0.0, 65.0, 1)
    plain, watched = rested(), rested()
    for plant in (plain, watched):
        plant.play(50.0, command_of(drive), RATE)
    watched.record(50.0, rate, int(0.5 * rate))
    for t in (50.2, 50.4, 50.49):
        assert watched.displacement_um(t) == pytest.approx(plain.displacement_um(t), abs=2e-5)


# --------------------------------------------------------------------- strangers


def stranger(name, **sizes):
    return WALLS_ONLY | {"strangers": {name: {"on": True, **sizes}}}


def test_the_stranger_stiction_lags_both_ways_at_its_place():
    turns = [0.0, 30.0, 60.0, 30.0, 0.0]
    bare = along(WALLS_ONLY, turns)
    x = along(stranger("stiction_bump", size=0.05, place=bare[1], width=0.3), turns)
    assert bare[1] - x[1] == pytest.approx(0.05, rel=1e-3)
    at_place = along(stranger("stiction_bump", size=0.05, place=bare[3], width=0.3), turns)
    assert at_place[3] - bare[3] == pytest.approx(0.05, rel=0.03)


def test_the_stranger_of_period_two_alternates():
    drive = triangle(0.0, 60.0, 5, samples=500)
    difference = played(stranger("period_two", size=0.04), drive) - played(WALLS_ONLY, drive)
    cycles = difference[500:2500].reshape(4, 500)
    np.testing.assert_allclose(cycles[0], cycles[2], atol=1e-6)
    np.testing.assert_allclose(cycles[0], -cycles[1], atol=2e-3)
    assert np.abs(cycles[0] - cycles[1]).max() == pytest.approx(0.04, rel=0.02)


def test_the_stranger_curvature_waits_for_a_large_excursion():
    turns = [0.0, 37.5, 0.0, 60.0, 37.5]
    config = stranger("curvature_change", size=0.05, beyond=40.0)
    extra = along(config, turns) - along(WALLS_ONLY, turns)
    np.testing.assert_allclose(extra[:3], 0.0, atol=1e-12)
    assert extra[4] == pytest.approx(0.05, rel=1e-9)


def test_the_stranger_backlash_follows_half_a_gap_behind():
    turns = [0.0, 60.0, 30.0]
    extra = along(stranger("backlash", gap=0.04), turns) - along(WALLS_ONLY, turns)
    assert extra[2] - extra[1] == pytest.approx(0.04, rel=1e-6)


def test_the_stranger_heat_rises_with_its_time_constant():
    drive = triangle(0.0, 75.0, 40, samples=2500)
    config = stranger("self_heating", size=0.05, tau=8.0)
    extra = played(config, drive) - played(WALLS_ONLY, drive)
    assert extra[-1] == pytest.approx(0.05 * (1.0 - np.exp(-20.0 / 8.0)), rel=0.01)
