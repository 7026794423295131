"""What a model was identified from, short enough for a model file: averages over cells of samples.

A model that cannot follow its recordings says with them what it did not follow. Later recordings
of the same drives are then compared with what was recorded, not with what a model makes of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
POINTS = 4000  # in all
SAME_DRIVE = 0.005  # rms difference, of the drive's range
SAME_LENGTH = 0.001
AS_ROBUST = 3  # recordings from which on their median is taken


@dataclass(frozen=True, eq=False)
class Recorded:
    """One drive and what it made of the actuator, recordings of it together.

    Attributes
    ----------
    condition : its name
    sample_rate : samples per second
    samples : of one recording
    cell : samples that were averaged into one
    recordings : how many
    drive_v, displacement_um : shape (samples // cell,)
    """

    condition: str
    sample_rate: float
    samples: int
    cell: int
    recordings: int
    drive_v: FloatArray
    displacement_um: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """Numbers in one line each: thousands of lines would bury the model."""
        return {
            "condition": self.condition, "sample_rate": self.sample_rate,
            "samples": self.samples, "cell": self.cell, "recordings": self.recordings,
            "drive_v": " ".join(f"{v:.3f}" for v in self.drive_v),
            "displacement_um": " ".join(f"{x:.5f}" for x in self.displacement_um),
        }  # fmt: skip

    def again(self, sweeps: Sequence[Sweep]) -> list[int]:
        """Which of the sweeps play the same drive."""
        return [i for i, s in enumerate(sweeps) if self._same(s)]

    def _same(self, sweep: Sweep) -> bool:
        if abs(sweep.samples - self.samples) > SAME_LENGTH * self.samples:
            return False
        if abs(sweep.sample_rate - self.sample_rate) > SAME_LENGTH * self.sample_rate:
            return False
        drive = cells(sweep.drive_v, self.cell)
        n = min(drive.size, self.drive_v.size)
        off = drive[:n] - self.drive_v[:n]
        return bool(np.sqrt(np.mean(off**2)) < SAME_DRIVE * np.ptp(self.drive_v))


def cells(values: FloatArray, cell: int) -> FloatArray:
    """Averages over cells of samples, shape (..., n // cell); what is left over is left out."""
    n = values.shape[-1] // cell
    return np.asarray(values[..., : n * cell].reshape(*values.shape[:-1], n, cell).mean(axis=-1))


def together(rows: FloatArray) -> FloatArray:
    """Recordings (r, n) of one drive as one, each counted from its own mean; shape (n,)."""
    centred = rows - rows.mean(axis=1, keepdims=True)
    if rows.shape[0] < AS_ROBUST:
        return np.asarray(centred.mean(axis=0))
    return np.asarray(np.median(centred, axis=0))


def recorded(sweeps: Sequence[Sweep]) -> list[Recorded]:
    """Every drive of some recordings, with the mean of its recordings."""
    found: list[tuple[Recorded, list[Sweep]]] = []
    for s in sweeps:
        for whole, members in found:
            if whole.condition == s.condition and whole.again([s]):
                members.append(s)
                break
        else:
            found.append((_at(s, [s], 1), [s]))
    total = sum(whole.samples for whole, _ in found)
    cell = max(int(np.ceil(total / POINTS)), 1)
    return [_at(members[0], members, cell) for _, members in found]


def _at(first: Sweep, members: Sequence[Sweep], cell: int) -> Recorded:
    n = min(s.samples for s in members)
    rows = np.array([s.displacement_um[:n] for s in members])
    return Recorded(
        first.condition, float(first.sample_rate), n, cell, len(members),
        cells(first.drive_v[:n], cell), cells(together(rows), cell),
    )  # fmt: skip


def recorded_of(provenance: Mapping[str, Any]) -> list[Recorded]:
    """What a model file says of its recordings; empty where it says nothing.

    Raises
    ------
    InputError : damaged
    """
    listed = provenance.get("recorded", [])
    try:
        return [_read(entry) for entry in listed]
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
        raise InputError(
            "model-recorded",
            "the given model's recordings ('recorded' in its provenance) are damaged",
            "the file was cut short, or changed by hand", "identify the model again",
        ) from None  # fmt: skip


def _read(entry: Mapping[str, Any]) -> Recorded:
    drive = np.array(entry["drive_v"].split(), dtype=float)
    displacement = np.array(entry["displacement_um"].split(), dtype=float)
    out = Recorded(
        str(entry["condition"]), float(entry["sample_rate"]), int(entry["samples"]),
        int(entry["cell"]), int(entry["recordings"]), drive, displacement,
    )  # fmt: skip
    right = drive.shape == displacement.shape and drive.size
    counts = min(out.cell, out.recordings) > 0 and out.samples // out.cell == drive.size
    finite = np.all(np.isfinite(drive + displacement)) and 0.0 < out.sample_rate < np.inf
    if not (right and counts and finite):
        raise ValueError("recorded")
    return out
