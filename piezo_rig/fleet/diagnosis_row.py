"""A diagnosis as a row of a table, from its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def row_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one diagnosis; ``units`` holds the units of those that have one.

    Every finding has ``CAUSE.p_value``, ``CAUSE.gain_percent`` and its parameters; of events that
    are listed one by one only their number is here, as ``CAUSE.events``.
    """
    data, baseline, rest = document["data"], document["baseline"], document["unexplained"]
    row: dict[str, Any] = {
        "sweeps": data["sweeps"], "samples": data["samples"], "repeats": data["repeats"],
        "rms_nm": baseline["rms_nm"], "max_percent": baseline["max_percent"],
        "held_out": data["held_out"],
        "noise_floor_nm": document["noise_floor_nm"],
        "extended_rms_nm": document["extended"]["rms_nm"],
        "extended_max_percent": document["extended"]["max_percent"],
        "unexplained": rest["detected"], "unexplained_rms_nm": rest["rms_nm"],
        "findings": [f["cause"] for f in document["findings"]],
    }
    units: dict[str, str] = {}
    for finding in document["findings"]:
        cause = finding["cause"]
        row[f"{cause}.p_value"] = finding["p_value"]
        row[f"{cause}.gain_percent"] = finding["gain_percent"]
        if "events" in finding:
            row[f"{cause}.events"] = len(finding["events"])
        for name, parameter in finding["parameters"].items():
            if not isinstance(parameter["value"], list):
                row[f"{cause}.{name}"] = parameter["value"]
                units[f"{cause}.{name}"] = parameter["unit"]
    return row | {"units": units}
