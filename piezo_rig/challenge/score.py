"""What answers are worth: figures beside the oracle's, and whether they are good enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_rig.causes.catalogue import CAUSES
from piezo_rig.challenge.answers import oracle_row
from piezo_rig.scoring.counts import (
    Row,
    matrix,
    named,
    null_table,
    parameter_table,
    several_table,
    share,
    stranger_table,
    within,
)
from piezo_rig.scoring.tables import number, table

MOST_FALSE = 0.02  # share of cases with nothing in them in which something is found
LEAST_FIRST = 0.90  # share of cases with a cause in them whose first finding is right


@dataclass(frozen=True)
class Figures:
    """Counts of one competitor; a failure is a false alarm or a miss, whichever applies."""

    cases: int
    failures: int
    nulls: int
    false_alarms: int
    known: int
    detected: int
    first: int
    first_fair: int
    strangers: int
    admitted: int
    false_unexplained: int
    further: int
    covered: int
    alternatives: float | None

    @property
    def passed(self) -> bool:
        """Few enough false alarms and enough right first findings: exit status 0."""
        few = self.false_alarms <= MOST_FALSE * self.nulls
        return few and self.first_fair >= LEAST_FIRST * self.known


def first_is_fair(row: Row) -> bool:
    """The first finding is hidden; or what is hidden stands among its alternatives, and the
    oracle cannot tell the two apart in these recordings either."""
    if not row["findings"]:
        return False
    first = row["findings"][0]
    causes = row["truth"]["causes"]
    if first["cause"] in causes:
        return True
    taken_for = {f["cause"]: {f["cause"], *f["alternatives"]}
                 for f in row["truth"]["oracle"]["findings"]}  # fmt: skip
    return any(
        c in first["alternatives"]
        and any({c, first["cause"]} <= either for either in taken_for.values())
        for c in causes
    )


def _sort(row: Row) -> str:
    causes = row["truth"]["causes"]
    if not causes:
        return "null"
    return "stranger" if causes[0].startswith("stranger:") else "known"


def figures(rows: Sequence[Row]) -> Figures:
    """Counted from rows of `answers.row_of`."""
    nulls = [r for r in rows if _sort(r) == "null"]
    known = [r for r in rows if _sort(r) == "known"]
    strangers = [r for r in rows if _sort(r) == "stranger"]
    firsts = [r for r in known if r["findings"]]
    sizes = [len(r["findings"][0]["alternatives"]) for r in firsts]
    return Figures(
        cases=len(rows),
        failures=sum(bool(r["error"]) for r in rows),
        nulls=len(nulls),
        false_alarms=sum(bool(r["error"] or r["findings"]) for r in nulls),
        known=len(known),
        detected=sum(bool(r["findings"]) or r["unexplained"]["detected"] for r in known),
        first=sum(r["findings"][0]["cause"] in r["truth"]["causes"] for r in firsts),
        first_fair=sum(first_is_fair(r) for r in known),
        strangers=len(strangers),
        admitted=sum(r["unexplained"]["detected"] for r in strangers),
        false_unexplained=sum(r["unexplained"]["detected"] for r in [*nulls, *known]),
        further=sum(
            not named(f) & set(r["truth"]["causes"]) for r in known for f in r["findings"]
        ),
        covered=sum(bool(named(r["findings"][0]) & set(r["truth"]["causes"])) for r in firsts),
        alternatives=float(np.mean(sizes)) if sizes else None,
    )


def score_text(rows: Sequence[Row]) -> str:
    """Every table, as Markdown; the oracle beside."""
    mine, oracle = figures(rows), figures([oracle_row(r["truth"]) for r in rows])
    known = [r for r in rows if _sort(r) == "known" and not r["error"]]
    parts = [
        _headline(mine, oracle), _gains(known), _cases(rows), _unknown_ids(rows),
        null_table([r for r in rows if _sort(r) == "null" and not r["error"]]),
        several_table([r for r in known if len(r["truth"]["causes"]) > 1]),
        stranger_table([r for r in rows if _sort(r) == "stranger" and not r["error"]]),
        parameter_table(known), matrix(rows),
    ]  # fmt: skip
    return "\n\n".join(p for p in parts if p)


def _headline(mine: Figures, oracle: Figures) -> str:
    def both(one: Callable[[Figures], Any]) -> tuple[Any, Any]:
        return one(mine), one(oracle)

    def of(count: str, total: str) -> tuple[Any, Any]:
        return both(lambda f: f"{getattr(f, count)}/{getattr(f, total)}")

    return table(("figure", "here", "oracle"), [
        ("cases", *both(lambda f: f.cases)),
        ("failures", *both(lambda f: f.failures)),
        ("false alarms: nulls in which something is found", *of("false_alarms", "nulls")),
        ("detected: a known cause shows at all", *of("detected", "known")),
        ("first: the first finding is hidden", *of("first", "known")),
        ("first, or told apart by nobody", *of("first_fair", "known")),
        ("alternatives: the first finding's set holds the truth", *of("covered", "known")),
        ("alternatives a first finding has", *both(lambda f: number(f.alternatives, 1))),
        ("findings beside the truth", *both(lambda f: f.further)),
        ("strangers called unexplained", *of("admitted", "strangers")),
        ("false unexplained", *both(lambda f: f"{f.false_unexplained}/{f.nulls + f.known}")),
    ])  # fmt: skip


def _gains(known: Sequence[Row]) -> str:
    """What was promised beside what somebody gains who knows the effect."""
    pairs = [
        (f, true)
        for r in known for f, true in zip(r["findings"], r["gains_again"], strict=True)
        if true is not None and f["gain"] is not None
    ]  # fmt: skip
    if not pairs:
        return ""
    off = [f["gain"] - true for f, true in pairs]
    hits = [h for f, true in pairs if (h := within(true, f["gain_ci95"])) is not None]
    head = ("gain beside the oracle's", "n", "median off, points", "largest off", "in its interval")
    return table(head,
                 [("true findings", len(pairs), number(float(np.median(off)), 2),
                   number(float(np.abs(off).max()), 1), share(hits))])  # fmt: skip


def _cases(rows: Sequence[Row]) -> str:
    """One line per case: the truth opened."""
    body = []
    for r in rows:
        t = r["truth"]
        said = "; ".join(
            f["cause"] + (f" (or {', '.join(f['alternatives'])})" if f["alternatives"] else "")
            for f in r["findings"]
        ) or "-"  # fmt: skip
        if r["unexplained"]["detected"]:
            said += "; unexplained"
        if r["error"]:
            said = f"failed: {r['error']}"
        oracle = ", ".join(f["cause"] for f in t["oracle"]["findings"]) or "-"
        if t["oracle"]["unexplained"]:
            oracle += ", unexplained"
        size = ", ".join(f"{d:.0f}" for d in t["d_prime"])
        body.append((t["case"], f"{t['protocol']}, {t['noise']}", t["cause"], size, said, oracle))
    return table(("case", "played", "hidden", "d'", "said", "oracle"), body)


def _unknown_ids(rows: Sequence[Row]) -> str:
    """What an answer calls a cause and the catalogue does not."""
    return "\n".join(
        f"- {r['truth']['case']}: {name[:60]!r} is no id of docs/causes.md and counts as wrong"
        for r in rows for f in r["findings"] for name in (f["cause"], *f["alternatives"])
        if name not in CAUSES
    )  # fmt: skip
