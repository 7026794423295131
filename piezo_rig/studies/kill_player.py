"""``run`` as it is, but it says on a pipe what it does, and hesitates once where it is told to.

    python -m piezo_rig.studies.kill_player PIPE STEP NTH SECONDS SILENCE -- run ...

Steps that take a millisecond can be hit that way, and a burst on a virtual clock lasts as long as
nobody asks whether it is complete. SILENCE is what the guard takes for a runner that hangs, s.
"""

from __future__ import annotations

import os
import runpy
import sys
from collections.abc import Callable
from dataclasses import replace

from drivers.clock import RealClock
from piezo_rig.guard import Keeper, Orders


def main() -> None:
    pipe, aimed_at, nth, seconds, silence = sys.argv[1:6]
    plain, start, seen = Keeper.step, Keeper.__init__, 0

    def begin(self: Keeper, orders: Orders, tell: Callable[[str], None]) -> None:
        start(self, replace(orders, silence_s=float(silence)), tell)

    def step(self: Keeper, name: str, expected_s: float = 0.0) -> None:
        nonlocal seen
        plain(self, name, expected_s)
        os.write(int(pipe), f"{name}\n".encode())
        if name.startswith(aimed_at):
            seen += 1
            if seen == int(nth):
                RealClock().sleep(float(seconds))

    Keeper.step = step  # type: ignore[method-assign]
    Keeper.__init__ = begin  # type: ignore[method-assign, assignment]
    sys.argv[1:] = sys.argv[7:]
    runpy.run_module("piezo_rig", run_name="__main__")


if __name__ == "__main__":
    main()
