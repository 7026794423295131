"""Fits gain and offset to voltmeter points, the sensitivity to a reference displacement.

POINTS is a CSV with columns command_v,drive_v and/or sensor_v,displacement_um (cells may be empty);
drive_u_v and displacement_u_um may state the reference's standard uncertainty point by point. The
file that is written is what a rig's config names as `calibration` of amplifier and interferometer.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from piezo_rig.calibrate.points import Points
    from piezo_rig.config.toml_text import Document

HELP = "fit gain, offset and sensitivity to measured points"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("points", metavar="POINTS.csv")
    parser.add_argument("--out", metavar="CAL.toml", required=True)
    parser.add_argument("--update", metavar="OLD.toml",
                        help="keep from this calibration file what was not measured")
    parser.add_argument("--sensitivity", metavar="0..6", type=int, choices=range(7),
                        help="the switch during the points; default: the one that fits best")
    parser.add_argument("--reference-percent", metavar="U", type=float, default=0.0,
                        help="relative standard uncertainty of the reference's scale, common to "
                        "all points, in percent (its certificate tells it)")
    parser.add_argument("--amplifier-serial", metavar="TEXT", default="")
    parser.add_argument("--interferometer-serial", metavar="TEXT", default="")
    parser.add_argument("--set-voltage", metavar="V", type=float,
                        help="what the amplifier itself shows as its set voltage")
    parser.add_argument("--reference", metavar="TEXT", default="",
                        help="what was measured with, and its serial number")
    parser.add_argument("--operator", metavar="TEXT", default="")
    parser.add_argument("--date", metavar="YYYY-MM-DD", default="", help="default: today")
    parser.add_argument("--note", metavar="TEXT", default="")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.calibrate.document import calibration_text
    from piezo_rig.calibrate.points import read_points
    from piezo_rig.config.calibration import sha256_of
    from piezo_rig.config.toml_text import Document

    said = _said(args)
    before = _before(args.update)
    measured = read_points(Path(args.points))
    parts: dict[str, dict[str, Any]] = {k: dict(v) for k, v in before.items()}
    for points in measured:
        part = _amplifier if points.instrument == "amplifier" else _interferometer
        parts[points.instrument] = part(points, args, before, said)
    text = calibration_text(parts)
    path = Path(args.out)
    _check(parts, Document(text, str(path), "calibration"))
    _write(path, text)
    print(f"calibration: {path}")
    print(f"sha256: {sha256_of(text)}")
    print("in the rig's config:")
    for name in parts:
        print(f'  under [{name}]: calibration = "{path}"')
    if "amplifier" in parts:
        _print_rail(float(parts["amplifier"]["gain"]), float(parts["amplifier"]["offset_v"]))
    return 0


def _said(args: argparse.Namespace) -> dict[str, str]:
    """What the operator says of this calibration, checked."""
    import math
    from datetime import date

    from piezo_rig.errors import InputError

    try:
        day = date.fromisoformat(args.date) if args.date else date.today()
    except ValueError:
        raise InputError("usage", f"--date {args.date}: not a date",
                         "a slip on the command line", "write it as 2026-01-31") from None
    if not 0.0 <= args.reference_percent < 100.0:
        raise InputError("usage", f"--reference-percent {args.reference_percent:g}: "
                         "not a relative standard uncertainty in percent",
                         "a slip on the command line", "0.01 stands for 0.01 %")
    if args.set_voltage is not None and not math.isfinite(args.set_voltage):
        raise InputError("usage", f"--set-voltage {args.set_voltage}: not a voltage",
                         "a slip on the command line", "write it in volts")
    return {"date": day.isoformat(), "operator": args.operator, "reference": args.reference,
            "note": args.note}


def _before(name: str | None) -> dict[str, dict[str, Any]]:
    """What an earlier calibration file says, by instrument, checked as a rig would."""
    from piezo_rig.config.calibration import parts_of
    from piezo_rig.config.toml_text import Document
    from piezo_rig.resources import find

    if name is None:
        return {}
    document = Document.load(find("calibration", name), "calibration", "calibration file")
    parts = parts_of(document.data)
    _check(parts, document)
    return parts


def _check(parts: Mapping[str, Any], document: Document) -> None:
    """Read a calibration as a rig would; ``InputError`` for what a rig would refuse."""
    from piezo_rig.config.calibration import amplifier_of, interferometer_of

    if "amplifier" in parts:
        amplifier_of(document)
    if "interferometer" in parts:
        interferometer_of(document, "printed")


def _shipped(instrument: str) -> dict[str, Any]:
    """The nominal values that a calibration without a predecessor starts from."""
    from piezo_rig.config.calibration import parts_of
    from piezo_rig.config.toml_text import Document
    from piezo_rig.resources import find

    name = {"amplifier": "amplifier", "interferometer": "sios_sp_s120"}[instrument]
    document = Document.load(find("calibration", name), "calibration", "calibration file")
    facts = parts_of(document.data)[instrument]
    return {k: v for k, v in facts.items() if not k.startswith(("noise", "output_noise", "note"))}


def _amplifier(
    points: Points, args: argparse.Namespace, before: dict[str, Any], said: dict[str, str]
) -> dict[str, Any]:
    from piezo_rig.calibrate.checks import Expected, check_amplifier, fitted, words
    from piezo_rig.calibrate.document import amplifier_facts

    known = before.get("amplifier") or _shipped("amplifier")
    line, warnings = fitted(points, args.reference_percent / 100.0)
    expected = Expected((float(known["gain"]),), offset_v=float(known["offset_v"]))
    warnings = check_amplifier(points, line, expected) + warnings
    _print(points, words(line, ("gain", "offset"), ("V/V", "V")), line.residual, warnings)
    facts = amplifier_facts(
        line, before.get("amplifier", {}), {**said, "serial": args.amplifier_serial}
    )
    if args.set_voltage is not None:
        facts["set_voltage_v"] = args.set_voltage
    return facts


def _interferometer(
    points: Points, args: argparse.Namespace, before: dict[str, Any], said: dict[str, str]
) -> dict[str, Any]:
    from piezo_rig.calibrate.checks import Expected, check_interferometer, fitted, words
    from piezo_rig.calibrate.document import interferometer_facts

    known = before.get("interferometer") or _shipped("interferometer")
    line, warnings = fitted(points, args.reference_percent / 100.0)
    expected = Expected(tuple(map(float, known["printed_um_per_v"])), args.sensitivity)
    switch, notes = check_interferometer(points, line, expected)
    lines = [f"switch       {switch}", *words(line, ("sensitivity", ""), ("um/V", "")),
             f"polarity     {1 if line.slope > 0 else -1}"]
    lacks = [key for key in ("noise_nm", "output_noise_v") if key not in known]
    if lacks:
        warnings.append(f"{' and '.join(lacks)} are not in the file, because points do not tell "
                        "them; --update OLD.toml keeps those of an earlier one")
    _print(points, lines, line.residual, notes + warnings)
    return interferometer_facts(
        line, switch, known, {**said, "serial": args.interferometer_serial}
    )


def _print(points: Points, lines: list[str], residual: float, warnings: list[str]) -> None:
    x, y = points.names
    print(f"{points.instrument}: {points.x.size} points of {x}, {y}")
    for line in lines:
        print(f"  {line}")
    print(f"  {'scatter':<12} {residual:.2g} {points.unit} about the line, "
          f"{points.x.size - 2} degrees of freedom")
    for warning in warnings:
        print(f"  note: {warning}")


def _print_rail(gain: float, offset_v: float) -> None:
    """What else a config needs where the generator's usual 0 V no longer reach the upper rail."""
    from piezo_rig.config.rig import COMMAND_MAX_V, DRIVE_MAX_V, SHIFT_V, command_max_for

    short = DRIVE_MAX_V - (gain * COMMAND_MAX_V + offset_v)
    need = command_max_for(DRIVE_MAX_V, gain, offset_v)
    if short > SHIFT_V:
        print(f"  note: {COMMAND_MAX_V:g} V of command are {DRIVE_MAX_V - short:.4g} V on the "
              f"stack; to reach {DRIVE_MAX_V:g} V raise the amplifier's set voltage and calibrate "
              "again")
    elif need > COMMAND_MAX_V:
        print(f"  under [waveform_dac]: command_max_v = {need:g}")
        print(f"    (to reach {DRIVE_MAX_V:g} V on the stack; its limit, drive_max_v, stays)")


def _write(path: Path, text: str) -> None:
    """The file, whole or not at all."""
    import os

    from piezo_rig.errors import BenchError

    draft = path.with_name(path.name + ".tmp")
    try:
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, path)
    except OSError as error:
        raise BenchError("disk", f"cannot write {path}: {error.strerror or error}",
                         "the folder is missing or not yours to write, or the disk is full",
                         "give another --out") from None
