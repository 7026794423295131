"""Who an instrument says it is."""

from __future__ import annotations

from dataclasses import dataclass

SIMULATED_PREFIX = "SIM"


@dataclass(frozen=True)
class Identity:
    """The four fields of ``*IDN?``, or what stands for them where there is no such query.

    ``raw`` is the answer as it came; it goes into the run file.
    """

    manufacturer: str
    model: str
    serial: str
    firmware: str
    raw: str

    @property
    def is_simulated(self) -> bool:
        """Whether the serial number marks a simulated instrument."""
        return self.serial.upper().startswith(SIMULATED_PREFIX)

    @property
    def is_manual(self) -> bool:
        """Whether a person vouches for this instrument, because it has no link."""
        return self.model == "manual"

    @classmethod
    def from_idn(cls, answer: str) -> Identity:
        """Split an ``*IDN?`` answer; ValueError when it does not have four fields."""
        fields = [field.strip().strip('"') for field in answer.split(",", 3)]
        if len(fields) != 4 or not fields[1]:
            raise ValueError(answer)
        return cls(fields[0], fields[1], fields[2], fields[3], answer.strip())

    @classmethod
    def manual(cls, description: str, serial: str = "") -> Identity:
        """An instrument without a link, as the rig's config describes it."""
        return cls("", "manual", serial, "", description)
