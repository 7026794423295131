"""The folder of a challenge: recordings for anybody, the sealed truth beside them.

    SHA256SUMS              of every truth and recording; printed before anything is played
    cases/case_0001/*.csv   recordings: time_s,drive_v,displacement_um
    truth/case_0001.json    what is hidden; case_0001.toml, the protocol
    answers/case_0001.json  what this program said
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.challenge.case import SCHEMA, Case
from piezo_rig.errors import InputError
from piezo_rig.resources import read_text
from piezo_rig.run_file.sweep import Sweep

SUMS = "SHA256SUMS"
REMEDY = "take the folder as it was made, or make it again: the same seed gives the same cases"
HEADER = "time_s,drive_v,displacement_um"
README = """Recordings of simulated piezo actuators, with effects hidden in some of them.

cases/case_0001/0-75 test 2.csv   repeat 2 of condition 0-75: time_s,drive_v,displacement_um.
    Every recording begins with a virgin actuator; time_s is one clock within a case.
truth/    what is hidden. Look at it afterwards. SHA256SUMS seals it.
answers/  what piezo-rig said: one diagnosis JSON per case.

Write your own answers as ANSWERS/case_0001.json, at least
    {"findings": [{"cause": "creep"}], "unexplained": {"detected": false}}
and score them: piezo-rig challenge --score ANSWERS --out THIS_FOLDER
docs/challenge.md of piezo-rig explains how cases are made and what each figure means.
"""


def seal(folder: Path, case: Case) -> str:
    """Write a case's truth and protocol; returns the truth's SHA-256."""
    truth = folder / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    path = truth / f"{case.truth.case}.json"
    write_json(path, case.document())
    path.with_suffix(".toml").write_text(case.protocol, encoding="utf-8", newline="\n")
    return sha256(path)


def write_recordings(folder: Path, name: str, sweeps: Sequence[Sweep]) -> None:
    """One CSV per recording, named as the importer reads names: ``0-75 test 2.csv``.

    ``time_s`` is the bench's clock, which all recordings of a case share.
    """
    case = folder / "cases" / name
    case.mkdir(parents=True, exist_ok=True)
    for sweep in sweeps:
        rows = np.column_stack(
            [sweep.start_time + sweep.time_s, sweep.drive_v, sweep.displacement_um]
        )
        np.savetxt(case / f"{sweep.condition} test {sweep.repeat}.csv", rows, "%.6f", ",",
                   header=HEADER, comments="")  # fmt: skip


def write_json(path: Path, plain: Any) -> None:
    """Plain data as JSON; the same data give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(plain, indent=1, ensure_ascii=False, default=_plain)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")


def _plain(x: Any) -> Any:
    return x.item() if isinstance(x, np.generic) else x.tolist()


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_sums(folder: Path) -> None:
    """Hashes of every truth and recording, as ``sha256sum --check`` reads them; and a read-me."""
    (folder / "README.txt").write_text(README, encoding="utf-8", newline="\n")
    paths = sorted([*(folder / "truth").glob("*.json"), *(folder / "cases").rglob("*.csv")])
    lines = [f"{sha256(p)}  {p.relative_to(folder).as_posix()}\n" for p in paths]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8", newline="\n")


def read_truths(folder: Path) -> dict[str, dict[str, Any]]:
    """Every case's truth by its name; whatever was sealed is there, and is what was sealed.

    Raises
    ------
    InputError : no folder of a challenge, or a truth or a recording that is missing, was changed
        or was never sealed
    """
    sums = _read_sums(folder)
    truths = sorted((folder / "truth").glob("*.json"))
    for name in [*sums, *(p.relative_to(folder).as_posix() for p in truths)]:
        path = folder / name
        if not path.is_file():
            raise InputError("challenge-seal", f"{path}: missing, though it was sealed in "
                             f"{folder / SUMS}",
                             "it was deleted or moved, or the folder was copied in part", REMEDY)
        if sums.get(name) != sha256(path):
            what = "truth" if path in truths else "recording"
            raise InputError("challenge-seal", f"{path}: not what was sealed in {folder / SUMS}",
                             f"the {what} was changed, or belongs to another challenge", REMEDY)
    found = {}
    for path in truths:
        truth = json.loads(path.read_text(encoding="utf-8"))
        if truth.get("schema") != SCHEMA:
            raise InputError("challenge-truth", f"{path}: not a {SCHEMA}", "another file",
                             "give the folder that 'challenge --out' wrote")  # fmt: skip
        found[truth["case"]] = truth
    if not found:
        raise InputError("challenge-truth", f"{folder}: no truths in it", "another folder",
                         "give the folder that 'challenge --out' wrote")  # fmt: skip
    return found


def _read_sums(folder: Path) -> dict[str, str]:
    """The sealed hashes by the names of their files, as `write_sums` wrote them."""
    path = folder / SUMS
    if not path.is_file():
        raise InputError("challenge-truth", f"{folder}: no folder of a challenge; it has no list "
                         f"of hashes, {SUMS}", "another folder, or that file was deleted",
                         "give the folder that 'challenge --out' wrote")  # fmt: skip
    sums = {}
    for number, line in enumerate(read_text(path, "list of hashes").splitlines(), 1):
        digest, _, name = line.partition("  ")
        if not name:
            raise InputError("challenge-seal", f"{path}, line {number}: not a hash, two blanks "
                             "and the name of a file", "the list was changed", REMEDY)
        sums[name] = digest
    return sums
