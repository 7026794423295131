"""The first look at a file: does it exist, is it what its name says, can it be text at all."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from piezo_rig.errors import InputError

LONGEST_LINE = 100_000
"""Bytes; a row of numbers is three orders shorter."""

_FORMATS = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", "give a run file its extension .h5 back"),
    (b"TDSm", "a TDMS file", "give it the extension .tdms"),
    (b"TDSh", "a TDMS index", "import the .tdms file beside it"),
    (b"LabVIEW Measurement", "a LabVIEW measurement file", "give it the extension .lvm"),
    (b"PK\x03\x04", "a zip archive or spreadsheet", "unpack it, or save the sheet as .csv"),
    (b"\x1f\x8b", "a gzip archive", "unpack it first"),
    (b"MATLAB 5.0", "a MATLAB file", "give it the extension .mat, if piezo-rig exported it"),
)


@contextmanager
def advised() -> Iterator[None]:
    """Whatever is refused inside says what to do: where nothing better is known, a fresh copy."""
    try:
        yield
    except InputError as error:
        error.remedy = error.remedy or (
            "copy the file again from the computer that recorded it, or export it as .csv with the "
            "header time_s,drive_v,displacement_um"
        )
        raise


def read_bytes(path: Path) -> bytes:
    """The whole file.

    Raises
    ------
    InputError : no such file, a directory or device, unreadable, or empty
    """
    try:
        if path.is_dir():
            raise InputError(
                "import-file", f"{path}: is a folder", remedy="name the recordings in it"
            )
        if not path.exists():
            raise InputError("import-file", f"{path}: no such file", remedy="check the path")
        if not path.is_file():
            raise InputError("import-file", f"{path}: is not a regular file")
        data = path.read_bytes()
    except (OSError, ValueError, MemoryError) as failure:
        raise InputError(
            "import-file",
            f"{path}: cannot be read",
            cause=str(failure) or type(failure).__name__,
        ) from failure
    if not data:
        raise InputError(
            "import-file",
            f"{path}: is empty",
            cause="the recording was never written, or the copy failed",
            remedy="copy it again from the computer that recorded it",
        )
    return data


def refuse_mislabelled(path: Path, data: bytes, own: bytes | None = None) -> None:
    """Refuse a file whose first bytes belong to another format than its extension.

    Parameters
    ----------
    own : the magic bytes that the extension promises, which are not refused
    """
    start = data.removeprefix(codecs.BOM_UTF8)
    for magic, what, remedy in _FORMATS:
        if magic != own and start.startswith(magic):
            raise InputError(
                f"import-{path.suffix.lower().lstrip('.')}",
                f"{path}: is {what}, not a {path.suffix} file",
                cause="the file was given the wrong extension",
                remedy=remedy,
            )


def text_bytes(path: Path, data: bytes, code: str) -> tuple[bytes, list[str]]:
    """The file as bytes of text with plain line ends, and warnings about what was cut away.

    UTF-16 with its mark is turned into UTF-8, CR-LF and CR into LF; zero bytes at the
    end (a disk that lost power) are cut.

    Raises
    ------
    InputError : zero bytes inside, or a line too long to be a row of numbers
    """
    warnings = []
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", errors="replace").encode("utf-8", errors="replace")
    data = data.removeprefix(codecs.BOM_UTF8)
    if data.endswith(b"\0"):
        trimmed = data.rstrip(b"\0")
        warnings.append(
            f"ends in {len(data) - len(trimmed)} zero bytes, which were cut: "
            "the file was not closed properly"
        )
        data = trimmed
    if data and not data.strip():
        raise InputError(
            code,
            f"{path}: holds nothing but empty lines",
            cause="the recording was never written, or the copy failed",
            remedy="copy it again from the computer that recorded it",
        )
    if b"\0" in data or not data:
        raise InputError(
            code,
            f"{path}: is not text" if data else f"{path}: holds nothing but zero bytes",
            cause="a binary or damaged file with the wrong extension",
            remedy="export the recording again as text",
        )
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
        data = re.sub(rb"\r+\n?", b"\n", data)
    if _has_long_line(data):
        raise InputError(
            code,
            f"{path}: has a line of more than {LONGEST_LINE} bytes",
            cause="it is not a table of numbers, or its line ends are lost",
            remedy="export the recording again, one sample per line",
        )
    return data, warnings


def decoded(text: bytes) -> str:
    """Words of a text file: UTF-8 where they are, else the Windows code page."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace")


def _has_long_line(data: bytes) -> bool:
    """Whether any line is longer than allowed, found by leaps rather than line by line."""
    position = 0
    while len(data) - position > LONGEST_LINE:
        end = data.rfind(b"\n", position, position + LONGEST_LINE + 1)
        if end < 0:
            return True
        position = end + 1
    return False
