"""The text of a calibration file: what was measured, and what is kept of the file before it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from piezo_rig.calibrate.line import Line
from piezo_rig.config.calibration import BOTH, INSTRUMENTS, SCHEMA

_INTRO = {
    "amplifier": "Drive on the stack = gain x command + offset_v.",
    "interferometer": "Micrometres per volt at switch positions 0..6; [[measured]] ones replace "
    "those of the table.",
}

Facts = dict[str, Any]


def amplifier_facts(line: Line, before: Mapping[str, Any], said: Mapping[str, str]) -> Facts:
    """What is known of an amplifier after a calibration.

    Parameters
    ----------
    line : drive over command
    before : what an earlier file says; its set voltage and serial number are kept
    said : serial, date, operator, reference, note
    """
    facts: Facts = {
        "gain": line.slope, "gain_u": line.slope_u,
        "offset_v": line.intercept, "offset_u_v": line.intercept_u,
        "gain_offset_covariance_v": line.covariance,
        **_record(line, "residual_v"),
    }
    if "set_voltage_v" in before:
        facts["set_voltage_v"] = before["set_voltage_v"]
    return {**facts, **_said(said, before)}


def interferometer_facts(
    line: Line, switch: int, before: Mapping[str, Any], said: Mapping[str, str]
) -> Facts:
    """What is known of an interferometer after one position of its switch was calibrated.

    Parameters
    ----------
    line : displacement over sensor volts
    before : what an earlier file says; its tables, noise and other positions are kept
    """
    others = [m for m in before.get("measured", []) if m.get("switch") != switch]
    new = {
        "switch": switch, "sensitivity_um_per_v": abs(line.slope),
        "sensitivity_u_um_per_v": line.slope_u, **_record(line, "residual_um"),
        **{k: said[k] for k in ("date", "operator", "reference", "note") if said.get(k)},
    }
    kept = {
        k: v for k, v in before.items()
        if k not in ("schema", "instrument", "polarity", "serial", "date", "note", "measured")
    }
    return {
        **kept, "polarity": 1 if line.slope > 0 else -1,
        "serial": said.get("serial") or before.get("serial", ""), "date": said["date"],
        "note": before.get("note", ""),
        "measured": sorted([*others, new], key=lambda m: int(m["switch"])),
    }


def _record(line: Line, residual: str) -> Facts:
    return {"points": int(line.residuals.size), "degrees_of_freedom": line.dof,
            residual: line.residual}


def _said(said: Mapping[str, str], before: Mapping[str, Any]) -> Facts:
    return {
        "serial": said.get("serial") or before.get("serial", ""), "date": said["date"],
        **{k: said[k] for k in ("operator", "reference", "note") if said.get(k)},
    }


def calibration_text(parts: Mapping[str, Mapping[str, Any]]) -> str:
    """The file: flat for one instrument, with a table for each where there are two.

    Parameters
    ----------
    parts : by instrument, its keys and values; lists of tables last
    """
    lines = [f"# {_INTRO[name]}" for name in INSTRUMENTS if name in parts]
    lines += ["# Values ending in _u, _u_v or _u_um_per_v are standard uncertainties (k = 1).",
              f"schema = {_value(SCHEMA)}"]
    if len(parts) == 1:
        ((name, facts),) = parts.items()
        return "\n".join([*lines, f"instrument = {_value(name)}", *_table(facts, "")]) + "\n"
    lines.append(f"instrument = {_value(BOTH)}")
    for name in INSTRUMENTS:
        lines += ["", f"[{name}]", *_table(parts[name], name + ".")]
    return "\n".join(lines) + "\n"


def _table(facts: Mapping[str, Any], prefix: str) -> list[str]:
    flat = [f"{k} = {_value(v)}" for k, v in facts.items()
            if k not in ("schema", "instrument", "measured")]
    for measured in facts.get("measured", []):
        flat += ["", f"[[{prefix}measured]]", *(f"{k} = {_value(v)}" for k, v in measured.items())]
    return flat


def _value(value: Any) -> str:
    """A value in TOML: text without control characters, numbers to twelve figures."""
    if isinstance(value, str):
        return json.dumps("".join(c if c.isprintable() else " " for c in value),
                          ensure_ascii=False)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, int):
        return str(value)
    text = f"{value:.12g}"
    return text if any(c in text for c in ".e") else text + ".0"
