"""A given model that lacks causes: held for gain and sensitivity, refitted for everything else.

What such a model gets wrong is many times the noise, and nobody knows how it is made up; held
fixed it would have to explain away all of that before anything smaller could be seen. So it is
asked for what a refit hides, by its own recordings (`since`), and then its kind is refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model, Stage
from piezo_rig.diagnosis.checks import baseline_warnings
from piezo_rig.diagnosis.early import noise_floor_nm
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.found import REFITTED, Diagnosis, Finding, Rung
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held import best_um_of
from piezo_rig.diagnosis.held_out import Errors, gain, held_out_errors
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.since import (
    GAIN,
    SCALE,
    Change,
    change_since,
    compared,
    lacks_causes,
)
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep

PLAIN = 3.0  # times the noise: what has changed by so much is told, whatever it is
Again = Callable[[Sequence[Sweep], str], Diagnosis]


def against_lacking(
    sweeps: Sequence[Sweep], model: Model, seed: int, again: Again, tell: Callable[[str], None]
) -> Diagnosis | None:
    """The diagnosis against a given model that lacks causes; None for any other model.

    Parameters
    ----------
    again : diagnoses recordings against a named model, which is refitted
    """
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    floor_nm = noise_floor_nm(groups)
    if floor_nm is None or not lacks_causes(model, floor_nm, groups):
        return None
    tell("what has changed since")
    own_um = best_um_of(model, groups)
    space = plain_space(groups, model)
    held = refit(space, Point(model, fixed=tuple(s.id for s in model.stages)))
    warnings = baseline_warnings(groups, held)
    both = compared(groups, sweeps, model)
    lacks = (f"the given model was off by {1e3 * own_um:.3g} nm where it was identified, many "
             "times the noise: it lacks causes")  # fmt: skip
    change, notes = None, [f"{lacks}; gain and sensitivity are held against its recordings, "
                           "everything else is found by refitting"]  # fmt: skip
    if both is None:
        notes = [f"{lacks}; it does not say what was recorded for these drives, so gain and "
                 "sensitivity could not be held against it: play the drives that it was "
                 "identified from, or give a model by `diagnose --save-model`"]  # fmt: skip
    elif not both.like_a_scale and 1e3 * both.changed_um > PLAIN * floor_nm:
        notes.append(
            f"the displacement is no longer what was recorded for that model, by "
            f"{1e3 * both.changed_um:.3g} nm rms, and that is neither a gain nor a sensitivity"
        )
    elif both.like_a_scale and 1e3 * both.changed_um > floor_nm:
        # a gain looks nearly like a scale: only a complete model says what else it does
        right = _put_right(sweeps, CAUSES[SCALE].of(None, ratio=both.scale))
        found = again(right, model.name)
        put = group_tracks(prepare(right, first_rises=True, clipped=True), right)
        tried = sum(1 for k in CAUSES.values() if issubclass(k, Cause))
        change = change_since(both, put, found.model, tried)
        if change is not None and change.stage.id == SCALE:
            return _beside(found, sweeps, groups, model, change, seed, notes, warnings)
        tell("with the gain put right" if change is not None else "as recorded")
    right = list(sweeps) if change is None else _put_right(sweeps, change.stage)
    return _beside(
        again(right, model.name), sweeps, groups, model, change, seed, notes, warnings
    )


def _put_right(sweeps: Sequence[Sweep], stage: Stage) -> list[Sweep]:
    """The recordings as they would be said with the true sensitivity, or the true gain."""
    ratio = stage["ratio"]
    if stage.id == SCALE:
        return [s.with_(sensitivity_um_per_v=s.sensitivity_um_per_v * ratio) for s in sweeps]
    stays = stage["stays_v"] if "stays_v" in stage.parameters else 0.0
    return [
        s.with_(gain=s.gain * ratio, offset_v=s.offset_v * ratio + (1.0 - ratio) * stays)
        for s in sweeps
    ]  # fmt: skip


def _beside(
    found: Diagnosis, sweeps: Sequence[Sweep], groups: Groups, model: Model,
    change: Change | None, seed: int, notes: list[str], warnings: list[str],
) -> Diagnosis:  # fmt: skip
    """A diagnosis of the refitted model, with the given one's rungs and what has changed before it.

    Parameters
    ----------
    found : of the recordings, put right for ``change``
    """
    before = _errors(groups, model)
    rungs = [_rung(model.name, before)]
    models, findings = [model], list[Finding]()
    if change is not None:
        after = _errors(groups, model.with_stage(change.stage))
        rungs.append(_rung(change.stage.id, after, 0))
        models.append(model.with_stage(change.stage))
        percent, interval = gain(before, after, np.random.default_rng(seed))
        findings.append(Finding(
            change.stage.id, CAUSES[change.stage.id].place, change.p_value, percent, interval,
            dict(change.stage.parameters), list(change.alternatives),
        ))  # fmt: skip
    more, extended = len(findings), found.model
    rungs.append(replace(found.rungs[0], added=REFITTED))
    rungs += [replace(r, finding=None if r.finding is None else r.finding + more)
              for r in found.rungs[1:]]  # fmt: skip
    inner = found.rung_models
    workings = found.workings
    if change is not None:
        inner = [m.with_stage(change.stage) for m in inner]
        extended = extended.with_stage(change.stage)
    if workings is not None:
        told = [_as_recorded(groups, g, change) for g in workings.groups]
        workings = replace(workings, groups=(*[groups] * (1 + more), *told))
    refused = {k: why for k, why in found.refused.items() if k not in (GAIN, SCALE)}
    return replace(
        found, samples=sum(s.samples for s in sweeps), baseline=model.name or "given model",
        rungs=rungs, findings=[*findings, *found.findings], model=extended,
        rung_models=[*models, *inner], notes=[*notes, *found.notes], refused=refused,
        warnings=[*warnings, *found.warnings], workings=workings,
    )  # fmt: skip


def _errors(groups: Groups, model: Model) -> Errors:
    space = plain_space(groups, model)
    point = Point(model, fixed=tuple(s.id for s in model.stages))
    return held_out_errors(space, refit(space, point), "none")


def _rung(added: str, errors: Errors, finding: int | None = None) -> Rung:
    return Rung(added, errors.rms_nm, errors.max_percent, finding)


def _as_recorded(groups: Groups, put_right: Groups, change: Change | None) -> Groups:
    """Cleaned recordings, as they were before they were put right."""
    if change is None:
        return put_right
    ratio = change.stage["ratio"] if change.stage.id == SCALE else 1.0
    return groups.with_([
        g.with_measured(c.measured_um / ratio)
        for g, c in zip(groups.groups, put_right.groups, strict=True)
    ])  # fmt: skip
