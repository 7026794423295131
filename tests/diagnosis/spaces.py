"""A space of recordings, and points in it, for tests of single steps of a diagnosis."""

from __future__ import annotations

import numpy as np

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.diagnosis import engine
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare


def begun(sweeps, noisy=None):
    """A space, and a point of the classical model in it.

    ``noisy`` : recordings that the noise is taken from, if not from these
    """
    data = _data(sweeps)
    plain = Point(starting_model(data, named_model("classical"), "classical"))
    of = data if noisy is None else _data(noisy)
    whitener, _ = engine.noise_of(of, plain, np.random.default_rng(0))
    return engine.space_of(data, whitener, plain.model)[0], plain


def _data(sweeps):
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


def with_member(point, id, sizes, **values):
    """The point with a cause at these values; ``sizes`` : of examples of what is free."""
    stage = CAUSES[id].of(None, **values)
    free = tuple((id, name, size) for name, size in sizes.items())
    return Point(point.model.with_stage(stage), (), (*point.sizes, *free))
