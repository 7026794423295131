"""Where everything stands in a run file. NeXus conventions; nothing here touches a disk.

```
/                         NXroot, default = entry
/entry                    NXentry, default = loop; schema_version, origin, complete
/entry/loop               NXdata of one representative sweep (the default plot)
/entry/sweep_0001 ...     NXcollection: command_v, sensor_v, drive_monitor_v and attributes
/entry/instrument/NAME    NXcollection: idn, settings (JSON), serial
/entry/sample             NXsample: the actuator
/entry/recording          per-sweep bookkeeping: n_valid, zero_v, start_time, stored_at
/entry/event_log          bytes: one JSON object a line
/entry/wire_transcript    bytes: records of `wire`
```

While a run is being recorded the same layout stands in ``NAME.part.h5``; what
is only known afterwards (zero, start time) is in ``recording`` and becomes
attributes of the sweeps when the run is closed. A run that is resumed keeps its
file; what is recorded after the seam stands in a part file beside it and is
joined to it when that is closed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

SCHEMA_VERSION = 1
PART_SUFFIX = ".part.h5"
NEW_SUFFIX = PART_SUFFIX + ".new"
GUARD_SUFFIX = ".guard.json"
CHUNK = 65_536
LOG_CHUNK = 16_384
WIRE_CHUNK = 65_536

REQUIRED_ATTRIBUTES = (
    "sample_rate", "gain", "offset_v", "sensitivity_um_per_v", "polarity", "zero_v",
    "condition", "repeat", "history", "start_time", "origin",
)
UNITS = {"command_v": "V", "sensor_v": "V", "drive_monitor_v": "V"}
DETAIL_PREFIX = "condition_"

Scalar = float | str | int | bool


@dataclass(frozen=True)
class SweepHeader:
    """What is known of a sweep before it is played."""

    name: str
    samples: int
    sample_rate: float
    gain: float
    offset_v: float
    sensitivity_um_per_v: float
    polarity: int
    condition: str
    repeat: int
    history: str
    oversampling: int = 1
    supersedes: str = ""
    details: dict[str, Scalar] = field(default_factory=dict)


@dataclass(frozen=True)
class InstrumentRecord:
    """One instrument as found at connection."""

    name: str
    idn: str
    serial: str
    settings: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunHeader:
    """What is known of a run before its first sweep."""

    title: str
    origin: str
    protocol_text: str
    plan_hash: str
    rig_config: str
    operator: str
    actuator: dict[str, Scalar]
    start_time: str
    clock_start: float
    software_version: str
    git_revision: str
    instruments: tuple[InstrumentRecord, ...] = ()
    monitor: bool = True
    calibrations: dict[str, str] = field(default_factory=dict)  # path -> SHA-256
    calibration_texts: dict[str, str] = field(default_factory=dict)  # path -> the file itself
    rig_path: str = ""
    protocol_files: str = ""  # what the protocol plays from files, packed; see protocol.drive_file
    notes: tuple[str, ...] = ()
