"""What a program says of a case: the diagnosis JSON, and what of it is scored."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from piezo_rig.errors import InputError
from piezo_rig.resources import read_text
from piezo_rig.scoring.counts import Row, named


def read_answer(path: Path) -> dict[str, Any]:
    """A diagnosis JSON; only `findings` has to be there.

    Raises
    ------
    InputError : not there, not JSON, or not of the contract's shape
    """
    try:
        answer = json.loads(read_text(path, "diagnosis JSON"))
        return _said(answer)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError("challenge-answer", f"{path}: {type(error).__name__}: {error}",
                         "not the diagnosis JSON that docs/challenge.md describes",
                         "mend the program that wrote it") from None  # fmt: skip


def _said(answer: Mapping[str, Any]) -> dict[str, Any]:
    rest = answer.get("unexplained") or {}
    return {
        "findings": [
            {
                "cause": str(f["cause"]),
                "p": f.get("p_value"),
                "gain": _number(f.get("gain_percent")),
                "gain_ci95": _interval(f.get("gain_ci95")),
                "parameters": {
                    str(n): {"value": _number(p["value"]), "ci95": _interval(p.get("ci95"))}
                    for n, p in (f.get("parameters") or {}).items()
                    if not isinstance(p["value"], list)
                },
                "alternatives": [str(a) for a in f.get("alternatives") or []],
            }
            for f in answer["findings"]
        ],
        "unexplained": {"detected": bool(rest.get("detected", False))},
    }


def _number(x: Any) -> float | None:
    return None if x is None else float(x)


def _interval(x: Any) -> list[float] | None:
    if x is None:
        return None
    low, high = (float(v) for v in x)
    return [low, high]


def row_of(
    truth: Mapping[str, Any], said: Mapping[str, Any] | None, error: str | None = None,
    seconds: float | None = None,
) -> Row:  # fmt: skip
    """What `scoring.counts` counts: truth and answer of one case side by side."""
    row: Row = {
        "kind": truth["cause"], "seed": truth["case"], "protocol": truth["protocol"],
        "noise": truth["noise"], "d_prime": truth["asked"], "truth": dict(truth),
        "error": error, "seconds": seconds, "findings": [], "unexplained": {"detected": False},
    }  # fmt: skip
    if said is not None:
        row |= said
    row["gains_again"] = oracle_gains(truth, row["findings"])
    return row


def oracle_row(truth: Mapping[str, Any]) -> Row:
    """The same for the oracle."""
    findings = [
        {**f, "gain": None, "gain_ci95": None, "parameters": {}}
        for f in truth["oracle"]["findings"]
    ]
    rest = {"detected": truth["oracle"]["unexplained"]}
    return row_of(truth, {"findings": findings, "unexplained": rest})


def oracle_gains(truth: Mapping[str, Any], findings: list[Row]) -> list[float | None]:
    """What each finding gains for somebody who knows its true form, in the order given, per cent.

    None for a cause that is not hidden, and for events, which nothing foretells.
    """
    out: list[float | None] = []
    taken: list[str] = []
    for f in findings:
        meant = next((c for c in truth["causes"] if c in named(f) and c not in taken), None)
        if meant is None:
            out.append(None)
            continue
        before = truth["left_nm"]["+".join(sorted(taken))]
        taken.append(meant)
        after = truth["left_nm"]["+".join(sorted(taken))]
        out.append(100.0 * (1.0 - after / before))
    return out
