"""The exported step function does what `simulate` does, sample by sample."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from compiled import Compiled

sys.path.insert(0, str(Path(__file__).parent.parent / "chain"))
from small_models import K, lawful, ride, table

from piezo_rig.causes import STAGES, load_model
from piezo_rig.causes.creep import SHARES
from piezo_rig.chain import Maxwell, Model
from piezo_rig.errors import InputError
from piezo_rig.model_export import c_source
from piezo_rig.resources import find

RATE = 5000.0
CLOSE_UM = 1e-9
PLAIN = lawful("initiation")


def triangle(hertz, seconds, low, high):
    t = np.arange(round(seconds * RATE)) / RATE
    return low + (high - low) * (1.0 - np.abs(2.0 * (t * hertz % 1.0) - 1.0))


def drives():
    """Triangles at three rates, loops inside loops, a random walk of turning points, holds."""
    rng = np.random.default_rng(5)
    rest = np.zeros(60)
    step = ride([0.0, 70.0, 10.0, 70.0], 250)
    return [
        triangle(2.0, 1.2, 0.0, 75.0),
        triangle(37.0, 0.3, 20.0, 70.0),
        triangle(200.0, 0.1, 0.0, 75.0),
        ride([0, 60, 20, 50, 30, 45, 33, 41, 10, 75, 0, 75, 5], 120),
        ride([5.0, *rng.uniform(0.0, 75.0, 60)], 41),
        np.concatenate([rest, step[:501], np.full(700, step[500]), step[501:], np.full(90, 70.0),
                        70.0 - step]),
    ]


def stages(*made):
    model = PLAIN
    for stage in made:
        model = model.with_stage(stage)
    return model


def of(id, **values):
    return STAGES[id].of(**values)


def reach(id, closing, taper, **values):
    return of(id, reach=0.45, closing=closing, taper=taper, **values)


BEND = {"from_v": 5.0, "over_v": 70.0, "square": 0.1, "cube": -0.2, "fourth": 0.05, "fifth": 0.03}
KINDS = {
    **{name: lawful(name) for name in ("initiation", "range-extremum", "direction")},
    "one element": Model((Maxwell.of(table(K[-1:])),)),
    "laws with a reach": stages(
        reach("range-dependence", 0.0, 1.0, slope=0.01, offset=-0.2),
        reach("direction-asymmetry", 1.0, 0.0, ratio=1.1),
        of("extremum-dependence", slope=0.002, offset=0.1),
    ),
    "laws that close": stages(
        reach("extremum-dependence", 1.0, 1.0, slope=0.01, offset=-0.2),
        of("direction-asymmetry", ratio=0.9),
    ),
    "a law inside the first element": stages(
        of("direction-asymmetry", ratio=1.2, reach=0.05, closing=1.0, taper=1.0),
    ),
    "an asymmetry with a long tail": stages(
        of("direction-asymmetry", ratio=0.9, reach=0.4, closing=1.0, taper=2.0, from_below=1.0),
    ),
    "an asymmetry that is given back": stages(
        of("direction-asymmetry", ratio=0.9, reach=0.4, closing=1.0, taper=5.0),
    ),
    "drive-gain": stages(of("drive-gain", ratio=1.03)),
    "drive-gain about 75 V": stages(of("drive-gain", ratio=0.98, stays_v=75.0)),
    "drive-clipping": stages(of("drive-clipping", lower=3.0, upper=61.0)),
    "slew-limit": stages(of("slew-limit", limit=700.0)),
    "amplifier-lag": stages(of("amplifier-lag", tau=2e-3)),
    "a lag below a sample": stages(of("amplifier-lag", tau=2e-5)),
    "bend": stages(of("bend", **BEND)),
    "input-bend": stages(
        of("drive-clipping", lower=3.0, upper=61.0),
        of("input-bend", square=-3.0, cube=1.0, from_v=-10.0, over_v=90.0)),
    "output-bend": stages(
        of("creep", rate_per_decade=0.015), of("output-bend", square=-0.01, cube=0.0004)),
    "creep": stages(of("creep", rate_per_decade=0.015)),
    "creep with shares of its own": stages(
        of("creep", rate_per_decade=0.015, **{n: 0.2 * k for k, n in enumerate(SHARES)})),
    "loops closed exactly are kept": stages(
        reach("range-dependence", 0.0, 0.0, slope=0.01, offset=-0.2, ties=1.0)),
    "rate-dependence": stages(of("rate-dependence", lag_um=0.05, exponent=0.7)),
    "a steep law of the rate": stages(
        of("rate-dependence", lag_um=0.05, exponent=0.4, window_s=2e-3, widens=0.0)),
    "a lag that settles": stages(
        of("rate-dependence", lag_um=0.05, exponent=0.6, window_s=2e-3, settles=1.0)),
    "thresholds that widen": stages(
        of("rate-dependence", lag_um=0.05, exponent=0.6, window_s=8e-3, widens=1.0)),
    "thresholds that widen by a share of themselves": stages(
        of("creep", rate_per_decade=0.015),
        of("rate-dependence", lag_um=0.05, exponent=0.6, window_s=8e-3, widens=2.0, opens_um=0.9)),
    "a lag that levels off": stages(
        of("rate-dependence", lag_um=0.05, exponent=0.6, window_s=2e-3, levels_off=1.0)),
    "cycle-aging": stages(
        of("creep", rate_per_decade=0.015), of("cycle-aging", rate_per_decade=0.02)),
    "cycle-aging that settles": stages(
        of("cycle-aging", rate_per_decade=0.02, settles=2.7)),
    "resonance": stages(of("resonance", share=0.3, frequency=700.0, damping=0.03)),
    "a mode whose damper moves along": stages(
        of("resonance", share=0.3, frequency=700.0, damping=0.03, moves_along=1.0)),
    "periodic-nonlinearity": stages(
        of("periodic-nonlinearity", sine=2.0, cosine=-1.0, sine_2=0.5, cosine_2=0.2)),
    "sensor-clipping": stages(of("sensor-clipping", level=4.0)),
    "sensor-clipping from below": stages(of("sensor-clipping", level=-1.0)),
    "sensor-scale": stages(of("sensor-scale", ratio=1.01)),
    "time-skew": stages(of("time-skew", delay=3.3e-4)),
    "a delay of many samples": stages(of("time-skew", delay=2.31e-2)),
    "a delay of whole samples": stages(of("time-skew", delay=4e-4)),
    "all at once": stages(
        of("drive-clipping", lower=-9.0, upper=71.0), of("amplifier-lag", tau=1e-3),
        of("range-dependence", slope=0.01, offset=-0.2),
        of("rate-dependence", lag_um=0.05, exponent=0.7, window_s=3e-3, widens=1.0),
        of("bend", **BEND), of("creep", rate_per_decade=0.015),
        of("resonance", share=0.3, frequency=700.0, damping=0.03),
        of("sensor-scale", ratio=1.01), of("time-skew", delay=3.3e-4),
    ),
    **{n: load_model(find("models", n)) for n in ("thesis_classical", "thesis_range")},
}


def simulated(model, drive):
    return model.simulate(np.arange(drive.size) / RATE, drive)


@pytest.mark.parametrize("kind", KINDS)
def test_the_step_function_agrees_with_simulate(kind, tmp_path):
    compiled = Compiled(KINDS[kind], tmp_path, RATE)
    assert compiled.source.left_out == {}
    played = drives()
    for drive, moved in zip(played, compiled.play(*played), strict=True):
        assert np.max(np.abs(moved - simulated(KINDS[kind], drive))) < CLOSE_UM
    assert (compiled.fault, compiled.forgotten) == (0, 0)


@pytest.mark.parametrize("kind", ["range-extremum", "laws with a reach", "cycle-aging"])
def test_reversals_that_are_no_half_loops_are_none_in_the_step_function(kind, tmp_path):
    # halfway up and down the drive wavers within 10 mV; the elements reach over 23 V
    waver = 0.005 * np.sin(np.arange(400) / 9.0)
    drive = np.concatenate([
        part for a, b in pairwise([0.0, 72.0, 20.0, 60.0, 5.0, 72.0])
        for part in (np.linspace(a, 0.5 * (a + b), 200), 0.5 * (a + b) + waver,
                     np.linspace(0.5 * (a + b), b, 200))
    ])  # fmt: skip
    compiled = Compiled(KINDS[kind], tmp_path, RATE)
    (moved,) = compiled.play(drive)
    assert np.max(np.abs(moved - simulated(KINDS[kind], drive))) < 1e-3  # um


def test_every_cause_has_a_c_form_or_a_reason_why_not():
    tried = {s.id for model in KINDS.values() for s in model.stages}
    clock = {id for id, kind in STAGES.items() if kind.locked_to == "clock"}
    assert set(STAGES) - tried - clock == {"clock-ratio", "remanence"}


def test_a_random_walk_of_every_size_is_followed(tmp_path):
    walk = np.abs(np.cumsum(np.random.default_rng(3).normal(0.0, 0.7, 20_000)))
    (moved,) = Compiled(PLAIN, tmp_path, RATE).play(walk)
    assert np.max(np.abs(moved - simulated(PLAIN, walk))) < CLOSE_UM


def test_a_shrinking_drive_beyond_the_bound_forgets_the_smallest_loop_only(tmp_path):
    turns = [0.0]
    for k in range(300):
        turns.append(40.0 + 30.0 * (-1.0) ** k * 0.99**k)
    drive = ride([*turns, 75.0, 0.0, 75.0], 20)
    compiled = Compiled(PLAIN, tmp_path, RATE)
    (moved,) = compiled.play(drive)
    assert compiled.forgotten > 0
    off = np.abs(moved - simulated(PLAIN, drive))
    assert np.max(off[: 120 * 20]) < CLOSE_UM  # nothing is forgotten before it is full
    smallest = 2 * 30.0 * 0.99**127
    steepest = 1.0 / table(K).slopes
    assert np.max(off) < compiled.forgotten * smallest * np.ptp(steepest)


def test_a_drive_that_is_no_number_is_passed_over_and_said(tmp_path):
    compiled = Compiled(PLAIN, tmp_path, RATE)
    drive = ride([0, 50, 20], 50)
    holes = np.insert(drive, 60, [np.nan, -np.inf, 1e13])
    (moved,) = compiled.play(holes)
    assert compiled.fault == 2
    assert moved[60:63] == pytest.approx(moved[59])
    assert np.delete(moved, [60, 61, 62]) == pytest.approx(simulated(PLAIN, drive), abs=CLOSE_UM)


def test_a_law_that_fails_is_said_and_the_table_goes_on(tmp_path):
    model = PLAIN.with_stage(of("range-dependence", slope=-1.0, offset=0.0))
    compiled = Compiled(model, tmp_path, RATE)
    drive = ride([0, 50, 20], 50)
    (moved,) = compiled.play(drive)
    assert compiled.fault == 1
    assert moved == pytest.approx(simulated(PLAIN, drive), abs=CLOSE_UM)


@pytest.mark.parametrize(("stage", "why"), [
    (of("thermal-drift", rate=3.0), "follows the clock"),
    (of("clock-ratio", ppm=20.0), "grows with the time"),
    (of("remanence", fraction=0.1), "begins virgin"),
    (of("cycle-aging", rate_per_decade=0.01, whole=1.0), "end of the half loop"),
    (of("time-skew", delay=-1e-4), "not causal"),
])  # fmt: skip
def test_what_cannot_be_causal_is_left_out_and_named_in_the_file(stage, why):
    source = c_source(PLAIN.with_stage(stage), "model", RATE)
    assert why in source.left_out[stage.id]
    assert why in " ".join(source.text.replace(" * ", " ").split())
    assert source.held == [s.id for s in PLAIN.stages]


def test_the_file_needs_nothing_but_math_h():
    text = c_source(KINDS["all at once"], "model", RATE).text
    assert [line for line in text.splitlines() if line.startswith("#include")] == [
        "#include <math.h>"]
    assert not any(word in text for word in ("malloc", "memset", "printf", "free("))


def test_a_hostile_name_stays_in_the_comment(tmp_path):
    model = PLAIN.with_(name="*/ #error gone /*", provenance={"note": "*/ int x = ;\n#error"})
    (moved,) = Compiled(model, tmp_path, RATE).play(np.array([0.0, 1.0, 2.0]))
    assert moved[0] == 0.0


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_sample_rate_that_is_none_is_refused(rate):
    with pytest.raises(InputError, match="sample rate"):
        c_source(PLAIN, "model", rate)
