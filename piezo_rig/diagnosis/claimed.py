"""What is said of the parameters of an accepted cause, and the model that is saved.

Intervals are those of the fit, or of the mixture over a law's forms and reaches, with room for
other laws where one is assumed; no finer than instruments agree; and nothing is said of what is
only believed beforehand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.causes.cause import Cause
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.chain import Model, Parameter
from piezo_rig.diagnosis.as_recorded import as_recorded
from piezo_rig.diagnosis.chances import AS_HELD
from piezo_rig.diagnosis.first_spring import offset_of, with_offset
from piezo_rig.diagnosis.reaches import Intervals
from piezo_rig.diagnosis.refit import Fitted

UNSEEN = 3.0  # standard errors of its size, by which a law may be off and nothing shows it
BELIEVED = 0.9  # of the spread that is believed beforehand: data that leave so much say nothing


def parameters_of(
    fitted: Fitted, cause: str, model: Model, spread: Intervals
) -> dict[str, Parameter]:
    """Reported parameters of an accepted cause, with the values of the final model.

    ``spread`` : intervals that are not those of the linear fit
    """
    stage = model.stage(cause)
    assert isinstance(stage, Cause)
    order = list(stage.parameters)
    covariance = np.zeros((len(order), len(order)))
    index = {name: j for j, (id, name) in enumerate(fitted.point.names) if id == cause}
    for a, name in enumerate(order):
        for b, other in enumerate(order):
            if name in index and other in index:
                covariance[a, b] = fitted.covariance[index[name], index[other]]
    said = {
        n: replace(p, ci95=stage.parameters[n].ci95)  # as it was held
        if n in stage.parameters and n not in index and p.ci95 is None else p
        for n, p in stage.reported(covariance).items()
    }  # fmt: skip
    said = {n: p for n, p in said.items() if not _only_believed(stage, n, p)}
    begun = fitted.point.model.stage(cause)
    if isinstance(begun, FirstSpring) and not fitted.point.fixed:
        said["offset"] = offset_of(fitted, begun)
    said = {n: _spread(p, spread.get((cause, n))) for n, p in said.items()}
    said = {n: _of_any_form(p, stage.by_form.get(n, 0.0)) for n, p in said.items()}
    if stage.bending:
        at = said[stage.bending]
        said[stage.bending] = as_recorded(
            fitted.space.groups, fitted.point.model, at, 1e-3 * fitted.space.sample_noise_nm
        )
    return {n: _no_finer(p, stage.known_to) for n, p in said.items()}


def _no_finer(p: Parameter, share: float) -> Parameter:
    """With an interval that reaches at least this share of the value to either side."""
    if p.ci95 is None:
        return p
    least = share * abs(p.value)
    return replace(p, ci95=(min(p.ci95[0], p.value - least), max(p.ci95[1], p.value + least)))


def _of_any_form(p: Parameter, share: float) -> Parameter:
    """With an interval that has room for other laws, which give it another size.

    So far as they do not show: beside a law that is off by more than some standard errors of its
    size something is left.
    """
    if p.ci95 is None or not share:
        return p
    error = (p.ci95[1] - p.ci95[0]) / 3.92
    other = 1.96 * min(share * abs(p.value), UNSEEN * error)
    low, high = (float(np.hypot(end - p.value, other)) for end in p.ci95)
    return replace(p, ci95=(p.value - low, p.value + high))


def _only_believed(stage: Cause, name: str, p: Parameter) -> bool:
    """Whether the data say nearly nothing of what a law is taken to be beforehand."""
    if name not in stage.priors or p.ci95 is None:
        return False
    return 0.5 * (p.ci95[1] - p.ci95[0]) > BELIEVED * AS_HELD * 1.96 * stage.priors[name][1]


def _spread(p: Parameter, interval: tuple[float, float] | None) -> Parameter:
    """With another interval, which holds the value all the same."""
    if interval is None:
        return p
    return replace(p, ci95=(min(interval[0], p.value), max(interval[1], p.value)))


def final_model(fitted: Fitted, name: str, spread: Intervals) -> Model:
    """The extended model with intervals, the first spring's constant part in its law."""
    model = fitted.point.model
    for stage in model.stages:
        if stage.units and isinstance(stage, Cause):
            own = {}
            for j, (id, parameter) in enumerate(fitted.point.names):
                if id == stage.id and fitted.covariance.size:
                    half = 1.96 * float(np.sqrt(max(fitted.covariance[j, j], 0.0)))
                    value = stage[parameter]
                    linear = Parameter(
                        value, stage.parameters[parameter].unit, (value - half, value + half)
                    )
                    own[parameter] = _of_any_form(
                        _spread(linear, spread.get((stage.id, parameter))),
                        stage.by_form.get(parameter, 0.0),
                    )
            model = model.with_(
                stages=tuple(
                    type(s)(s.parameters | own, s.elements) if s.id == stage.id else s
                    for s in model.stages
                )
            )
    for stage in model.stages:
        if isinstance(stage, FirstSpring) and not fitted.point.fixed:
            model = with_offset(fitted, model, stage)
    return model.with_(name=f"{name} extended")
