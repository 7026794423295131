"""What is analysed by itself: one file, or a folder with all files of one actuator."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from piezo_rig.run_file.importers import distinct_names

READABLE = (".h5", ".hdf5", ".nxs", ".lvm", ".tdms", ".csv")
UNFINISHED = ".part.h5"


@dataclass(frozen=True)
class Item:
    """One input.

    Attributes
    ----------
    name : what its outputs are called, before their endings; no two items share an output
    given : as it was given, for people
    files : absolute paths
    known : hash of the input that its outputs were made from before; empty if there are none
    """

    name: str
    given: str
    files: tuple[str, ...]
    known: str = ""


def items_of(data: Sequence[str], endings: Sequence[str]) -> list[Item]:
    """One item for every file or folder; what is given twice is one item.

    Parameters
    ----------
    data : files, and folders whose runs and recordings belong to one actuator
    endings : of the outputs of an item, such as ``_range.json``
    """
    paths: dict[str, Path] = {}
    for name in data:
        paths.setdefault(os.path.realpath(name), Path(name))
    stems = {p: _plain(p.name if p.is_dir() else p.stem) for p in paths.values()}
    times = Counter(stem.casefold() for stem in stems.values())
    shared = [p for p, stem in stems.items() if times[stem.casefold()] > 1]
    long = {p: _plain(shown) for p, shown in distinct_names(shared).items()}
    taken: set[str] = set()
    found = []
    for path, stem in stems.items():
        first = long.get(path, stem)
        for name in chain((first,), (f"{first}-{n}" for n in count(2))):
            wanted = {f"{name}{ending}".casefold() for ending in endings}
            if not wanted & taken:
                break
        taken |= wanted
        found.append(Item(name, str(path), _files_of(path)))
    return found


def _plain(text: str) -> str:
    """A name that is one on every system."""
    return re.sub(r"[^\w.+-]+", "_", text).strip("._") or "data"


def _files_of(path: Path) -> tuple[str, ...]:
    if not path.is_dir():
        return (os.path.abspath(path),)
    return tuple(
        os.path.abspath(p) for p in sorted(path.iterdir())
        if p.suffix.lower() in READABLE and not p.name.endswith(UNFINISHED)
    )
