"""From sweeps to a model: the one entrance to identification."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig import __version__
from piezo_rig.causes import CAUSES, NAMED_MODELS, named_model
from piezo_rig.chain import Elements, Maxwell, Model, Parameter, Stage
from piezo_rig.errors import InputError
from piezo_rig.identification import least_squares, slopes
from piezo_rig.identification.bent import bent
from piezo_rig.identification.data import Data, prepare
from piezo_rig.identification.folds import Folds
from piezo_rig.identification.normal import finer, rms
from piezo_rig.identification.recorded import recorded
from piezo_rig.identification.scores import Scores, held_out_scores, scores
from piezo_rig.identification.tied import FINE_PIECES as TIED_PIECES
from piezo_rig.identification.uncertainty import Bands, bands, linearised
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
FINE_PIECES = 160  # into which data are cut for their uncertainty
NOT_EXPLAINED = 0.25  # of the displacement's rms is left: no hysteresis of this drive
SCHEMES = ("least-squares", "slopes")
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Identification:
    """A model and how good it is.

    Attributes
    ----------
    model : the stages, with provenance
    scheme : ``least-squares`` or ``slopes``
    fitted : figures on the data that the model was fitted to
    held_out : figures on data that a refit never saw; None when nothing could be held out
    held_out_kind : ``condition``, ``sweep``, ``cycles`` or ``none``
    bands : 95 % bands (least squares only)
    slopes : the slope scheme's own outcome (slopes only)
    left_out : what of the data was not used, and why; what was chosen
    """

    model: Model
    scheme: str
    fitted: Scores
    held_out: Scores | None
    held_out_kind: str
    bands: Bands | None = None
    slopes: slopes.Slopes | None = None
    left_out: list[str] = field(default_factory=list)

    @property
    def rms_nm(self) -> float:
        """Held-out rms error, or that of the fit where nothing could be held out."""
        return (self.held_out or self.fitted).rms_nm

    @property
    def max_percent(self) -> float:
        """Largest error in percent of its sweep's travel, held out where possible."""
        return (self.held_out or self.fitted).max_percent


def identify(
    sweeps: Sequence[Sweep],
    model: str = "range",
    scheme: str = "least-squares",
    elements: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    runs: Sequence[dict[str, Any]] = (),
) -> Identification:
    """Identify a named model.

    Parameters
    ----------
    sweeps : recordings of one actuator with one calibration
    model : a name out of `NAMED_MODELS`
    scheme : ``least-squares`` (all samples) or ``slopes`` (the thesis's)
    elements : number of elements; chosen by held-out data (40 for the slope scheme) unless given
    seed : of the bootstrap
    progress : called with what is being done and the share that is done
    runs : the files that the sweeps came from, with hashes, for the model's provenance

    Raises
    ------
    InputError : for data, names or numbers that cannot be identified; says which and why
    """
    tell = progress or (lambda what, share: None)
    kinds = named_model(model)
    if scheme not in SCHEMES:
        raise InputError("unknown-scheme", f"no scheme {scheme!r}", "", f"use {SCHEMES}")
    tell("reading", 0.0)
    one_curve = "initiation-stage" not in NAMED_MODELS[model]
    data = prepare(sweeps, first_rises=not one_curve)
    laws = tuple(k for k in kinds if k.id != "initiation-stage")
    provenance = _provenance(sweeps, runs, scheme)
    ends = [f(t.drive_v) for t in data.tracks for f in (np.min, np.max)]
    provenance |= {"drive_v": [float(min(ends)), float(max(ends))]}
    provenance |= {"known_v": data.known_v(one_curve)}  # `simulate` warns beyond
    if scheme == "slopes":
        found = _by_slopes(data, model, one_curve, laws, elements, provenance)
        return replace(found, model=_with_recorded(found.model, sweeps))
    fit = least_squares.fit(data, one_curve, laws, elements, tell)
    tell("uncertainty", 0.85)
    fine, owner = finer(data, fit.pieces, TIED_PIECES if fit.prior else FINE_PIECES)
    by_half_loop = fit.normal or linearised(data, fit.curves, fine)
    normal = by_half_loop.joined(owner, fit.pieces)
    floor = least_squares.floor_of(data)
    band = bands(
        data, fit.curves, by_half_loop, floor, seed, prior=fit.prior, others=fit.others
    )
    reach = max(data.first_reach_v, data.later_reach_v / 2.0)
    first = fit.curves.first_elements(reach)
    later = first if one_curve else fit.curves.later_elements(data.later_reach_v)
    law_stages = [_with_intervals(s, band) for s in fit.curves.law_stages()]
    provenance |= {"held_out": fit.folds.kind, "condition_number": _short(band.condition_number)}
    provenance |= {"bands95": band.to_dict()}
    built = _build(model, first, later, one_curve, law_stages, provenance)
    tell("held out", 0.9)
    held = held_out_scores(data, fit.curves, normal, fit.folds, floor, fit.prior)
    tell("done", 1.0)
    fitted = scores(data, built.branches())
    whole, within = (held.whole, held.within or fitted) if held else (None, fitted)
    built = _off_by(built, whole or fitted, within)
    built = _with_bent(data, fit, built, elements, laws)
    built = _with_recorded(built, sweeps)
    notes = [*data.left_out, *fit.notes, *_bend_said(built), *_unexplained(data, fitted)]
    return Identification(
        built, scheme, fitted, whole, fit.folds.kind, band, None, notes
    )


def _by_slopes(
    data: Data,
    name: str,
    one_curve: bool,
    laws: tuple[type[Stage], ...],
    elements: int | None,
    provenance: dict[str, Any],
) -> Identification:
    n = elements or least_squares.THESIS_ELEMENTS
    outcome = slopes.fit_slopes(data, one_curve, laws, n)
    provenance = provenance | {"held_out": "none", "dx_um": outcome.dx_um}
    provenance |= {"r_squared": dict(outcome.r_squared)} if outcome.r_squared else {}
    built = _build(name, outcome.first, outcome.later, one_curve, list(outcome.laws), provenance)
    fitted = scores(data, built.branches())
    worse = _worse_with_laws(data, laws, n, fitted) if laws else []
    folds = Folds.of(data)
    held = None
    if folds.kind in ("condition", "sweep"):
        held = _slopes_held_out(data, folds, name, one_curve, laws, n)
    return Identification(
        _off_by(built, held or fitted),
        "slopes",
        fitted,
        held,
        folds.kind if held else "none",
        None,
        outcome,
        [*data.left_out, *outcome.notes, *worse],
    )


def _off_by(model: Model, scores: Scores, within: Scores | None = None) -> Model:
    """The model, with how far off it is: what it is held to when later data are held against it.

    ``within`` : the same of drives that swing no further than others that it knew
    """
    said = {"rms_nm": round(scores.rms_nm, 4)}
    if within is not None:
        said["within_nm"] = round(within.rms_nm, 4)
    return model.with_(provenance=model.provenance | said)


def _with_recorded(model: Model, sweeps: Sequence[Sweep]) -> Model:
    """With what it was identified from: the yardstick for later recordings of the same drives."""
    said = [r.to_dict() for r in recorded(sweeps)]
    return model.with_(provenance=model.provenance | {"recorded": said})


def _with_bent(
    data: Data, fit: least_squares.LeastSquares, built: Model, elements: int | None,
    laws: tuple[type[Stage], ...],
) -> Model:
    """With the same fit beside a bend in its provenance, where that is nearer to the data."""
    name = built.name
    one_curve = "initiation-stage" not in NAMED_MODELS[name]
    try:
        found = bent(data, fit, one_curve, laws, elements)
    except (InputError, np.linalg.LinAlgError, RuntimeError):
        found = None  # data that bear this model and no more
    if found is None:
        return built
    reach = max(data.first_reach_v, data.later_reach_v / 2.0)
    first = found.curves.first_elements(reach)
    later = first if one_curve else found.curves.later_elements(data.later_reach_v)
    model = _build(name, first, later, one_curve, list(found.curves.law_stages()), {})
    model = model.with_stage(found.bend)
    said = {"rms_nm": round(found.rms_nm, 4), "within_nm": round(found.within_nm, 4),
            "stages": [s.to_dict() for s in model.stages]}  # fmt: skip
    return built.with_(provenance=built.provenance | {"bent": said})


def _bend_said(model: Model) -> list[str]:
    if "bent" not in model.provenance:
        return []
    return [
        f"beside a memoryless bend it would be off by {model.provenance['bent']['rms_nm']:.3g} nm "
        f"instead of {model.provenance['rms_nm']:.3g} nm; the bend is kept in the file's "
        "provenance, where `diagnose --baseline` finds it"
    ]


def _worse_with_laws(
    data: Data, laws: tuple[type[Stage], ...], elements: int, fitted: Scores
) -> list[str]:
    """A warning where the model fits better without its laws."""
    plain = slopes.fit_slopes(data, False, (), elements)
    model = _build("initiation", plain.first, plain.later, False, [], {})
    without = scores(data, model.branches())
    if fitted.rms_nm <= without.rms_nm:
        return []
    return [
        f"warning: with {' and '.join(law.id for law in laws)} the fit is worse (rms "
        f"{fitted.rms_nm:.3g} nm) than without (`initiation`: {without.rms_nm:.3g} nm): the first "
        "springs follow no such law, or loops that begin with different slopes drift away from "
        "each other; identify `initiation`, or by least squares"
    ]


def _slopes_held_out(
    data: Data,
    folds: Folds,
    name: str,
    one_curve: bool,
    laws: tuple[type[Stage], ...],
    elements: int,
) -> Scores | None:
    """The slope scheme on all but one condition, scored on that one; for every condition."""
    from piezo_rig.identification.normal import pieces_of

    pieces, found = pieces_of(data), []
    for group in folds.groups:
        held = {pieces[i].track for i in group}
        rest = tuple(t for i, t in enumerate(data.tracks) if i not in held)
        if not rest or len(rest) == len(data.tracks):
            return None
        try:
            out = slopes.fit_slopes(replace(data, tracks=rest), one_curve, laws, elements)
            built = _build(name, out.first, out.later, one_curve, list(out.laws), {})
        except InputError:
            return None
        scored = replace(data, tracks=tuple(data.tracks[i] for i in sorted(held)))
        found.append(scores(scored, built.branches()))
    return Scores.pooled(found)


def _build(
    name: str,
    first: Elements,
    later: Elements,
    one_curve: bool,
    laws: list[Stage],
    provenance: dict[str, Any],
) -> Model:
    stages: list[Stage] = [Maxwell.of(later)]
    if not one_curve:
        stages.append(CAUSES["initiation-stage"].of(first))
    model = Model((*stages, *laws), provenance, name)
    model.check()
    return model


def _unexplained(data: Data, fitted: Scores) -> list[str]:
    """A warning where hysteresis of the drive is not what moves the sensor."""
    moved = rms(data, [t.displacement_um for t in data.tracks])
    share = fitted.rms_nm / (1e3 * moved)
    if share < NOT_EXPLAINED:
        return []
    return [
        f"warning: the model leaves {100 * share:.0f} % of the displacement's rms unexplained: "
        "another channel, another drive, or something other than hysteresis"
    ]


def _with_intervals(stage: Stage, band: Bands) -> Stage:
    parameters = {
        n: Parameter(p.value, p.unit, band.laws.get((stage.id, n)))
        for n, p in stage.parameters.items()
    }
    return type(stage)(parameters, stage.elements)


def _provenance(
    sweeps: Sequence[Sweep], runs: Sequence[dict[str, Any]], scheme: str
) -> dict[str, Any]:
    listed = []
    for s in sweeps:
        digest = hashlib.sha256(np.ascontiguousarray(s.command_v).tobytes())
        digest.update(np.ascontiguousarray(s.sensor_v).tobytes())
        listed.append(
            {"name": s.name, "condition": s.condition, "repeat": int(s.repeat),
             "sha256": digest.hexdigest()}
        )  # fmt: skip
    return {
        "runs": list(runs),
        "sweeps": listed,
        "scheme": scheme,
        "software": f"piezo-rig {__version__}",
    }


def _short(x: float) -> float:
    return float(f"{x:.3g}")
