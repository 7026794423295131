"""Dropped samples: some are missing from the record, and what follows is shifted.

Physics: a buffer that overflows, a block that the bus lost, a writer that was too slow. The record
goes on without a gap, so that everything after it stands at too early a time: against the drive
as commanded it leads by a whole number of samples.

Shows as: a lead that begins within a sample and stays to the end of the sweep, in proportion to
the velocity; nothing while the actuator stands still. Repeats do not share it.

Remedy: Look at the digitizer's buffer and its link; the places are listed, and what follows each is
shifted. Record again if it matters.

Plausible: single samples to whole blocks of some hundreds; 1 sample of 5 kHz is 8 nm at 40 um/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause


class DroppedSamples(Cause):
    """``index`` in the record of the first missing sample, and how many (``count``)."""

    id = "dropped-samples"
    place = "acquisition"
    locked_to = "clock"
    meanings: ClassVar[Mapping[str, str]] = {
        "index": "sample of its recording after which they are missing",
        "count": "samples that are missing",
        "sweep": "recording that it is in",
    }
    units: ClassVar[Mapping[str, str]] = {"index": "1", "count": "1"}
    optional: ClassVar[Mapping[str, str]] = {"sweep": "1"}
