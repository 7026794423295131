"""Converts a run (csv, tdms, mat) or a model (c, csv, mat) for other programs.

A run becomes one .csv or .tdms for every sweep in the folder OUT (for a run of one sweep, OUT
may be the file), or one .mat. Raw volts are written, with the settings that make drive and
displacement of them; import, identify and diagnose read them back as the same sweeps.
A model becomes a step function in C for a controller, or its tables.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

HELP = "convert a run (csv, tdms, mat) or a model (c, csv, mat)"
OF_RUN, OF_MODEL = ("csv", "tdms", "mat"), ("c", "csv", "mat")
RATE = 5000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE",
                        help="a run (.h5), a model file, or the name of a shipped model")
    parser.add_argument("--format", metavar="F", required=True, choices=("csv", "tdms", "mat", "c"),
                        help="of a run: csv, tdms, mat; of a model: c, csv, mat")
    parser.add_argument("--out", metavar="OUT", required=True,
                        help="a file; for the csv or tdms of a run, a folder")
    parser.add_argument("--sample-rate", metavar="HZ", type=float,
                        help=f"with c: calls of the step function a second; {RATE:g}")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.data_options import is_run
    from piezo_rig.errors import InputError

    of_run = is_run(args.file)
    fit = OF_RUN if of_run else OF_MODEL
    if args.format not in fit:
        raise InputError(
            "usage", f"piezo-rig export: a {'run' if of_run else 'model'} is not converted to "
            f"{args.format}", "a run (.h5) was taken for a model, or the other way round",
            f"choose --format from {', '.join(fit)}",
        )
    if args.sample_rate is not None and args.format != "c":
        raise InputError("usage", "piezo-rig export: --sample-rate goes with --format c",
                         "a slip on the command line", "see 'piezo-rig export --help'")
    if of_run:
        return _run(args, Path(args.out))
    return _model(args, Path(args.out))


def _run(args: argparse.Namespace, out: Path) -> int:
    from pathlib import Path

    from piezo_rig.run_file.exporters import export_run
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import require_run

    exported = export_run(Run(require_run(Path(args.file))), args.format, out)
    for line in exported.left_out:
        print(f"left out: {line}")
    for path in exported.files:
        print(f"{args.format}: {path}")
    return 0


def _model(args: argparse.Namespace, out: Path) -> int:
    from piezo_rig.causes.catalogue import load_model
    from piezo_rig.errors import BenchError
    from piezo_rig.model_export import c_source, identifier, write_csv_tables, write_mat_tables
    from piezo_rig.resources import find

    path = find("models", args.file)
    model = load_model(path)
    source = None
    if args.format == "c":
        rate = RATE if args.sample_rate is None else args.sample_rate
        source = c_source(model, identifier(out.stem), rate, path.name)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if source:
            out.write_text(source.text, encoding="ascii")
        elif args.format == "csv":
            write_csv_tables(model, out)
        else:
            write_mat_tables(model, out)
    except OSError as error:
        raise BenchError(
            "disk", f"could not write {out}: {error.strerror or error}",
            "the disk is full, or the folder is not yours to write", "give another --out",
        ) from None
    if source:
        print(f"stages    {', '.join(source.held)}")
        for id, why in source.left_out.items():
            print(f"left out: {id}: {why}")
    print(f"{args.format}: {out}")
    return 0
