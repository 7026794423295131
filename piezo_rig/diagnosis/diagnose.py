"""The one entrance: from sweeps to findings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.causes.input_bend import InputBend
from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.among_repeats import as_able
from piezo_rig.diagnosis.checks import (
    baseline_warnings,
    beyond_its_drives,
    data_warnings,
    far_off,
    further_off,
)
from piezo_rig.diagnosis.claimed import final_model, parameters_of
from piezo_rig.diagnosis.climbed import Climbed
from piezo_rig.diagnosis.confusion import Confusion, confusion
from piezo_rig.diagnosis.early.remembered import without_remembered
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.follow_up import follow_up
from piezo_rig.diagnosis.found import EVENTS, NO_FINDINGS, Diagnosis, Finding, Rung
from piezo_rig.diagnosis.given import against_lacking
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held import within_its_drives, within_its_first_rise
from piezo_rig.diagnosis.held_out import (
    AGAIN,
    Errors,
    extrapolates,
    held_out_errors,
    repeated,
    spanned,
)
from piezo_rig.diagnosis.in_step import in_step, out_of_step
from piezo_rig.diagnosis.in_turns import InTurns, TurnsBetween
from piezo_rig.diagnosis.isolability import Workings
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.memory import give_back
from piezo_rig.diagnosis.offsets import recording_offsets
from piezo_rig.diagnosis.refit import settle
from piezo_rig.diagnosis.refusals import BESIDE
from piezo_rig.diagnosis.rest import Seen, looks, rest_of
from piezo_rig.diagnosis.rungs import Gain, rungs_of
from piezo_rig.diagnosis.taken_back import taken_back, without_the_doubtful
from piezo_rig.diagnosis.unlike import within_what_is_wrong, within_what_remains
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep

Tell = Callable[[str], None]
MOSTLY = 0.8  # held-out error without the worst stretches, of all, below which that is said
BENDS = {
    Bend.id: "the actuator's reversible strain is not linear in the drive",
    InputBend.id: "springs and sliders follow a drive that is not linear in the volts",
    OutputBend.id: "the displacement is not linear in what springs and sliders add up to",
}


def diagnose(
    sweeps: Sequence[Sweep],
    baseline: str | Model = "classical",
    seed: int = 0,
    tell: Tell | None = None,
) -> Diagnosis:
    """What the baseline gets wrong, why, and how much better it gets.

    Parameters
    ----------
    sweeps : recordings of one actuator
    baseline : a named model, refitted to the data, or a model, held fixed but for offsets
    seed : of every random number; the same data give the same answer

    Raises
    ------
    InputError : data that cannot be diagnosed, in words
    """
    def step(text: str) -> None:
        give_back()
        if tell is not None:
            tell(text)

    if not isinstance(baseline, Model):
        return _diagnosed(sweeps, baseline, seed, step)
    known, notes = within_its_drives(sweeps, baseline)
    found = against_lacking(
        known, baseline, seed, lambda them, name: _diagnosed(them, name, seed, step), step
    )
    if found is None:
        found = _diagnosed(known, baseline, seed, step)
    return replace(found, notes=[*notes, *found.notes])


def _diagnosed(
    sweeps: Sequence[Sweep], baseline: str | Model, seed: int, tell: Tell,
    between: Model | None = None,
) -> Diagnosis:
    """``between`` : a model with whose amplifier the drive turns between samples where it may"""
    rng = np.random.default_rng(seed)
    data = prepare(sweeps, first_rises=True, clipped=True)
    tell("baseline")
    data = without_remembered(data, sweeps, _baseline(group_tracks(data, sweeps), baseline))
    notes: list[str] = []
    if isinstance(baseline, Model):
        data, notes = within_its_first_rise(data, baseline)
    raw = group_tracks(data, sweeps)
    notes = [*data.left_out, *notes]
    drives = out_of_step(raw, data.tracks)
    model = between or (plainly(raw, _baseline(raw, baseline)).point.model if drives else None)
    if drives and model is not None and (stepped := in_step(raw, drives, model)) is not None:
        raw, between = stepped.groups, between or (model if stepped.between else None)
        notes.append("repeats were not sampled in step with their drive, by what their drive "
                     "columns say: they are compared as if they had been")  # fmt: skip
    if between is not None and (turned := raw.turned(between)) is not None:
        raw = turned
        notes.append("the drive turns between samples, and is taken to go on there: to where the "
                     "straight lines before and after a corner meet, and along the curve of a "
                     "fast sine")  # fmt: skip
    start = plainly(raw, _baseline(raw, baseline))
    warnings = [*data_warnings(raw, sweeps), *baseline_warnings(raw, start)]
    notes += beyond_its_drives(raw, start)
    turns = InTurns(raw, sweeps, start, rng, tell, between is not None)
    try:
        turns.go()
    except TurnsBetween as found:
        tell("what the drive does between samples")
        return _diagnosed(sweeps, baseline, seed, tell, found.model)
    name = baseline if isinstance(baseline, str) else (baseline.name or "given model")
    return _answer(turns, name, notes + turns.notes, warnings + turns.warnings, tell)


def _baseline(groups: Groups, baseline: str | Model) -> Point:
    if isinstance(baseline, Model):
        return Point(baseline, fixed=tuple(s.id for s in baseline.stages))
    kinds = named_model(baseline)
    model = starting_model(groups, kinds, baseline)
    sizes = []
    for kind in kinds:
        for name in kind.units:
            if name == "offset":  # the table's first compliance says the same
                continue
            unit = 0.01 if kind.units[name] == "1" else 0.01 / groups.travel_um
            sizes.append((kind.id, name, float(unit)))
    return Point(model, (), tuple(sizes))


def _answer(
    turns: InTurns, name: str, notes: list[str], warnings: list[str], tell: Tell
) -> Diagnosis:
    """What is said of recordings that are clean and of a ladder that is climbed."""
    search, early, raw = turns.search, turns.early, turns.raw
    clean = _on_the_scale_of(search.space.groups, turns.clean)
    space, last = search.space, search.ladder.last
    steps = [*search.monitored, *search.ladder.steps]
    refused = search.ladder.scans[-1].refused if search.ladder.scans else {}
    refused = _still_true(refused, {s.cause for s in steps})
    tell("held out, what can be told apart, and the rest")
    settle(space, last.point)
    looked = _looked(turns, clean, steps, refused)
    begun = len(turns.cleaned) - 1 + len(search.monitored)
    back = taken_back(search.ladder, looked.errors[begun:]) if search.kind != "none" else None
    if back is not None:
        search.ladder, said = back
        return _answer(turns, name, [*notes, said], warnings, tell)
    names = [name, *(cause for cause, _ in turns.cleaned[1:]), *(s.cause for s in steps)]
    rungs, gains = rungs_of(names, looked.errors, turns.rng)
    given, notes = notes, [*notes, *_on_the_figures(search, rungs, looked.carried)]
    model = final_model(last, name, search.spread)
    findings = [
        Finding(f.cause, CAUSES[f.cause].place, min(f.p_value, 1.0),
                *(gains[i] if f.cause not in EVENTS else (None, None)), f.parameters, [],
                events=f.events)
        for i, f in enumerate(early)
    ]  # fmt: skip
    before = len(turns.cleaned) - 1
    own = _of_the_ladder(search, steps, gains[before:], looked.apart, model, rungs[-1].rms_nm)
    doubted = without_the_doubtful(search.ladder, own)
    if doubted is not None:
        search.ladder = doubted
        return _answer(turns, name, given, warnings, tell)
    findings += own
    notes += [
        f"the base model has a memoryless bend: {BENDS[s.cause]}" for s in steps
        if s.cause in NO_FINDINGS
    ]  # fmt: skip
    if search.kind == "none":
        why = "too few cycles to hold anything out"
        if len(space.groups.groups) > 1:
            why = "each recording goes further than the other: nothing can be held out"
        elif extrapolates(space):
            why = "the last cycles go further than all before them: nothing can be held out"
        notes.append(f"{why}; figures are of the fit itself, gains are not given")
    rest = rest_of(turns, clean, rungs, looked.seen)
    in_vain = turns.patience.note if rest.detected else None
    notes += [in_vain] if in_vain else []
    if rest.detected and own:
        own = [
            replace(f, alternatives=list(dict.fromkeys([
                *f.alternatives,
                *within_what_remains(space, last, f.cause, 1e-3 * rest.rms_nm),
            ])))
            for f in own
        ]  # fmt: skip
        findings[-len(own) :] = own
    confused = {f.cause: f.alternatives for f in own}
    refused = _but_for(refused, confused)
    if turns.aside is not None:
        notes.append(f"{turns.aside.text} is set aside before causes are looked for; the model "
                     "does not have it")  # fmt: skip
    if turns.reading is None and any(
        CAUSES[c].place == "drive" for cause, others in confused.items() if others
        for c in (cause, *others)
    ):
        notes.append("a recorded drive monitor would say whether it is the amplifier")
    own_nm = 1e3 * space.own_um
    return Diagnosis(
        len(turns.sweeps), sum(s.samples for s in turns.sweeps), raw.repeats, search.held_out,
        recording_offsets(space, clean, search.first, turns.sweeps), name, rungs, search.floor_nm,
        findings, rest, follow_up(space, last, confused), model,
        [*([search.first.point.model] * (1 + before)), *(s.fitted.point.model for s in steps)],
        notes, warnings, refused,
        Workings((*(g for _, g in turns.cleaned), *(clean for _ in steps)), space, last),
        tried_in_vain=in_vain is not None,
        at_home_nm=own_nm if further_off(own_nm, rungs[-1].rms_nm) else None,
    )  # fmt: skip


class _Looked(NamedTuple):
    """Errors of every rung; where the climb held out other things than the figures do, those of
    the first and the last rung on these; of every finding of the ladder what it cannot be told
    from; what is seen in the rest.
    """

    errors: list[Errors]
    carried: list[Errors]
    apart: list[Confusion]
    seen: Seen


def _looked(
    turns: InTurns, clean: Groups, steps: Sequence[Step], refused: Mapping[str, str]
) -> _Looked:
    """All that may be done in any order once the ladder is climbed."""
    search, space = turns.search, turns.search.space
    kind, folds, last = search.kind, search.folds, search.ladder.last
    errors = [
        *(partial(held_out_errors, space, search.first, kind, g) for _, g in turns.cleaned),
        *(partial(search.figures, s.fitted) for s in steps),
    ]  # fmt: skip
    carried = [
        partial(held_out_errors, space, f, folds) for f in (search.first, last)
    ] if folds == "condition" != kind else []  # fmt: skip
    apart = [partial(confusion, space, last, s.cause) for s in steps if s.cause not in NO_FINDINGS]
    every: list[Callable[[], Any]] = [*errors, *carried, *apart, *looks(turns, clean, refused)]
    found = iter(abreast(space, every))
    return _Looked(
        [next(found) for _ in errors], [next(found) for _ in carried],
        [next(found) for _ in apart], Seen(*found),
    )  # fmt: skip


def _on_the_figures(
    search: Climbed, rungs: Sequence[Rung], carried: Sequence[Errors]
) -> list[str]:
    """What is to be said of how the errors were measured, and of how large they are."""
    notes = list(search.said)
    if not search.repeated:
        notes.append("no repeats: the noise is estimated from what a generous model leaves, and "
                     "the noise floor is not known")  # fmt: skip
    further = _in_every_fit(search)
    if further:
        notes.append("in every fit, and not in the figures, for no other goes as far, or as far on "
                     f"a first rise: {', '.join(further)}")  # fmt: skip
    if search.kind == AGAIN:
        notes.append("a drive that was recorded once is not left out: its part of the figures is "
                     "of the fit itself")  # fmt: skip
    if search.space.loose:
        notes.append(
            "the baseline has no memoryless bend, but the actuator has one: what the baseline "
            "gets wrong by that hides whatever is as small; identified again, by `identify` or "
            "`diagnose --save-model`, it says what its bend is"
        )
    first, last = search.errors(search.first), search.errors(search.ladder.last)
    if search.kind == "condition" and last.mostly_nm < MOSTLY * last.rms_nm:
        notes.append(
            "a condition that is left out goes further than all others, where nothing is known of "
            "the elements: that stretch rules the figures; without the worst tenth of every "
            f"recording they are {first.mostly_nm:.3g} nm with the baseline, "
            f"{last.mostly_nm:.3g} nm with everything"
        )
    own_nm = 1e3 * search.space.own_um
    notes += far_off(own_nm, search.floor_nm)
    notes += further_off(own_nm, rungs[-1].rms_nm)
    if carried:
        without, full = (e.rms_nm for e in carried)
        notes.append(
            f"on conditions that were left out of the fit: {without:.4g} nm with the baseline, "
            f"{full:.4g} nm with everything"
        )
    return notes


def _in_every_fit(search: Climbed) -> list[str]:
    """Conditions that are not left out where others are."""
    space = search.space
    kept = spanned(space)
    if search.kind not in ("condition", "sweep") or repeated(space.groups) or not kept:
        return []
    names = [space.groups.groups[p.group].condition for p in space.pieces if p.fold not in kept]
    return list(dict.fromkeys(n for n in names if n))


def _of_the_ladder(
    search: Climbed, steps: Sequence[Step], gains: Sequence[Gain], apart: Sequence[Confusion],
    model: Model, left_nm: float,
) -> list[Finding]:  # fmt: skip
    """Findings among the rungs, each with what these data cannot tell it from.

    ``apart`` : of each of them; ``left_nm`` : held-out error of the last rung
    """
    space, last = search.space, search.ladder.last
    told = [(s, g) for s, g in zip(steps, gains, strict=True) if s.cause not in NO_FINDINGS]
    members = {s.cause for s in steps}
    found = []
    for (step, gain), one in zip(told, apart, strict=True):
        others = [c for c in step.rivals if c not in members]
        if step not in search.monitored:  # which was seen where none of these would show
            others = [*one.alternatives, *others]
        others += [
            c for c in within_what_is_wrong(
                space, last, step.cause, 1e-3 * left_nm,
                1e-3 * (search.floor_nm or space.sample_noise_nm),
            ) if c not in members
        ]  # fmt: skip
        found.append(Finding(
            step.cause, CAUSES[step.cause].place, step.p_value,
            *((None, None) if search.kind == "none" else gain),
            parameters_of(last, step.cause, model, search.spread),
            as_able(space, last.point.model, step.cause, list(dict.fromkeys(others))), one.d_prime,
        ))  # fmt: skip
    return found


def _but_for(
    refused: Mapping[str, str], confused: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """Refusals but for causes that a finding cannot be told from: those are not left out."""
    listed = {other for others in confused.values() for other in others}
    return {cause: why for cause, why in refused.items() if cause not in listed}


def _still_true(refused: Mapping[str, str], members: set[str]) -> dict[str, str]:
    """Reasons, without others that a cause was not needed beside and that have gone since."""
    gone = "once others were refitted it said no more than the model without it"
    return {
        cause: why if not why.startswith(BESIDE) or why.removeprefix(BESIDE) in members else gone
        for cause, why in refused.items()
    }


def _on_the_scale_of(known: Groups, groups: Groups) -> Groups:
    """The same groups, beginning where others of the same drives do on the sensor's own scale."""
    if all(g.reads is None for g in known.groups):
        return groups
    return groups.with_([
        replace(g, reads=k.reads)
        for g, k in zip(groups.groups, known.groups, strict=True)
    ])  # fmt: skip


__all__ = ["Diagnosis", "Finding", "diagnose"]
