"""Rows of a hidden-effect study or of a challenge, counted."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from piezo_rig.scoring.tables import number, table

Row = dict[str, Any]  # one case: what was hidden, what was said of it

PLAIN = 40.0  # d' of a stranger off what is known, from which on it is one for an oracle
SHARE_FROM = 0.05  # of the error on the unseen drive that the effect must make up to be counted


def named(finding: Row) -> set[str]:
    """The causes that a finding leaves open."""
    return {finding["cause"], *finding["alternatives"]}


def share(hits: Iterable[bool]) -> str:
    flags = list(hits)
    return f"{sum(flags)}/{len(flags)}" if flags else "-"


def within(value: float, interval: Sequence[float] | None) -> bool | None:
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
        null_table(nulls), _singles(single), several_table(several), stranger_table(strangers),
        f"False unexplained: {share(r['unexplained']['detected'] for r in nulls)} nulls, "
        f"{share(r['unexplained']['detected'] for r in known)} known effects "
        f"({share(r['unexplained']['detected'] for r in known if r['truth']['form'][0] == 'A')} "
        "of form A)",
        parameter_table(known), _gains(fine), _unseen(single),
    ]  # fmt: skip
    return "\n\n".join(p for p in parts if p)


def _median_seconds(rows: Sequence[Row]) -> str:
    return number(float(np.median([r["seconds"] for r in rows])) if rows else None, 1)


def _by(rows: Iterable[Row], key: Callable[[Row], Any]) -> list[tuple[Any, list[Row]]]:
    groups: dict[Any, list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return sorted(groups.items())


def called_unexplained(rows: Iterable[Row]) -> int:
    return sum(r["unexplained"]["detected"] for r in rows)


def null_table(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for (protocol, noise), group in _by(rows, lambda r: (r["protocol"], r["noise"])):
        wrong = sorted(f["cause"] for r in group for f in r["findings"])
        body.append((f"{protocol}, {noise}", len(group), sum(bool(r["findings"]) for r in group),
                     called_unexplained(group), ", ".join(wrong)))  # fmt: skip
    for curved in (False, True):
        group = [r for r in rows if ("curved" in r["truth"]["form"]) == curved]
        found = sum(bool(r["findings"]) for r in group)
        body.append((f"all {'with' if curved else 'without'} curvature", len(group), found,
                     called_unexplained(group), ""))  # fmt: skip
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
            called_unexplained(group),
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


def several_table(rows: Sequence[Row]) -> str:
    """Several effects at once; each is plain off the others.

    An oracle names just those, and with them what it cannot tell from one of them (``not_told`` of
    a row: cause -> causes; nothing where it was not asked).
    """
    if not rows:
        return ""
    body = []

    def played(apart: bool) -> list[tuple[tuple[int, str, float], list[Row]]]:
        return _by(rows, lambda r: (
            len(r["truth"]["causes"]), r["protocol"] if apart else "all", r["d_prime"],
        ))  # fmt: skip

    several = len({r.get("protocol") for r in rows}) > 1
    for (count, protocol, asked), group in [*(played(True) if several else []), *played(False)]:
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
        reported = [set().union(*(named(f) for f in r["findings"])) for r in group]
        oracles = [set(r["truth"]["causes"]).union(*r.get("not_told", {}).values()) for r in group]
        body.append((
            count, protocol, f"{asked:g}", len(group), hit, missed, extra, number(f1, 3),
            sum(len(r["findings"]) <= count for r in group),
            sum(len(s) <= count for s in reported), called_unexplained(group),
            sum(len(s) <= len(o) for s, o in zip(reported, oracles, strict=True)),
        ))  # fmt: skip
    head = ("effects at once", "protocol", "d'", "n", "found", "missed", "extra", "F1",
            "no more than hidden", "nor alternatives", "unexplained",
            "no more than the oracle's")  # fmt: skip
    return table(head, body)


def stranger_table(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    body = []
    for (cause, asked), group in _by(rows, lambda r: (r["truth"]["cause"], r["d_prime"])):
        body.append((
            cause, f"{asked:g}", len(group),
            called_unexplained(group),
            sum(bool(r["findings"]) for r in group),
            ", ".join(_counted(f["cause"] for r in group for f in r["findings"])),
            _median(r.get("off_known") for r in group),
        ))  # fmt: skip
    far = [r for r in rows if r.get("off_known", 0.0) >= PLAIN]
    said = f"\n\nOf those with d' {PLAIN:g} and more off every known cause unexplained: " + share(
        r["unexplained"]["detected"] for r in far
    )
    head = ("stranger", "d'", "n", "unexplained", "named", "as", "d' off the nearest cause")
    return table(head, body) + (said if far else "")


def _median(values: Iterable[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{float(np.median(known)):.0f}" if known else ""


def parameter_table(rows: Sequence[Row]) -> str:
    hits: dict[str, list[bool]] = defaultdict(list)
    off: dict[str, list[float]] = defaultdict(list)
    for r in rows:
        for f in r["findings"]:
            true = r["truth"]["parameters"].get(f["cause"], {})
            for name, value in true.items():
                said = f["parameters"].get(name)
                inside = said and within(value, said["ci95"])
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
            inside = within(true, f["gain_ci95"])
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


def isolation(rows: Sequence[Row]) -> dict[str, Counter[str]]:
    """True cause -> first finding -> how often; strangers are one row, failures are left out."""
    counts: dict[str, Counter[str]] = {}
    for r in rows:
        if r["error"]:
            continue
        truth = r["truth"]["cause"]
        truth = "stranger" if truth.startswith("stranger:") else truth
        first = r["findings"][0]["cause"] if r["findings"] else "nothing"
        counts.setdefault(truth, Counter())[first] += 1
    return counts


def matrix(rows: Sequence[Row]) -> str:
    """True cause against the first finding, counted."""
    counts = isolation(rows)
    columns = sorted({c for row in counts.values() for c in row})
    body = [(t, *(counts[t][c] or "" for c in columns)) for t in sorted(counts)]
    return table(("hidden, first finding", *columns), body)
