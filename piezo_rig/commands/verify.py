"""Checks runs: whole, undamaged, consistent; says for each sweep whether it may be used."""

from __future__ import annotations

import argparse

HELP = "check runs for damage and inconsistency"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", metavar="RUN", nargs="+")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.run_file.verify import require_run, verify

    status = 0
    for name in args.runs:
        path = require_run(Path(name))
        sweeps, found = verify(path)
        faulty = {v.sweep for v in found if v.fault}
        for verdict in found:
            word = "FAULT" if verdict.fault else "note "
            print(f"{word} {verdict.sweep or 'run'}: {verdict.text}")
        good = len(sweeps) - len(faulty - {""})
        print(f"{path}: {good} of {len(sweeps)} sweeps may be used"
              + ("" if faulty else "; no faults"))
        status = max(status, int(bool(faulty)))
    return status
