"""Plays a protocol on a bench, stores it, identifies a first model and draws it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from piezo_rig.config import Rig
    from piezo_rig.protocol import Plan

HELP = "play a protocol, log it, identify a first model"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("protocol", metavar="PROTOCOL",
                        help="a file, or the name of a shipped one")
    parser.add_argument("--rig", metavar="CONFIG", help="default: the simulated bench")
    parser.add_argument("--out", metavar="DIR", default="runs", help="default: runs")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.first_model import first_model
    from piezo_rig.config import DEFAULT_RIG, load_rig
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.resources import find
    from piezo_rig.run_file.close import recover
    from piezo_rig.run_file.reader import Run
    from piezo_rig.sweep_watch import error_of

    rig = load_rig(args.rig or DEFAULT_RIG)
    plan = build_plan(load_protocol(find("protocols", args.protocol)), rig)
    folder = Path(args.out)
    make_room(folder, plan)
    for path in recover(folder):
        print(f"recovered a run that was left unfinished: {path}")
    path = record(plan, rig, folder)
    model, figure = first_model(path)
    print(f"run: {path}")
    print(f"model: {model}")
    print(f"figure: {figure}")
    run = Run(path)
    if flagged := error_of(run.events(), run.sweep_names):
        flagged.piezo = "at 0 V (the run ended at rest)"
        raise flagged
    return 0


def make_room(folder: Path, plan: Plan) -> None:
    """Refuse to begin what the disk cannot hold.

    Raises
    ------
    BenchError : the folder cannot be made, or the disk is too full (exit 4); nothing was played
    """
    import shutil

    from piezo_rig.commands.console import size
    from piezo_rig.errors import BenchError

    try:
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
        probe = folder / ".piezo-rig-probe"
        probe.write_bytes(b"x")
        probe.unlink()
    except OSError as error:
        raised = BenchError(
            "disk", f"cannot write into {folder}: {error.strerror or error}",
            "the folder is not yours to write, or the disk is full", "give another --out",
        )
        raised.piezo = "not touched"
        raise raised from None
    # Twice: the part file and its copy stand side by side for a moment when the run is closed.
    need = 2 * plan.file_bytes + 10_000_000
    if free < need:
        raised = BenchError(
            "disk-full", f"{folder} has {size(free)} left; this protocol needs up to {size(need)}",
            "the disk is nearly full", "make room, or give another --out",
        )
        raised.piezo = "not touched"
        raise raised


def record(plan: Plan, rig: Rig, folder: Path) -> Path:
    """Play a plan into a new run in ``folder``; returns the run."""
    import time

    from piezo_rig.bench import open_bench
    from piezo_rig.commands.console import Progress, seconds
    from piezo_rig.errors import PiezoRigError
    from piezo_rig.runner import Wire, new_run_path, play

    wire = Wire()
    progress = Progress()
    print(f"{plan.protocol.name}: {len(plan.sweeps)} sweeps, {seconds(plan.play_s)} of drive, "
          f"{seconds(plan.duration_s)} of bench time with rests")
    try:
        with open_bench(rig, confirm, wire) as bench:
            for instrument in bench.instruments:
                print(f"  {instrument.name:<15} {instrument.idn}")
            print(f"  all {bench.origin}; actuator {rig.actuator.model} {rig.actuator.serial}")
            begun = time.monotonic()
            path = play(plan, bench, new_run_path(folder, plan.protocol.name), wire, progress)
            took = time.monotonic() - begun
    except PiezoRigError as error:
        error.piezo = error.piezo or "not touched; nothing was sent that moves it"
        raise
    finally:
        progress.close()
    print(f"played {plan.samples} samples in {took:.1f} s, "
          f"{plan.play_s / took:.0f} times as fast as the drive itself; stack at 0 V")
    return path


def confirm(question: str) -> bool:
    """Ask the operator at the terminal; without one the answer is no."""
    import sys

    if not sys.stdin.isatty():
        print(f"{question} (nobody at the terminal to say so)")
        return False
    return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
