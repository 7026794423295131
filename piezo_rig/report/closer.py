"""The figure to look closer with: the residual against the drive, any condition on any rung.

Without a script it shows the first and the last rung over all conditions; with one, every condition
by itself. The means in bins stand in the page as integers, hundredths of a nanometre.
"""

from __future__ import annotations

import json
from html import escape

import numpy as np

from piezo_rig.diagnosis import Diagnosis
from piezo_rig.report.residuals import Residuals, binned
from piezo_rig.report.svg import Panel, Plot, draw
from piezo_rig.report.views import DRIVE, curves_of

BINS, MOST = 48, 40  # bins of one curve; conditions that are offered


def closer_html(found: Diagnosis, residuals: Residuals) -> str:
    """The figure, what chooses in it, and its numbers."""
    last = residuals.rungs - 1
    panels = [Panel(f"with {found.rungs[0].added}", curves_of(residuals, 0, DRIVE))]
    if last:
        panels.append(Panel("with everything", curves_of(residuals, last, DRIVE)))
    plot = Plot(panels, DRIVE.x_label, "measured minus model (nm)",
                "Residual against drive, first and last rung, all conditions together.",
                band=found.noise_floor_nm, x_unit="V")  # fmt: skip
    rungs = [("" if i == 0 else "up to + ") + r.added for i, r in enumerate(found.rungs)]
    options = "".join(
        f'<option value="{i}"{" selected" if i == last else ""}>{escape(name)}</option>'
        for i, name in enumerate(rungs[: residuals.rungs])
    )
    conditions = _conditions(residuals)
    named = "".join(
        f'<option value="{k}">{escape(str(c["name"]))}</option>' for k, c in enumerate(conditions)
    )
    data = json.dumps({"floor": round(found.noise_floor_nm or 0.0, 3), "rungs": rungs,
                       "conditions": conditions}, separators=(",", ":"))  # fmt: skip
    # no tag can end the script early
    data = data.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return (
        "<figure>"
        '<p class="script" hidden><label>model <select>'
        f"{options}</select></label> <label>condition <select>"
        f'<option value="">all together, first and last model</option>{named}</select></label> '
        '<label><input type="checkbox"> one scale for all models</label></p>'
        f'<div class="view">{draw(plot)}</div>'
        "<figcaption>Means of the residual in bins of the drive, mean over repeats; grey: the "
        "noise floor.</figcaption>"
        f'<script type="application/json" id="closer-data">{data}</script></figure>'
    )


def _conditions(residuals: Residuals) -> list[dict[str, object]]:
    out: list[dict[str, object]] = []
    for g, s in enumerate(residuals.samples[:MOST]):
        drive = s.drive_v
        edges = np.linspace(float(drive.min()), float(drive.max()) + 1e-9, BINS + 1)
        xs: list[list[float]] = []
        ys: list[list[list[float]]] = [[] for _ in range(residuals.rungs)]
        for way in (1, -1):
            mask = s.direction * way > 0
            for r in range(residuals.rungs):
                b = binned([(drive[mask], residuals.mean(r, g)[mask], s.loop[mask])], edges)
                ys[r].append([round(float(v), 2) for v in b.mean])
                if r == 0:
                    xs.append([round(float(v), 3) for v in b.x])
        history = "from rest" if s.group.virgin else s.group.history
        out.append({"name": f"{s.group.condition or f'drive {g + 1}'} ({history})", "x": xs,
                    "y": ys})  # fmt: skip
    return out
