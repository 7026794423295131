"""Summarises a run: what was played, on what, and what came of it."""

from __future__ import annotations

import argparse

HELP = "summarise a run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="a run (.h5)")
    parser.add_argument("--log", action="store_true", help="print the event log as well")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    import numpy as np

    from piezo_rig.report.terminal import draw
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import require_run

    run = Run(require_run(Path(args.run)))
    texts = run.texts
    print(f"run       {run.path}")
    print(f"title     {texts.get('title', '')}")
    started = f", started {texts['start_time']}" if "start_time" in texts else ""
    print(f"origin    {run.origin}{started}, {'complete' if run.complete else 'INCOMPLETE'}")
    software = f"{texts.get('software_version', '?')} {texts.get('git_revision', '')}"
    print(f"software  {software.rstrip()}")
    if run.origin == "IMPORTED":
        for note in texts.get("notes", "").splitlines():
            print(f"noted     {note}")
    else:
        print(f"plan      {texts.get('plan_hash', '')[:16]}")
        actuator = run.actuator()
        print("actuator  " + ", ".join(f"{k} {v}" for k, v in actuator.items() if v != ""))
        for name, record in run.instruments().items():
            print(f"{name:<16} {record.get('idn', '')}")
    sweeps = run.sweeps()
    print()
    print("sweep       condition        rep  history   samples     drive V         travel um")
    for s in sweeps:
        drive, travel = s.drive_v, s.displacement_um
        print(f"{s.name}  {s.condition:<16} {s.repeat:>3}  {s.history:<8} {s.samples:>8}  "
              f"{drive.min():6.2f} .. {drive.max():6.2f}  {np.ptp(travel):9.3f}"
              + ("" if s.resumed_after_s is None else f"  resumed after {s.resumed_after_s:.0f} s"))
    for entry in run.entries():
        if entry.superseded_by:
            print(f"{entry.name}  superseded by {entry.superseded_by}")
    if sweeps:
        widest = max(sweeps, key=lambda s: float(np.ptp(s.drive_v)))
        print()
        print(draw(widest.drive_v, widest.displacement_um, width=60, height=14, x_label="V",
                   y_label=f"displacement of {widest.condition}, um"))
    if args.log:
        print()
        for event in run.events():
            extra = ", ".join(f"{k} {v}" for k, v in event.items() if k not in ("time_s", "event"))
            print(f"{event['time_s']:12.3f} s  {event['event']}{': ' + extra if extra else ''}")
    return 0
