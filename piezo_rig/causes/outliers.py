"""Outliers: isolated spikes of the sensor.

Physics: a beam that is interrupted for a moment, a transient on the analog line, a converter that
slips a code. Nothing foretells them, so no model gains by them; they are found, counted and left
out of everything that follows.

Shows as: one or a few samples far off their neighbours on both sides.

Remedy: Shield the beam, check connectors; the spikes are listed and were left out, so nothing else
hangs on them.

Plausible: up to a few per second, tens of nm to micrometres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause


class Outliers(Cause):
    """``per_second``: how many."""

    id = "outliers"
    place = "sensor"
    locked_to = "clock"
    meanings: ClassVar[Mapping[str, str]] = {
        "per_second": "how often they occur",
    }
    units: ClassVar[Mapping[str, str]] = {"per_second": "1/s"}
