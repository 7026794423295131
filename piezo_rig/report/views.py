"""Which plot of the residual reveals which cause, and that plot before and after its rung.

A view says what to draw the residual against and how to part the samples. A cause that has no view
here is drawn against the drive, so a new one needs nothing in this file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from piezo_rig.causes.periodic_nonlinearity import HALF_WAVE_UM
from piezo_rig.report.residuals import Residuals, Samples, binned
from piezo_rig.report.svg import Curve, Panel, Plot, limits_of

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
Parts = list[tuple[str, list[Mask]]]
BINS = 72
NEIGHBOURS = 11  # samples
FEWEST = 4  # bins
CLASSES = 4  # curves of one plot, at most
RINGS_S = 0.05  # after a corner
SHARE = 0.25  # of the half loops that a bin must hold, where a curve is to be one population


@dataclass(frozen=True)
class View:
    """What the residual is drawn against.

    Attributes
    ----------
    x : values of one group's samples
    x_label, x_unit : what they are
    part : how the samples are parted into curves
    log : x is logarithmic
    along : the residual is counted in the direction of the motion
    bins : how many
    most : x above it is left out
    envelope : largest and smallest residual of every bin, not their mean
    local : what single samples stand off their neighbours
    centred : every half loop is counted from its own mean
    own : what single recordings have of their own, where a drive was recorded more than once
    whole : no more bins than there are cycles
    text : one sentence for the caption
    """

    x: Callable[[Samples], FloatArray]
    x_label: str
    x_unit: str
    part: Callable[[Sequence[Samples]], Parts]
    text: str
    log: bool = False
    along: bool = False
    bins: int = BINS
    most: float = np.inf
    envelope: bool = False
    local: bool = False
    centred: bool = False
    own: bool = False
    whole: bool = False


def _all(samples: Sequence[Samples]) -> Parts:
    return [("mean", [np.ones(s.taken.size, bool) for s in samples])]


def _directions(samples: Sequence[Samples]) -> Parts:
    return [("drive rising", [s.direction > 0 for s in samples]),
            ("drive falling", [s.direction < 0 for s in samples])]  # fmt: skip


def _first_rise(samples: Sequence[Samples]) -> Parts:
    return [("first rise from rest", [s.first_rise for s in samples]),
            ("later rises", [~s.first_rise & (s.direction > 0) for s in samples])]  # fmt: skip


def _halves(samples: Sequence[Samples]) -> Parts:
    middles = [0.5 * (s.displacement_um.min() + s.displacement_um.max()) for s in samples]
    upper = [s.displacement_um > m for s, m in zip(samples, middles, strict=True)]
    return [("upper half of the travel", upper),
            ("lower half", [~mask for mask in upper])]  # fmt: skip


def _classes(
    name: str, unit: str, of: Callable[[Samples], FloatArray]
) -> Callable[[Sequence[Samples]], Parts]:
    """Parted by the size of something, in classes of about as many samples each."""

    def part(samples: Sequence[Samples]) -> Parts:
        values = [of(s) for s in samples]
        every = np.concatenate(values)
        cuts = np.unique(np.quantile(every, np.linspace(0, 1, CLASSES + 1)))
        if cuts.size < 2 or np.ptp(every) < 1e-6 * max(abs(float(every.max())), 1e-12):
            return [("mean", [np.ones(v.size, bool) for v in values])]
        parts: Parts = []
        for k, (a, b) in enumerate(pairwise(cuts)):
            last = k == cuts.size - 2
            masks = [(v >= a) & ((v <= b) if last else (v < b)) for v in values]
            inside = np.concatenate([v[m] for v, m in zip(values, masks, strict=True)])
            if inside.size:
                low, high = (f"{x:.3g}" for x in (inside.min(), inside.max()))
                span_text = low if low == high else f"{low} to {high}"
                parts.append((f"{name} {span_text} {unit}", masks))
        return parts

    return part


_SINCE = View(
    lambda s: s.since_turn_s, "time since the turning point (s, logarithmic)", "s", _directions,
    "A lag shows just after the turning point, as two curves that lie apart, one for each "
    "direction.", log=True,
)  # fmt: skip
_LAST = View(
    lambda s: s.since_turn_s, "time since the turning point (s, logarithmic)", "s", _directions,
    "All half loops together, by how long ago the drive has turned.", log=True,
)  # fmt: skip
_RELAXING = View(
    lambda s: s.since_turn_s, "time since the turning point (s, logarithmic)", "s", _directions,
    "Every half loop from its own mean: what goes on moving after the drive has turned shows as a "
    "slope or a bend.", log=True, centred=True,
)  # fmt: skip
_RINGING = View(
    lambda s: s.since_turn_s, "time since the turning point (s, logarithmic)", "s", _directions,
    "Every half loop from its own mean: ringing shows as waves in the first milliseconds after "
    "the drive has turned.", log=True, bins=150, most=RINGS_S, centred=True,
)  # fmt: skip
_CLOCK = View(
    lambda s: s.time_s, "time since the recording began (s)", "s", _all,
    "What goes on with the clock, whatever the drive does, shows as a slope from the beginning of "
    "a recording to its end.", whole=True,
)  # fmt: skip
_CYCLES = View(
    lambda s: s.cycle, "cycles since the recording began", "", _halves,
    "A travel that changes from cycle to cycle shows as two curves that run apart, or together: "
    "one of the upper half of the travel, one of the lower.", whole=True,
)  # fmt: skip
_SPIKES = View(
    lambda s: s.time_s, "time since the recording began (s)", "s", _all,
    "How far single samples stand off their neighbours, largest and smallest in all recordings.",
    bins=240, envelope=True, local=True,
)  # fmt: skip
_BREAKS = View(
    lambda s: s.time_s, "time since the recording began (s)", "s", _all,
    "Largest and smallest in all recordings: a step, or a loop that is shifted from some moment "
    "on. Where a drive was recorded more than once a recording is taken against the mean of the "
    "others.", bins=240, envelope=True, own=True,
)  # fmt: skip
_DISPLACEMENT = View(
    lambda s: s.displacement_um, "displacement (µm)", "µm", _directions,
    "Rising and falling half loops apart, all conditions together.",
)
_DRIVE = View(
    lambda s: s.drive_v, "drive (V)", "V", _directions,
    "Rising and falling half loops apart, all conditions together.",
)


def _folded(period_um: float, which: str, text: str) -> View:
    return View(
        lambda s: np.mod(1e3 * s.displacement_um, 1e3 * period_um),
        f"displacement modulo {1e3 * period_um:.4g} nm{which} (nm)", "nm", _all, text,
    )  # fmt: skip


_CHANGE = "drive change since the turning point (V)"
_ALONG = "Counted in the direction of the motion: above zero the actuator is further on than the "
VIEWS: dict[str, tuple[View, ...]] = {
    "creep": (_RELAXING, _CLOCK),
    "time-skew": (_SINCE,),
    "amplifier-lag": (_SINCE,),
    "slew-limit": (_SINCE,),
    "resonance": (_RINGING,),
    "periodic-nonlinearity": (_folded(
        HALF_WAVE_UM, ", half a wavelength",
        "An error of the interferometer comes back every half wavelength, so that it adds up "
        "here, while everything else averages out.",
    ),),
    "direction-asymmetry": (View(
        lambda s: s.change_v, _CHANGE, "V", _directions,
        "Counted in the direction of the motion: if the two directions differ in shape, the two "
        "curves part.", along=True,
    ),),
    "range-dependence": (View(
        lambda s: s.change_v, _CHANGE, "V",
        _classes("range before:", "V", lambda s: s.range_v),
        _ALONG + "model says. One curve to a class of ranges.", along=True,
    ),),
    "extremum-dependence": (View(
        lambda s: s.change_v, _CHANGE, "V",
        _classes("turned at", "V", lambda s: s.extremum_v),
        _ALONG + "model says. One curve to a class of turning points.", along=True,
    ),),
    "rate-dependence": (View(
        lambda s: s.change_v, _CHANGE, "V",
        _classes("speed", "V/s", lambda s: s.speed_v_per_s),
        _ALONG + "model says; a loop that opens with speed lies the lower the faster.",
        along=True,
    ),),
    "initiation-stage": (View(
        lambda s: s.drive_v, "drive (V)", "V", _first_rise,
        "Only the first rise from rest differs; later rises over the same drive do not.",
    ),),
    "thermal-drift": (_CLOCK,),
    "cycle-aging": (_CYCLES,),
    "clock-ratio": (_CLOCK,),
    "sensor-clipping": (_DISPLACEMENT,),
    "outliers": (_SPIKES,),
    "fringe-jump": (_BREAKS,),
    "dropped-samples": (_BREAKS,),
}  # fmt: skip


def views_of(cause: str) -> tuple[View, ...]:
    return VIEWS.get(cause, (_DRIVE,))


def before_and_after(
    residuals: Residuals, rungs: tuple[int, int], cause: str, view: View, band_nm: float | None,
    marks: Sequence[tuple[float, str]] = (),
) -> Plot:  # fmt: skip
    """The residual on two rungs side by side, on the same axes; ``marks`` stand along x."""
    curves = [curves_of(residuals, rung, view) for rung in rungs]
    return Plot(
        [Panel(f"everything but {cause}", curves[0]), Panel("with everything", curves[1])],
        view.x_label,
        OTHERS if view.own and residuals.groups[0].repeats > 1 else y_label(view),
        f"Residual against {view.x_label}, with everything but {cause}, and with everything.",
        view.log, band_nm, view.x_unit, marks=marks,
    )  # fmt: skip


def own_scale(plot: Plot) -> Plot:
    """The last panel of a plot by itself, as large as it can be drawn."""
    last = plot.panels[-1]
    return Plot(
        [Panel(last.title + ", on a scale of its own", last.curves, limits_of(last.curves))],
        plot.x_label, plot.y_label, plot.said, plot.log, plot.band, plot.x_unit, plot.y_unit,
        plot.marks,
    )  # fmt: skip


def single(residuals: Residuals, rung: int, view: View, title: str) -> Panel:
    """One panel of one rung."""
    return Panel(title, curves_of(residuals, rung, view))


DRIVE = _DRIVE
OTHERS = "off the other recordings (nm)"
REST: dict[str, View] = {
    "displacement": _DISPLACEMENT,
    "range": VIEWS["range-dependence"][0],
    "cycle": _CYCLES,
    "clock": _CLOCK,
    "frequency": VIEWS["rate-dependence"][0],
}


def rest_views(depends_on: Sequence[str]) -> list[View]:
    """The last residual against drive and time since the turn, and what else it goes with."""
    return list(dict.fromkeys([_DRIVE, _LAST, *(REST[w] for w in depends_on if w in REST)]))


def ripple_view(over: str, period: float) -> View:
    """What comes back with displacement, every so many um, or with the drive, every so many V."""
    text = "What comes back so often adds up here, while everything else averages out."
    if over != "drive":
        return _folded(period, "", text)
    return View(
        lambda s: np.mod(s.drive_v, period),
        f"drive modulo {period:.4g} V (V)", "V", _all, text,
    )  # fmt: skip


def y_label(view: View) -> str:
    return "residual along the motion (nm)" if view.along else "measured minus model (nm)"


def curves_of(residuals: Residuals, rung: int, view: View) -> list[Curve]:
    """Binned residuals of one rung, a curve to a part."""
    samples = residuals.samples
    xs = [view.x(s) for s in samples]
    parts = view.part(samples)
    # a bin holds whole cycles: part of one would show what the drive does
    most = max(s.loop.max() + 1.0 for s in samples) / 2.0 if view.whole else None
    edges = _edges(xs, view, most)
    if view.envelope:
        return _envelope(residuals, rung, xs, edges, view)
    out = []
    for label, masks in parts:
        rows = []
        for g, (s, x, mask) in enumerate(zip(samples, xs, masks, strict=True)):
            y = residuals.mean(rung, g)
            if view.centred:
                count = np.maximum(np.bincount(s.loop), 1)
                y = y - (np.bincount(s.loop, y) / count)[s.loop]
            if view.along:
                y = y * s.direction
            rows.append((x[mask], y[mask], s.loop[mask]))
        b = binned(rows, edges)
        if b.x.size:
            # where other half loops take over, a curve would jump
            kept = b.units >= (SHARE * b.units.max() if view.along else 0.0)
            out.append(Curve(label, b.x[kept], b.mean[kept], b.error[kept]))
    return out


def _envelope(
    residuals: Residuals, rung: int, xs: list[FloatArray], edges: FloatArray, view: View
) -> list[Curve]:
    rows = []
    for g, x in enumerate(xs):
        for row in residuals.own(rung, g) if view.own else residuals.single(rung, g):
            off = row - median_filter(row, NEIGHBOURS, mode="nearest") if view.local else row
            rows.append((x, off, np.zeros(x.size, np.int64)))
    b = binned(rows, edges)
    return [Curve("largest", b.x, b.high), Curve("smallest", b.x, b.low)]


def _edges(xs: Sequence[FloatArray], view: View, most: float | None = None) -> FloatArray:
    low = min(float(x.min()) for x in xs)
    high = min(max(float(x.max()) for x in xs), view.most)
    if not view.log:
        bins = view.bins if most is None else int(np.clip(most, FEWEST, view.bins))
        return np.linspace(low, max(high, low + 1e-9), bins + 1)
    steps = [np.diff(x[:2000]) for x in xs]
    step = float(np.median(np.concatenate([d[d > 0] for d in steps] or [np.array([1e-4])])))
    edges = np.geomspace(0.5 * step, max(high, step), view.bins + 1)
    kept = [edges[0]]
    for e in edges[1:]:  # no bin narrower than a sample
        if e - kept[-1] >= 0.999 * step:
            kept.append(e)
    return np.array(kept if len(kept) > 1 else [edges[0], edges[-1]])
