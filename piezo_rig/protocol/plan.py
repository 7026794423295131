"""The Plan: the very samples of every sweep, as plain data.

``plan`` prints it, ``run`` plays it, and both see the same numbers, quantised
as the waveform DAC will play them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_rig.config import Rig
from piezo_rig.protocol.protocol_file import Condition, Protocol

FloatArray = NDArray[np.float64]

DAC_FULL_SCALE = 32767
DAC_MAX_POINTS = 1_000_000
DIGITIZER_MAX_SAMPLES = 32_000_000
MIN_SPAN_V = 0.01  # of command; the generator cannot set HIGH = LOW
REST_DRIVE_V = 0.0


@dataclass(frozen=True, eq=False)
class Wave:
    """The samples of one condition.

    ``codes`` has one more entry than ``command_v``: the closing point at rest. The generator
    rests at the first point when a burst ends, and first = last = rest; the digitizer records
    the samples before it.
    """

    codes: NDArray[np.int16]
    low_v: float
    high_v: float
    command_v: FloatArray
    drive_v: FloatArray


@dataclass(frozen=True, eq=False)
class PlannedSweep:
    """One sweep to be played."""

    name: str
    condition: Condition
    repeat: int
    history: str
    wave: Wave

    @property
    def samples(self) -> int:
        return int(self.wave.command_v.size)


@dataclass(frozen=True, eq=False)
class Plan:
    """Every sweep of a protocol on a rig, in the order in which it is played."""

    protocol: Protocol
    rig: Rig
    sweeps: tuple[PlannedSweep, ...]

    @property
    def sample_rate(self) -> float:
        return self.protocol.sample_rate

    @cached_property
    def samples(self) -> int:
        return sum(s.samples for s in self.sweeps)

    @property
    def play_s(self) -> float:
        """Seconds of drive, without the waits."""
        return self.samples / self.sample_rate

    @property
    def waits(self) -> int:
        """How many sweeps begin after a rest of ``recovery_s``."""
        return sum(s.history == "virgin" for s in self.sweeps)

    @property
    def duration_s(self) -> float:
        return self.play_s + self.waits * self.rig.recovery_s

    @property
    def file_bytes(self) -> int:
        """Size of the run file before compression: command 8, each recorded channel 4 bytes."""
        channels = 2 if self.rig.digitizer.monitor_channel else 1
        return self.samples * (8 + 4 * channels * self.rig.digitizer.oversampling)

    @cached_property
    def hash(self) -> str:
        """SHA-256 over what is played: identities, histories and every DAC code."""
        digest = hashlib.sha256(f"{self.sample_rate!r}".encode())
        for path, text in sorted(self.protocol.files.items()):
            digest.update(f"{path}|{hashlib.sha256(text.encode()).hexdigest()}|".encode())
        codes: dict[int, bytes] = {}
        for s in self.sweeps:
            if id(s.wave) not in codes:
                codes[id(s.wave)] = hashlib.sha256(s.wave.codes.tobytes()).digest()
            digest.update(
                f"{s.name}|{s.condition.name}|{s.repeat}|{s.history}|"
                f"{s.wave.low_v!r}|{s.wave.high_v!r}".encode()
            )
            digest.update(codes[id(s.wave)])
        return digest.hexdigest()

    def conditions(self) -> Iterator[tuple[Condition, Wave]]:
        """Each condition once, with its samples."""
        seen = set()
        for s in self.sweeps:
            if s.condition.name not in seen:
                seen.add(s.condition.name)
                yield s.condition, s.wave
