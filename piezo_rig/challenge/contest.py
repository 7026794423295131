"""The whole of it: draw and seal every case, play and diagnose every case, open and score.

A case that breaks, or takes its process with it, is counted as a failure, and the rest go on.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any, TypeVar

from piezo_rig.challenge.answers import read_answer, row_of
from piezo_rig.challenge.case import draw, name_of
from piezo_rig.challenge.files import (
    read_truths,
    seal,
    write_json,
    write_recordings,
    write_sums,
)
from piezo_rig.challenge.play import played
from piezo_rig.challenge.rehearsal import Rehearsal
from piezo_rig.errors import InputError, PiezoRigError
from piezo_rig.scoring.counts import Row

Tell = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Failed:
    """Why a case could not be done."""

    reason: str


@dataclass(frozen=True)
class Played:
    """A case that was played and diagnosed: what was said, and how long that took."""

    said: str
    seconds: float


def contest(seed: int, cases: int, folder: Path, jobs: int, tell: Tell) -> list[Row]:
    """Make, play, diagnose and score cases in an empty folder; rows in the order of the cases."""
    indices = range(cases)
    tell(f"drawing {cases} cases of seed {seed}, {jobs} at a time")
    broken: dict[str, str] = {}
    seals: dict[str, str] = {}
    for index, sealed in _each(partial(_draw, seed, str(folder)), indices, jobs):
        if isinstance(sealed, Failed):
            broken[name_of(index)] = sealed.reason
        else:
            seals[name_of(index)] = sealed
    for name in sorted(seals):
        tell(f"sealed {name}  sha256 {seals[name]}")
    write_sums(folder)  # a challenge that is stopped can still be scored as far as it went
    times: dict[str, float] = {}
    names = sorted(seals)
    results = _each(partial(_perform, str(folder), names), range(len(names)), jobs)
    for done, (i, result) in enumerate(results, 1):
        if isinstance(result, Failed):
            broken[names[i]] = result.reason
            tell(f"{done} of {len(names)}: {names[i]}  failed: {result.reason}")
        else:
            times[names[i]] = result.seconds
            tell(f"{done} of {len(names)}: {names[i]}  {result.seconds:.1f} s  {result.said}")
    write_sums(folder)
    if not seals:
        why = next(iter(broken.values()))
        raise InputError("challenge-cases", f"no case could be drawn: {why}",
                         "a fault in piezo-rig", "report it with the seed")  # fmt: skip
    return scored(folder, folder / "answers", broken, times) + [
        _undrawn(name, reason) for name, reason in sorted(broken.items()) if name not in seals
    ]


def scored(
    folder: Path, answers: Path, broken: dict[str, str] | None = None,
    times: dict[str, float] | None = None,
) -> list[Row]:  # fmt: skip
    """Rows of the answers ``answers/case_0001.json`` to the cases of a folder.

    An answer that is missing or cannot be read is a failure.

    Raises
    ------
    InputError : no challenge in the folder, or a truth that was changed
    """
    rows = []
    for name, truth in read_truths(folder).items():
        error = (broken or {}).get(name)
        said = None
        if error is None:
            try:
                said = read_answer(answers / f"{name}.json")
            except InputError as refused:
                error = refused.what
        rows.append(row_of(truth, said, error, (times or {}).get(name)))
    return rows


def _undrawn(name: str, reason: str) -> Row:
    """The row of a case that could not even be drawn: a cause that was missed."""
    nothing: dict[str, Any] = {
        "case": name, "cause": "not drawn", "causes": ["not drawn"], "parameters": {},
        "d_prime": [], "asked": 0.0, "reached": False, "form": "", "protocol": "", "noise": "",
        "left_nm": {}, "oracle": {"findings": [], "unexplained": False},
    }  # fmt: skip
    return row_of(nothing, None, reason)


def _draw(seed: int, folder: str, index: int) -> str:
    return seal(Path(folder), draw(seed, index))


def _perform(folder: str, names: Sequence[str], which: int) -> Played:
    """Play one sealed case, hand out its recordings, and let the diagnosis say what it says."""
    from piezo_rig.diagnosis import diagnose, document

    name, home = names[which], Path(folder)
    truth = json.loads((home / "truth" / f"{name}.json").read_text(encoding="utf-8"))
    protocol = (home / "truth" / f"{name}.toml").read_text(encoding="utf-8")
    room = home / f".{name}"
    room.mkdir()
    try:
        sweeps = played(Rehearsal.of(protocol), truth["plant"], room)
    finally:
        shutil.rmtree(room, ignore_errors=True)
    write_recordings(home, name, sweeps)
    begun = time.perf_counter()
    found = diagnose(sweeps)
    seconds = time.perf_counter() - begun
    write_json(home / "answers" / f"{name}.json", document(found))
    said = ", ".join(f.cause for f in found.findings) or "nothing found"
    return Played(said + (", unexplained" if found.unexplained.detected else ""), seconds)


def _each(
    work: Callable[[int], T], items: Sequence[int], jobs: int
) -> Iterator[tuple[int, T | Failed]]:
    """``work`` of every item, as they come; what raises or dies becomes a `Failed`."""
    if jobs <= 1:
        for item in items:
            yield item, _kept(work, item)
        return
    lost: list[int] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        try:
            futures: dict[Future[T | Failed], int] = {
                pool.submit(_kept, work, item): item for item in items
            }
            for future in as_completed(futures):
                try:
                    yield futures[future], future.result()
                except BrokenProcessPool:
                    lost.append(futures[future])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():  # nobody waits for what they would say
                child.terminate()
            raise
    for item in lost:  # a process died: whose fault it was shows when each has its own
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            try:
                yield item, pool.submit(_kept, work, item).result()
            except BrokenProcessPool:
                yield item, Failed("its process died")


def _kept(work: Callable[[int], T], item: int) -> T | Failed:
    try:
        return work(item)
    except PiezoRigError as error:
        return Failed(f"{error.code}: {error.what}")
    except Exception as error:
        return Failed(f"{type(error).__name__}: {error}")
