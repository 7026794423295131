"""What every stage but the kernel becomes in C: members of the state, and one sample's step.

In the step, ``v`` is the drive and ``x`` the displacement so far. ``s->begun`` is 0 in the first
call, in which states settle. At a fixed sample period the exact responses of `piezo_rig.chain`
to straight pieces have constant coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from piezo_rig.causes.amplifier_lag import AmplifierLag
from piezo_rig.causes.clock_ratio import ClockRatio
from piezo_rig.causes.creep import Creep
from piezo_rig.causes.cycle_aging import CycleAging
from piezo_rig.causes.direction_asymmetry import DirectionAsymmetry
from piezo_rig.causes.drive_clipping import DriveClipping
from piezo_rig.causes.drive_gain import DriveGain
from piezo_rig.causes.input_bend import InputBend
from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.causes.periodic_nonlinearity import HALF_WAVE_UM, PeriodicNonlinearity
from piezo_rig.causes.rate_dependence import REFERENCE_V_PER_S, RateDependence
from piezo_rig.causes.remanence import Remanence
from piezo_rig.causes.resonance import Resonance
from piezo_rig.causes.sensor_clipping import SensorClipping
from piezo_rig.causes.sensor_scale import SensorScale
from piezo_rig.causes.slew_limit import SlewLimit
from piezo_rig.causes.time_skew import TimeSkew
from piezo_rig.chain.bend import POWERS, Bend
from piezo_rig.chain.branches import sliders
from piezo_rig.chain.stage import Stage
from piezo_rig.model_export.c_asymmetry import direction_asymmetry
from piezo_rig.model_export.c_part import Part, Place
from piezo_rig.model_export.c_text import array, number

LONGEST_LINE = 1_000_000  # samples of delay


def decay_and_hold(period_s: float, tau_s: float) -> tuple[float, float]:
    """Coefficients of d, how far a first-order lag is off a signal that is straight in between.

    d = decay d - hold (x - x before)
    """
    z = period_s / tau_s
    return math.exp(-z), -math.expm1(-z) / z


def _drive_gain(stage: Stage, at: Place) -> Part:
    assert isinstance(stage, DriveGain)
    return Part(step=f"v = {number(stage['ratio'])} * v + {number(stage.added_v)};")


def _drive_clipping(stage: Stage, at: Place) -> Part:
    low, high = number(stage["lower"]), number(stage["upper"])
    return Part(step=f"if (v < {low}) v = {low};\nif (v > {high}) v = {high};")


def _slew_limit(stage: Stage, at: Place) -> Part:
    most, out, before = number(stage["limit"] * at.period_s), at.own("out"), at.own("before")
    return Part(
        members=f"double {out}, {before};",
        step=f"""\
if (!s->begun)
    s->{out} = s->{before} = v;
{{
    /* the drive goes straight in between, and may be met on the way */
    double gap = s->{before} - s->{out}, moved = v - s->{before};
    double way = gap > 0.0 || (gap == 0.0 && moved > 0.0) ? 1.0 : -1.0;
    double closing = {most} - way * moved;
    s->{before} = v;
    if (closing < way * gap)
        s->{out} += way * {most};
    else if (way * moved >= -{most})
        s->{out} = v;
    else
        s->{out} += way * {most} * (2.0 * way * gap / closing - 1.0);
    v = s->{out};
}}""",
    )


def _lag(at: Place, tau_s: float) -> Part:
    """``off``: how far the drive behind a lag is off the drive."""
    decay, hold = (number(c) for c in decay_and_hold(at.period_s, tau_s))
    off, before = at.own("off"), at.own("before")
    return Part(
        members=f"double {off}, {before};",
        step=f"""\
if (!s->begun) {{
    s->{off} = 0.0;
    s->{before} = v;
}}
s->{off} = {decay} * s->{off} - {hold} * (v - s->{before});
if (fabs(s->{off}) < 1e-200)
    s->{off} = 0.0;
s->{before} = v;""",
    )


def _amplifier_lag(stage: Stage, at: Place) -> Part:
    if stage["tau"] <= 0.0:
        return Part()
    lag = _lag(at, stage["tau"])
    return Part(members=lag.members, step=f"{lag.step}\nv += s->{at.own('off')};")


def _rate_dependence(stage: Stage, at: Place) -> Part:
    assert isinstance(stage, RateDependence)
    if stage.settles:
        return _settling_drag(stage, at)
    lag = _lag(at, stage.window)
    rate = at.own("rate")
    grown = _grown(stage, f"s->{rate}")
    begin = f"""\
{lag.step}
s->{rate} = -s->{at.own('off')} / {number(stage.window)} / {number(REFERENCE_V_PER_S)};
"""
    members = f"{lag.members}\ndouble {rate};"
    if stage.stretches:
        return _stretching(stage, at, members, begin)
    if not stage.widens:
        return Part(members=members, step=begin + f"""\
x -= {number(stage['lag_um'])} * (s->{rate} < 0.0 ? -1.0 : 1.0)
     * {grown};""")
    seen, width = at.own("seen"), at.own("width")
    return Part(
        members=f"{members}\ndouble {seen}, {width};",
        step=begin + f"""\
s->{width} = {number(stage.widens_by_v(at.branches))} * {grown};
if (!s->begun)
    s->{seen} = v;
if (s->{seen} < v - s->{width})
    s->{seen} = v - s->{width};
if (s->{seen} > v + s->{width})
    s->{seen} = v + s->{width};
seen = s->{seen};""",
    )


def _grown(stage: RateDependence, rate: str) -> str:
    """A lag at a rate, of that at the reference rate."""
    grows = stage.growth
    if grows >= 0.0:
        return f"pow(fabs({rate}), {number(grows)})"
    return f"log(1.0 + {number(-grows)} * fabs({rate})) / {number(math.log1p(-grows))}"


def _stretching(stage: RateDependence, at: Place, members: str, begin: str) -> Part:
    thresholds, weights = sliders(at.branches)
    name, n = f"{at.name}_{at.index}", thresholds.size
    plain, wide, earlier, drive, rate = (
        at.own(word) for word in ("plain", "wide", "earlier", "drive", "rate")
    )
    return Part(
        tables="\n".join((
            "/* Sliders that widen with the speed: threshold, V, and what each opens, um/V. */",
            array(f"{name}_threshold", thresholds),
            array(f"{name}_opens", weights),
        )),
        members=f"{members}\ndouble {plain}[{n}], {wide}[{n}], {earlier}, {drive};",
        step=begin + f"""\
{{
    int k;
    double r, still = v, share = {number(stage.at_reference)} * {_grown(stage, f's->{rate}')};
    int turned;
    if (!s->begun) {{
        s->{earlier} = 0.0;
        s->{drive} = v;
    }}
    turned = s->{earlier} * s->{rate} < 0.0;
    if (turned) {{
        double way = {number(stage.window / at.period_s)} * log(1.0
            - s->{earlier} * {number(at.period_s * REFERENCE_V_PER_S)} / (v - s->{drive}));
        still = s->{drive} + (v - s->{drive}) * (way < 0.0 ? 0.0 : way > 1.0 ? 1.0 : way);
    }}
    for (k = 0; k < {n}; k++) {{
        if (!s->begun)
            s->{plain}[k] = s->{wide}[k] = v;
        r = {name}_threshold[k];
        if (s->{plain}[k] < v - r)
            s->{plain}[k] = v - r;
        if (s->{plain}[k] > v + r)
            s->{plain}[k] = v + r;
        if (turned && s->{wide}[k] < still - r)
            s->{wide}[k] = still - r;
        if (turned && s->{wide}[k] > still + r)
            s->{wide}[k] = still + r;
        r *= 1.0 + share;
        if (s->{wide}[k] < v - r)
            s->{wide}[k] = v - r;
        if (s->{wide}[k] > v + r)
            s->{wide}[k] = v + r;
        x += {name}_opens[k] * (s->{wide}[k] - s->{plain}[k]);
    }}
    s->{earlier} = s->{rate};
    s->{drive} = v;
}}""",
    )


def _settling_drag(stage: RateDependence, at: Place) -> Part:
    lag, before = at.own("lag"), at.own("before")
    kept = number(math.exp(-at.period_s / stage.window))
    return Part(
        members=f"double {lag}, {before};",
        step=f"""\
{{
    double rate, drag;
    if (!s->begun) {{
        s->{lag} = 0.0;
        s->{before} = v;
    }}
    rate = (v - s->{before}) / {number(at.period_s)} / {number(REFERENCE_V_PER_S)};
    drag = {number(stage['lag_um'])} * (rate < 0.0 ? -1.0 : 1.0)
        * {_grown(stage, "rate")};
    s->{lag} = drag + (s->{lag} - drag) * {kept};
    s->{before} = v;
    x -= s->{lag};
}}""",
    )


def _bend(stage: Stage, at: Place) -> Part:
    terms = [number(stage[name]) for name, _ in sorted(POWERS.items(), key=lambda p: p[1])]
    nested = terms[-1]
    for term in reversed(terms[:-1]):
        nested = f"({term} + u * {nested})"
    return Part(step=f"""\
{{
    double u = (v - {number(stage['from_v'])}) / {number(stage['over_v'])};
    x += u * u * {nested};
}}""")


def _creep(stage: Stage, at: Place) -> Part:
    assert isinstance(stage, Creep)
    pairs = [decay_and_hold(at.period_s, float(t)) for t in stage.times_s]
    n, name = len(pairs), f"{at.name}_{at.index}"
    total = number(float(stage.shares.sum()))
    off, before, start = at.own("off"), at.own("before"), at.own("start")
    return Part(
        tables="\n".join((
            "/* Creep: decay and hold of each relaxation over one sample, and its weight. */",
            array(f"{name}_decay", [decay for decay, _ in pairs]),
            array(f"{name}_hold", [hold for _, hold in pairs]),
            array(f"{name}_weight", stage.shares),
        )),
        members=f"double {off}[{n}], {before}, {start};",
        step=f"""\
{{
    int k;
    double crept = 0.0;
    if (!s->begun) {{
        for (k = 0; k < {n}; k++)
            s->{off}[k] = 0.0;
        s->{start} = s->{before} = x;
    }}
    for (k = 0; k < {n}; k++) {{
        s->{off}[k] = {name}_decay[k] * s->{off}[k] - {name}_hold[k] * (x - s->{before});
        if (fabs(s->{off}[k]) < 1e-200)
            s->{off}[k] = 0.0;
        crept += {name}_weight[k] * s->{off}[k];
    }}
    s->{before} = x;
    x += {total} * (x - s->{start}) + crept;
}}""",
    )


def _cycle_aging(stage: Stage, at: Place) -> Part:
    drive, way, halves, before, aged = (
        at.own(w) for w in ("drive", "way", "halves", "before", "aged")
    )
    settles = stage["settles"] if "settles" in stage.parameters else 0.0
    grown = "log10(cycles + 1.0)"
    if settles > 0.0:  # over a decade they have grown by the rate
        grown = f"expm1(-cycles / {number(settles)}) / expm1(-9.0 / {number(settles)})"
    return Part(
        members=f"double {drive}, {halves}, {before}, {aged};\nint {way};",
        step=f"""\
if (!s->begun) {{
    s->{drive} = v;
    s->{way} = 0;
    s->{halves} = s->{aged} = 0.0; /* two half loops are a cycle */
    s->{before} = x;
}}
if ((v - s->{drive}) * s->{way} > 0.0) {{
    s->{drive} = v;
}} else if (v - s->{drive} > s->dead_band || s->{drive} - v > s->dead_band) {{
    s->{halves} += s->{way} ? 1.0 : 0.0;
    s->{way} = v > s->{drive} ? 1 : -1;
    s->{drive} = v;
}}
{{
    double back = v != s->{drive} && s->{way} ? 1.0 : 0.0; /* until it turns out to be small */
    double cycles = floor(0.5 * (s->{halves} + back));
    s->{aged} += {grown} * (x - s->{before});
}}
s->{before} = x;
x += {number(stage['rate_per_decade'])} * s->{aged};""",
    )


def _resonance(stage: Stage, at: Place) -> Part:
    assert isinstance(stage, Resonance)
    h, damping, behind = at.period_s, stage["damping"], stage.behind_s
    omega = 2.0 * math.pi * stage["frequency"]
    ringing = omega * math.sqrt(1.0 - damping * damping)
    fade = math.exp(-damping * omega * h)
    c, s = fade * math.cos(ringing * h), fade * math.sin(ringing * h) / ringing
    off, rate, slope, before = (at.own(w) for w in ("off", "rate", "slope", "before"))
    return Part(
        members=f"double {off}, {rate}, {slope}, {before};",
        step=f"""\
{{
    double fast, e, w;
    if (!s->begun) {{
        s->{off} = s->{rate} = s->{slope} = 0.0;
        s->{before} = x;
    }}
    fast = (x - s->{before}) / {number(h)};
    e = s->{off} + {number(behind)} * (fast - s->{slope});
    w = s->{rate} - (fast - s->{slope});
    s->{slope} = fast;
    s->{before} = x;
    s->{off} = {number(c)} * e + {number(s)} * (w + {number(damping * omega)} * e);
    s->{rate} = {number(c)} * w
        - {number(s)} * ({number(omega * omega)} * e + {number(damping * omega)} * w);
    x += {number(stage['share'])} * (s->{off} - {number(behind)} * fast);
}}""",
    )


def _periodic(stage: Stage, at: Place) -> Part:
    terms = [
        f"{number(1e-3 * stage[which])} * {function}({order}a)"
        for which, function, order in (
            ("sine", "sin", ""), ("cosine", "cos", ""),
            ("sine_2", "sin", "2.0 * "), ("cosine_2", "cos", "2.0 * "),
        )
    ]
    angle = number(2.0 * math.pi / HALF_WAVE_UM)
    lines = "\n       + ".join(terms)
    return Part(step=f"{{\n    double a = {angle} * x;\n    x += {lines};\n}}")


def _sensor_clipping(stage: Stage, at: Place) -> Part:
    end = at.own("end")
    beyond = ">" if stage["level"] > 0 else "<"
    return Part(members=f"double {end};", step=f"""\
if (!s->begun)
    s->{end} = x + {number(stage['level'])};
if (x {beyond} s->{end})
    x = s->{end};""")


def _output_bend(stage: Stage, at: Place) -> Part:
    square, cube = number(stage["square"]), number(stage["cube"])
    return Part(step=f"x = x + x * x * ({square} + {cube} * x);")


def _input_bend(stage: Stage, at: Place) -> Part:
    square, cube = number(stage["square"]), number(stage["cube"])
    return Part(step=f"""\
{{
    double u = (v - {number(stage['from_v'])}) / {number(stage['over_v'])};
    v += u * (u - 1.0) * ({square} + {cube} * u);
}}""")


def _sensor_scale(stage: Stage, at: Place) -> Part:
    return Part(step=f"x = x / {number(stage['ratio'])};")


def _time_skew(stage: Stage, at: Place) -> Part:
    if stage["delay"] == 0.0:
        return Part()
    late = stage["delay"] / at.period_s
    whole = math.floor(late)
    size, line, next_ = whole + 2, at.own("line"), at.own("next")
    return Part(
        members=f"double {line}[{size}];\nint {next_};",
        step=f"""\
{{
    int k, newer, older;
    if (!s->begun) {{
        for (k = 0; k < {size}; k++)
            s->{line}[k] = x;
        s->{next_} = 0;
    }}
    s->{line}[s->{next_}] = x;
    newer = (s->{next_} + {size - whole}) % {size};
    older = (s->{next_} + {size - whole - 1}) % {size};
    s->{next_} = (s->{next_} + 1) % {size};
    x = s->{line}[newer] + {number(late - whole)} * (s->{line}[older] - s->{line}[newer]);
}}""",
    )


PARTS: dict[type[Stage], Callable[[Stage, Place], Part]] = {
    DriveGain: _drive_gain,
    DriveClipping: _drive_clipping,
    SlewLimit: _slew_limit,
    AmplifierLag: _amplifier_lag,
    RateDependence: _rate_dependence,
    Bend: _bend,
    OutputBend: _output_bend,
    InputBend: _input_bend,
    DirectionAsymmetry: direction_asymmetry,
    Creep: _creep,
    CycleAging: _cycle_aging,
    Resonance: _resonance,
    PeriodicNonlinearity: _periodic,
    SensorClipping: _sensor_clipping,
    SensorScale: _sensor_scale,
    TimeSkew: _time_skew,
}
"""The stages that act on a signal and have a C form."""


def no_form(stage: Stage, period_s: float) -> str:
    """Why a stage has no C form; empty where it has one."""
    if stage.locked_to == "clock":
        return "it follows the clock and not the drive; simulate leaves it out as well"
    if isinstance(stage, Remanence):
        return ("the memory of drives before the first sample; the function begins virgin, as "
                "simulate does with one drive")
    if isinstance(stage, ClockRatio):
        return ("its delay grows with the time since a trigger, without end; a controller has "
                "no trigger")
    if isinstance(stage, CycleAging) and "whole" in stage.parameters and stage["whole"] > 0:
        return "in this form it needs the end of the half loop that is being played"
    if isinstance(stage, TimeSkew) and stage["delay"] < 0.0:
        return f"the record is {-stage['delay']:g} s ahead of the displacement: not causal"
    if isinstance(stage, TimeSkew) and stage["delay"] / period_s > LONGEST_LINE:
        return f"its delay is longer than {LONGEST_LINE} samples"
    return ""
