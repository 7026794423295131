"""What a program says of a case: the diagnosis JSON, and what of it is scored."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezo_rig.errors import InputError
from piezo_rig.resources import read_text
from piezo_rig.scoring.counts import Row, named

SHOWN = 60  # characters of what stands where something else is expected


def read_answer(path: Path) -> dict[str, Any]:
    """A diagnosis JSON; only `findings` has to be there.

    Raises
    ------
    InputError : not there, not JSON, or not of the contract's shape; names the field
    """
    text = read_text(path, "diagnosis JSON")
    try:
        answer = json.loads(text)
    except json.JSONDecodeError as error:
        what = f"line {error.lineno}, column {error.colno}: not JSON" if text.strip() else "empty"
        raise _refused(f"{path}: {what}") from None
    except (ValueError, RecursionError):  # a number of thousands of digits; brackets as many
        raise _refused(f"{path}: not JSON of a sensible size") from None
    return _said(_Field(path, "", answer))


def _refused(what: str) -> InputError:
    return InputError("challenge-answer", what,
                      "not the diagnosis JSON that docs/challenge.md describes",
                      "mend the program that wrote it")  # fmt: skip


@dataclass(frozen=True)
class _Field:
    """A value of an answer, and where it stands: ``findings[0].cause``. null is as good as missing.

    Every method raises `InputError` where the value is not what its name says.
    """

    path: Path
    name: str
    value: Any

    def wrong(self, expected: str) -> InputError:
        found = "missing" if self.value is None else json.dumps(self.value)
        found = found if len(found) <= SHOWN else found[:SHOWN] + " ..."
        what = f"{self.name} is {found}" if self.name else f"it is {found}"
        return _refused(f"{self.path}: {what}; expected {expected}")

    def fields(self) -> dict[str, _Field]:
        """Of an object; none where it is missing."""
        if self.value is None and self.name:
            return {}
        if not isinstance(self.value, dict):
            raise self.wrong('an object, {"name": value}')
        dot = "." if self.name else ""
        return {k: _Field(self.path, f"{self.name}{dot}{k}", v) for k, v in self.value.items()}

    def field(self, key: str) -> _Field:
        """Of an object, one that may be missing."""
        dot = "." if self.name else ""
        return self.fields().get(key, _Field(self.path, f"{self.name}{dot}{key}", None))

    def items(self, of: str) -> list[_Field]:
        if not isinstance(self.value, list):
            raise self.wrong(f"a list of {of}")
        return [_Field(self.path, f"{self.name}[{i}]", v) for i, v in enumerate(self.value)]

    def cause(self) -> str:
        if not isinstance(self.value, str):
            raise self.wrong('the id of a cause, such as "creep"')
        return self.value

    def number(self) -> float | None:
        value = self.value
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not _finite(value):
            raise self.wrong("a finite number")
        return float(value)

    def interval(self) -> list[float] | None:
        if self.value is None:
            return None
        if not isinstance(self.value, list) or len(self.value) != 2:
            raise self.wrong("two numbers, [low, high]")
        low, high = (item.number() for item in self.items("numbers"))
        if low is None or high is None or low > high:
            raise self.wrong("two numbers, [low, high]")
        return [low, high]

    def flag(self) -> bool:
        if self.value is not None and not isinstance(self.value, bool):
            raise self.wrong("true or false")
        return bool(self.value)


def _finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond any float
        return False


def _said(answer: _Field) -> dict[str, Any]:
    return {
        "findings": [_finding(f) for f in answer.field("findings").items("findings")],
        "unexplained": {"detected": answer.field("unexplained").field("detected").flag()},
    }


def _finding(f: _Field) -> dict[str, Any]:
    alternatives = f.field("alternatives")
    return {
        "cause": f.field("cause").cause(),
        "p": f.field("p_value").number(),
        "gain": f.field("gain_percent").number(),
        "gain_ci95": f.field("gain_ci95").interval(),
        "parameters": {
            n: _parameter(p)
            for n, p in f.field("parameters").fields().items()
            if not isinstance(p.field("value").value, list)  # of several events
        },
        "alternatives": [
            a.cause() for a in ([] if alternatives.value is None else alternatives.items("ids"))
        ],
    }


def _parameter(p: _Field) -> dict[str, Any]:
    value, interval = p.field("value"), p.field("ci95").interval()
    if value.value is None and interval is not None:
        raise value.wrong("the number that ci95 is of")
    return {"value": value.number(), "ci95": interval}


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
