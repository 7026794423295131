"""One line of the checklist."""

from __future__ import annotations

from dataclasses import dataclass

from piezo_rig.errors import PiezoRigError


@dataclass(frozen=True)
class Check:
    """One line of the checklist.

    ``status`` is ``ok``, ``FAULT``, ``skip`` (could not be checked, ``text`` says why) or
    ``note``; a fault has a likely cause and what to do.
    """

    status: str
    subject: str
    text: str
    cause: str = ""
    remedy: str = ""

    @classmethod
    def of(cls, subject: str, error: PiezoRigError) -> Check:
        return cls("FAULT", subject, f"{error.what} [{error.code}]", error.cause, error.remedy)
