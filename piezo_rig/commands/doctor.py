"""Checks a rig before the day begins: every instrument, the drive, the sensor; ends at rest."""

from __future__ import annotations

import argparse

HELP = "check a rig before the day begins"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rig", metavar="CONFIG", help="default: the simulated bench")


def execute(args: argparse.Namespace) -> int:
    from contextlib import closing

    from piezo_rig.commands.run import confirm
    from piezo_rig.config import DEFAULT_RIG, load_rig
    from piezo_rig.doctor import examine

    rig = load_rig(args.rig or DEFAULT_RIG)
    print(f"{rig.name} ({rig.path})")
    faults = 0
    with closing(examine(rig, confirm)) as checks:  # type: ignore[type-var]
        for check in checks:
            print(f"  {check.status:<5}  {check.subject:<15} {check.text}", flush=True)
            for label, text in (("cause", check.cause), ("do", check.remedy)):
                if text:
                    print(f"         {'':<15} {label + ':':<7}{text}", flush=True)
            faults += check.status == "FAULT"
    print(f"{faults} fault{'s' * (faults != 1)}" if faults else "no faults; the rig is ready")
    return int(faults > 0)
