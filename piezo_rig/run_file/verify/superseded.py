"""Sweeps that were played again: kept, but neither counted nor held against the run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify.verdict import Verdict


def check_claims(run: Run, read: dict[str, dict[str, Any]]) -> list[Verdict]:
    """A sweep gives way only to a later one of its own condition and repeat.

    ``read`` holds the attributes of every sweep that has them, by name.
    """
    found = []
    for name, a in read.items():
        if "superseded_by" not in a:
            continue
        by = run.superseded.get(name, "")
        if not by:
            claim = str(a["superseded_by"])[:40]
            found.append(Verdict(
                "", True, f"{name} says that {claim!r} was played in its stead, which is no later "
                "sweep of this run",
            ))
        elif by in read and any(a[key] != read[by][key] for key in ("condition", "repeat")):
            found.append(Verdict(
                "", True, f"{name} says that {by} was played in its stead, which is of "
                f"{read[by]['condition']}, repeat {read[by]['repeat']}",
            ))
    return found


def as_notes(run: Run, found: list[Verdict]) -> list[Verdict]:
    """What was found in superseded sweeps is only said."""
    return [
        replace(v, fault=False, cause="",
                text=f"superseded by {run.superseded[v.sweep]}; {v.text}")
        if v.sweep in run.superseded and v.fault else v
        for v in found
    ]
