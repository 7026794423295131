"""What a user may say about recordings, and what reading them gives back."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import HISTORIES, Sweep

SWITCH_UM_PER_V = (0.24, 0.97, 3.87, 15.48, 61.9, 247.61, 990.44)
"""The printed table of the interferometer's sensitivity switch, positions 0 to 6."""

DRIVE, DISPLACEMENT = "drive", "displacement"

_PER_VOLT = re.compile(
    r"\s*(\d+(?:\.\d*)?(?:[eE][+-]?\d{1,3})?|\.\d+(?:[eE][+-]?\d{1,3})?)\s*([uµμnm])m\s*/\s*V\s*"
)
_TO_UM = {"u": 1.0, "µ": 1.0, "μ": 1.0, "n": 1e-3, "m": 1e3}


@dataclass(frozen=True)
class ImportOptions:
    """How recordings are to be read.

    Attributes
    ----------
    gain, offset_v : drive = gain * command + offset_v, for channels that hold a command
    polarity : +1 or -1; None takes the default of the thesis's recordings, -1
    sensitivity : ``"3"`` (the switch, 0 to 6) or ``"3.87um/V"``; None asks the file's name
    command, sensor, monitor, time : a channel's name or its 1-based number, None for the default
    history : ``virgin``, ``carried`` or ``unknown``
    explicit : names of the attributes above that the user gave; a channel, a polarity or a
        sensitivity that is not None counts as given in any case
    """

    gain: float = 7.5
    offset_v: float = 75.0
    polarity: int | None = None
    sensitivity: str | None = None
    command: str | int | None = None
    sensor: str | int | None = None
    monitor: str | int | None = None
    time: str | int | None = None
    history: str = "unknown"
    explicit: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not math.isfinite(self.gain) or self.gain == 0:
            raise InputError(
                "import-option",
                f"a gain of {self.gain} cannot be used",
                remedy="give the drive in volts per volt of command, as in --gain 7.5",
            )
        if not math.isfinite(self.offset_v):
            raise InputError(
                "import-option",
                f"an offset of {self.offset_v} cannot be used",
                remedy="give the drive at 0 V of command, as in --offset 75",
            )
        if self.polarity not in (None, 1, -1):
            raise InputError(
                "import-option",
                f"a polarity of {self.polarity} cannot be used",
                remedy="give --polarity +1 or --polarity -1",
            )
        if self.history not in HISTORIES:
            raise InputError(
                "import-option",
                f"history {self.history!r} is not known",
                remedy="give --history virgin, carried or unknown",
            )
        if self.sensitivity is not None:
            parse_sensitivity(self.sensitivity)

    def given(self, name: str) -> bool:
        """Whether the user said this, rather than the default."""
        if name in self.explicit:
            return True
        return name not in ("gain", "offset_v", "history") and getattr(self, name) is not None


@dataclass(frozen=True)
class Imported:
    """Recordings as sweeps, with everything that was assumed on the way.

    Attributes
    ----------
    sweeps : in the order in which the files were given, origin IMPORTED
    assumptions : one printed sentence each
    warnings : one printed sentence each: what looks damaged, was left out, or contradicts
    offsets_s : start of each sweep on the shared clock, seconds after the earliest of them
    """

    sweeps: list[Sweep]
    assumptions: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    offsets_s: list[float] = field(default_factory=list)


def parse_sensitivity(text: str) -> tuple[float, int | None]:
    """Micrometres per volt of ``"3"`` or ``"3.87um/V"``, and the switch's position if it was one.

    Raises
    ------
    InputError : neither a position of the switch nor a positive figure with its unit
    """
    stripped = text.strip()
    if re.fullmatch("[0-6]", stripped):
        return SWITCH_UM_PER_V[int(stripped)], int(stripped)
    match = _PER_VOLT.fullmatch(text) if len(text) < 64 else None
    value = float(match[1]) * _TO_UM[match[2]] if match else 0.0
    if match is None or not 0 < value < math.inf:
        raise InputError(
            "import-sensitivity",
            f"sensitivity {text[:60]!r} cannot be read",
            cause="it is neither a position of the switch, 0 to 6, nor a positive figure with unit",
            remedy="give --sensitivity 3 or --sensitivity 3.87um/V",
        )
    return value, None
