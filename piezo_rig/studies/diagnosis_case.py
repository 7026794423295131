"""One hidden case: drawn, diagnosed, and checked on data that the diagnosis has not seen."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import added_by
from piezo_rig.chain import Model, half_loops
from piezo_rig.diagnosis import Diagnosis, diagnose
from piezo_rig.identification import identify
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.scoring.counts import Row
from piezo_rig.studies.hidden import Case, draw
from piezo_rig.studies.hidden.confounded import left_off, not_told

FloatArray = NDArray[np.float64]
# removed from the recordings before any model
CLOCK_FIRST = ("outliers", "mains-hum", "fringe-jump", "dropped-samples")
AGAIN, BEFORE = 1000, 1001  # seeds of the second session, and of the one before the effect
FIXED = "fixed:"


@dataclass(frozen=True)
class Spec:
    """One case to be drawn and diagnosed."""

    kind: str
    seed: int
    protocol: str
    noise: str
    d_prime: float
    repeats: int = 2
    baseline: str = "classical"  # or ``fixed:classical``: identified before the effect came


def run_case(spec: Spec) -> Row:
    """Draw, diagnose, check what it promised on data that it has not seen; plain data."""
    row: Row = {**asdict(spec), "error": None}
    begin = time.perf_counter()
    case = draw(spec.kind, spec.seed, spec.protocol, spec.noise, spec.d_prime, spec.repeats)
    row["draw_seconds"] = round(time.perf_counter() - begin, 3)
    row["truth"] = asdict(case.truth)
    row["noise_rms_nm"] = case.noise.rms_nm
    begin = time.perf_counter()
    try:
        baseline = _baseline(case, spec.baseline)
        found = diagnose(case.sweeps, baseline)
    except Exception as error:
        row["error"] = f"{type(error).__name__}: {error}"
        row["seconds"] = round(time.perf_counter() - begin, 3)
        return row
    row["seconds"] = round(time.perf_counter() - begin, 3)
    row |= _said(found)
    try:
        if any(f.alternatives for f in found.findings):
            row["not_told"] = not_told(case)
        if case.truth.cause.startswith("stranger:"):
            row["off_known"] = min(left_off(case)[case.truth.cause].values())
        row |= _checked(case, found, baseline)
    except Exception as error:
        row["check_error"] = f"{type(error).__name__}: {error}"
    return row


def _baseline(case: Case, name: str) -> str | Model:
    """A named model, or one that was identified in a session before the effect came."""
    if not name.startswith(FIXED):
        return name
    return identify(case.before(BEFORE), name.removeprefix(FIXED)).model


def _said(found: Diagnosis) -> Row:
    return {
        "findings": [
            {
                "cause": f.cause, "p": f.p_value, "d_prime": f.d_prime,
                "gain": f.gain_percent, "gain_ci95": f.gain_ci95,
                "parameters": {n: {"value": p.value, "ci95": p.ci95 and list(p.ci95)}
                               for n, p in f.parameters.items()},
                "alternatives": list(f.alternatives),
            }
            for f in found.findings
        ],
        "unexplained": {
            "detected": found.unexplained.detected, "rms_nm": found.unexplained.rms_nm,
            "allowance_nm": found.unexplained.allowance_nm,
            "depends_on": list(found.unexplained.depends_on),
        },
        "noise_floor_nm": found.noise_floor_nm,
        "rungs": [asdict(r) for r in found.rungs],
        "follow_up": found.follow_up and found.follow_up.protocol,
        "refused": sorted(found.refused),
    }  # fmt: skip


def rung_models(found: Diagnosis) -> list[Model] | None:
    """The model of every rung, the baseline first; None where a diagnosis does not tell.

    The hook for `Diagnosis.rung_models`: as many as ``rungs``.
    """
    models = getattr(found, "rung_models", None)
    if callable(models):
        models = models()
    return list(models) if models is not None and len(models) == len(found.rungs) else None


def _checked(case: Case, found: Diagnosis, baseline: str | Model) -> Row:
    """Gains on a second session, and on a drive that was never measured."""
    models = rung_models(found)
    if models is None:
        return {"gains_again": None, "unseen": None}
    again = case.again(AGAIN)
    clean = not any(f.cause in CLOCK_FIRST for f in found.findings)
    clean = clean and not any(c in CLOCK_FIRST for c in case.truth.causes)
    errors = [_rms_nm(again, m) for m in models] if clean else None
    gains = None
    if errors is not None:
        gains = [
            100.0 * (1.0 - b / a)
            for (a, b), rung in zip(pairwise(errors), found.rungs[1:], strict=True)
            if rung.finding is not None
        ]
    return {"gains_again": gains, "unseen": _on_unseen(case, models, baseline)}


def _on_unseen(case: Case, models: Sequence[Model], baseline: str | Model) -> Row | None:
    """Errors on a drive that was never measured, nm; None where no effect would show there.

    ``possible_nm`` is what is left to somebody who takes the true effects off the recordings
    before fitting the baseline, and puts them back; ``oracle_nm`` the same with the bench's base.
    """
    unseen = case.unseen()
    effect = unseen.with_effect_um - unseen.without_um
    if len(models) < 2 or not np.any(effect):
        return None
    bare = rung_models(diagnose(case.bare(), baseline))
    assert bare is not None

    def off(predicted: FloatArray) -> float:
        return 1e3 * float(np.std(predicted - unseen.with_effect_um))

    def played(model: Model) -> FloatArray:
        return model.simulate(unseen.time_s, unseen.drive_v, "virgin")

    return {
        "before_nm": off(played(models[0])), "after_nm": off(played(models[-1])),
        "possible_nm": off(played(bare[0]) + effect), "oracle_nm": off(case.best_unseen_um()),
        "effect_nm": 1e3 * float(np.std(effect)), "bare_findings": len(bare) - 1,
    }  # fmt: skip


def _rms_nm(sweeps: Iterable[Sweep], model: Model) -> float:
    """Error of a model on recordings, with a free offset for each."""
    sweeps = list(sweeps)
    begun = min(s.start_time for s in sweeps)
    square, count = 0.0, 0
    earlier: list[FloatArray] = []
    for s in sweeps:
        if model.remembering:
            predicted = model.simulate(s.time_s, s.drive_v, s.history, earlier=earlier)
            earlier.append(s.drive_v[np.append(half_loops(s.drive_v).start, s.samples - 1)])
        else:
            predicted = model.simulate(s.time_s, s.drive_v, s.history)
        for stage in model.stages:
            if stage.locked_to == "clock" and stage.id not in CLOCK_FIRST:
                predicted = predicted + added_by(stage, s.time_s + s.start_time - begun, s.drive_v)
        error = s.displacement_um - predicted
        square += float(np.sum((error - error.mean()) ** 2))
        count += error.size
    return 1e3 * float(np.sqrt(square / count))
