"""What spoils the noise and everything after it: found first, in single recordings.

`clean_up` runs the detectors in order. ``spikes`` finds outliers; ``breaks`` jumps of the
interferometer and lost samples, with ``traces`` (what a recording has of its own), ``place`` (at
which sample), ``running_off`` (or a clock) and ``mended`` (the repair); ``hum`` the mains;
``lines`` any other line in clock time, for the verdict on the rest. ``seen_by_monitor`` finds
what the drive monitor shows to be lost, and ``monitor`` reads the rest of it, with ``corners``
(where in it, and its noise) and ``behind_a_lag`` (a drive at any instant).
"""

from piezo_rig.diagnosis.early.clean_up import (
    HUM,
    TRIED,
    Early,
    clean_up,
    credited,
    hum_again,
    hum_behind,
    never_outliers,
)
from piezo_rig.diagnosis.early.lines import find_line
from piezo_rig.diagnosis.early.mended import Break
from piezo_rig.diagnosis.early.monitor import Reading, read_monitor
from piezo_rig.diagnosis.early.seen_by_monitor import losses_of_monitors, with_monitors_mended
from piezo_rig.diagnosis.early.spikes import noise_floor_nm

__all__ = [
    "HUM", "TRIED", "Break", "Early", "Reading", "clean_up", "credited", "find_line", "hum_again",
    "hum_behind", "losses_of_monitors", "never_outliers", "noise_floor_nm", "read_monitor",
    "with_monitors_mended",
]  # fmt: skip
