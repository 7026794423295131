"""What a worker does with one item, and what comes back from it; nothing here ever raises."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from piezo_rig.errors import InputError, PiezoRigError
from piezo_rig.fleet.item import Item

Analyse = Callable[[Item, Path], dict[str, Any]]
_ONE_AT_A_TIME = threading.Lock()  # what is printed and the bound on memory are the process's


@dataclass(frozen=True)
class Outcome:
    """What became of one item.

    Attributes
    ----------
    row : plain data for the table; empty where ``unchanged``
    files : ending -> content of an output
    said : assumptions and warnings
    sha256 : of the input; empty where it could not be read
    error, code, text, exit_status : the block of the error, and its parts; empty and 0 if done
    unchanged : the input is the one that the outputs were made from before
    """

    name: str
    row: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    sha256: str = ""
    error: str = ""
    code: str = ""
    text: str = ""
    exit_status: int = 0
    seconds: float = 0.0
    unchanged: bool = False


def failed(item: Item, error: PiezoRigError, sha256: str = "", seconds: float = 0.0) -> Outcome:
    """The outcome of an item that could not be analysed."""
    return Outcome(item.name, sha256=sha256, error=error.block(), code=error.code,
                   text=error.what, exit_status=error.exit_status, seconds=seconds)


@dataclass(frozen=True)
class Work:
    """The work on one item; can be sent to another process.

    Attributes
    ----------
    analyse : called with the item and an empty folder; leaves ``NAME + ending`` there for every
        output, and returns a row of plain data
    elsewhere : it is done on other computers, which may not see the files
    """

    analyse: Analyse
    elsewhere: bool = False

    def __call__(self, item: Item) -> Outcome:
        begun = time.monotonic()
        digest = ""
        try:
            with _ONE_AT_A_TIME:
                digest = self._hashed(item)
                if digest == item.known:
                    return Outcome(item.name, sha256=digest, unchanged=True)
                row, files, said = self._analysed(item)
        except PiezoRigError as error:
            return failed(item, error, digest, time.monotonic() - begun)
        except Exception as error:  # one bad file never stops the rest, whatever it does
            return failed(item, InputError(
                "internal", f"{item.given}: {type(error).__name__}: {error}",
                "a fault in piezo-rig, or input that nobody thought of",
                "analyse this file by itself, and report what it says",
            ), digest, time.monotonic() - begun)  # fmt: skip
        return Outcome(item.name, row, files, said, digest, seconds=time.monotonic() - begun)

    def _hashed(self, item: Item) -> str:
        """SHA-256 of one file, or of the names and hashes of several."""
        if not item.files:
            raise InputError("no-data", f"{item.given}: no run and no recording in this folder",
                             "a wrong folder", "give the folder of one actuator's files")
        found = []
        for name in item.files:
            try:
                found.append((os.path.basename(name), _sha256(name)))
            except OSError as error:
                if self.elsewhere:
                    raise InputError(
                        "not-visible", f"{name}: the worker on {socket.gethostname()} cannot read "
                        f"it: {error.strerror or error}",
                        "the file is not on a disk that the workers share, has another path "
                        "there, or is a link to nothing", "mend the link, or put the files where "
                        "scheduler, workers and this computer see them by one path",
                    ) from None
                raise InputError("not-found", f"{item.given}: {error.strerror or error}",
                                 "a wrong path, or a file that is not yours to read",
                                 "check the name") from None
        if len(found) == 1:
            return found[0][1]
        return hashlib.sha256(repr(found).encode()).hexdigest()

    def _analysed(self, item: Item) -> tuple[dict[str, Any], dict[str, bytes], tuple[str, ...]]:
        printed = io.StringIO()
        with tempfile.TemporaryDirectory(prefix="piezo-rig-") as folder:
            with contextlib.redirect_stdout(printed):
                row = self.analyse(item, Path(folder))
            files = {p.name[len(item.name):]: p.read_bytes() for p in Path(folder).iterdir()}
        said = tuple(line for line in printed.getvalue().splitlines()
                     if line.startswith(("assumed: ", "warning: ")))
        return row, files, said


def _sha256(path: str) -> str:
    digest = hashlib.sha256()
    if not os.path.isfile(path):
        raise FileNotFoundError(2, "no such file" if not os.path.exists(path) else "not a file")
    with open(path, "rb") as handle:
        while block := handle.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
