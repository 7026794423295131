"""Model files: one model as JSON.

The same model gives the same bytes: keys in a fixed order, numbers in their
shortest exact form, no time stamps. A file that is damaged, or that somebody
wrote by hand, is refused in words.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from piezo_rig.chain.elements import Elements
from piezo_rig.chain.model import Model
from piezo_rig.chain.stage import Parameter, Stage
from piezo_rig.errors import InputError

SCHEMA = "piezo-rig/model/1"
OFF_BY = ("rms_nm", "within_nm")  # in a provenance: how far off this fit was, not the others
LARGEST = 50_000_000  # bytes; a model of a thousand elements has a hundred thousand


def model_text(model: Model) -> str:
    """The text of a model file."""
    body = {
        "schema": SCHEMA,
        "name": model.name,
        "stages": [s.to_dict() for s in model.stages],
        "provenance": model.provenance,
    }
    return json.dumps(body, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def save_model(model: Model, path: str | Path) -> Path:
    """Write a model file; raises InputError where the disk refuses."""
    path = Path(path)
    try:
        path.write_text(model_text(model), encoding="utf-8", newline="\n")
    except OSError as e:
        raise InputError(
            "model-not-written",
            f"{path}: {e.strerror or e}",
            "the folder is missing, full, or not yours to write",
            "name another place with --out",
        ) from None
    return path


def read_model(path: str | Path, stages: Mapping[str, type[Stage]]) -> Model:
    """Read a model file.

    Parameters
    ----------
    path : the file
    stages : the stages that the program knows, by id

    Raises
    ------
    InputError : not readable, not JSON, of another schema, or with numbers that cannot be right
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST:
            raise _broken(path, "too large for a model file")
        body = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except OSError as e:
        raise InputError(
            "model-not-found", f"{path}: {e.strerror or e}", "a wrong path", "check the name"
        ) from None
    except (ValueError, RecursionError) as e:
        raise _broken(path, f"not JSON ({str(e)[:100]})") from None
    if not isinstance(body, dict) or not isinstance(body.get("schema"), str):
        raise _broken(path, "no schema")
    if body["schema"] != SCHEMA:
        raise InputError(
            "model-schema",
            f"{path}: schema {body['schema'][:60]!r}, this program reads {SCHEMA!r}",
            "not a model file, or one of a newer version",
            "identify the model again, or update piezo-rig",
        )
    listed, provenance, name = body.get("stages"), body.get("provenance", {}), body.get("name", "")
    if not isinstance(listed, list) or not isinstance(provenance, dict) or type(name) is not str:
        raise _broken(path, "stages, provenance or name is not what it should be")
    try:
        model = Model(tuple(_stage(s, stages) for s in listed), provenance, name)
        model.check()
        bent_model(model, stages)
    except InputError as e:
        raise InputError(
            e.code, f"{path}: {e.what}", e.cause or "the file is damaged or was written by hand",
            e.remedy or "identify the model again, or mend the file",
        ) from None
    return model


def bent_model(model: Model, stages: Mapping[str, type[Stage]]) -> Model | None:
    """The fit beside a bend, if the model's provenance has it; InputError if damaged.

    It is as far off as itself was where it was identified, not as the fit without the bend.
    """
    said = model.provenance.get("bent")
    if said is None:
        return None
    listed = said.get("stages") if isinstance(said, dict) else None
    if not isinstance(listed, list) or not _number(said.get("rms_nm")):
        raise InputError("model-stage", "the fit with a bend in its provenance is damaged")
    own = {k: v for k, v in model.provenance.items() if k not in OFF_BY}
    own |= {k: said[k] for k in OFF_BY if _number(said.get(k))}
    bent = Model(tuple(_stage(s, stages) for s in listed), own, model.name)
    bent.check()
    return bent


def _stage(data: Any, stages: Mapping[str, type[Stage]]) -> Stage:
    if not isinstance(data, dict) or not isinstance(data.get("id"), str):
        raise InputError("model-stage", "a stage has no id")
    id = data["id"]
    if id not in stages:
        raise InputError(
            "unknown-stage",
            f"stage {id[:60]!r} is not known",
            "the model was written by a newer version, or the name was misspelt",
            f"known: {', '.join(sorted(stages))}",
        )
    kind = stages[id]
    listed = data.get("parameters", {})
    units = {**kind.units, **kind.optional}
    if not isinstance(listed, dict) or not set(listed) <= set(units):
        raise InputError(
            "model-stage", f"stage {id}: its parameters are {', '.join(units) or 'none'}"
        )
    parameters = {n: _parameter(id, n, listed[n], units[n]) for n in units if n in listed}
    elements = None
    if kind.has_elements:
        elements = Elements.from_rows(data.get("elements"), f"stage {id}")
    stage = kind(parameters, elements)
    stage.check()
    return stage


def _parameter(id: str, name: str, data: Any, unit: str) -> Parameter:
    value = data.get("value") if isinstance(data, dict) else None
    if value is None or not _number(value):
        raise InputError("model-stage", f"stage {id}: {name} has no value that is a number")
    if data.get("unit", unit) != unit:
        raise InputError(
            "model-stage", f"stage {id}: {name} is in {data['unit']!r}, it should be in {unit!r}"
        )
    ci95 = data.get("ci95")
    if ci95 is not None:
        if not isinstance(ci95, list) or len(ci95) != 2 or not all(map(_number, ci95)):
            raise InputError("model-stage", f"stage {id}: ci95 of {name} is not two numbers")
        ci95 = (float(ci95[0]), float(ci95[1]))
    return Parameter(float(value), unit, ci95)


def _number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e300


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not a number")


def _broken(path: Path, what: str) -> InputError:
    return InputError(
        "model-damaged",
        f"{path}: {what}",
        "the file is damaged, or is not a model file",
        "identify the model again",
    )
