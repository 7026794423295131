"""Calibration files: what turns volts into drive and displacement, with its uncertainty."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from piezo_rig.config.toml_text import Document


@dataclass(frozen=True)
class AmplifierCalibration:
    """Drive = gain x command + offset_v.

    ``gain_u`` and ``offset_u_v`` are standard uncertainties (NaN where the file states none).
    """

    gain: float
    offset_v: float
    gain_u: float
    offset_u_v: float
    serial: str
    date: str
    path: str
    sha256: str
    text: str


@dataclass(frozen=True)
class InterferometerCalibration:
    """Micrometres per volt at each position of the sensitivity switch.

    ``noise_nm`` and ``output_noise_v`` are rms at rest within a second, of the measurement and
    of the analog output (NaN where the file states none).
    """

    sensitivities_um_per_v: tuple[float, ...]
    table: str
    output_limit_v: float
    noise_nm: float
    output_noise_v: float
    serial: str
    date: str
    path: str
    sha256: str
    text: str


def _document(path: Path) -> tuple[Document, str]:
    document = Document.load(path, "calibration", "calibration file")
    return document, hashlib.sha256(document.text.encode()).hexdigest()


def load_amplifier(path: Path) -> AmplifierCalibration:
    """Read an amplifier's calibration; ``InputError`` names line and key."""
    document, digest = _document(path)
    root = document.root()
    root.text("schema", choices=("piezo-rig/calibration/1",))
    root.text("instrument", "amplifier", choices=("amplifier",))
    result = AmplifierCalibration(
        gain=root.number("gain", above=0.0, high=1000.0),
        offset_v=root.number("offset_v", low=-1000.0, high=1000.0),
        gain_u=root.number("gain_u", float("nan"), low=0.0),
        offset_u_v=root.number("offset_u_v", float("nan"), low=0.0),
        serial=root.text("serial", ""),
        date=root.text("date", ""),
        path=str(path),
        sha256=digest,
        text=document.text,
    )
    root.text("note", "")
    root.finish()
    return result


def load_interferometer(path: Path, table: str) -> InterferometerCalibration:
    """Read an interferometer's calibration.

    Parameters
    ----------
    path : the file
    table : ``printed`` for the values on the instrument, ``exact`` for 990.44 / 4^k
    """
    document, digest = _document(path)
    root = document.root()
    root.text("schema", choices=("piezo-rig/calibration/1",))
    root.text("instrument", "interferometer", choices=("interferometer",))
    tables = {
        name: tuple(root.numbers(f"{name}_um_per_v", low=1e-6)) for name in ("printed", "exact")
    }
    for name, values in tables.items():
        if len(values) != 7:
            raise root.error(f"{name}_um_per_v", f"expected seven values, found {len(values)}")
    result = InterferometerCalibration(
        sensitivities_um_per_v=tables[table],
        table=table,
        output_limit_v=root.number("output_limit_v", 10.0, above=0.0),
        noise_nm=root.number("noise_nm", float("nan"), low=0.0, high=1e6),
        output_noise_v=root.number("output_noise_v", float("nan"), low=0.0, high=10.0),
        serial=root.text("serial", ""),
        date=root.text("date", ""),
        path=str(path),
        sha256=digest,
        text=document.text,
    )
    root.text("note", "")
    root.finish()
    return result
