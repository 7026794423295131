"""Plays a protocol on a bench, stores it, identifies a first model and draws it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from drivers.clock import Clock
    from piezo_rig.bench import Bench
    from piezo_rig.config import Rig
    from piezo_rig.protocol import Plan
    from piezo_rig.run_file.reader import Run
    from piezo_rig.runner.resume import Seam

HELP = "play a protocol, log it, identify a first model"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("protocol", metavar="PROTOCOL", nargs="?",
                        help="a file, or the name of a shipped one; with --resume the run's own")
    parser.add_argument("--rig", metavar="CONFIG",
                        help="default: the simulated bench; with --resume the run's own")
    parser.add_argument("--out", metavar="DIR", help="default: runs; with --resume the run's own")
    parser.add_argument("--resume", metavar="RUN", help="play what this run still lacks")
    parser.add_argument("--only", metavar="CONDITION",
                        help="with --resume: play this condition again; the old sweeps are kept, "
                        "marked as superseded")


def execute(args: argparse.Namespace) -> int:
    from piezo_rig.commands.first_model import first_model
    from piezo_rig.errors import Aborted
    from piezo_rig.run_file.reader import Run
    from piezo_rig.sweep_watch import error_of

    path = resume(args) if args.resume else begin(args)
    try:
        model, figure = first_model(path)
    except KeyboardInterrupt:
        aborted = Aborted("aborted", "stopped while the first model was identified",
                          "the operator or the system",
                          f"the run is whole: {path}; identify it with 'piezo-rig identify'")
        aborted.piezo = "at 0 V (the bench was left at rest before)"
        raise aborted from None
    print(f"run: {path}")
    print(f"model: {model}")
    print(f"figure: {figure}")
    run = Run(path)
    if flagged := error_of(run.events(), run.active_names):
        flagged.piezo = "at 0 V (the run ended at rest)"
        raise flagged
    return 0


def begin(args: argparse.Namespace) -> Path:
    """Play a protocol from its beginning."""
    from pathlib import Path

    from piezo_rig.config import DEFAULT_RIG, load_rig
    from piezo_rig.errors import InputError
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.resources import find
    from piezo_rig.runner import new_run_path

    if args.only or not args.protocol:
        raise InputError("usage", "piezo-rig run: " + (
            "--only goes with --resume" if args.only else "a PROTOCOL is needed, or --resume RUN"
        ), "a slip on the command line", "see 'piezo-rig run --help'")
    rig = load_rig(args.rig or DEFAULT_RIG)
    plan = build_plan(load_protocol(find("protocols", args.protocol)), rig)
    folder = Path(args.out or "runs")
    make_room(folder, plan)
    recover_runs(folder)
    return record(plan, rig, new_run_path(folder, plan.protocol.name))


def resume(args: argparse.Namespace) -> Path:
    """Play what a run lacks, or one of its conditions again."""
    from pathlib import Path

    from piezo_rig.config import load_rig
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.protocol.drive_file import unpack
    from piezo_rig.protocol.protocol_file import recorded_protocol
    from piezo_rig.resources import find
    from piezo_rig.run_file.close import find_run
    from piezo_rig.run_file.reader import Run
    from piezo_rig.runner.resume import (
        check_plan,
        check_recorded,
        check_rig,
        config_path,
        seam_of,
    )

    given = Path(args.resume)
    recover_runs(given.parent)
    run = Run(find_run(given))
    check_recorded(run)
    rig = load_rig(args.rig or str(config_path(run)))
    check_rig(run, rig)
    protocol = (
        load_protocol(find("protocols", args.protocol)) if args.protocol
        else recorded_protocol(
            run.texts["protocol_text"], str(run.path),
            unpack(run.texts.get("protocol_files", ""), str(run.path)),
        )
    )
    plan = build_plan(protocol, rig)
    check_plan(run, plan)
    if args.out and Path(args.out).resolve() != run.path.parent.resolve():
        make_room(Path(args.out), plan)
        recover_runs(Path(args.out))
        run = copied(run, Path(args.out))
    seam = seam_of(run, plan, args.only or "")
    if not seam.sweeps:
        print(f"{run.path} lacks nothing")
        return run.path
    make_room(run.path.parent, plan)
    return record(plan, rig, run.path, seam, run)


def recover_runs(folder: Path) -> None:
    """Close what a killed program left in a folder, and say so."""
    from piezo_rig.run_file.close import recover

    for path in recover(folder):
        print(f"recovered a run that was left unfinished: {path}")


def copied(run: Run, folder: Path) -> Run:
    """The run, copied into another folder, where it is gone on with.

    Raises
    ------
    InputError : there is one of that name already
    BenchError : the disk refuses
    """
    import os
    import shutil

    from piezo_rig.errors import BenchError, InputError
    from piezo_rig.run_file.reader import Run

    path = folder / run.path.name
    if path.exists():
        raise InputError("run-exists", f"{path} is there already",
                         "the run was copied there before", f"resume {path}")
    draft = path.with_name(path.name + ".tmp")
    try:
        shutil.copyfile(run.path, draft)
        os.replace(draft, path)
    except OSError as error:
        raise BenchError("disk", f"cannot copy {run.path} to {folder}: {error.strerror or error}",
                         "the disk is full, or the folder not yours", "leave out --out") from None
    return Run(path)


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


def record(
    plan: Plan, rig: Rig, path: Path, seam: Seam | None = None, run: Run | None = None,
    check: Callable[[Bench], None] | None = None, clock: Clock | None = None,
) -> Path:
    """Play a plan into a new run, or what ``run`` lacks into it; returns the run.

    ``check`` refuses a bench before anything moves; ``clock`` replaces the rig's.
    """
    import time

    from piezo_rig.bench import open_bench
    from piezo_rig.commands.console import Progress, seconds
    from piezo_rig.errors import PiezoRigError
    from piezo_rig.run_file.layout import GUARD_SUFFIX
    from piezo_rig.runner import Wire, play
    from piezo_rig.runner.resume import check_bench

    wire = Wire()
    progress = Progress()
    samples = sum(s.samples for s in (seam.sweeps if seam else plan.sweeps))
    play_s = samples / plan.sample_rate
    if seam:
        print(f"{path}: {len(seam.sweeps)} of {len(plan.sweeps)} sweeps to be played, "
              f"{seconds(play_s)} of drive")
    else:
        print(f"{plan.protocol.name}: {len(plan.sweeps)} sweeps, {seconds(play_s)} of drive, "
              f"{seconds(plan.duration_s)} of bench time with rests")
    print(f"to follow it from another terminal: piezo-rig watch {path}")
    try:
        report = path.with_name(path.name.removesuffix(".h5") + GUARD_SUFFIX)
        with open_bench(rig, confirm, wire, clock, report=report, tell=print) as bench:
            for instrument in bench.instruments:
                print(f"  {instrument.name:<15} {instrument.idn}")
            print(f"  all {bench.origin}; actuator {rig.actuator.model} {rig.actuator.serial}")
            if run:
                check_bench(run, bench)
            if check:
                check(bench)
            begun = time.monotonic()
            play(plan, bench, path, wire, progress, seam)
            took = time.monotonic() - begun
    except PiezoRigError as error:
        error.piezo = error.piezo or "not touched; nothing was sent that moves it"
        raise
    finally:
        progress.close()
    print(f"played {samples} samples, {seconds(play_s)} of drive, in {seconds(took)}; stack at 0 V")
    return path


def confirm(question: str) -> bool:
    """Ask the operator at the terminal; without one the answer is no."""
    import sys

    if not sys.stdin.isatty():
        print(f"{question} (nobody at the terminal to say so)")
        return False
    return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
