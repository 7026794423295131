"""Every model of the thesis, by both schemes, fitted in parallel and scored on 0-65 V."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.errors import InputError
from piezo_rig.identification import identify
from piezo_rig.identification.slopes import FirstSprings
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]

ELEMENTS = 40
VALIDATION = "0-65"
HELD_OUT = ("0-65", "75-10")  # the validation sweeps, and those of the same range from 75 V
TRAINING = {
    "all": "all 27 conditions",
    "0-75": "0-75 V only",
    "rest": "all but 0-65 and 75-10 V",
}
NAMES = ("classical", "initiation", "range", "extremum", "range-extremum", "direction",
         "range-direction")  # fmt: skip
SCHEMES = ("slopes", "least-squares")


@dataclass(frozen=True)
class Job:
    """One fit: which model, by which scheme, from which sweeps."""

    model: str
    scheme: str
    training: str


@dataclass(frozen=True)
class Error:
    """How far a prediction is from one sweep; um, percent of the sweep's travel, volts."""

    worst_um: float
    percent: float
    rms_um: float
    drive_v: float
    measured_um: float
    descending: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of a job.

    Attributes
    ----------
    model : None where the scheme refused
    errors : of 0-65 V, one per repeat
    dx_um, first_springs : of the slope scheme
    refusal : why there is no model
    """

    job: Job
    model: Model | None
    errors: tuple[Error, ...] = ()
    dx_um: float = 0.0
    first_springs: FirstSprings | None = None
    refusal: str = ""

    @property
    def percent(self) -> float:
        """Largest error in percent of travel, mean of the repeats."""
        return float(np.mean([e.percent for e in self.errors]))

    @property
    def spread(self) -> tuple[float, float]:
        """Smallest and largest of the repeats, percent."""
        values = [e.percent for e in self.errors]
        return min(values), max(values)

    @property
    def worst(self) -> Error:
        """The repeat with the largest error."""
        return max(self.errors, key=lambda e: e.percent)


def jobs() -> list[Job]:
    """All fits, the long ones first."""
    found = [Job(name, scheme, "all") for scheme in SCHEMES for name in reversed(NAMES)]
    for scheme in SCHEMES:
        found += [Job(name, scheme, "rest") for name in ("extremum", "range", "classical")]
        found.append(Job("classical", scheme, "0-75"))
    return found


def fit_all(run: Path, wanted: Sequence[Job]) -> dict[Job, Fit]:
    """Fit jobs to a run of ``thesis_matrix``, as many at once as there are processors."""
    workers = max(1, min(4, len(os.sched_getaffinity(0))))
    found: dict[Job, Fit] = {}
    with ProcessPoolExecutor(workers, get_context("spawn"), _load, (str(run),)) as pool:
        for fit in pool.map(_fit, wanted):
            found[fit.job] = fit
            said = fit.refusal or f"{fit.percent:.2f} % on {VALIDATION} V"
            print(f"  {fit.job.model}, {fit.job.scheme}, {TRAINING[fit.job.training]}: {said}",
                  flush=True)  # fmt: skip
    return found


def chosen(sweeps: Sequence[Sweep], training: str) -> list[Sweep]:
    """The sweeps that a training set holds."""
    if training == "0-75":
        return [s for s in sweeps if s.condition == "0-75"]
    if training == "rest":
        return [s for s in sweeps if s.condition not in HELD_OUT]
    return list(sweeps)


def error_of(model: Model, sweep: Sweep) -> Error:
    """The thesis's error: |measured - predicted| over the whole sweep, its largest over travel."""
    error = sweep.displacement_um - model.simulate(sweep.time_s, sweep.drive_v, "virgin")
    i = int(np.argmax(np.abs(error)))
    drive = sweep.drive_v
    return Error(
        worst_um=float(abs(error[i])),
        percent=100.0 * float(abs(error[i])) / float(np.ptp(sweep.displacement_um)),
        rms_um=float(np.sqrt(np.mean(error**2))),
        drive_v=float(drive[i]),
        measured_um=float(sweep.displacement_um[i]),
        descending=bool(drive[min(i + 5, drive.size - 1)] < drive[max(i - 5, 0)]),
    )


_sweeps: list[Sweep] = []


def _load(run: str) -> None:
    _sweeps[:] = Run(run).sweeps()


def _fit(job: Job) -> Fit:
    try:
        found = identify(chosen(_sweeps, job.training), job.model, job.scheme, ELEMENTS)
    except InputError as error:
        return Fit(job, None, refusal=f"refused ({error.code})")
    errors = tuple(error_of(found.model, s) for s in _sweeps if s.condition == VALIDATION)
    slopes = found.slopes
    if slopes is None:
        return Fit(job, found.model, errors)
    return Fit(job, found.model, errors, slopes.dx_um, slopes.first_springs)
