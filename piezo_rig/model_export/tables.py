"""A model's numbers as tables: elements, curves and parameters, with units and intervals."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.chain.elements import Elements
from piezo_rig.chain.model import Model

CSV_HEADER = ("stage", "place", "table", "row", "quantity", "value", "unit", "ci95_low",
              "ci95_high")


@dataclass(frozen=True)
class Column:
    """One quantity of a table: its values (n,) and their unit."""

    quantity: str
    unit: str
    values: np.ndarray


def element_table(elements: Elements) -> list[Column]:
    """Springs and sliders, in the order in which they give way."""
    return [
        Column("k_v_per_um", "V/um", elements.k_v_per_um),
        Column("slides_at_um", "um", elements.slides_at_um),
        Column("breakaway_v", "V", elements.breakaway_v),
    ]


def operator_table(elements: Elements) -> list[Column]:
    """The same as play operators: y = sum of weight x play(threshold) of the drive.

    The first has the threshold 0. On a first rise y = sum of weight x (V - threshold) beyond it.
    """
    compliance = 1.0 / elements.slopes
    return [
        Column("threshold_v", "V", np.append(0.0, elements.knots_v[:-1])),
        Column("weight_um_per_v", "um/V", np.diff(compliance, prepend=0.0)),
    ]


def curve_table(elements: Elements, factor: float) -> list[Column]:
    """Break points of a branch from its turning point (factor 2) or of a first rise (1)."""
    return [
        Column("drive_v", "V", np.append(0.0, factor * elements.knots_v)),
        Column("displacement_um", "um", np.append(0.0, factor * elements.slides_at_um)),
    ]


def element_tables(model: Model) -> dict[str, dict[str, list[Column]]]:
    """All tables, by the id of their stage and by name; curves are before any law."""
    first = model.stage("initiation-stage")
    found: dict[str, dict[str, list[Column]]] = {}
    for stage in model.stages:
        if stage.elements is None:
            continue
        tables = {"elements": element_table(stage.elements),
                  "operators": operator_table(stage.elements)}
        if stage is model.maxwell:
            tables["later_branch"] = curve_table(stage.elements, 2.0)
        if stage is first or (first is None and stage is model.maxwell):
            tables["first_rise"] = curve_table(stage.elements, 1.0)
        found[stage.id] = tables
    return found


def write_csv_tables(model: Model, path: Path) -> None:
    """One long table, a number a line, with the columns `CSV_HEADER`; OSError from the disk."""
    tables = element_tables(model)
    with path.open("w", newline="", encoding="utf-8") as handle:
        rows = csv.writer(handle, lineterminator="\n")
        rows.writerow(CSV_HEADER)
        for stage in model.stages:
            for name, p in stage.parameters.items():
                low, high = ("", "") if p.ci95 is None else map(repr, map(float, p.ci95))
                rows.writerow([stage.id, stage.place, "parameters", "", name,
                               repr(float(p.value)), p.unit, low, high])
            for table, columns in tables.get(stage.id, {}).items():
                for c in columns:
                    for row, value in enumerate(c.values, start=1):
                        rows.writerow([stage.id, stage.place, table, row, c.quantity,
                                       repr(float(value)), c.unit, "", ""])


def write_mat_tables(model: Model, path: Path) -> None:
    """``model.stages{k}`` with ``parameters.NAME.value`` and tables; OSError from the disk."""
    from scipy.io import savemat

    tables = element_tables(model)
    stages = np.empty((1, len(model.stages)), dtype=object)
    for k, stage in enumerate(model.stages):
        stages[0, k] = {
            "id": stage.id, "place": stage.place,
            "parameters": {n: _parameter(p.value, p.unit, p.ci95)
                           for n, p in stage.parameters.items()},
            **{table: {c.quantity: c.values for c in columns}
               for table, columns in tables.get(stage.id, {}).items()},
        }
    body: dict[str, Any] = {"name": model.name, "stages": stages,
                            "provenance": repr(model.provenance)}
    savemat(path, {"model": body}, appendmat=False, long_field_names=True, oned_as="column")


def _parameter(value: float, unit: str, ci95: tuple[float, float] | None) -> dict[str, Any]:
    return {"value": float(value), "unit": unit,
            "ci95": np.empty((0, 0)) if ci95 is None else np.asarray(ci95)[None, :]}
