"""The thesis, reproduced: plays its experiments, identifies its models, writes docs/thesis.md.

``make study-thesis``. Everything is played through the drivers on the simulated bench; every
number in the document comes from here, the prose from ``thesis_template.md``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant import settings
from piezo_rig import __version__
from piezo_rig.causes import load_model
from piezo_rig.chain import Elements, Model
from piezo_rig.commands.run import record
from piezo_rig.config import DEFAULT_RIG, Rig, load_rig
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import find
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.studies import thesis_figures as figures
from piezo_rig.studies import thesis_tables as tables
from piezo_rig.studies.document import fill, number
from piezo_rig.studies.fits import HELD_OUT, VALIDATION, Fit, Job, fit_all, jobs
from piezo_rig.studies.half_loops import (
    MeanHalfLoop,
    first_rise,
    mean_half_loops,
    pick,
    segment_slopes,
    springs,
)
from piezo_rig.studies.pairing import (
    Pairs,
    Section,
    measure,
    paired_as_printed,
    paired_correctly,
)

FloatArray = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
SEED = 1
MORE_SEEDS = (2, 3)
FINE_STEP_UM = 0.1366  # dx of Figure 2-6
FIG_2_6_RANGES = np.arange(10.0, 45.0, 5.0)
CLASSICAL = Job("classical", "slopes", "0-75")
RANGE = Job("range", "slopes", "all")
EXTREMUM = Job("extremum", "slopes", "all")
PLANT_SETTINGS = (
    "stack", "initiation_stage", "range_dependence", "direction_asymmetry", "creep",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that was played with the main seed."""

    matrix: list[Sweep]
    matrix_loops: list[MeanHalfLoop]
    staircase: list[Sweep]
    bias_loops: list[MeanHalfLoop]

    def of(self, condition: str) -> list[Sweep]:
        """The repeats of one condition of the matrix."""
        return [s for s in self.matrix if s.condition == condition]


def play(protocol: Path, seed: int, folder: Path) -> Path:
    """Play a protocol on the simulated bench with a seed of its own."""
    rig: Rig = load_rig(DEFAULT_RIG)
    rig = replace(rig, plant={**rig.plant, "seed": seed})
    return record(build_plan(load_protocol(protocol), rig), rig, folder)


def thesis_models() -> dict[str, Model]:
    """Appendices A to C as the program ships them."""
    names = ("classical", "range", "extremum")
    return {n: load_model(find("models", f"thesis_{n}.json")) for n in names}


def rise_of(model: Model) -> Elements:
    """Elements of the first rise."""
    stage = model.stage("initiation-stage")
    assert stage is not None
    assert stage.elements is not None
    return stage.elements


def later_of(model: Model, range_v: float | None = None) -> Elements:
    """Elements of later cycles; the first one of a range law at ``range_v``."""
    elements = model.maxwell.elements
    assert elements is not None
    law = model.stage("range-dependence")
    if law is None or range_v is None:
        return elements
    k = elements.k_v_per_um.copy()
    k[0] = law["slope"] * range_v + law["offset"]
    return Elements(k, elements.slides_at_um)


def staircase_pairs(sweeps: Sequence[Sweep], step_um: float) -> FloatArray:
    """First spring of each of Appendix H's 59 sections, averaged over the repeats.

    k1 = s1 - s2 of the section itself, or s1 where there is one segment only (Appendix G).
    """
    loops = mean_half_loops(sweeps)
    drive, displacement = first_rise(sweeps)

    def first_spring(section: Section) -> float:
        if section.first_rise:
            return float(springs(segment_slopes(drive, displacement, step_um))[0])
        loop = pick(loops, section.start_v, section.range_v, section.direction)
        return float(springs(segment_slopes(loop.drive_v, loop.travel_um, 2.0 * step_um))[0])

    return measure(first_spring)


def matrix_pairs(fit: Fit) -> Pairs:
    """First springs of the slope scheme with their own range and extremum."""
    found = fit.first_springs
    assert found is not None
    return Pairs(found.k1, found.range_v, found.extremum_v)


def own_pairs(loops: Sequence[MeanHalfLoop], step_um: float) -> Pairs:
    """As Appendix H has it: the second slope is that of the same half loop, not the mean one."""
    k1 = []
    for loop in loops:
        slopes = segment_slopes(loop.drive_v, loop.travel_um, 2.0 * step_um)
        k1.append(float(springs(slopes)[0]))
    return Pairs(
        np.array(k1), np.array([x.range_v for x in loops]), np.array([x.start_v for x in loops])
    )


def first_three(loops: Sequence[MeanHalfLoop], direction: int) -> tuple[FloatArray, FloatArray]:
    """First three slopes and springs at every range of Figure 2-6, shape (7, 3) each."""
    found = np.full((2, FIG_2_6_RANGES.size, 3), np.nan)
    for row, range_v in enumerate(FIG_2_6_RANGES):
        loop = pick(loops, 0.0 if direction > 0 else 75.0, range_v, direction)
        slopes = segment_slopes(loop.drive_v, loop.travel_um, 2.0 * FINE_STEP_UM)
        for values, kind in ((slopes, 0), (springs(slopes), 1)):
            count = min(3, values.size)
            found[kind, row, :count] = values[:count]
    return found[0], found[1]


def observations(bench: Bench, images: Path, fit: Fit, theirs: Model) -> dict[str, str]:
    """Section 2.3: Figures 2-2 to 2-6."""
    dx = fit.dx_um
    loops = bench.matrix_loops
    rise = segment_slopes(*first_rise(bench.of("0-70")), dx)
    ours = {"first rise": rise}
    for start, way, name in ((0.0, 1, "ascending"), (70.0, -1, "descending")):
        loop = pick(loops, start, 70.0, way)
        ours[name] = segment_slopes(loop.drive_v, loop.travel_um, 2.0 * dx)
    printed = {"first rise": rise_of(theirs).slopes, "later": later_of(theirs, 70.0).slopes}
    figures.initiation_slopes(images / "thesis_2_2.png", ours, printed, dx)

    up, down = pick(loops, 0.0, 65.0, 1), pick(loops, 65.0, 65.0, -1)
    figures.rotated(images / "thesis_2_3.png", up, down)

    rising = [pick(bench.bias_loops, v, 25.0, 1) for v in (0.0, 15.0, 50.0)]
    falling = [pick(bench.bias_loops, v, 25.0, -1) for v in (25.0, 40.0, 75.0)]
    figures.same_range(images / "thesis_2_4.png", rising, falling)

    pairs = [(bench.of(f"0-{v:g}")[0], bench.of(f"75-{75 - v:g}")[0]) for v in FIG_2_6_RANGES]
    figures.inputs(images / "thesis_2_5.png", pairs)
    series = {
        "ascending from 0 V": first_three(loops, 1),
        "descending from 75 V": first_three(loops, -1),
    }
    figures.over_range(images / "thesis_2_6.png", FIG_2_6_RANGES, series)

    def segments(loop: MeanHalfLoop) -> str:
        return str(int(np.ceil(loop.travel_um[-1] / (2.0 * FINE_STEP_UM))))

    forty = pick(loops, 0.0, 40.0, 1)
    return {
        "ends_table": tables.ends(up, down),
        "same_range_table": tables.same_range(rising, falling),
        "over_range_table": tables.over_range(FIG_2_6_RANGES, series),
        "segments_of_40": segments(forty),
        "segments_of_10": segments(pick(loops, 0.0, 10.0, 1)),
        "travel_of_40": number(float(forty.travel_um[-1]), 2),
    }


def first_springs(bench: Bench, images: Path, fit: Fit) -> dict[str, str]:
    """Section 4.2, Figure 4-3: both pairings on the staircase, and the matrix."""
    k1 = staircase_pairs(bench.staircase, fit.dx_um)
    printed, right = paired_as_printed(k1), paired_correctly(k1)
    usual = np.abs(printed.k1 - np.median(printed.k1)) < 4.0
    without = Pairs(printed.k1[usual], printed.range_v[usual], printed.extremum_v[usual])
    matrix = matrix_pairs(fit)
    rows = [
        ("staircase, paired as printed in Appendix H", printed),
        (f"the same without its {int(np.sum(~usual))} outliers", without),
        ("staircase, paired correctly", right),
        ("matrix, paired correctly", own_pairs(bench.matrix_loops, fit.dx_um)),
        ("the same, k1 by eq. 17 (slope scheme)", matrix),
    ]
    panels = [
        ("as printed, in part", printed, (-1.0, 3.0)),
        ("staircase, correct", right, None),
        ("matrix, eq. 17", matrix, None),
    ]
    figures.first_spring(images / "thesis_4_3.png", panels)
    return {
        "spring_laws_table": tables.spring_laws(rows),
        "outliers": str(int(np.sum(~usual))),
        "outlier_size": number(float(printed.k1[~usual].mean()), 1),
    }


def appendices(
    bench: Bench, fits: dict[Job, Fit], theirs: dict[str, Model]
) -> dict[str, str]:
    """Appendices A to C and their check values."""
    ours: dict[str, Model] = {}
    for name, job in (("classical", CLASSICAL), ("range", RANGE), ("extremum", EXTREMUM)):
        model = fits[job].model
        assert model is not None
        ours[name] = model
    a, b, c = rise_of(theirs["range"]), later_of(theirs["range"]), later_of(theirs["classical"])
    our_laws = {name: ours[name] for name in ("range", "extremum")}
    dx = fits[RANGE].dx_um
    law = ours["range"].stage("range-dependence")
    assert law is not None
    return {
        "appendix_a": tables.elements(a, rise_of(ours["range"])),
        "appendix_b_laws": tables.laws(float(a.slides_at_um[0]), our_laws, dx),
        "appendix_b": tables.elements(b, later_of(ours["range"]), first=2),
        "appendix_c": tables.elements(c, later_of(ours["classical"])),
        "check_values": tables.check_values(
            theirs, ours, first_rise(bench.of("0-75")), bench.matrix_loops
        ),
        "dx_range": number(dx, 4),
        "dx_classical": number(fits[CLASSICAL].dx_um, 4),
        "range_law_zero": _zero(law["slope"], law["offset"]),
    }


def _zero(slope: float, offset: float) -> str:
    """Where a law of the first spring changes its sign, in words."""
    zero = -offset / slope
    return f"at {zero:.1f} V" if zero > 0.0 else f"nowhere (its zero lies at {zero:.1f} V)"


def validation(bench: Bench, images: Path, fits: dict[Job, Fit]) -> dict[str, str]:
    """Sections 4.3 and 4.4: Figures 4-4 and 4-5, the thesis's way and held out."""
    sweep = bench.of(VALIDATION)[0]
    figures.validation_input(images / "thesis_4_4.png", sweep)

    def columns(*chosen: Job) -> list[tuple[str, Model]]:
        found = []
        for job in chosen:
            model = fits[job].model
            if model is not None:
                found.append((f"{job.model}, {job.scheme}", model))
        return found

    figures.validation(images / "thesis_4_5.png", sweep, columns(RANGE, CLASSICAL))
    rest = [Job(n, "least-squares", "rest") for n in ("range", "classical")]
    figures.validation(images / "thesis_4_5_held_out.png", sweep, columns(*rest))
    values = {
        "thesis_way_table": tables.the_thesis_way(fits),
        "validation_table": tables.validation(fits),
        "held_out": " and ".join(f"{c} V" for c in HELD_OUT),
    }
    for name in ("range", "classical"):
        for scheme, short in (("slopes", "slopes"), ("least-squares", "squares")):
            fit = fits[Job(name, scheme, "rest")]
            values[f"held_{name}_{short}"] = number(fit.percent, 2)
    for name in ("classical", "initiation", "range", "extremum", "direction"):
        values[f"all_{name}"] = number(fits[Job(name, "slopes", "all")].percent, 2)
    return values


def summary(bench: Bench, fits: dict[Job, Fit]) -> dict[str, str]:
    """The figures that the default plant is set by."""
    pairs = matrix_pairs(fits[RANGE])
    rises = [first_rise(bench.of(c))[1][-1] for c in ("0-65", "0-75")]
    up, down = (pick(bench.matrix_loops, *k) for k in ((0.0, 65.0, 1), (65.0, 65.0, -1)))
    travel = 0.5 * float(up.travel_um[-1] + down.travel_um[-1])
    falling = travel - np.interp(65.0 - up.drive_v, down.drive_v, down.travel_um)
    width = float(np.max(falling - up.travel_um)) / travel
    return {
        "ours_classical": number(fits[CLASSICAL].percent, 2),
        "ours_range": number(fits[RANGE].percent, 2),
        "ours_r2_range": number(pairs.on_range[2]),
        "ours_r2_extremum": number(pairs.on_extremum[2]),
        "ours_rise": " and ".join(number(float(r), 2) for r in rises),
        "ours_width": number(100.0 * width, 1),
    }


def other_seeds(folder: Path, first: dict[Job, Fit]) -> str:
    """The matrix again with other noise: does the outcome hang on the seed?"""
    found = [(SEED, first[CLASSICAL], first[RANGE], matrix_pairs(first[RANGE]))]
    for seed in MORE_SEEDS:
        run = play(find("protocols", "thesis_matrix"), seed, folder)
        fits = fit_all(run, [CLASSICAL, RANGE])
        found.append((seed, fits[CLASSICAL], fits[RANGE], matrix_pairs(fits[RANGE])))
        run.unlink()
    return tables.seeds(found)


def study(folder: Path, docs: Path) -> Path:
    """Play, identify, write; returns the document."""
    images = docs / "images"
    images.mkdir(parents=True, exist_ok=True)
    run = play(find("protocols", "thesis_matrix"), SEED, folder)
    stairs = play(find("protocols", "thesis_staircase"), SEED, folder)
    bias = play(HERE / "same_range.toml", SEED, folder)
    fits = fit_all(run, jobs())
    matrix = Run(run).sweeps()
    bench = Bench(
        matrix, mean_half_loops(matrix), Run(stairs).sweeps(),
        mean_half_loops(Run(bias).sweeps()),
    )  # fmt: skip
    theirs = thesis_models()
    values = {
        "version": __version__,
        "seed": str(SEED),
        "elements": "40",
        "plant_table": tables.settings(settings(), PLANT_SETTINGS),
        **summary(bench, fits),
        "seeds_table": other_seeds(folder, fits),
        **observations(bench, images, fits[RANGE], theirs["range"]),
        **first_springs(bench, images, fits[RANGE]),
        **appendices(bench, fits, theirs),
        **validation(bench, images, fits),
    }
    page = docs / "thesis.md"
    template = (HERE / "thesis_template.md").read_text(encoding="utf-8")
    page.write_text(fill(template, values), encoding="utf-8")
    return page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="default: docs")
    args = parser.parse_args()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="thesis-study-") as folder:
        page = study(Path(folder), args.docs)
    print(f"wrote {page} in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
