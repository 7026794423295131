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
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise, product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import added_by
from piezo_rig.chain import Model, half_loops
from piezo_rig.diagnosis import Diagnosis, diagnose
from piezo_rig.identification import identify
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.studies.document import number, table
from piezo_rig.studies.hidden import NOISES, PROTOCOLS, Case, draw

FloatArray = NDArray[np.float64]
Row = dict[str, Any]
# removed from the recordings before any model
CLOCK_FIRST = ("outliers", "mains-hum", "fringe-jump", "dropped-samples")
AGAIN, BEFORE = 1000, 1001  # seeds of the second session, and of the one before the effect
FIXED = "fixed:"
SHARE_FROM = 0.05  # of the error on the unseen drive that the effect must make up to be counted


@dataclass(frozen=True)
class Spec:
    """One case to be drawn and diagnosed."""

    kind: str
    seed: int
    protocol: str
    noise: str
    d_prime: float
    repeats: int = 2
    baseline: str = "classical"  # or ``fixed:classical``: identified before the effect came


def run_case(spec: Spec) -> Row:
    """Draw, diagnose, check what it promised on data that it has not seen; plain data."""
    row: Row = {**asdict(spec), "error": None}
    begin = time.perf_counter()
    case = draw(spec.kind, spec.seed, spec.protocol, spec.noise, spec.d_prime, spec.repeats)
    row["draw_seconds"] = round(time.perf_counter() - begin, 3)
    row["truth"] = asdict(case.truth)
    row["noise_rms_nm"] = case.noise.rms_nm
    begin = time.perf_counter()
    try:
        baseline = _baseline(case, spec.baseline)
        found = diagnose(case.sweeps, baseline)
    except Exception as error:
        row["error"] = f"{type(error).__name__}: {error}"
        row["seconds"] = round(time.perf_counter() - begin, 3)
        return row
    row["seconds"] = round(time.perf_counter() - begin, 3)
    row |= _said(found)
    try:
        row |= _checked(case, found, baseline)
    except Exception as error:
        row["check_error"] = f"{type(error).__name__}: {error}"
    return row


def _baseline(case: Case, name: str) -> str | Model:
    """A named model, or one that was identified in a session before the effect came."""
    if not name.startswith(FIXED):
        return name
    return identify(case.before(BEFORE), name.removeprefix(FIXED)).model


def _said(found: Diagnosis) -> Row:
    return {
        "findings": [
            {
                "cause": f.cause, "p": f.p_value, "d_prime": f.d_prime,
                "gain": f.gain_percent, "gain_ci95": f.gain_ci95,
                "parameters": {n: {"value": p.value, "ci95": p.ci95 and list(p.ci95)}
                               for n, p in f.parameters.items()},
                "alternatives": list(f.alternatives),
            }
            for f in found.findings
        ],
        "unexplained": {
            "detected": found.unexplained.detected, "rms_nm": found.unexplained.rms_nm,
            "allowance_nm": found.unexplained.allowance_nm,
            "depends_on": list(found.unexplained.depends_on),
        },
        "noise_floor_nm": found.noise_floor_nm,
        "rungs": [asdict(r) for r in found.rungs],
        "follow_up": found.follow_up and found.follow_up.protocol,
        "refused": sorted(found.refused),
    }  # fmt: skip


def rung_models(found: Diagnosis) -> list[Model] | None:
    """The model of every rung, the baseline first; None where a diagnosis does not tell.

    The hook for `Diagnosis.rung_models`: as many as ``rungs``.
    """
    models = getattr(found, "rung_models", None)
    if callable(models):
        models = models()
    return list(models) if models is not None and len(models) == len(found.rungs) else None


def _checked(case: Case, found: Diagnosis, baseline: str | Model) -> Row:
    """Gains on a second session, and on a drive that was never measured."""
    models = rung_models(found)
    if models is None:
        return {"gains_again": None, "unseen": None}
    again = case.again(AGAIN)
    clean = not any(f.cause in CLOCK_FIRST for f in found.findings)
    clean = clean and not any(c in CLOCK_FIRST for c in case.truth.causes)
    errors = [_rms_nm(again, m) for m in models] if clean else None
    gains = None
    if errors is not None:
        gains = [
            100.0 * (1.0 - b / a)
            for (a, b), rung in zip(pairwise(errors), found.rungs[1:], strict=True)
            if rung.finding is not None
        ]
    return {"gains_again": gains, "unseen": _on_unseen(case, models, baseline)}


def _on_unseen(case: Case, models: Sequence[Model], baseline: str | Model) -> Row | None:
    """Errors on a drive that was never measured, nm; None where no effect would show there.

    ``possible_nm`` is what is left to somebody who takes the true effects off the recordings
    before fitting the baseline, and puts them back; ``oracle_nm`` the same with the bench's base.
    """
    unseen = case.unseen()
    effect = unseen.with_effect_um - unseen.without_um
    if len(models) < 2 or not np.any(effect):
        return None
    bare = rung_models(diagnose(case.bare(), baseline))
    assert bare is not None

    def off(predicted: FloatArray) -> float:
        return 1e3 * float(np.std(predicted - unseen.with_effect_um))

    def played(model: Model) -> FloatArray:
        return model.simulate(unseen.time_s, unseen.drive_v, "virgin")

    return {
        "before_nm": off(played(models[0])), "after_nm": off(played(models[-1])),
        "possible_nm": off(played(bare[0]) + effect), "oracle_nm": off(case.best_unseen_um()),
        "effect_nm": 1e3 * float(np.std(effect)), "bare_findings": len(bare) - 1,
    }  # fmt: skip


def _rms_nm(sweeps: Iterable[Sweep], model: Model) -> float:
    """Error of a model on recordings, with a free offset for each."""
    square, count = 0.0, 0
    earlier: list[FloatArray] = []
    for s in sweeps:
        if model.remembering:
            predicted = model.simulate(s.time_s, s.drive_v, s.history, earlier=earlier)
            earlier.append(s.drive_v[np.append(half_loops(s.drive_v).start, s.samples - 1)])
        else:
            predicted = model.simulate(s.time_s, s.drive_v, s.history)
        for stage in model.stages:
            if stage.locked_to == "clock" and stage.id not in CLOCK_FIRST:
                predicted = predicted + added_by(stage, s.time_s, s.drive_v)
        error = s.displacement_um - predicted
        square += float(np.sum((error - error.mean()) ** 2))
        count += error.size
    return 1e3 * float(np.sqrt(square / count))


# -- running ---------------------------------------------------------------------------------


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


# -- summary ---------------------------------------------------------------------------------


def named(finding: Row) -> set[str]:
    """The causes that a finding leaves open."""
    return {finding["cause"], *finding["alternatives"]}


def _share(hits: Iterable[bool]) -> str:
    flags = list(hits)
    return f"{sum(flags)}/{len(flags)}" if flags else "-"


def _within(value: float, interval: Sequence[float] | None) -> bool | None:
    return None if interval is None else interval[0] <= value <= interval[1]


def summary(rows: Sequence[Row]) -> str:
    """Everything counted, as Markdown."""
    failed = [r for r in rows if r["error"]]
    fine = [r for r in rows if not r["error"]]
    nulls = [r for r in fine if not r["truth"]["causes"]]
    strangers = [r for r in fine if r["truth"]["cause"].startswith("stranger:")]
    known = [r for r in fine if r["truth"]["causes"] and r not in strangers]
    single = [r for r in known if len(r["truth"]["causes"]) == 1]
    several = [r for r in known if len(r["truth"]["causes"]) > 1]
    parts = [
        f"{len(rows)} cases, {len(failed)} errors, median {_median_seconds(fine)} s a case",
        *(f"- error: {r['truth']['cause']} {r['protocol']} {r['noise']} {r['seed']}: {r['error']}"
          for r in failed[:10]),
        _nulls(nulls), _singles(single), _several(several), _strangers(strangers),
        f"False unexplained: {_share(r['unexplained']['detected'] for r in nulls)} nulls, "
        f"{_share(r['unexplained']['detected'] for r in known)} known effects "
        f"({_share(r['unexplained']['detected'] for r in known if r['truth']['form'][0] == 'A')} "
        "of form A)",
        _parameters(known), _gains(fine), _unseen(known),
    ]  # fmt: skip
    return "\n\n".join(p for p in parts if p)


def _median_seconds(rows: Sequence[Row]) -> str:
    return number(float(np.median([r["seconds"] for r in rows])) if rows else None, 1)


def _by(rows: Iterable[Row], key: Callable[[Row], Any]) -> list[tuple[Any, list[Row]]]:
    groups: dict[Any, list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return sorted(groups.items())


def _unexplained(rows: Iterable[Row]) -> int:
    return sum(r["unexplained"]["detected"] for r in rows)


def _nulls(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for (protocol, noise), group in _by(rows, lambda r: (r["protocol"], r["noise"])):
        wrong = sorted(f["cause"] for r in group for f in r["findings"])
        body.append((f"{protocol}, {noise}", len(group), sum(bool(r["findings"]) for r in group),
                     _unexplained(group), ", ".join(wrong)))  # fmt: skip
    for curved in (False, True):
        group = [r for r in rows if ("curved" in r["truth"]["form"]) == curved]
        body.append((f"all {'with' if curved else 'without'} curvature", len(group),
                     sum(bool(r["findings"]) for r in group), _unexplained(group), ""))  # fmt: skip
    return table(("nulls", "n", "false alarms", "unexplained", "named"), body)


def _singles(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for (cause, asked, form), group in _by(
        rows, lambda r: (r["truth"]["cause"], r["d_prime"], r["truth"]["form"][0])
    ):
        said = [r["findings"] for r in group]
        firsts = [f[0] for f in said if f]
        body.append((
            f"{cause} {form}", f"{asked:g}", len(group),
            sum(bool(f) or r["unexplained"]["detected"] for f, r in zip(said, group, strict=True)),
            sum(any(cause in named(f) for f in fs) for fs in said),
            sum(f["cause"] == cause for f in firsts),
            sum(cause in named(f) for f in firsts),
            sum(sum(cause not in named(f) for f in fs) for fs in said),
            _unexplained(group),
            ", ".join(_counted(f["cause"] for f in firsts if cause not in named(f))),
            sum(not r["truth"]["reached"] for r in group) or "",
        ))  # fmt: skip
    head = ("effect, form", "d'", "n", "detected", "in set", "first", "first or confounded",
            "further findings", "unexplained", "wrong first", "not reached")  # fmt: skip
    return table(head, body)


def _counted(names: Iterable[str]) -> list[str]:
    count: dict[str, int] = defaultdict(int)
    for n in names:
        count[n] += 1
    return [f"{n} {k}" for n, k in sorted(count.items(), key=lambda x: -x[1])]


def _several(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for asked, group in _by(rows, lambda r: r["d_prime"]):
        hit = missed = extra = 0
        for r in group:
            left = set(r["truth"]["causes"])
            for f in r["findings"]:
                match = next((c for c in (f["cause"], *f["alternatives"]) if c in left), None)
                if match is None:
                    extra += 1
                else:
                    left.remove(match)
                    hit += 1
            missed += len(left)
        f1 = 2 * hit / max(2 * hit + missed + extra, 1)
        body.append((f"{asked:g}", len(group), hit, missed, extra, number(f1, 3)))
    return table(("pairs, d'", "n", "found", "missed", "extra", "F1"), body)


def _strangers(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for (cause, asked), group in _by(rows, lambda r: (r["truth"]["cause"], r["d_prime"])):
        body.append((
            cause, f"{asked:g}", len(group),
            _unexplained(group),
            sum(bool(r["findings"]) for r in group),
            ", ".join(_counted(f["cause"] for r in group for f in r["findings"])),
        ))  # fmt: skip
    return table(("stranger", "d'", "n", "unexplained", "named", "as"), body)


def _parameters(rows: Sequence[Row]) -> str:
    hits: dict[str, list[bool]] = defaultdict(list)
    off: dict[str, list[float]] = defaultdict(list)
    for r in rows:
        for f in r["findings"]:
            true = r["truth"]["parameters"].get(f["cause"], {})
            for name, value in true.items():
                said = f["parameters"].get(name)
                inside = said and _within(value, said["ci95"])
                if inside is None or said is None:
                    continue
                hits[f"{f['cause']} {name}"].append(inside)
                half = 0.5 * (said["ci95"][1] - said["ci95"][0])
                off[f"{f['cause']} {name}"].append((said["value"] - value) / max(half, 1e-300))
    if not hits:
        return ""
    body = []
    for name, h in sorted(hits.items()):
        middle = (float(np.median(off[name])), float(np.median(np.abs(off[name]))))
        body.append((name, len(h), number(100 * float(np.mean(h)), 0),
                     *(number(m, 2) for m in middle)))  # fmt: skip
    every = [x for h in hits.values() for x in h]
    body.append(("all", len(every), number(100 * float(np.mean(every)), 1), "", ""))
    return table(("95 % interval holds", "n", "%", "median off / half width", "median |off|"), body)


def _gains(rows: Sequence[Row]) -> str:
    hits: dict[str, list[bool]] = defaultdict(list)
    off: dict[str, list[float]] = defaultdict(list)
    for r in rows:
        for f, true in zip(r["findings"], r.get("gains_again") or (), strict=False):
            inside = _within(true, f["gain_ci95"])
            if inside is not None:
                hits[r["noise"]].append(inside)
                off[r["noise"]].append(true - f["gain"])
    if not hits:
        return "Gains on a second session: not known (`rung_models`)"
    body = [(name, len(h), number(100 * float(np.mean(h)), 1), number(float(np.mean(off[name])), 2))
            for name, h in sorted(hits.items())]  # fmt: skip
    return table(("gain on a second session, in its interval", "n", "%", "mean off, points"), body)


def _unseen(rows: Sequence[Row]) -> str:
    shares: dict[str, list[float]] = defaultdict(list)
    for r in rows:
        u = r.get("unseen")
        if not u:
            continue
        possible = u["before_nm"] - u["possible_nm"]
        if possible > SHARE_FROM * u["before_nm"]:
            shares[r["truth"]["cause"]].append((u["before_nm"] - u["after_nm"]) / possible)
    if not shares:
        return ""
    body = [(name, len(s), *(number(float(np.quantile(s, q)), 2) for q in (0.1, 0.5, 0.9)))
            for name, s in sorted(shares.items())]  # fmt: skip
    every = [x for s in shares.values() for x in s]
    body.append(("all", len(every), *(number(float(np.quantile(every, q)), 2)
                                      for q in (0.1, 0.5, 0.9))))  # fmt: skip
    return table(("gain on an unseen drive, of the possible", "n", "10 %", "median", "90 %"), body)


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
        from piezo_rig.studies.diagnosis_document import write

        write(options.files, options.out)
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
