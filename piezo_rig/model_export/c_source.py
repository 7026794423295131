"""A model as one C file: a step function for a controller, at a fixed sample period.

C99, no header, static memory only, nothing of the library but ``math.h``. Whatever of the model
has no such form is named in the file and in `CSource.left_out`, with the reason.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from piezo_rig import __version__
from piezo_rig.causes.rate_dependence import RateDependence
from piezo_rig.chain.half_loops import SMALL
from piezo_rig.chain.model import Model
from piezo_rig.chain.stage import Stage
from piezo_rig.errors import InputError
from piezo_rig.model_export.c_kernel import DEPTH, Kernel, kernel, law_of
from piezo_rig.model_export.c_part import Part, Place
from piezo_rig.model_export.c_parts import PARTS, no_form
from piezo_rig.model_export.c_text import comment, number


@dataclass(frozen=True)
class CSource:
    """The text of a C file, and what it holds.

    Attributes
    ----------
    held, left_out : ids of stages; the latter with the reason
    """

    text: str
    held: list[str]
    left_out: dict[str, str]


def c_source(model: Model, name: str, sample_rate: float, source: str = "") -> CSource:
    """The C file of a model.

    Parameters
    ----------
    model : any that passes `Model.check`
    name : prefix of everything in it, a C identifier
    sample_rate : calls of the step function a second
    source : where the model came from, for the head of the file

    Raises
    ------
    InputError : a sample rate that is none, or a model that has no C form at all
    """
    if not 1e-3 <= sample_rate <= 1e9:
        raise InputError(
            "export-c", f"a sample rate of {sample_rate:g} per second cannot be used",
            "a slip on the command line", "give the controller's rate, as in --sample-rate 5000",
        )
    period_s = 1.0 / sample_rate
    left_out: dict[str, str] = {}
    stages: list[Stage] = []
    for stage in model.stages:
        why = no_form(stage, period_s) or _unknown(stage)
        if why:
            left_out[stage.id] = why
        else:
            stages.append(stage)
    branches = Model(tuple(stages)).branches()
    laws = [s for s in stages if law_of(s, "slope")]
    maxwell = kernel(name, branches, laws)
    parts = [
        (s, _part(s, Place(name, k, period_s, branches)))
        for k, s in enumerate(stages) if type(s) in PARTS
    ]
    dead_band_v = SMALL * _swing_v(model)
    body = _file(name, maxwell, parts, 1.0 / branches.first_slope_v_per_um, dead_band_v)
    counts = bool(laws) or any(s.id == "cycle-aging" for s in stages)
    head = _head(model, name, sample_rate, source, stages, left_out, counts, dead_band_v)
    return CSource(f"{head}\n{body}", [s.id for s in stages], left_out)


def _part(stage: Stage, at: Place) -> Part:
    try:
        return PARTS[type(stage)](stage, at)
    except (ArithmeticError, ValueError) as error:
        raise InputError(
            "export-c", f"stage {stage.id} has no coefficients: {error}",
            "a parameter that is beyond what can be", "identify the model again",
        ) from None


def _unknown(stage: Stage) -> str:
    """Why a stage is not translated although nothing forbids it."""
    kind = type(stage)
    acts = kind.act is not Stage.act or kind.seen_by_sliders is not Stage.seen_by_sliders
    if acts and kind not in PARTS:
        return "nobody has written its C form"
    shapes = kind.shape is not Stage.shape and not kind.has_elements
    unknown = shapes and kind not in PARTS and not law_of(stage, "slope")
    return "nobody has written its C form" if unknown else ""


def _head(
    model: Model, name: str, sample_rate: float, source: str, stages: list[Stage],
    left_out: dict[str, str], counts: bool, dead_band_v: float,
) -> str:
    """The comment at the top."""
    lines = [
        f"{name}: displacement of a piezo actuator, one sample at a time.",
        "",
        f"Written by piezo-rig {__version__} export --format c.",
        f"Model: {model.name or 'unnamed'}{f', from {source}' if source else ''}.",
        "",
        "Use:",
        f"    static struct {name} state;",
        f"    {name}_init(&state);",
        f"    displacement_um = {name}_step(&state, drive_v);   once every sample period",
        "",
        f"Sample period: {1.0 / sample_rate:.10g} s ({sample_rate:g} samples/s); it is fixed.",
        "Input: drive in V on the actuator, as commanded (gain x command + offset).",
        "Output: displacement in um that the sensor would show, 0 at the first call.",
        "The first call's drive is where a virgin actuator begins: its memory is empty.",
        f"To compare: piezo-rig simulate MODEL.json DRIVE.csv with {sample_rate:g} rows a second.",
        "",
        f"Memory: struct {name} and constant tables; nothing is allocated. It remembers up to",
        f"{DEPTH} turning points inside each other; should a drive nest more of them, the smallest",
        "loop is forgotten, the displacement is off by no more than that loop's opening, and",
        "state.forgotten counts it.",
        "state.fault: 1 where a law gave a slope that is not positive (the table's own is used",
        "then, simulate would stop), 2 after a drive that is no number (it is passed over).",
    ]
    if counts:
        lines += [
            f"Reversals up to state.dead_band, {dead_band_v:.4g} V, begin no half loop. For a",
            "noisier drive, as a measured one, set it after init to ten times the noise.",
        ]
    lines += ["", "Stages:"]
    for stage in stages:
        values = ", ".join(f"{k} {p.value:.6g} {p.unit}" for k, p in stage.parameters.items())
        rows = f"{len(stage.elements)} elements" if stage.elements is not None else ""
        said = "; ".join(t for t in (rows, values) if t)
        lines += _wrapped(f"{stage.id} ({stage.place}){': ' if said else ''}{said}")
    lines += ["", "Left out:" if left_out else "Left out: nothing."]
    for id, why in left_out.items():
        lines += _wrapped(f"{id}: {why}")
    if model.provenance:
        lines += ["", "Provenance:"]
        for key, value in model.provenance.items():
            lines += _wrapped(f"{key}: {json.dumps(value, ensure_ascii=True)}"[:2000])
    inside = "\n".join(f" * {comment(line)}".rstrip() for line in lines)
    return f"/*\n{inside}\n */"


def _swing_v(model: Model) -> float:
    """How far the drives swung that the elements reach."""
    own = [s.elements for s in model.stages if s.has_elements and s.id != "maxwell"]
    later = model.maxwell.elements
    assert later is not None
    return float(max(2.0 * later.knots_v[-1], *(e.knots_v[-1] for e in own if e is not None), 0.0))


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 88, initial_indent="    ", subsequent_indent="        ")


def _file(
    name: str, maxwell: Kernel, parts: list[tuple[Stage, Part]], ahead_um_per_v: float,
    dead_band_v: float,
) -> str:
    """All of it below the head."""
    before = [(s, p) for s, p in parts if s.place == "drive"]
    sliders = [(s, p) for s, p in parts if isinstance(s, RateDependence) and s.widens]
    after = [(s, p) for s, p in parts if (s, p) not in before and (s, p) not in sliders]
    after.sort(key=lambda part: not (isinstance(part[0], RateDependence) and part[0].stretches))
    tables = "\n".join(p.tables for _, p in parts if p.tables)
    members = "\n".join(f"    {line}" for _, p in parts for line in p.members.splitlines())
    ahead = ""
    if sliders:
        sliders = sliders[-1:]
        ahead = (
            "\n    /* the first spring follows the drive itself */"
            f"\n    x += {number(ahead_um_per_v)} * (v - seen);"
        )
    return f"""\
#include <math.h>

#define {name}_DEPTH {DEPTH}
{maxwell.tables}
{tables}

struct {name} {{
    int begun, fault;
    unsigned long forgotten;
    double zero, shown;
    double dead_band; /* reversals up to that are no half loops, V */
{maxwell.members}{members}
}};

void {name}_init(struct {name} *s);
double {name}_step(struct {name} *s, double drive_v);

{maxwell.functions}
/* A virgin actuator; the first drive that comes is where it begins. */
void {name}_init(struct {name} *s)
{{
    s->begun = s->fault = 0;
    s->forgotten = 0;
    s->zero = s->shown = 0.0;
    s->dead_band = {number(dead_band_v)};
}}

/* Displacement, um, of the next sample of the drive, V. */
double {name}_step(struct {name} *s, double drive_v)
{{
    double v, seen, x;
    if (!(drive_v >= -1e12 && drive_v <= 1e12)) {{
        s->fault |= 2;
        return s->shown;
    }}
    v = drive_v;
{_steps(before)}
    seen = v;
{_steps(sliders)}
    if (!s->begun) {{
        s->origin = s->here = s->extreme = s->begun_at = seen;
        s->moved = 0.0;
        s->way = s->loop_way = s->depth = 0;
        s->band[0] = 0;
    }}
    {name}_move(s, seen);
    x = s->moved;{ahead}
{_steps(after)}
    if (!s->begun)
        s->zero = x;
    s->begun = 1;
    s->shown = x - s->zero;
    return s->shown;
}}
"""


def _steps(parts: Sequence[tuple[Stage, Part]]) -> str:
    return "\n".join(
        textwrap.indent(f"/* {stage.id} */\n{part.step}", "    ") for stage, part in parts
        if part.step
    )
