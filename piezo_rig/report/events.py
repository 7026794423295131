"""The events of a finding, one by one: a table of all, and the residual about each to step through.

With repeats a recording is drawn against the mean of the others, which have the same drive and the
same loop but not the same accidents; without, against the model.
"""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis import Diagnosis, Finding
from piezo_rig.diagnosis.events import Event, size_text, where_text
from piezo_rig.report.residuals import Residuals
from piezo_rig.report.svg import Curve, Panel, Plot, draw
from piezo_rig.report.views import OTHERS
from piezo_rig.report.words import nm, real_minus

FloatArray = NDArray[np.float64]
DRAWN = 24  # events with a figure of their own: the largest
NUMBERED = 12  # marks in the overview that have room for a number
POINTS = 500  # of a curve
WIDE = 560  # so narrow that the event itself is seen in a narrow window
AROUND_S = {"outliers": 0.01, "fringe-jump": 0.06, "dropped-samples": 0.15}


def events_html(
    found: Diagnosis, index: int, finding: Finding, residuals: Residuals | None,
    rungs: tuple[int, int],
) -> str:  # fmt: skip
    """Table and figures of a finding's events; ``rungs``: before they were mended, and after."""
    many = len(found.recordings) > 1
    figures = {} if residuals is None else _figures(found, finding, residuals, rungs)
    rows = []
    for k, e in enumerate(finding.events):
        where = escape(where_text(e, many))
        number = f'<a href="#event-{index}-{k}">{k + 1}</a>' if k in figures else f"{k + 1}"
        rows.append(f'<tr><td>{number}</td><td>{where}</td><td>{_when(e)}</td>'
                    f"<td>{escape(real_minus(size_text(finding.cause, e)))}</td></tr>")  # fmt: skip
    table = (
        '<div class="wide events" tabindex="0"><table class="list"><thead><tr><th>no.</th>'
        "<th>sweep</th><th>time in the sweep</th><th>how large</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )
    if not figures:
        return table
    largest = "" if len(figures) == len(finding.events) else f" (the {len(figures)} largest)"
    floor = "" if found.noise_floor_nm is None else (
        f" Grey: the noise floor of single readings, ±{nm(found.noise_floor_nm)}."
    )  # fmt: skip
    assert residuals is not None
    against = ("the mean of the other recordings of the same drive"
               if residuals.groups[0].repeats > 1 else "the model")  # fmt: skip
    shown = "\n".join(
        f'<div class="step" id="event-{index}-{k}">'
        f"{draw(p)}</div>"
        for k, p in figures.items()
    )
    return (
        f'{table}<figure class="steps"><p class="script" hidden>'
        '<button type="button" data-step="-1">previous</button>'
        '<button type="button" data-step="1">next event</button> <span class="at"></span></p>'
        f"{shown}<figcaption>Every event by itself{largest}: the recording against {against}, from "
        f"its level before the event, as recorded and mended.{floor}</figcaption></figure>"
    )


def _when(e: Event) -> str:
    low, high = e.between_s
    if high - low <= 0:
        return f"{e.time_s:.4f} s"
    return f'{e.time_s:.4f} s <span class="quiet">({low:.4f} to {high:.4f} s)</span>'


def marks_of(finding: Finding, residuals: Residuals) -> list[tuple[float, str]]:
    """Where the events stand on an axis of time since the recording began, with their numbers."""
    out = []
    for k, e in enumerate(finding.events):
        g, _, sample = e.place
        time = residuals.groups[0].groups[g].time_s
        at = float(time[min(sample, time.size - 1)] - time[0])
        out.append((at, f"{k + 1}" if len(finding.events) <= NUMBERED else ""))
    return out


def _figures(
    found: Diagnosis, finding: Finding, residuals: Residuals, rungs: tuple[int, int]
) -> dict[int, Plot]:
    """A figure to an event, by its number from 0."""
    events, many = finding.events, len(found.recordings) > 1
    order = sorted(range(len(events)), key=lambda k: -abs(events[k].size))[:DRAWN]
    known: dict[tuple[int, int], FloatArray] = {}
    out = {}
    for k in sorted(order):
        e = events[k]
        g, row, sample = e.place
        for rung in rungs:
            if (rung, g) not in known:
                known[rung, g] = residuals.own(rung, g)
        taken = residuals.samples[g].taken
        group = residuals.groups[0].groups[g]
        wide = max(20, round(AROUND_S.get(finding.cause, 0.06) * residuals.groups[0].rate))
        a, b = (int(i) for i in np.searchsorted(taken, [sample - wide, sample + wide + 1]))
        at = int(np.searchsorted(taken, sample)) - a
        if b - a < 8 or not 0 <= at < b - a:
            continue
        x = 1e3 * (group.time_s[taken[a:b]] - group.time_s[sample])
        curves = []
        for label, rung in zip(("as recorded", "mended"), rungs, strict=True):
            y = known[rung, g][row, a:b]
            before = y[:at] if at >= 4 else y
            curves.append(Curve(label, *_thinned(x, y - np.median(before))))
        title = f"{k + 1} of {len(events)}: {where_text(e, many)}, at {e.time_s:.4f} s"
        out[k] = Plot(
            [Panel(title, curves)], "time from the event (ms)", OTHERS
            if group.repeats > 1 else "measured minus model (nm)",
            f"The residual about event {k + 1}.", band=found.noise_floor_nm, x_unit="ms",
            marks=[(0.0, "")], drawn=WIDE,
        )  # fmt: skip
    return out


def _thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of neighbouring samples where there are too many to draw."""
    step = -(-x.size // POINTS)
    n = x.size // step * step
    return x[:n].reshape(-1, step).mean(axis=1), y[:n].reshape(-1, step).mean(axis=1)
