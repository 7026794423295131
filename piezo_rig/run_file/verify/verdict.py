"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """One thing that was found.

    Attributes
    ----------
    sweep : its name; empty for the run as a whole
    fault : a sweep with a fault may not be used; a note is only said
    text : what is wrong, with sample and values where known
    cause : the catalogue's name of a physical cause that explains a fault of a sweep, as in
        ``drive-clipping``. The file is whole then, it is the bench that was not: `diagnose`
        may use the sweep, which is how it names the cause; nothing else may.
    """

    sweep: str
    fault: bool
    text: str
    cause: str = ""

    def line(self) -> str:
        """As `piezo-rig verify` prints it."""
        only = f" (may be used by diagnose only: {self.cause})" if self.cause else ""
        return f"{'FAULT' if self.fault else 'note '} {self.sweep or 'run'}: {self.text}{only}"
