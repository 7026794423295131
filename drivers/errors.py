"""What an instrument can do wrong, by name.

The application turns these into messages for the technician; a driver only
says what it saw.
"""

from __future__ import annotations


class InstrumentError(Exception):
    """An instrument, or the line to it, failed.

    Parameters
    ----------
    code : stable identifier, as in ``instrument-timeout``
    instrument : which one, in the words of the rig's config
    what : what happened: setting, asked and answered where they matter
    cause : the likely cause
    remedy : what to do
    """

    def __init__(
        self, code: str, instrument: str, what: str, cause: str = "", remedy: str = ""
    ) -> None:
        super().__init__(f"{instrument}: {what}")
        self.code = code
        self.instrument = instrument
        self.what = what
        self.cause = cause
        self.remedy = remedy
