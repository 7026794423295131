"""The bench's clock on a port of its own, for clients in another process.

``CLOCK:TIME?`` answers bench seconds; ``CLOCK:SLEEP <s>`` lets that much bench
time pass: at once on a virtual clock, for real on a real one.
"""

from __future__ import annotations

from typing import Any

from drivers.clock import Clock
from drivers.scpi import Unit
from drivers.scpi_values import parse_number
from drivers.simulated.scpi_device import ScpiDevice, ScpiError, pass_until

LONGEST_SLEEP_S = 86400.0


class ClockServer(ScpiDevice):
    """A tiny SCPI instrument whose only reading is the time."""

    def __init__(self, clock: Clock, serial: str = "SIM00000") -> None:
        super().__init__(clock, f"piezo-rig,bench clock,{serial},1")
        self.on("CLOCk:TIME", get=lambda unit: repr(self.clock.now()))
        self.on("CLOCk:SLEEP", set=self._sleep)

    def _sleep(self, unit: Unit) -> Any:
        seconds = parse_number(unit.text(0))
        if not 0 <= seconds <= LONGEST_SLEEP_S:
            raise ScpiError(-222, "Data out of range")
        return pass_until(self.clock, self.clock.now() + seconds)
