"""Where every recording stands against the first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held_out import refold
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import Sweep


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
