"""The page of many actuators: how they are distributed, which stand out and in what, what failed.

It shows at most so many rows; the table beside it (Parquet) has all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from piezo_rig import __version__
from piezo_rig.fleet.outliers import LEAST, LIMIT, Outlier, outliers, rare_findings, robust_z
from piezo_rig.fleet.table import COUNTS, DONE, FAILED, NAME, Row, columns_of
from piezo_rig.report.sheet import sheet
from piezo_rig.report.svg import Curve, Panel, Plot, draw
from piezo_rig.report.words import significant

MOST, FIGURES = 200, 30  # rows of a table, figures
BINS, NEAR = 24, 6.0  # of a distribution; robust z-scores that it shows
NOT_COMPARED = (".p_value",)
ENDINGS = (("um_per_v", "um/V"), ("_percent", "%"), ("_nm", "nm"), ("_um", "um"), ("_v", "V"))


@dataclass(frozen=True)
class Overview:
    """What there is to say of a table.

    Attributes
    ----------
    what : the verb's participle, ``identified`` or ``diagnosed``
    settings : what every item was analysed with, for people
    units : unit by column
    """

    what: str
    rows: Sequence[Row]
    settings: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def done(self) -> list[Row]:
        return [r for r in self.rows if r["status"] == DONE]

    @property
    def failed(self) -> list[Row]:
        return [r for r in self.rows if r["status"] == FAILED]

    def compared(self) -> list[str]:
        """Columns with a number in enough rows to compare them."""
        return [
            c for c in columns_of(self.rows)
            if c not in COUNTS and not c.endswith(NOT_COMPARED)
            and sum(_is_number(r.get(c)) for r in self.rows) >= LEAST
        ]

    def outliers(self) -> list[Outlier]:
        return outliers(self.rows, self.compared())

    def unit(self, column: str) -> str:
        """`` um``, `` %``; empty where there is none."""
        unit = self.units.get(column) or next(
            (unit for ending, unit in ENDINGS if column.endswith(ending)), ""
        )
        return "" if unit in ("", "1") else f" {unit}"


def _is_number(x: object) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and bool(np.isfinite(x))


def page(overview: Overview) -> str:
    """The page's text."""
    found = overview.outliers()
    rare = rare_findings(overview.rows)
    failed = overview.failed
    sections = [
        ("outliers", "Which stand out, and in what", _outliers(overview, found, rare)),
        ("findings", "What was found", _findings(overview)),
        ("distributions", "How they are distributed", _distributions(overview)),
        ("failures", "What failed, and why", _failures(failed)),
        ("provenance", "Where this comes from", _provenance(overview)),
    ]
    files = len({o.file for o in found} | {f for _, names in rare for f in names})
    verdict = [f"{len(overview.done)} of {len(overview.rows)} inputs were {overview.what}"
               + (f"; {len(failed)} failed." if failed else ".")]
    if len(overview.done) < LEAST:
        verdict.append(f"Fewer than {LEAST} are too few to say which is unusual.")
    else:
        verdict.append(f"{files or 'None'} of them stand{'s' if files <= 1 else ''} out from the "
                       "others." if files != 1 else "One of them stands out from the others.")
    title = f"{len(overview.rows)} actuators, {overview.what}"
    return sheet(title, verdict, bool(failed or files), sections)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], more: int = 0) -> str:
    """Cells are HTML already."""
    cells = "".join(f'<th scope="col">{escape(h)}</th>' for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    rest = f'<p class="quiet">and {more} more: {NAME} has them all</p>' if more > 0 else ""
    return f'<div class="wide"><table class="facts"><tr>{cells}</tr>{body}</table></div>{rest}'


def _outliers(
    overview: Overview, found: Sequence[Outlier], rare: Sequence[tuple[str, list[str]]]
) -> str:
    out = []
    if found:
        rows = [(escape(o.file), escape(o.actuator), escape(o.column),
                 escape(significant(o.value) + overview.unit(o.column)),
                 escape(significant(o.median) + overview.unit(o.column)),
                 significant(round(o.z or 0.0, 1))) for o in found[:MOST]]  # fmt: skip
        out.append(_table(("input", "actuator", "what is unusual", "value", "median of all",
                           "robust z"), rows, len(found) - MOST))  # fmt: skip
    for cause, files in rare:
        names = ", ".join(escape(f) for f in files)
        out.append(f"<p>Hardly any other shows <b>{escape(cause)}</b>: {names}.</p>")
    if not out:
        out.append("<p>None.</p>")
    out.append(f'<p class="quiet">Robust z: 0.6745 times the distance from the median, over the '
               f"median of all distances. Beyond ±{LIMIT:g} a value is called unusual; of "
               "values that are only noise, one in two thousand is. Skewed quantities, such as "
               "errors, have a few more.</p>")  # fmt: skip
    return "\n".join(out)


def _findings(overview: Overview) -> str:
    rows = [r for r in overview.done if r.get("findings") is not None]
    if not rows:
        return ""
    causes = sorted({c for r in rows for c in r["findings"]})
    counted = {c: [r for r in rows if c in r["findings"]] for c in causes}
    body = []
    for cause in sorted(causes, key=lambda c: (-len(counted[c]), c)):
        gains = [r[f"{cause}.gain_percent"] for r in counted[cause]
                 if _is_number(r.get(f"{cause}.gain_percent"))]  # fmt: skip
        gain = f"{significant(float(np.median(gains)))} %" if gains else "-"
        body.append((escape(cause), f"{len(counted[cause])} of {len(rows)}", gain))
    strange = sum(bool(r.get("unexplained")) for r in rows)
    none = sum(not r["findings"] for r in rows)
    return (_table(("cause", "actuators", "median gain"), body) if body else "") + (
        f"<p>No cause was named in {none}; something stays unexplained in {strange}.</p>"
    )


def _distributions(overview: Overview) -> str:
    columns = overview.compared()
    figures = [_distribution(overview, c) for c in columns[:FIGURES]]
    if len(columns) > FIGURES:
        figures.append(f'<p class="quiet">and {len(columns) - FIGURES} more in {NAME}</p>')
    return "\n".join(figures) or f"<p>Fewer than {LEAST} values of anything.</p>"


def _distribution(overview: Overview, column: str) -> str:
    having = [r for r in overview.done if _is_number(r.get(column))]
    values = np.array([float(r[column]) for r in having])
    near = values[np.abs(robust_z(values)) <= NEAR]
    low, high = float(near.min()), float(near.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        return (f"<p><b>{escape(column)}</b>: {significant(low)}"
                f"{escape(overview.unit(column))} in {near.size} of {values.size}.</p>")
    edges = np.linspace(low, high, BINS + 1)
    curves = []
    for origin in sorted({str(r.get("origin")) for r in having}):
        mine = np.array([float(r[column]) for r in having if str(r.get("origin")) == origin])
        counts = np.histogram(mine, edges)[0].astype(float)
        curves.append(Curve(origin, np.concatenate([edges[:1], np.repeat(edges, 2)[1:-1],
                                                    edges[-1:]]),
                            np.concatenate([[0.0], np.repeat(counts, 2), [0.0]])))  # fmt: skip
    beyond = values.size - near.size
    unit = overview.unit(column).strip()
    title = column + (f" ({beyond} beyond this range)" if beyond else "")
    median = float(np.median(values))
    return "<figure>" + draw(Plot(
        [Panel(title, curves)], f"{column} ({unit})" if unit else column, "actuators",
        f"Distribution of {column} over {values.size} actuators, median {significant(median)} "
        f"{unit}.", x_unit=unit, y_unit="", marks=((median, "median"),),
    )) + "</figure>"  # fmt: skip


def _failures(failed: Sequence[Row]) -> str:
    if not failed:
        return ""
    rows = [(escape(r["file"]), f"<code>{escape(r['error_code'])}</code>",
             escape(r["error_text"])) for r in failed[:MOST]]  # fmt: skip
    return _table(("input", "error", "what stopped"), rows, len(failed) - MOST)


def _provenance(overview: Overview) -> str:
    origins: dict[str, int] = {}
    for row in overview.done:
        origins[str(row.get("origin"))] = origins.get(str(row.get("origin")), 0) + 1
    rows = [
        ("inputs", ", ".join(f"{n} {escape(o)}" for o, n in sorted(origins.items())) or "none"),
        *((escape(k), escape(v)) for k, v in overview.settings.items()),
        ("table", f"{NAME}: one row to an input, with its SHA-256"),
        ("software", f"piezo-rig {escape(__version__)}"),
    ]
    cells = "".join(f'<tr><th scope="row">{k}</th><td>{v}</td></tr>' for k, v in rows)
    return f'<div class="wide"><table class="facts">{cells}</table></div>'
