"""What can go wrong, said to a technician.

Every error that leaves the program is one block on stderr: a stable code,
what stopped, whether the piezo is at 0 V (where an instrument was involved),
the likely cause, and what to do. This module knows the exit statuses; nothing
else does.
"""

from __future__ import annotations

BAD_INPUT = 2
LIMIT = 3
INSTRUMENT = 4
ABORTED = 5


class PiezoRigError(Exception):
    """An error with a code and words for the person at the bench.

    Parameters
    ----------
    code : stable identifier, kebab-case, printed as ``error[CODE]:``
    what : what stopped, with file, line, sweep or sample where known
    cause : the likely cause
    remedy : what to do
    """

    exit_status = BAD_INPUT

    def __init__(self, code: str, what: str, cause: str = "", remedy: str = "") -> None:
        super().__init__(what)
        self.code = code
        self.what = what
        self.cause = cause
        self.remedy = remedy
        self.piezo = ""  # filled in by whoever knows the state of the stack

    def block(self) -> str:
        """The text for stderr."""
        lines = [f"error[{self.code}]: {self.what}"]
        for label, text in (("piezo", self.piezo), ("cause", self.cause), ("do", self.remedy)):
            if text:
                lines.append(f"  {label + ':':<7}{text}")
        return "\n".join(lines)


class InputError(PiezoRigError):
    """Bad input, bad usage, or too little data (exit 2)."""

    exit_status = BAD_INPUT


class LimitError(PiezoRigError):
    """A limit would be broken, or a bench refused (exit 3)."""

    exit_status = LIMIT


class BenchError(PiezoRigError):
    """An instrument or the disk failed (exit 4)."""

    exit_status = INSTRUMENT


class Aborted(PiezoRigError):
    """The operator stopped the program (exit 5)."""

    exit_status = ABORTED
