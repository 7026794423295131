"""The names of channels that a recording may carry, in whatever spelling.

``time_s`` is also ``Time (s)`` or ``time [s]``: letters and digits count, not what
stands between them.
"""

from __future__ import annotations

import re

TIME = ("time_s", "t_s")
BARE_TIME = ("time", "t", "x_value")
COMMAND_V, DRIVE_V = "command_v", "drive_v"
SENSOR_V, DISPLACEMENT_UM = "sensor_v", "displacement_um"
MONITOR_V = "drive_monitor_v"
KNOWN = frozenset((*TIME, COMMAND_V, DRIVE_V, SENSOR_V, DISPLACEMENT_UM, MONITOR_V))


def plain(name: str) -> str:
    """A name without case, brackets and spaces: ``Displacement [µm]`` is ``displacement_um``."""
    lowered = name.strip()[:200].lower().replace("µ", "u").replace("μ", "u")
    return re.sub(r"[^a-z0-9]+", "_", lowered).strip("_")


def is_known(name: str) -> bool:
    """Whether a name is one of the contract's."""
    return plain(name) in KNOWN


def is_time(name: str) -> bool:
    """Whether a name is that of a time axis in seconds."""
    return plain(name) in (*TIME, *BARE_TIME)
