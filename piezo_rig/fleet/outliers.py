"""Which rows of a table differ from the others, and in what.

The robust z-score: 0.6745 (x - median) / MAD, an outlier beyond 3.5 (Iglewicz and Hoaglin, How to
Detect and Handle Outliers, 1993). Half of the rows may be wild before it fails. Where more than
half of all values are the same the MAD is 0, and the mean absolute deviation takes its place, as
they advise. Real, simulated and imported data are each compared among themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.fleet.table import DONE, Row

LIMIT = 3.5
LEAST = 8  # rows with a value, below which nothing is called unusual
RARE, RARE_OF = 0.02, 50  # a cause in less than this share of at least so many rows is unusual


@dataclass(frozen=True)
class Outlier:
    """One value that stands out; ``z`` is None for a finding that few have."""

    file: str
    actuator: str
    column: str
    value: float
    median: float
    z: float | None


def robust_z(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robust z-scores, shape (n,); 0 everywhere if all values are the same."""
    median = np.median(values)
    away = values - median
    mad = np.median(np.abs(away))
    if mad > 0.0:
        return np.asarray(0.6745 * away / mad)
    mean = np.mean(np.abs(away))
    return np.asarray(away / (1.253314 * mean)) if mean > 0.0 else np.zeros_like(away)


def outliers(rows: Sequence[Row], columns: Sequence[str]) -> list[Outlier]:
    """All outliers of these columns, the farthest first."""
    found = []
    for origin in sorted({str(row.get("origin")) for row in rows if row["status"] == DONE}):
        mine = [r for r in rows if r["status"] == DONE and str(r.get("origin")) == origin]
        for column in columns:
            having = [r for r in mine if isinstance(r.get(column), int | float)
                      and np.isfinite(r[column])]  # fmt: skip
            if len(having) < LEAST:
                continue
            values = np.array([float(r[column]) for r in having])
            median = float(np.median(values))
            for row, z in zip(having, robust_z(values), strict=True):
                if abs(z) > LIMIT:
                    found.append(Outlier(row["file"], row.get("actuator") or "", column,
                                         float(row[column]), median, float(z)))  # fmt: skip
    found.sort(key=lambda o: (-abs(o.z or 0.0), o.file, o.column))
    return found


def rare_findings(rows: Sequence[Row]) -> list[tuple[str, list[str]]]:
    """Causes that hardly any other actuator shows, with the files that do."""
    done = [r for r in rows if r["status"] == DONE and r.get("findings") is not None]
    if len(done) < RARE_OF:
        return []
    causes = sorted({c for r in done for c in r["findings"]})
    having = {c: [r["file"] for r in done if c in r["findings"]] for c in causes}
    return [(c, files) for c, files in having.items() if len(files) < RARE * len(done)]
