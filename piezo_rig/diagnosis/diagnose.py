"""The one entrance: from sweeps to findings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.causes.cause import Cause
from piezo_rig.causes.clock_ratio import ClockRatio
from piezo_rig.causes.input_bend import InputBend
from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.abreast import abreast, both
from piezo_rig.diagnosis.between import turn_between
from piezo_rig.diagnosis.bursts import bursts
from piezo_rig.diagnosis.checks import (
    baseline_warnings,
    beyond_its_drives,
    data_warnings,
    far_off,
    further_off,
)
from piezo_rig.diagnosis.claimed import final_model, parameters_of
from piezo_rig.diagnosis.climbed import PERIODIC, climbed
from piezo_rig.diagnosis.confusion import confusion
from piezo_rig.diagnosis.early import (
    HUM,
    TRIED,
    Early,
    Reading,
    clean_up,
    credited,
    find_line,
    hum_again,
    hum_behind,
    read_monitor,
)
from piezo_rig.diagnosis.early.recounted import BESIDE_ALL, PLAINLY, square_of
from piezo_rig.diagnosis.early.remembered import without_remembered
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.follow_up import follow_up
from piezo_rig.diagnosis.found import NO_FINDINGS, Diagnosis, Finding, Rung
from piezo_rig.diagnosis.given import against_lacking
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held_out import Errors, extrapolates, gain, held_out_errors, refold
from piezo_rig.diagnosis.isolability import Workings
from piezo_rig.diagnosis.levels import levels
from piezo_rig.diagnosis.memory import give_back
from piezo_rig.diagnosis.refit import Fitted, settle
from piezo_rig.diagnosis.scale import at_one_phase, read_anew
from piezo_rig.diagnosis.scan import LEVEL
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.unexplained import (
    unexplained,
    with_bursts,
    with_gain,
    with_levels,
    with_line,
    with_wandering,
)
from piezo_rig.diagnosis.unlike import within_what_is_wrong
from piezo_rig.diagnosis.unsteady import unsteady
from piezo_rig.diagnosis.wandering import AGEING, WANDERS, wandering
from piezo_rig.errors import InputError
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep

Tell = Callable[[str], None]
SHARE = 0.2  # of the false alarms that a search of the raw recordings may take
BENDS = {
    Bend.id: "the actuator's reversible strain is not linear in the drive",
    InputBend.id: "springs and sliders follow a drive that is not linear in the volts",
    OutputBend.id: "the displacement is not linear in what springs and sliders add up to",
}
READ_ANEW = 2  # times
EVENTS = ("outliers", "fringe-jump", "dropped-samples")  # nothing foretells them: no gain


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

    if isinstance(baseline, Model):
        found = against_lacking(
            sweeps, baseline, seed, lambda them, name: _diagnosed(them, name, seed, step), step
        )
        if found is not None:
            return found
    return _diagnosed(sweeps, baseline, seed, step)


def _diagnosed(
    sweeps: Sequence[Sweep], baseline: str | Model, seed: int, tell: Tell,
    between: Model | None = None,
) -> Diagnosis:
    """``between`` : a model with whose amplifier the drive turns between samples where it may"""
    rng = np.random.default_rng(seed)
    data = prepare(sweeps, first_rises=True, clipped=True)
    tell("baseline")
    data = without_remembered(data, sweeps, _baseline(group_tracks(data, sweeps), baseline))
    raw = group_tracks(data, sweeps)
    notes = list(data.left_out)
    if between is not None and (turned := raw.turned(between)) is not None:
        raw = turned
        notes.append("the drive turns between samples: where the straight lines before and after "
                     "a corner meet, and along the curve of a fast one")  # fmt: skip
    warnings = data_warnings(raw, sweeps)
    point = _baseline(raw, baseline)
    start = plainly(raw, point)
    warnings += baseline_warnings(raw, start)
    notes += beyond_its_drives(raw, start)
    tell("outliers, jumps, lost samples and hum")
    tried = len(TRIED)
    count = sum(1 for k in CAUSES.values() if issubclass(k, Cause))

    def cleaned(
        beside: Point | None = None, behind: float | None = None, enough: float = PLAINLY
    ) -> tuple[list[Early], Point]:
        return clean_up(
            raw, sweeps, beside or start.point,
            lambda groups, p: plainly(groups, p).point, SHARE * LEVEL, count, behind, enough,
        )  # fmt: skip

    def heard() -> Reading | None:
        return read_monitor(raw, sweeps, SHARE * LEVEL, count)

    def turned_between(model: Model) -> Diagnosis:
        tell("what the drive does between samples")
        return _diagnosed(sweeps, baseline, seed, tell, model)

    # neither asks for what the other says: the monitor hears nothing of what the sensor does
    (found_early, point), reading = both(start.space, cleaned, heard, [raw, *start.parts])
    if reading is not None and reading.between and between is None:
        model = start.point.model
        for seen in reading.told:
            model = model.with_stage(seen.stage)
        return turned_between(model)
    clean = raw
    if found_early:
        clean = found_early[-1].groups
        start = plainly(clean, point)
    whole, clean = clean, at_one_phase(clean, start.point.model)
    if clean is not whole:
        notes.append("the interferometer's periodic error has another phase in every recording: "
                     "repeats are turned to that of the first")  # fmt: skip
        start = plainly(clean, start.point)
    if reading is not None:
        notes += reading.notes
        warnings += reading.warnings
    hums = bool(found_early) and found_early[-1].cause == HUM
    search = climbed(clean, start.point, rng, tell, tried, reading, brief=hums)
    if search.turned is not None:
        return turned_between(search.turned)
    known = credited(found_early)
    while search.ladder.steps and (
        alone := {k for k, g in enumerate(clean.groups) if g.repeats < 2}
    ):
        whole_model = base = search.ladder.last.point
        left = square_of(clean, whole_model, alone)
        for step in search.ladder.steps:
            base = base.without(step.cause)
        if any(s.cause == ClockRatio.id for s in search.ladder.steps):
            tell("lost samples behind what looks like a clock")
            behind, base = cleaned(base, left)
            others = credited(behind) > known
        elif known[0]:
            tell("lost samples counted once more")
            behind, there = cleaned(whole_model, enough=BESIDE_ALL)
            mended = behind[-1].groups if behind else raw
            others = credited(behind)[0] != known[0] and (
                square_of(mended, plainly(mended, there).point, alone) < BESIDE_ALL * left
            )
        else:
            break
        if not others:
            break
        known, found_early = credited(behind), behind
        whole = found_early[-1].groups if found_early else raw
        clean = at_one_phase(whole, plainly(whole, base).point.model)
        start = plainly(clean, base)
        hums = bool(found_early) and found_early[-1].cause == HUM
        search = climbed(clean, start.point, rng, tell, tried, reading, brief=hums)
        if search.turned is not None:
            return turned_between(search.turned)
    late = None if hums or not search.ladder.steps else hum_behind(
        clean, search.ladder.last.point.model, SHARE * LEVEL, count
    )  # fmt: skip
    if late is not None:
        tell("hum")
        found_early.append(late)
        whole = clean = late.groups
        start = plainly(clean, start.point)
        search = climbed(clean, start.point, rng, tell, tried, reading)
    if hums and search.ladder.steps:
        # hum was fitted to what the baseline left; most of that has an explanation now
        tell("hum once more")
        better, hum = search.ladder.last.point.model, found_early.pop()
        whole = found_early[-1].groups if found_early else raw
        again = hum_again(whole, hum, better, SHARE * LEVEL, count)
        if again is not None:
            found_early.append(again)
            whole = again.groups
        clean = at_one_phase(whole, better.without(PERIODIC))
        start = plainly(clean, start.point)
        search = climbed(clean, start.point, rng, tell, tried, reading)
    if search.turned is not None:
        return turned_between(search.turned)
    if turn_between(search.space, search.ladder.last):
        return turned_between(search.ladder.last.point.model)
    for _ in range(READ_ANEW):
        # phases were read beside all that the baseline leaves; most of that is explained now
        better = search.ladder.last.point.model
        if better.stage(PERIODIC) is None:
            break
        anew = read_anew(whole, search.space.groups, better.without(PERIODIC))
        if anew is None:
            break
        tell("where recordings stand on the interferometer's scale")
        clean, search = anew, climbed(anew, start.point, rng, tell, tried, reading)
        if search.turned is not None:
            return turned_between(search.turned)
    stages = [(f.cause, f.groups) for f in found_early]
    clean = _on_the_scale_of(search.space.groups, clean)
    space, ladder, kind, floor = search.space, search.ladder, search.kind, search.floor_nm
    folds, errors = search.folds, search.errors
    steps = [*search.monitored, *ladder.steps]
    notes += search.said
    if not search.repeated:
        notes.append("no repeats: the noise is estimated from what a generous model leaves, and "
                     "the noise floor is not known")  # fmt: skip
    if space.loose:
        notes.append(
            "the baseline has no memoryless bend, but the actuator has one: what the baseline "
            "gets wrong by that hides whatever is as small; identified again, by `identify` or "
            "`diagnose --save-model`, it says what its bend is"
        )
    tell("held out")
    name = baseline if isinstance(baseline, str) else (baseline.name or "given model")
    every = [
        *(partial(held_out_errors, space, search.first, kind, g)
          for g in (raw, *(g for _, g in stages))),
        *(partial(errors, s.fitted) for s in steps),
    ]  # fmt: skip
    carried = kind != folds and folds in ("condition", "sweep")
    ends = [partial(held_out_errors, space, f, folds) for f in (search.first, ladder.last)]
    found = abreast(space, [*every, *(ends if carried else [])])
    rungs, gains = _rungs(
        [name, *(cause for cause, _ in stages), *(s.cause for s in steps)], found[: len(every)],
        rng,
    )  # fmt: skip
    notes += far_off(1e3 * space.own_um, floor)
    notes += further_off(1e3 * space.own_um, rungs[-1].rms_nm)
    if carried:
        without, full = (e.rms_nm for e in found[len(every) :])
        notes.append(
            f"on conditions that were left out of the fit: {without:.4g} nm with the baseline, "
            f"{full:.4g} nm with everything"
        )
    findings = [
        Finding(f.cause, CAUSES[f.cause].place, min(f.p_value, 1.0),
                *(gains[i] if f.cause not in EVENTS else (None, None)), f.parameters, [],
                events=f.events)
        for i, f in enumerate(found_early)
    ]  # fmt: skip
    tell("what can be told apart")
    last = ladder.last
    settle(space, last.point)
    spread = search.spread
    model = final_model(last, name, spread)
    confused: dict[str, list[str]] = {}
    told = [s for s in steps if s.cause not in NO_FINDINGS]
    apart = dict(zip((s.cause for s in told), abreast(
        space, [partial(confusion, space, last, s.cause) for s in told]
    ), strict=True))  # fmt: skip
    for i, step in enumerate(steps):
        if step.cause in NO_FINDINGS:
            notes.append(f"the base model has a memoryless bend: {BENDS[step.cause]}")
            continue
        told_apart = apart[step.cause]
        members = [s.cause for s in steps]
        confused[step.cause] = [
            *told_apart.alternatives,
            *(c for c in step.rivals if c not in members and c not in told_apart.alternatives),
        ] if step not in search.monitored else []  # it was seen where none of those would show
        confused[step.cause] += [
            c for c in within_what_is_wrong(
                space, last, step.cause, 1e-3 * rungs[-1].rms_nm,
                1e-3 * (floor or space.sample_noise_nm),
            )
            if c not in confused[step.cause] and c not in members
        ]
        value, interval = gains[len(found_early) + i]
        findings.append(Finding(
            step.cause, CAUSES[step.cause].place, step.p_value,
            None if kind == "none" else value, None if kind == "none" else interval,
            parameters_of(last, step.cause, model, spread), confused[step.cause],
            told_apart.d_prime,
        ))  # fmt: skip
    if kind == "none":
        why = "too few cycles to hold anything out"
        if extrapolates(space):
            why = "the last cycles go further than all before them: nothing can be held out"
        notes.append(f"{why}; figures are of the fit itself, gains are not given")
    tell("the rest")
    rest = with_line(
        unexplained(space, last, floor or rungs[-1].rms_nm, _by_laws_nm(rungs), rng,
                    rungs[-1].rms_nm),
        find_line(clean, last.point.model), floor,
    )  # fmt: skip
    rest = with_gain(rest, unsteady(space.groups, space.whitener, last.point.model), floor)
    refused = ladder.scans[-1].refused if ladder.scans else {}
    if refused.get(AGEING) == WANDERS:
        rest = with_wandering(rest, *wandering(space, last))
    rest = with_bursts(rest, bursts(space.groups, last.point.model), floor)
    rest = with_levels(rest, levels(clean))
    advice = follow_up(space, last, confused)
    if reading is None and any(
        CAUSES[c].place == "drive" for cause, others in confused.items() if others
        for c in (cause, *others)
    ):
        notes.append("a recorded drive monitor would say whether it is the amplifier")
    return Diagnosis(
        len(sweeps), sum(s.samples for s in sweeps), raw.repeats, kind,
        recording_offsets(space, clean, search.first, sweeps), name, rungs, floor, findings, rest,
        advice,
        model, [*([search.first.point.model] * (1 + len(stages))),
                *(s.fitted.point.model for s in steps)],
        notes, warnings, refused,
        Workings((raw, *(g for _, g in stages), *(clean for _ in steps)), space, last),
    )  # fmt: skip


def _on_the_scale_of(known: Groups, groups: Groups) -> Groups:
    """The same groups, beginning where others of the same drives do on the sensor's own scale."""
    if all(g.reads is None for g in known.groups):
        return groups
    return groups.with_([
        replace(g, reads=k.reads)
        for g, k in zip(groups.groups, known.groups, strict=True)
    ])  # fmt: skip


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


def _rungs(
    names: Sequence[str], errors: Sequence[Errors], rng: np.random.Generator
) -> tuple[list[Rung], list[tuple[float | None, list[float] | None]]]:
    """Errors of every rung, and the gain of each against the one before."""
    rungs, count = [], 0
    for i, (added, e) in enumerate(zip(names, errors, strict=True)):
        mine = i > 0 and added not in NO_FINDINGS
        rungs.append(Rung(added, e.rms_nm, e.max_percent, count if mine else None))
        count += mine
    return rungs, [gain(before, after, rng) for before, after in pairwise(errors)]


def _by_laws_nm(rungs: Sequence[Rung]) -> float:
    """Rms error that causes with a law may have left of what they took; tables and bends fit
    whatever there is.
    """
    def leaves(cause: str) -> float:
        kind = CAUSES[cause]
        return kind.leaves if issubclass(kind, Cause) else 0.0

    square = sum(
        leaves(after.added) ** 2 * max(before.rms_nm**2 - after.rms_nm**2, 0.0)
        for before, after in pairwise(rungs)
        if after.added not in NO_FINDINGS and not CAUSES[after.added].has_elements
        and after.added not in EVENTS
    )  # fmt: skip
    return float(np.sqrt(square))


def recording_offsets(
    space: Space, groups: Groups, fitted: Fitted, sweeps: Sequence[Sweep]
) -> list[tuple[str, float]]:
    """Offset of every source against the model; of the first none.

    Where memories are not known, against the model as the first source alone fits it, if that can
    be played further out.
    """
    found: dict[str, list[float]] = {}
    sources = [{Path(sweeps[i].source).name for m in g.sweeps for i in m} for g in groups.groups]
    train = [k for k, p in enumerate(space.pieces) if sources[p.group] & sources[0]]
    model = fitted.point.model
    if len(train) < len(space.pieces) and not all(g.virgin for g in groups.groups):
        model = refold(fitted.point, fitted, train).model
    try:
        places = [model.place_um(g.drive_v, g.history) for g in groups.groups]
    except InputError:
        places = [fitted.point.model.place_um(g.drive_v, g.history) for g in groups.groups]
    for g, predicted in zip(groups.groups, places, strict=True):
        for members, row in zip(g.sweeps, g.measured_um, strict=True):
            sweep = sweeps[members[0]]
            inside = np.concatenate([np.arange(a, b) for a, b in g.blocks])
            # absolute: the zero that was taken off the record is put back
            zero = sweep.polarity * sweep.zero_v * sweep.sensitivity_um_per_v
            value = float(np.mean((row - predicted)[inside])) + zero
            source = Path(sweep.source).name or sweep.name
            found.setdefault(source, []).append(value)
    first = None
    out = []
    for name, values in found.items():
        mean = float(np.mean(values))
        first = mean if first is None else first
        out.append((name, mean - first))
    return out


__all__ = ["Diagnosis", "Finding", "diagnose"]
