"""Runs the drivers against a run's wire transcript, without any instrument."""

from __future__ import annotations

import argparse

HELP = "run the drivers against a run's wire transcript"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="a run from the bench (.h5)")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.replay import replay
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import require_run

    run = Run(require_run(Path(args.run)))
    found = replay(run)
    for difference in found.differences:
        print(f"DIFFERS {difference}")
    for note in found.notes:
        print(f"note    {note}")
    if found.differences:
        print(f"{run.path}: {found.exchanges} exchanges are the same; the drivers now differ")
        return 1
    print(f"{run.path}: all {found.exchanges} exchanges are the same")
    return 0
