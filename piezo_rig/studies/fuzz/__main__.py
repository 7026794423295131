"""The campaign: a worker for each format in turn, started again where one dies.

    python -m piezo_rig.studies.fuzz --inputs 100000 --folder build/study-fuzz
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from piezo_rig.studies.fuzz.formats import FORMATS

_STUCK_S = 40.0  # without progress


def main() -> int:
    parser = argparse.ArgumentParser(prog="piezo_rig.studies.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--formats", default=",".join(FORMATS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/study-fuzz"))
    parser.add_argument("--worker", metavar="FORMAT", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        from piezo_rig.studies.fuzz.campaign import work

        return work(args.worker, args.inputs, args.seed, args.folder)
    names = args.formats.split(",")
    shares = sum(FORMATS[n].share for n in names)
    broke = total = 0
    for name in names:
        count = round(args.inputs * FORMATS[name].share / shares)
        done, bad = _format(name, count, args.seed, args.folder / name)
        total, broke = total + done, broke + bad
    print(f"{total} inputs, {broke} that broke something")
    return int(broke > 0)


def _format(name: str, count: int, seed: int, folder: Path) -> tuple[int, int]:
    """All inputs of one format; how many were read, and how many broke something."""
    folder.mkdir(parents=True, exist_ok=True)
    begun, done, bad, most, steps = time.monotonic(), 0, 0, 0.0, 0
    tally: dict[str, int] = {}
    codes: dict[str, int] = {}
    while done < count:
        progress = folder / "progress.json"
        progress.unlink(missing_ok=True)
        status = _worker(name, count - done, seed, folder)
        said = json.loads(progress.read_text()) if progress.exists() else {}
        done += said.get("done", 0)
        seed += 1_000_000
        for into, key in ((tally, "tally"), (codes, "codes")):
            for word, number in said.get(key, {}).items():
                into[word] = into.get(word, 0) + number
        most, steps = max(most, said.get("memory_mb", 0.0)), max(steps, said.get("steps", 0))
        if status not in (0, 3):
            done += 1
            tally["died"] = tally.get("died", 0) + 1
            (current,) = folder.glob("current.*")
            kept = folder / "found" / f"died-{seed}{current.suffix}"
            kept.write_bytes(current.read_bytes())
            kept.with_suffix(".txt").write_text(f"worker ended with status {status}\n")
        if tally.get("died", 0) > 20:
            break
    bad = sum(n for word, n in tally.items() if word not in ("ok", "error"))
    took = time.monotonic() - begun
    listed = ", ".join(f"{n} {word}" for word, n in sorted(tally.items()))
    print(f"{name:<12} {done:>6} inputs in {took:4.0f} s: {listed}; {len(codes)} error codes, "
          f"{steps} steps reached, at most {most:.0f} MB", flush=True)
    return done, bad


def _worker(name: str, count: int, seed: int, folder: Path) -> int:
    """One worker to its end; killed where it makes no progress."""
    process = subprocess.Popen([
        sys.executable, "-m", "piezo_rig.studies.fuzz", "--worker", name, "--inputs", str(count),
        "--seed", str(seed), "--folder", str(folder),
    ])
    last, since = -1.0, time.monotonic()
    while True:
        try:
            return process.wait(1.0)
        except subprocess.TimeoutExpired:
            moved = max((p.stat().st_mtime for p in folder.glob("current.*")), default=0.0)
            if moved != last:
                last, since = moved, time.monotonic()
            elif time.monotonic() - since > _STUCK_S:
                process.kill()
                return process.wait()


sys.exit(main())
