"""Finds the causes by file, and knows which of them make a named model."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import piezo_rig.causes as _package
from piezo_rig.chain.bend import Bend
from piezo_rig.chain.maxwell import Maxwell
from piezo_rig.chain.model import Model
from piezo_rig.chain.model_file import read_model
from piezo_rig.chain.stage import Stage
from piezo_rig.errors import InputError

NAMED_MODELS: dict[str, tuple[str, ...]] = {
    "classical": (),
    "initiation": ("initiation-stage",),
    "range": ("initiation-stage", "range-dependence"),
    "extremum": ("initiation-stage", "extremum-dependence"),
    "range-extremum": ("initiation-stage", "range-dependence", "extremum-dependence"),
    "direction": ("initiation-stage", "direction-asymmetry"),
    "range-direction": ("initiation-stage", "range-dependence", "direction-asymmetry"),
}


def _find() -> dict[str, type[Stage]]:
    found: dict[str, type[Stage]] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(_package.__path__)):
        if module in ("catalogue", "cause", "first_spring"):
            continue
        for thing in vars(importlib.import_module(f"{_package.__name__}.{module}")).values():
            if not (isinstance(thing, type) and issubclass(thing, Stage)):
                continue
            if thing.id not in ("", "maxwell"):
                found[thing.id] = thing
    return found


CAUSES = _find()
"""Every cause by its id."""

STAGES: dict[str, type[Stage]] = {"maxwell": Maxwell, "bend": Bend, **CAUSES}
"""Every stage that a model file may name."""


def named_model(name: str) -> tuple[type[Stage], ...]:
    """The causes of a named model; InputError when nothing has that name."""
    if name not in NAMED_MODELS:
        raise InputError(
            "unknown-model",
            f"no model is called {name[:60]!r}",
            "a misspelt name, or a model file without its .json",
            f"use one of {', '.join(NAMED_MODELS)}",
        )
    return tuple(CAUSES[id] for id in NAMED_MODELS[name])


def load_model(path: str | Path) -> Model:
    """Read a model file that may use any cause of the catalogue; see `read_model`."""
    return read_model(path, STAGES)
