"""One worker: spoil a file, have it read, judge what happened, keep what reached new lines."""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import traceback
import warnings
from pathlib import Path

from piezo_rig.errors import PiezoRigError
from piezo_rig.studies.fuzz.formats import FORMATS, Format, silent
from piezo_rig.studies.fuzz.mutate import spoiled
from piezo_rig.studies.fuzz.reached import Reached

MOST_S = 5.0
MOST_MB = 500.0
_MOST_FILES = 400  # that are kept to go on from
_TRACED = 0.2  # of the inputs; the others cost a fifth
START_AGAIN = 3  # exit status of a worker whose memory has been blown up


def judge(format: Format, path: Path) -> tuple[str, str]:
    """Read one file: (``ok``, ``error``, ``broke`` or ``slow`` or ``memory``, and the details)."""
    begun = _cpu_s()
    verdict, details = "ok", ""
    try:
        with silent():
            format.read(path)
    except PiezoRigError as error:
        verdict, details = "error", error.code
        if not error.what or "Traceback" in error.block():
            verdict, details = "broke", f"an error without words: {error.block()}"
    except RecursionError:
        verdict, details = "broke", "RecursionError"
    except Exception:
        verdict, details = "broke", traceback.format_exc()
    took = _cpu_s() - begun
    if took > MOST_S:
        verdict, details = "slow", f"{took:.1f} s; {details}"
    if (used := memory_mb()) > MOST_MB:
        verdict, details = "memory", f"{used:.0f} MB; {details}"
    return verdict, details


def _cpu_s() -> float:
    """Processor seconds of this process and its children: others may be at work here too."""
    return sum(os.times()[:4])


def memory_mb() -> float:
    """The most memory that this process has had; ``ru_maxrss`` would count its parent's too."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text(encoding="ascii").splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1000
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def work(name: str, count: int, seed: int, folder: Path) -> int:
    """Read ``count`` spoiled files of one format; the exit status of the worker.

    In ``folder``: ``progress.json``, ``current`` (the file being read, for whoever finds this
    process dead), ``kept/`` and ``found/``.
    """
    warnings.simplefilter("error", RuntimeWarning)  # noise on the user's terminal
    format, chance = FORMATS[name], random.Random(f"{name}-{seed}")
    for part in ("kept", "found", "seeds"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    seeds = format.seeds(folder / "seeds")
    kept = [*seeds, *(p.read_bytes() for p in sorted((folder / "kept").iterdir()))]
    current = folder / f"current{format.suffix}"
    tally: dict[str, int] = {}
    codes: dict[str, int] = {}
    seen: set[int] = set()
    reached = Reached()
    todo = list(seeds)
    for number in range(count):
        if todo:
            data = todo.pop()
        else:
            # Half from what reached something new lately, half from anything.
            pool = kept[-40:] if chance.random() < 0.5 else kept
            data = spoiled(chance, chance.choice(pool), kept, format.words)
        current.write_bytes(data)
        if todo or chance.random() < _TRACED:
            with reached:
                verdict, details = judge(format, current)
            if verdict == "slow":  # tracing makes the clock unfair
                verdict, details = judge(format, current)
        else:
            reached.steps = set()
            verdict, details = judge(format, current)
        tally[verdict] = tally.get(verdict, 0) + 1
        if verdict == "error":
            codes[details] = codes.get(details, 0) + 1
        elif verdict != "ok":
            _keep(folder / "found", data, format.suffix, f"{verdict}\n{details}")
        if reached.steps - seen:
            seen |= reached.steps
            if len(kept) < _MOST_FILES and len(data) < 100_000:
                kept.append(data)
                _keep(folder / "kept", data, "", "")
        if number % 50 == 49 or number == count - 1 or verdict == "memory":
            (folder / "progress.json").write_text(json.dumps({
                "done": number + 1, "tally": tally, "codes": codes, "steps": len(seen),
                "memory_mb": memory_mb(),
            }))
        if verdict == "memory":
            return START_AGAIN
    return 0


def _keep(folder: Path, data: bytes, suffix: str, text: str) -> None:
    name = hashlib.sha256(data).hexdigest()[:16]
    (folder / (name + suffix)).write_bytes(data)
    if text:
        (folder / f"{name}.txt").write_text(text)
