"""The Maxwell kernel in C, one sample at a time: `piezo_rig.chain.kernels` without its arrays.

The same walk by Madelung's rules: turning points that are remembered, outermost first; a band
for every branch; a branch ends at the turning point before its own, or goes on along the first
rise. A drive that comes sample by sample has no dead band: every reversal begins a half loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_rig.causes.direction_asymmetry import DirectionAsymmetry
from piezo_rig.causes.extremum_dependence import ExtremumDependence
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.causes.range_dependence import RangeDependence
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.stage import Stage
from piezo_rig.errors import InputError
from piezo_rig.model_export.c_text import array, number

DEPTH = 128  # turning points that are remembered at once
HISTORY = {RangeDependence: "range", ExtremumDependence: "extremum"}  # variables of the C


def law_of(stage: Stage, slope: str) -> str | None:
    """What a stage's law makes of a slope, as C; None for a stage whose law is not known here, or
    hangs on the half loop before as well.
    """
    if "carries" in stage.parameters and stage["carries"] > 0:
        return None
    if isinstance(stage, FirstSpring) and type(stage) in HISTORY:
        history = HISTORY[type(stage)]
        return f"{slope} + {number(stage['slope'])} * {history} + {number(stage['offset'])}"
    if isinstance(stage, DirectionAsymmetry) and not stage.closes:
        r = stage["ratio"]
        rising, falling = number(2 * r / (1 + r)), number(2.0 / (1 + r))
        return f"{slope} * (way > 0 ? {rising} : {falling})"
    return None


@dataclass(frozen=True)
class Kernel:
    """Pieces of C: tables before the struct, members of it, and functions after it."""

    tables: str
    members: str
    functions: str


def kernel(name: str, branches: Branches, laws: Sequence[Stage]) -> Kernel:
    """The kernel of a model.

    Parameters
    ----------
    name : the C prefix
    branches : as shaped by the stages that have a C form
    laws : those of them that have a law for the first spring, in their order

    Raises
    ------
    InputError : a single element, a law of its table, and another one with a reach of its own
    """
    own = [s for s in laws if "reach" not in s.parameters]
    if branches.reaching:
        grid = branches.grid()
        if grid.rest is None and own:
            raise InputError(
                "export-c", "a model of one element with laws of two kinds has no C form",
                "its slope far from a turning point depends on the first half loop",
                "identify it with more elements",
            )
        widths, of_first = grid.widths_um, grid.of_first
        base = np.where(of_first, branches.first_slope_v_per_um, grid.slopes_v_per_um)
        rest_knots = np.empty(0) if grid.rest is None else grid.rest.knots_v
        rest = (
            np.array([1.0 / branches.first_slope_v_per_um]) if grid.rest is None
            else grid.rest.compliance_um_per_v
        )
        ends = grid.ends_um
    else:
        ends = widths = np.array([branches.first_break_um])
        of_first, base = np.array([True]), np.array([branches.first_slope_v_per_um])
        rest_knots, rest = branches.rest.knots_v, branches.rest.compliance_um_per_v
        if not rest.size:
            rest = np.array([1.0 / branches.first_slope_v_per_um])
    never = ~np.isfinite(widths)
    n0, e = branches.initiation.compliance_um_per_v.size, int(widths.size)
    tables = [
        f"#define {name}_FIRST_BANDS {n0}",
        f"#define {name}_EARLY_BANDS {e}",
        f"#define {name}_REST_BANDS {rest.size}",
        f"#define {name}_KEEPS_TIES {int(branches.keeps_ties)} /* loops closed exactly */",
        f"#define {name}_NEVER 1e300 /* volts that no drive reaches */",
        "/* First rise: volts from the start at which its pieces end, and um/V on each. */",
        array(f"{name}_first_knots", np.append(branches.initiation.knots_v, 1e300)),
        array(f"{name}_first_slope", branches.initiation.compliance_um_per_v),
        "/* Later branches: width (um) and slope before any law (V/um) of the first bands, ... */",
        array(f"{name}_early_width", np.where(never, 1.0, widths)),
        array(f"{name}_early_base", base),
        "/* ... then volts after those at which bands end, and um/V on each. */",
        array(f"{name}_rest_knots", np.append(rest_knots, 1e300)),
        array(f"{name}_rest_slope", rest),
    ]
    shaping = [*_own(own, of_first)]
    for k, (stage, reach) in enumerate(
        zip([s for s in laws if "reach" in s.parameters], branches.reaching, strict=True)
    ):
        share = np.zeros(e)
        for begin, end, part in reach.steps:
            share[slice(*np.searchsorted(ends, [begin, end], side="right"))] = part
        back = np.where(reach.taken_back(ends), reach.closing / reach.last_um, 0.0)
        tables += [
            f"/* {stage.id}: its share of every early band, and what is taken back (per um). */",
            array(f"{name}_share_{k}", share), array(f"{name}_back_{k}", back),
        ]
        shaping += _reaching(name, k, stage, bool(np.any(back)))
    last = " = NAME_NEVER;" if never[-1] else " = volts;"
    text = _FUNCTIONS.replace("/*SHAPING*/", "\n".join("    " + line for line in shaping))
    text = text.replace("/*LAST*/", "    s->early_knot[at][NAME_EARLY_BANDS - 1]" + last)
    return Kernel("\n".join(tables), _MEMBERS.replace("NAME", name), text.replace("NAME", name))


def _own(stages: Sequence[Stage], of_first: np.ndarray) -> list[str]:
    """Laws of the table's first element."""
    if not stages:
        return []
    lines = ["first = slope[0];"]
    lines += [f"first = {law_of(s, 'first')}; /* {s.id} */" for s in stages]
    return lines + [f"slope[{b}] = first;" for b in np.flatnonzero(of_first)]


def _reaching(name: str, k: int, stage: Stage, back: bool) -> list[str]:
    """One law with a reach of its own."""
    lines = [
        f"/* {stage.id} */",
        "first = 0.0;",
        f"for (b = 0; b < {name}_EARLY_BANDS; b++) {{",
        f"    double change = {name}_share_{k}[b] * (({law_of(stage, 'slope[b]')}) - slope[b]);",
        f"    first += {name}_early_width[b] * change;",
        "    slope[b] += change;",
        "}",
    ]
    if back:
        lines += [
            f"for (b = 0; b < {name}_EARLY_BANDS; b++)",
            f"    slope[b] -= {name}_back_{k}[b] * first;",
        ]
    return lines


_MEMBERS = """\
    double origin, here, moved;       /* drive at the start and now (V); displacement (um) */
    double extreme, begun_at;         /* of the half loop, its furthest drive and its first, V */
    int loop_way;                     /* of the half loop, as `way` */
    int way;                          /* +1 rising, -1 falling, 0 not moved yet */
    int depth;                        /* turning points that are remembered */
    double turn[NAME_DEPTH];
    int band[NAME_DEPTH + 1];         /* how far along its branch each was left */
    double early_knot[NAME_DEPTH][NAME_EARLY_BANDS];   /* V */
    double early_slope[NAME_DEPTH][NAME_EARLY_BANDS];  /* V/um */
"""

_FUNCTIONS = """\
/* The bands of a branch that begins at a turning point: `range` volts after the one before it,
 * at a drive of `extremum`, going the `way`. */
static void NAME_branch(struct NAME *s, int at, double range, double extremum, int way)
{
    double slope[NAME_EARLY_BANDS], first = 0.0, volts = 0.0;
    int b;
    for (b = 0; b < NAME_EARLY_BANDS; b++)
        slope[b] = NAME_early_base[b];
/*SHAPING*/
    (void)range; (void)extremum; (void)way; (void)first;
    for (b = 0; b < NAME_EARLY_BANDS; b++) {
        if (!(slope[b] > 0.0)) { /* a law does not hold here: the table does */
            slope[b] = NAME_early_base[b];
            s->fault |= 1;
        }
        volts += slope[b] * NAME_early_width[b];
        s->early_slope[at][b] = slope[b];
        s->early_knot[at][b] = volts;
    }
/*LAST*/
}

/* Springs and sliders from where the drive is to where it goes. */
static void NAME_move(struct NAME *s, double to)
{
    int way, b, d;
    double reference, limit, knot, slope, stop;
    if (to == s->here)
        return;
    way = to > s->here ? 1 : -1;
    if (s->way == -way) {
        double range = s->here - s->begun_at;
        if (s->depth == NAME_DEPTH) { /* full: the smallest loop, the innermost, is forgotten */
            s->depth -= 2;
            s->forgotten++;
        }
        s->turn[s->depth] = s->here;
        NAME_branch(s, s->depth, range < 0.0 ? -range : range, s->here, way);
        s->depth++;
        s->band[s->depth] = 0;
    }
    s->way = way;
    if ((to - s->extreme) * s->loop_way > 0.0) {
        s->extreme = to;
    } else if (to - s->extreme > s->dead_band || s->extreme - to > s->dead_band) {
        if (s->loop_way)
            s->begun_at = s->extreme;
        s->loop_way = to > s->extreme ? 1 : -1;
        s->extreme = to;
    }
    for (;;) {
        int endless, returns, on;
        d = s->depth;
        b = s->band[d];
        if (d == 0) {
            reference = s->origin;
            limit = way * NAME_NEVER;
            knot = NAME_first_knots[b];
            endless = b == NAME_FIRST_BANDS - 1;
            slope = NAME_first_slope[b];
        } else {
            reference = s->turn[d - 1];
            limit = d > 1 ? s->turn[d - 2] : 2.0 * s->origin - reference;
            if (b < NAME_EARLY_BANDS) {
                knot = s->early_knot[d - 1][b];
                endless = knot >= NAME_NEVER;
                slope = 1.0 / s->early_slope[d - 1][b];
            } else {
                knot = s->early_knot[d - 1][NAME_EARLY_BANDS - 1]
                     + NAME_rest_knots[b - NAME_EARLY_BANDS];
                endless = b - NAME_EARLY_BANDS == NAME_REST_BANDS - 1;
                slope = NAME_rest_slope[b - NAME_EARLY_BANDS];
            }
        }
        knot = reference + way * knot;
        returns = endless || (limit - knot) * way <= 0.0;
        stop = returns ? limit : knot;
        on = (to - stop) * way >= 0.0;
        if (NAME_KEEPS_TIES && returns && to == stop)
            on = 0;
        if (!on)
            stop = to;
        s->moved += slope * (stop - s->here);
        s->here = stop;
        if (!on)
            break;
        if (returns) {
            s->depth = d > 1 ? d - 2 : 0;
            if (to == stop)
                break;
        } else {
            s->band[d]++;
        }
    }
}
"""
