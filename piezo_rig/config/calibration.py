"""Calibration files: what turns volts into drive and displacement, with its uncertainty.

A file holds one instrument (its keys stand at the top), or, with ``instrument = "bench"``, both:
in tables ``[amplifier]`` and ``[interferometer]``. `piezo-rig calibrate` writes them.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezo_rig.config.toml_text import Document, Table

SCHEMA = "piezo-rig/calibration/1"
INSTRUMENTS = ("amplifier", "interferometer")
BOTH = "bench"
TABLES = ("printed", "exact")
UNSTATED = float("nan")


@dataclass(frozen=True)
class AmplifierCalibration:
    """Drive = gain x command + offset_v.

    ``gain_u``, ``offset_u_v`` are standard uncertainties, ``covariance_v`` the covariance of gain
    and offset (NaN where the file states none). ``set_voltage_v`` is what the amplifier itself
    tells of its offset; the same, where the file does not say otherwise.
    """

    gain: float
    offset_v: float
    gain_u: float
    offset_u_v: float
    covariance_v: float
    set_voltage_v: float
    serial: str
    date: str
    path: str
    sha256: str
    text: str


@dataclass(frozen=True)
class InterferometerCalibration:
    """Micrometres per volt at each position of the sensitivity switch.

    ``sensitivities_um_per_v`` are those of ``table``, replaced where a position was measured;
    ``sensitivities_u_um_per_v`` their standard uncertainties, NaN where none was measured.
    ``polarity`` is 0 where the file does not state it. ``noise_nm`` and ``output_noise_v`` are rms
    at rest within a second, of the measurement and of the analog output (NaN where the file states
    none).
    """

    sensitivities_um_per_v: tuple[float, ...]
    sensitivities_u_um_per_v: tuple[float, ...]
    table: str
    polarity: int
    output_limit_v: float
    noise_nm: float
    output_noise_v: float
    serial: str
    date: str
    path: str
    sha256: str
    text: str


def load_amplifier(path: Path) -> AmplifierCalibration:
    """Read an amplifier's calibration; ``InputError`` names line and key."""
    return amplifier_of(_document(path))


def load_interferometer(path: Path, table: str) -> InterferometerCalibration:
    """Read an interferometer's calibration.

    Parameters
    ----------
    path : the file
    table : ``printed`` for the values on the instrument, ``exact`` for 990.44 / 4^k
    """
    return interferometer_of(_document(path), table)


def amplifier_of(document: Document) -> AmplifierCalibration:
    """The amplifier's calibration in a document; ``InputError`` names line and key."""
    root = _section(document, "amplifier")
    offset_v = root.number("offset_v", low=-1000.0, high=1000.0)
    result = AmplifierCalibration(
        gain=root.number("gain", above=0.0, high=1000.0),
        offset_v=offset_v,
        gain_u=root.number("gain_u", UNSTATED, low=0.0),
        offset_u_v=root.number("offset_u_v", UNSTATED, low=0.0),
        covariance_v=root.number("gain_offset_covariance_v", UNSTATED),
        set_voltage_v=root.number("set_voltage_v", offset_v, low=-1000.0, high=1000.0),
        serial=root.text("serial", ""),
        date=root.text("date", ""),
        path=document.name,
        sha256=sha256_of(document.text),
        text=document.text,
    )
    _take_record(root, "residual_v")
    root.finish()
    return result


def interferometer_of(document: Document, table: str) -> InterferometerCalibration:
    """The interferometer's calibration in a document; ``InputError`` names line and key."""
    root = _section(document, "interferometer")
    tables = {name: list(root.numbers(f"{name}_um_per_v", low=1e-6)) for name in TABLES}
    for name, values in tables.items():
        if len(values) != 7:
            raise root.error(f"{name}_um_per_v", f"expected seven values, found {len(values)}")
    values, uncertainties = tables[table], [UNSTATED] * 7
    for measured in root.tables("measured") if "measured" in root else []:
        switch = measured.integer("switch", low=0, high=6)
        if not math.isnan(uncertainties[switch]):
            raise measured.error("switch", f"position {switch} is stated twice")
        values[switch] = measured.number("sensitivity_um_per_v", low=1e-6)
        uncertainties[switch] = measured.number("sensitivity_u_um_per_v", low=0.0)
        measured.text("date", "")
        _take_record(measured, "residual_um")
        measured.finish()
    polarity = root.integer("polarity", 0)
    if polarity not in (-1, 0, 1):
        raise root.error("polarity", "expected 1 or -1")
    result = InterferometerCalibration(
        sensitivities_um_per_v=tuple(values),
        sensitivities_u_um_per_v=tuple(uncertainties),
        table=table,
        polarity=polarity,
        output_limit_v=root.number("output_limit_v", 10.0, above=0.0),
        noise_nm=root.number("noise_nm", UNSTATED, low=0.0, high=1e6),
        output_noise_v=root.number("output_noise_v", UNSTATED, low=0.0, high=10.0),
        serial=root.text("serial", ""),
        date=root.text("date", ""),
        path=document.name,
        sha256=sha256_of(document.text),
        text=document.text,
    )
    root.text("note", "")
    root.finish()
    return result


def parts_of(parsed: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What a parsed calibration file says, by instrument; for readers that check nothing."""
    kind = parsed.get("instrument")
    if kind == BOTH:
        return {k: v for k in INSTRUMENTS if isinstance(v := parsed.get(k), dict)}
    if kind not in INSTRUMENTS:  # of an early version
        kind = INSTRUMENTS["printed_um_per_v" in parsed]
    return {kind: parsed}


def sha256_of(text: str) -> str:
    """What a run refers to a calibration by."""
    return hashlib.sha256(text.encode()).hexdigest()


def _document(path: Path) -> Document:
    return Document.load(path, "calibration", "calibration file")


def _section(document: Document, instrument: str) -> Table:
    """Where an instrument's keys stand."""
    root = document.root()
    root.text("schema", choices=(SCHEMA,))
    if root.text("instrument", instrument, choices=(instrument, BOTH)) == instrument:
        return root
    for other in INSTRUMENTS:
        if other != instrument:
            root.table(other, required=False)
    found = root.table(instrument)
    root.finish()
    return found


def _take_record(table: Table, residual: str) -> None:
    """Pass over what a calibration says of how it was made."""
    for key in ("points", "degrees_of_freedom"):
        table.integer(key, 0, low=0)
    table.number(residual, 0.0, low=0.0)
    for key in ("operator", "reference", "note"):
        table.text(key, "")
