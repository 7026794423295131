"""The interferometer: a SIOS SP-S 120, read through its analog output.

Never tried on hardware. There is no public wire protocol: the sensitivity is a
switch on the instrument, and a person confirms where it stands.

The printed sensitivities are 990.44 um/V divided by powers of four and rounded;
the two smallest are off by 0.75 % and 0.29 %. The printed table is the default,
a calibration file decides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.errors import InstrumentError
from drivers.identity import Identity

PRINTED_UM_PER_V = (0.24, 0.97, 3.87, 15.48, 61.9, 247.61, 990.44)
"""Sensitivity at the switch positions 0..6, as printed on the instrument."""

EXACT_UM_PER_V = tuple(990.44 / 4.0 ** (6 - position) for position in range(7))
"""The same as powers of four."""

Confirm = Callable[[str], bool]
"""Puts a yes-or-no question to the operator."""


class Interferometer(Protocol):
    """What measures the displacement, as volts at the digitizer."""

    identity: Identity | None

    def connect(self) -> Identity: ...

    def set_switch(self, position: int) -> float: ...

    def settings(self) -> dict[str, str]: ...

    def close(self) -> None: ...


class SiosSPS120:
    """A SP-S 120 with its sensitivity switch.

    Parameters
    ----------
    confirm : asks the operator; True when the switch stands as asked
    table_um_per_v : sensitivity at positions 0..6, um/V
    serial : serial number, as the rig's config gives it
    """

    def __init__(
        self,
        confirm: Confirm,
        table_um_per_v: tuple[float, ...] = PRINTED_UM_PER_V,
        serial: str = "",
    ) -> None:
        self._confirm = confirm
        self._table = tuple(table_um_per_v)
        self._serial = serial
        self._position: int | None = None
        self.identity: Identity | None = None

    def connect(self) -> Identity:
        self.identity = Identity.manual("SIOS SP-S 120, analog output", self._serial)
        return self.identity

    def set_switch(self, position: int) -> float:
        """Have the switch put to ``position``; the sensitivity there, um/V.

        The operator is asked once per position. InstrumentError instrument-setting
        when the answer is no; ValueError for a position that does not exist.
        """
        if not 0 <= position < len(self._table):
            raise ValueError(f"sensitivity switch {position}: 0 to {len(self._table) - 1}")
        if position != self._position:
            question = (
                f"Is the interferometer's sensitivity switch at {position} "
                f"({self._table[position]:g} um/V)?"
            )
            if not self._confirm(question):
                raise InstrumentError(
                    "instrument-setting",
                    "interferometer",
                    f"the sensitivity switch is not at {position}",
                    remedy="set the switch, check the beam, and run again",
                )
            self._position = position
        return self._table[position]

    def settings(self) -> dict[str, str]:
        if self._position is None:
            return {}
        return {
            "switch": str(self._position),
            "sensitivity_um_per_v": f"{self._table[self._position]:g}",
        }

    def close(self) -> None:
        """Nothing to close."""
