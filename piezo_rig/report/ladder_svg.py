"""The ladder of a diagnosis for a page: the same bars as in `ladder`, in the page's own colours."""

from __future__ import annotations

from html import escape

import numpy as np

from piezo_rig.diagnosis import Diagnosis
from piezo_rig.diagnosis.found import NO_FINDINGS
from piezo_rig.report.svg import number
from piezo_rig.report.words import gain_text, nm

WIDTH, ROW, TOP, BOTTOM = 900, 34, 40, 46
NAMES, BARS = 190, 330  # widths of the first two columns
RMS, WORST, GAIN = NAMES + BARS + 70, NAMES + BARS + 132, NAMES + BARS + 152
LONGEST = 26  # letters of a name


def ladder_svg(found: Diagnosis) -> str:
    """One row to a rung: name, bar, rms, largest error, gain."""
    values = [max(r.rms_nm, 1e-6) for r in found.rungs]
    shown = values + ([found.noise_floor_nm] if found.noise_floor_nm else [])
    low, high = min(shown) / 1.3, max(shown) * 1.25
    if high / low < 4.0:  # an axis of less than half a decade says little
        middle = float(np.sqrt(low * high))
        low, high = middle / 2.0, middle * 2.0

    def at(value: float) -> float:
        return NAMES + BARS * float(np.log(value / low) / np.log(high / low))

    bottom = TOP + ROW * len(values)
    out = [
        f'<svg class="ladder" viewBox="0 0 {WIDTH} {bottom + BOTTOM}" role="img" aria-label='
        f'"The ladder: rms error of the model and of every extension, {values[0]:.3g} nm at the '
        f'top, {values[-1]:.3g} nm at the bottom">',
        _text(0, 16, "model and what was added", "tick"), _text(RMS, 16, "rms (nm)", "tick", "end"),
        _text(WORST, 16, "max (%)", "tick", "end"), _text(GAIN, 16, "gain (95 % interval)", "tick"),
    ]
    for v in _decades(low, high):
        out.append(f'<path class="grid" d="M{at(v):.1f} {TOP - 6}V{bottom}"/>')
        out.append(_text(at(v), bottom + 16, number(v), "tick", "middle"))
    out.append(_text(NAMES + BARS / 2, bottom + 36, "rms error (nm, logarithmic)", "label",
                     "middle"))  # fmt: skip
    if found.noise_floor_nm:
        x = at(found.noise_floor_nm)
        out.append(f'<path class="floor" d="M{x:.1f} {TOP - 10}V{bottom}"/>')
        left = x < NAMES + BARS / 2
        text = f"noise floor {nm(found.noise_floor_nm)}"
        out.append(_text(x + (4 if left else -4), TOP - 8, text, "floor-text",
                         "start" if left else "end"))  # fmt: skip
    before = None
    for i, (rung, value) in enumerate(zip(found.rungs, values, strict=True)):
        y = TOP + ROW * i + ROW / 2
        finding = None if rung.finding is None else found.findings[rung.finding]
        name = rung.added if len(rung.added) <= LONGEST else rung.added[: LONGEST - 1] + "…"
        label = _text(0, y + 5, f"+ {name}" if i else name, "name" if finding or not i else "base")
        if finding is not None:
            label = f'<a href="#finding-{rung.finding}">{label}</a>'
        out.append(label)
        if before is not None:
            out.append(f'<path class="drop" d="M{at(before):.1f} {y - ROW:.1f}V{y:.1f}"/>')
            kind = "worse" if value > before else "better" if finding else "quiet"
            a, b = sorted((at(before), at(value)))
            out.append(f'<rect class="{kind}" x="{a:.1f}" y="{y - 5:.1f}" '
                       f'width="{max(b - a, 1):.1f}" height="10"/>')  # fmt: skip
        out.append(f'<circle class="{"dot" if finding else "dot quiet-dot"}" cx="{at(value):.1f}" '
                   f'cy="{y:.1f}" r="5"/>')  # fmt: skip
        gain, kind = "the baseline" if i == 0 else "", "tick"
        if finding is not None:
            gain, kind = gain_text(finding).replace("95 %: ", ""), "figure"
            if finding.events:
                gain = f"{len(finding.events)} event{'' if len(finding.events) == 1 else 's'}"
        elif rung.added in NO_FINDINGS:
            gain = NO_FINDINGS[rung.added]
        out += [_text(RMS, y + 5, f"{rung.rms_nm:.2f}", "figure", "end"),
                _text(WORST, y + 5, f"{rung.max_percent:.2f}", "figure", "end"),
                _text(GAIN, y + 5, gain, kind)]  # fmt: skip
        before = value
    return "\n".join([*out, "</svg>"])


def _text(x: float, y: float, text: str, kind: str, anchor: str = "start") -> str:
    return (f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">'
            f"{escape(text)}</text>")  # fmt: skip


def _decades(low: float, high: float) -> list[float]:
    steps = (1, 2, 5) if high / low < 300 else (1,)
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [v for p in powers for m in steps if low <= (v := m * 10.0**p) <= high]
