"""Summarises a run: what was played, on what, and what came of it.

`watch` follows one that is still being recorded; `export` converts one for other programs.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezo_rig.run_file.budget import DisplacementBudget
    from piezo_rig.run_file.reader import Run

HELP = "summarise a run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="a run (.h5)")
    parser.add_argument("--log", action="store_true", help="print the event log as well")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.errors import InputError
    from piezo_rig.run_file.layout import PART_SUFFIX
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import require_run

    run = Run(require_run(Path(args.run)))
    if run.path.name.endswith(PART_SUFFIX):
        print(f"not closed yet; to follow it: piezo-rig watch {run.path}")
    _show_head(run)
    read, wrong = _show_sweeps(run)
    if args.log:
        print()
        try:
            for event in run.events():
                extra = ", ".join(
                    f"{k} {v}" for k, v in event.items() if k not in ("time_s", "event")
                )
                print(f"{event['time_s']:12.3f} s  {event['event']}{': ' + extra if extra else ''}")
        except InputError as error:
            print(f"event log: {error.what}")
    if wrong and not read:
        raise InputError(
            "run-file", f"{run.path}: none of its {wrong} sweeps can be read",
            "the file is damaged", "see 'piezo-rig verify'; take the file from the backup",
        )
    return 0


def _show_head(run: Run) -> None:
    """What the run says of itself; what cannot be read is said and passed over."""
    from piezo_rig.errors import InputError

    texts = run.texts
    print(f"run       {run.path}")
    print(f"title     {_line(texts.get('title', ''))}")
    started = f", started {_line(texts['start_time'])}" if "start_time" in texts else ""
    print(f"origin    {_line(run.origin)}{started}, {'complete' if run.complete else 'INCOMPLETE'}")
    software = f"{texts.get('software_version', '?')} {texts.get('git_revision', '')}"
    print(f"software  {_line(software).rstrip()}")
    if run.origin == "IMPORTED":
        for note in texts.get("notes", "").splitlines():
            print(f"noted     {_line(note)}")
        return
    print(f"plan      {_line(texts.get('plan_hash', ''))[:16]}")
    try:
        actuator = run.actuator()
        print("actuator  " + ", ".join(f"{k} {_line(v)}" for k, v in actuator.items() if v != ""))
        for name, record in run.instruments().items():
            print(f"{name:<16} {_line(record.get('idn', ''))}")
    except InputError as error:
        print(f"instruments: {error.what}")
    for path, digest in _calibrations(run).items():
        print(f"calibrated by    {_line(path)}, sha256 {_line(digest)[:16]}")
    for name, why in run.unreadable.items():
        print(f"{_line(name)}: {why}")


def _calibrations(run: Run) -> dict[str, str]:
    """Path and hash of the calibration files; what is damaged is `verify`'s to say."""
    import json

    try:
        found = json.loads(run.texts.get("calibrations", "{}"))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _show_sweeps(run: Run) -> tuple[int, int]:
    """A line for every sweep, and the widest loop of those that count.

    Returns how many of these could be read, and how many not.
    """
    import numpy as np

    from piezo_rig.errors import InputError
    from piezo_rig.report.terminal import draw

    print()
    print("sweep       condition        rep  history   samples     drive V         travel um")
    widest, wrong = None, 0
    largest: dict[float, tuple[float, DisplacementBudget]] = {}  # by sensitivity, um
    for name, s in run.each():
        if isinstance(s, InputError):
            why = s.what.removeprefix(f"{run.path}: {name}: ")
            print(f"{_line(name)}  cannot be read: {why}")
            wrong += 1
            continue
        drive, travel = s.drive_v, s.displacement_um
        finite = np.isfinite(drive) & np.isfinite(travel)
        span = float(np.ptp(drive[finite])) if finite.any() else 0.0
        reach = (
            f"{drive[finite].min():6.2f} .. {drive[finite].max():6.2f}  "
            f"{np.ptp(travel[finite]):9.3f}" if finite.any() else "  no numbers"
        )
        missing = s.samples - int(finite.sum())
        print(f"{s.name}  {s.condition:<16} {s.repeat:>3}  {s.history:<8} {s.samples:>8}  {reach}"
              + ("" if s.resumed_after_s is None else f"  resumed after {s.resumed_after_s:.0f} s")
              + (f"  ({missing} samples missing)" if missing else ""))
        if finite.any() and abs(travel[finite]).max() >= largest.get(
            s.sensitivity_um_per_v, (0.0,)
        )[0]:
            largest[s.sensitivity_um_per_v] = (
                float(abs(travel[finite]).max()), run.displacement_budget(s)
            )
        if finite.sum() > 1 and (widest is None or span > widest[0]):
            widest = (span, s.condition, drive[finite], travel[finite])
    for name, by in run.superseded.items():
        print(f"{_line(name)}  superseded by {_line(by)}")
    if widest is not None:
        print()
        print(draw(widest[2], widest[3], width=60, height=14, x_label="V",
                   y_label=f"displacement of {widest[1]}, um"))
    for sensitivity, (um, budget) in sorted(largest.items()):
        _show_budget(sensitivity, um, budget)
    return len(run.active_names) - wrong, wrong


def _show_budget(sensitivity: float, um: float, budget: DisplacementBudget) -> None:
    """What displacement is uncertain by at one sensitivity, and at its largest displacement."""
    print()
    print(f"standard uncertainty of displacement at {sensitivity:g} um/V")
    for part in budget.parts:
        value = f"{100 * part.value:.3g} %" if part.kind == "scale" else f"{part.value:.3g} nm"
        print(f"  {part.name:<24} {value:>9}  {part.kind:<7} {part.source}")
    systematic, u = (1e3 * float(f(um)) for f in (budget.systematic_um, budget.u_um))
    print(f"  {f'together, at {um:.3g} um':<24} {u:>6.3g} nm  systematic {systematic:.3g} nm, "
          f"random {budget.random_nm:.3g} nm; 95 %: about +-{2 * u:.3g} nm")
    for text in budget.left_out:
        print(f"  not in it: {text}")


def _line(value: object) -> str:
    """A text of the file as one line that does nothing to a terminal."""
    return "".join(c if c.isprintable() else "?" for c in str(value)[:500])
