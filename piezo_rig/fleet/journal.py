"""What is done already, line by line beside the outputs, so that nothing is done twice.

A line is written when an item's outputs stand on the disk. It holds as long as input, options,
version and outputs are the same; a line that was torn by a power cut counts as none.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from piezo_rig.errors import BenchError

NAME = "journal.jsonl"


def key_of(settings: Mapping[str, Any]) -> str:
    """A hash of everything besides the input that outputs depend on."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


class Journal:
    """The journal of one folder.

    Parameters
    ----------
    folder : it and the outputs' folders exist
    key : of the options; lines with another key are left alone
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.path = folder / NAME
        self.key = key
        self._lines: dict[str, dict[str, Any]] = {}
        try:
            text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        except (OSError, UnicodeDecodeError):
            text = ""
        for line in text.splitlines():
            try:
                said = json.loads(line)
                if said["key"] == key and isinstance(said["outputs"], dict):
                    self._lines[str(said["name"])] = said
            except (ValueError, KeyError, TypeError):
                continue
        self._torn = bool(text) and not text.endswith("\n")

    def known(self, name: str) -> dict[str, Any] | None:
        """The line of an item whose outputs are still as they were written."""
        line = self._lines.get(name)
        if line is None:
            return None
        for path, digest in line["outputs"].items():
            try:
                if hashlib.sha256(Path(path).read_bytes()).hexdigest() != digest:
                    return None
            except OSError:
                return None
        return line

    def add(self, line: dict[str, Any], outputs: Mapping[Path, bytes]) -> None:
        """Note an item whose outputs stand on the disk.

        Raises
        ------
        BenchError : the disk refuses
        """
        said = {"key": self.key, **line, "outputs": {
            str(path.absolute()): hashlib.sha256(data).hexdigest() for path, data in outputs.items()
        }}  # fmt: skip
        try:
            with self.path.open("a", encoding="utf-8", newline="\n") as handle:
                handle.write(("\n" if self._torn else "") + json.dumps(said) + "\n")
        except OSError as error:
            raise BenchError("disk", f"could not write {self.path}: {error.strerror or error}",
                             "the disk is full, or the folder is not yours to write",
                             "give the same command again once there is room") from None
        self._torn = False
