"""Finds the drive that makes an actuator follow a target: a model, inverted sample by sample.

The actuator begins virgin, at rest and at 0 um. The drive stays within the rig's limits; a target
out of reach ends with exit status 3 and names the sample. A protocol plays the result:
waveform = "file", path = "OUT.csv".
"""

from __future__ import annotations

import argparse

HELP = "find the drive that makes an actuator follow a target"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL.json",
                        help="a model file, or the name of a shipped one (thesis_range)")
    parser.add_argument("target", metavar="TARGET.csv",
                        help="a CSV with time_s,displacement_um; it begins at 0 um")
    parser.add_argument("--out", metavar="OUT.csv", required=True,
                        help="gets time_s,drive_v, one row for every row of TARGET")
    parser.add_argument("--rig", metavar="CONFIG", help="whose limits; simulated bench")
    parser.add_argument("--free-end", action="store_true",
                        help="the actuator itself is in time, not its record: do not lead by the "
                        "record's delay")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    import numpy as np

    from piezo_rig.causes.catalogue import load_model
    from piezo_rig.commands.simulate import beyond, beyond_curves, write_table
    from piezo_rig.compensation import Target, compensate
    from piezo_rig.compensation.compensate import bounds_of
    from piezo_rig.config import DEFAULT_RIG, load_rig
    from piezo_rig.csv_table import parse_table, read_table_text
    from piezo_rig.resources import find

    model = load_model(find("models", args.model))
    model.check()
    rig = load_rig(args.rig or DEFAULT_RIG)
    text = read_table_text(Path(args.target), "a CSV with time_s,displacement_um")
    time, um = parse_table(text, ("time_s", "displacement_um"), args.target)
    target = Target(time, um, args.target)
    done = compensate(model, target, bounds_of(rig), args.free_end)
    write_table(Path(args.out), "time_s,drive_v", np.column_stack([target.time_s, done.drive_v]))
    drive = done.drive_v
    print(f"model     {model.name or args.model}")
    for t in done.treatments:
        print(f"{t.how:<9} {t.id} ({t.place}){': ' + t.why if t.why else ''}")
    print(f"rig       {rig.name} ({rig.path})")
    slew = float(np.abs(np.diff(drive) / np.diff(target.time_s)).max())
    print(f"drive     {drive.size} samples, {drive.min():.4g} .. {drive.max():.4g} V, "
          f"up to {slew:.4g} V/s, from a virgin start at {drive[0]:g} V")
    error = 1e3 * (done.predicted_um - target.displacement_um)
    what = "the free end" if args.free_end else "the record"
    print(f"predicted {what} follows the target within {np.abs(error).max():.3g} nm, "
          f"rms {np.sqrt(np.mean(error**2)):.3g} nm, if the model is right")
    for line in done.warnings:
        print(f"warning: {line}")
    for line in beyond(model.provenance.get("drive_v"), drive):
        print(line)
    for line in beyond_curves(model.provenance.get("known_v"), [drive], "virgin"):
        print(line)
    print(f"compensation: {args.out}")
    return 0
