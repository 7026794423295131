"""Direction asymmetry in C: stops of many widths, or a memory of turning points."""

from __future__ import annotations

from piezo_rig.causes.direction_asymmetry import DirectionAsymmetry
from piezo_rig.chain.given_back import CLOSED, DEEPEST
from piezo_rig.chain.stage import Stage
from piezo_rig.model_export.c_part import Part, Place
from piezo_rig.model_export.c_text import array, number


def direction_asymmetry(stage: Stage, at: Place) -> Part:
    assert isinstance(stage, DirectionAsymmetry)
    if not stage.closes:  # the kernel has it, as a law
        return Part()
    if stage.until_back:
        return _given_back(stage, at)
    widths, share, fades = stage.state
    stops, before, n = at.own("stops"), at.own("before"), widths.size
    name = f"{at.name}_{at.index}_widths"
    begins = number(stage.begun_at)
    even = f"mean * mean / {number(2.0 * float(widths.mean()))}" if fades else "fabs(mean)"
    return Part(
        tables=array(name, widths),
        members=f"double {stops}[{n}], {before};",
        step=f"""\
{{
    double mean = 0.0;
    int k;
    for (k = 0; k < {n}; k++) {{
        double *stop = &s->{stops}[k];
        *stop = s->begun ? *stop + x - s->{before} : {begins} * {name}[k];
        if (*stop > {name}[k])
            *stop = {name}[k];
        if (*stop < -{name}[k])
            *stop = -{name}[k];
        mean += *stop / {n}.0;
    }}
    s->{before} = x;
    x -= {number(share)} * {even};
}}""",
    )


def _given_back(stage: DirectionAsymmetry, at: Place) -> Part:
    """`piezo_rig.chain.given_back.given_back_each`, a sample at a time."""
    where, had, depth = at.own("at"), at.own("had"), at.own("depth")
    way, beyond, has, before = at.own("way"), at.own("beyond"), at.own("has"), at.own("before")
    reach = number(stage["reach"])
    return Part(
        members=(f"double {where}[{DEEPEST + 1}], {had}[{DEEPEST + 1}];\n"
                 f"double {way}, {beyond}, {has}, {before};\nint {depth};"),
        step=f"""\
{{
    double moved = 0.0, whole;
    int top;
    if (!s->begun) {{
        s->{where}[0] = x;
        s->{had}[0] = s->{way} = s->{beyond} = s->{has} = 0.0;
        s->{depth} = 1;
    }} else {{
        moved = x - s->{before};
    }}
    if (moved * s->{way} < 0.0) {{
        if (s->{depth} > {DEEPEST - 1})
            s->{depth} -= 2;
        s->{where}[s->{depth}] = s->{before};
        s->{had}[s->{depth}] = s->{has};
        s->{depth}++;
    }}
    if (moved != 0.0)
        s->{way} = moved > 0.0 ? 1.0 : -1.0;
    while (s->{depth} > 2 && (x - s->{where}[s->{depth} - 2]) * s->{way}
           >= -{CLOSED} * fabs(s->{where}[s->{depth} - 2] - s->{where}[s->{depth} - 1]))
        s->{depth} -= 2;
    if (s->{depth} == 2 && (x - s->{where}[0]) * s->{way}
        >= -{CLOSED} * fabs(s->{where}[0] - s->{where}[1])) {{
        s->{beyond} = s->{had}[0];
        s->{where}[0] = s->{where}[1];
        s->{had}[0] = s->{had}[1];
        s->{depth} = 1;
    }}
    s->{has} = s->{beyond};
    if (s->{depth} > 1) {{
        top = s->{depth} - 1;
        moved = fabs(x - s->{where}[top]);
        whole = fabs(s->{where}[top - 1] - s->{where}[top]);
        s->{has} = s->{had}[top] + (s->{had}[top - 1] - s->{had}[top]) * moved / whole;
        if (whole > 0.0)
            s->{has} += {reach} * (1.0 - exp(-moved / {reach})) * (1.0 - moved / whole);
    }}
    s->{before} = x;
    x += {number(stage.share)} * s->{has};
}}""",
    )
