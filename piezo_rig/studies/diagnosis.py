"""How good is the diagnosis? Cases of the independent bench, run through it and counted.

    python -m piezo_rig.studies.diagnosis run --kinds null,creep --seeds 0:20
        --protocols matrix,rates --noises white,ar,1/f --d-prime 20,40 --out FILE.jsonl [--jobs 1]
    python -m piezo_rig.studies.diagnosis summary FILE.jsonl

`run` appends one line per case and leaves out what the file holds already. The cases come from
`piezo_rig.studies.hidden`, which shares no code with the program.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.scoring.counts import Row, summary
from piezo_rig.studies.diagnosis_case import Spec, run_case
from piezo_rig.studies.diagnosis_document import write
from piezo_rig.studies.hidden import NOISES, PROTOCOLS


def specs(
    kinds: Sequence[str], seeds: Sequence[int], protocols: Sequence[str], noises: Sequence[str],
    d_primes: Sequence[float], repeats: int = 2, baseline: str = "classical",
) -> list[Spec]:  # fmt: skip
    """Every combination; what has no effect is played once, not for every d'."""
    out = []
    for seed, kind, protocol, noise in product(seeds, kinds, protocols, noises):
        for d in d_primes if kind != "null" else (0.0,):
            out.append(Spec(kind, seed, protocol, noise, d, repeats, baseline))
    return out


def read(path: Path) -> list[Row]:
    """Rows of a file; a last line that was cut off is left out."""
    rows = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                rows.append(json.loads(line))
            except json.JSONDecodeError:
                continue
    return rows


def _spec_of(row: Row) -> Spec:
    return Spec(**{name: row[name] for name in Spec.__dataclass_fields__})


def run(todo: Sequence[Spec], out: Path, jobs: int, tell: Callable[[str], None]) -> None:
    """Run cases that the file does not hold yet, appending a line for each."""
    done = {_spec_of(row) for row in read(out)}
    left = [s for s in todo if s not in done]
    tell(f"{len(left)} cases, {len(todo) - len(left)} there already")
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.exists() and out.read_bytes()[-1:] not in (b"\n", b""):
        with out.open("a", encoding="utf-8") as file:
            file.write("\n")
    with out.open("a", encoding="utf-8") as file:
        for row in _rows(left, jobs):
            file.write(json.dumps(row, default=_plain) + "\n")
            file.flush()
            tell(_line(row))


def _rows(todo: Sequence[Spec], jobs: int) -> Iterator[Row]:
    if jobs <= 1:
        yield from map(run_case, todo)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_case, todo)


def _plain(x: Any) -> Any:
    return x.item() if isinstance(x, np.generic) else x.tolist()


def _line(row: Row) -> str:
    what = f"{row['truth']['cause']:40s} {row['protocol']:12s} {row['noise']:5s} {row['seed']:4d}"
    if row["error"]:
        return f"{what}  error {row['error'][:80]}"
    said = ", ".join(
        f["cause"] + (f" (or {', '.join(f['alternatives'])})" if f["alternatives"] else "")
        for f in row["findings"]
    )
    rest = "  UNEXPLAINED" if row["unexplained"]["detected"] else ""
    return f"{what}  {row['seconds']:5.1f} s  {said or '-'}{rest}"


def _list(text: str) -> list[str]:
    return [x for x in text.split(",") if x]


def _seeds(text: str) -> list[int]:
    if ":" in text:
        a, b = text.split(":")
        return list(range(int(a), int(b)))
    return [int(x) for x in text.split(",")]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    runs = verbs.add_parser("run")
    runs.add_argument("--kinds", type=_list, default=["null"])
    runs.add_argument("--seeds", type=_seeds, default=_seeds("0:10"))
    runs.add_argument("--protocols", type=_list, default=["matrix"])
    runs.add_argument("--noises", type=_list, default=["white"])
    runs.add_argument("--d-prime", type=lambda t: [float(x) for x in _list(t)], default=[40.0])
    runs.add_argument("--repeats", type=int, default=2)
    runs.add_argument("--baseline", default="classical")
    runs.add_argument("--out", type=Path, required=True)
    runs.add_argument("--jobs", type=int, default=1)
    sums = verbs.add_parser("summary")
    sums.add_argument("files", type=Path, nargs="+")
    page = verbs.add_parser("document")
    page.add_argument("files", type=Path, nargs="+")
    page.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    if options.verb == "document":
        write([row for path in options.files for row in read(path)], options.out)
        return
    if options.verb == "summary":
        print(summary([row for path in options.files for row in read(path)]))
        return
    for name, known in (("protocols", PROTOCOLS), ("noises", NOISES)):
        unknown = set(getattr(options, name)) - set(known)
        if unknown:
            parser.error(f"--{name}: {', '.join(sorted(unknown))} is not one of {', '.join(known)}")
    todo = specs(options.kinds, options.seeds, options.protocols, options.noises,
                 options.d_prime, options.repeats, options.baseline)  # fmt: skip
    run(todo, options.out, options.jobs, lambda line: print(line, file=sys.stderr, flush=True))


if __name__ == "__main__":
    main()
