"""What every band of the element tables does by itself.

At fixed break points the displacement is linear in the compliances: one walk over the drive
serves all columns. Laws move break points a little; their columns are taken without that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Branches, Model, Signal
from piezo_rig.chain.branches import sliders
from piezo_rig.chain.drives import LONG_AGO_S, preceded
from piezo_rig.chain.first_rise import first_rise_v
from piezo_rig.chain.stage import Wider
from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.left_before import played_before

FloatArray = NDArray[np.float64]


def bands(model: Model, group: Group) -> FloatArray:
    """Displacement per unit of compliance of every band of every table, in V, shape (p, n).

    In the order of the tables among the model's stages. Recordings that were played after
    different ones are averaged, as in `Group.predicted`.
    """
    if not group.virgin:
        whole = np.ascontiguousarray(preceded(group.drive_v))
        return _bands(model, group, whole[: whole.size - group.drive_v.size])
    return np.asarray(sum(
        share * _bands(model, group, volts) for share, volts in played_before(model, group)
    ))  # fmt: skip


def _bands(model: Model, group: Group, played: FloatArray) -> FloatArray:
    """`bands` after a drive that was played long ago."""
    from piezo_rig.chain import kernels

    branches = replace(model.branches(), laws=(), reaching=())
    before = played.size
    drive = np.ascontiguousarray(np.concatenate([played, group.drive_v]))
    time = group.time_s
    if before:
        time = np.concatenate([time[0] - LONG_AGO_S * np.arange(before, 0, -1), time])
    signal = Signal(time, drive, np.zeros(0))
    for stage in model.stages:
        if stage.place == "drive":
            signal = stage.act(signal)
    drive = np.ascontiguousarray(signal.drive_v)
    seen, wider = drive, None
    for stage in model.stages:
        if stage.moves_sliders:
            seen = stage.seen_by_sliders(signal, model.branches())
            by = stage.wider_by(signal)
            wider = None if by is None else _wider(branches, drive, by)
    own = not model.one_curve
    apart = own and before > 0  # a first rise of its own beside what is left of others
    if apart:
        branches = branches.of_one_curve()
    walk = branches.walk(seen)
    mine = walk.ints[:, 1] > before  # where it stood after all that came before is set to 0
    ints, floats = walk.ints[mine], walk.floats[mine]
    first = branches.initiation.compliance_um_per_v.size
    later = 1 + branches.rest.compliance_um_per_v.size
    rows = []
    for stage in model.stages:
        if stage.elements is None:
            continue
        rising = first_rise_v(stage.elements.knots_v, seen[before:]) if apart else None
        behind = max(len(stage.elements) - first, 0)  # of a first rise, before it is recorded
        for k in range(len(stage.elements)):
            if rising is not None and stage.id != "maxwell":
                rows.append(rising[k])
                continue
            rise, branch = np.zeros(first), np.zeros(later)
            if stage.id == "maxwell":
                branch[k] = 1.0
            if (stage.id != "maxwell" or apart or not own) and k >= behind:
                rise[k - behind] = 1.0
            out = np.empty(drive.size)
            slope = np.full((1, 1), 1.0 / branch[0] if branch[0] else np.inf)
            kernels.fill(seen, ints, floats, first, rise, slope, branch[1:], out)
            if branch[0]:  # the first spring follows the drive itself
                out += drive - seen
            if wider is not None and stage.id == "maxwell":
                out += wider[k]
            out = out[before:] - out[before]
            rows.append(out if rising is None else out - rising[k])
    return np.array(rows)


def _wider(branches: Branches, drive: FloatArray, by: Wider) -> FloatArray:
    """What widening thresholds add to the bands of a later branch, V, shape (bands, n)."""
    from piezo_rig.chain.widening import each_wider_v

    thresholds, _ = sliders(branches)
    each = each_wider_v(thresholds, np.zeros(1, np.int64), drive, by)
    return np.asarray(-np.diff(each, axis=0, prepend=0.0, append=0.0))
