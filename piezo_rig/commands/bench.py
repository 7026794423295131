"""Serves the simulated instruments and prints their addresses; any SCPI client may talk to them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

HELP = "serve the simulated instruments"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rig", metavar="CONFIG", default=None,
                        help="the config whose [plant] is simulated; default: the simulated bench")
    parser.add_argument("--clock", choices=("real", "virtual"), default="real",
                        help="virtual: waiting for a burst takes no time")
    parser.add_argument("--record", metavar="FILE.csv",
                        help="the plant's own record of the stack: time_s,stack_v")
    parser.add_argument("--config-out", metavar="RIG.toml",
                        help="write a rig config that points to these instruments")


def execute(args: argparse.Namespace) -> int:
    import signal
    import threading
    from contextlib import ExitStack

    from drivers.clock import RealClock, VirtualClock
    from drivers.simulated.bench import SimulatedBench
    from piezo_rig.bench import simulated_faults, simulated_plant
    from piezo_rig.commands.rig_text import served_rig
    from piezo_rig.config import DEFAULT_RIG, load_rig

    rig = load_rig(args.rig or DEFAULT_RIG)
    clock = VirtualClock(follow_wall=True) if args.clock == "virtual" else RealClock()
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    with ExitStack() as stack:
        plant = simulated_plant(rig)
        if args.record:
            stack.enter_context(_recording(plant, Path(args.record), clock))
        bench = stack.enter_context(SimulatedBench(
            plant, clock, faults=simulated_faults(rig), card=rig.is_card,
            amplifier=rig.amplifier.driver,
        ))
        for name, address in bench.addresses.items():
            print(f"{name}: {address}", flush=True)
        if args.config_out:
            path = Path(args.config_out)
            path.write_text(served_rig(rig.text, bench.addresses, args.clock), encoding="utf-8")
            print(f"config: {path}", flush=True)
        print(f"serving on a {args.clock} clock; Ctrl-C ends it", flush=True)
        while not stop.wait(0.25):
            if args.record:
                # A little behind the present: an instrument may be about to add an event to it.
                plant.flush_history(max(0.0, clock.now() - 0.2))
    return 0


@contextmanager
def _recording(plant: Any, path: Path, clock: Any) -> Iterator[None]:
    """Write the plant's own record of the stack into ``path`` while the bench serves."""
    import numpy as np

    from drivers.simulated.plant.history import csv_sink
    from piezo_rig.errors import BenchError

    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise BenchError("disk", f"could not write {path}: {error.strerror or error}",
                         "the folder is missing or not yours to write",
                         "give another --record") from None
    with file:
        write = csv_sink(file)
        # What the plant knows of the time before the clock started is its own affair.
        plant.keep_history(lambda time_s, stack_v: write(np.maximum(time_s, 0.0), stack_v))
        try:
            yield
        finally:
            plant.flush_history(clock.now())
