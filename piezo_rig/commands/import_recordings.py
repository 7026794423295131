"""Puts recordings (.lvm, .tdms, .csv) into a run; every assumption is printed and stored."""

from __future__ import annotations

import argparse

HELP = "put recordings into a run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_reading_arguments

    parser.add_argument("files", metavar="FILE", nargs="+")
    parser.add_argument("--out", metavar="RUN.h5", required=True)
    add_reading_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.data_options import read_recordings_as_said
    from piezo_rig.run_file.imported import write_imported

    imported = read_recordings_as_said(args.files, args)
    path = write_imported(
        imported.sweeps, Path(args.out), [*imported.assumptions, *imported.warnings]
    )
    for sweep in imported.sweeps:
        print(f"{sweep.name}: {sweep.condition}, repeat {sweep.repeat}, {sweep.samples} samples "
              f"at {sweep.sample_rate:g} Sa/s, from {sweep.source}")
    print(f"run: {path}")
    return 0
