"""Checks runs: whole, undamaged, consistent; says for each sweep whether it may be used."""

from __future__ import annotations

import argparse

HELP = "check runs for damage and inconsistency"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", metavar="RUN", nargs="+", help="runs (.h5)")


def execute(args: argparse.Namespace) -> int:
    import sys
    from pathlib import Path

    from piezo_rig.errors import BAD_INPUT, InputError
    from piezo_rig.run_file.verify import require_run

    if len(args.runs) == 1:
        return _one(require_run(Path(args.runs[0])))
    status = 0
    for name in args.runs:  # one file that is no run does not hide what the others are
        try:
            status = max(status, _one(require_run(Path(name))))
        except InputError as error:
            print(error.block(), file=sys.stderr)
            status = BAD_INPUT
    return status


def _one(path: object) -> int:
    """Print what is found in one run; 1 where there are faults."""
    from pathlib import Path

    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import verify

    assert isinstance(path, Path)
    sweeps, found = verify(path)
    faults = [v for v in found if v.fault]
    for verdict in found:
        print(verdict.line())
    bad = {v.sweep for v in faults if v.sweep}
    damaged = {v.sweep for v in faults if v.sweep and not v.cause}
    superseded = {n: by for n, by in Run(path).superseded.items() if n in sweeps}
    for name in sweeps:
        if name in superseded:
            word = f"superseded by {superseded[name]}, not counted"
        elif name not in bad:
            word = "may be used"
        elif name not in damaged:
            word = "may NOT be used, but by diagnose"
        else:
            word = "may NOT be used"
        print(f"      {name}: {word}")
    count = len(sweeps) - len(superseded)
    good = f"{count - len(bad)} of {count} sweeps may be used"
    print(f"{path}: {good}{'' if faults else '; no faults'}")
    return int(bool(faults))
