"""The diagnosis as the JSON of the contract, and as text for a terminal."""

from __future__ import annotations

from typing import Any

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.early.reported import Several
from piezo_rig.diagnosis.events import LISTED, Event, in_all, size_text, where_text
from piezo_rig.diagnosis.found import Diagnosis, Finding, said_all

SCHEMA = "piezo-rig/diagnosis/1"
LEAST_P = 1e-299  # a chance is small, and never none
TRIED_OUT = 1e-6  # a chance: nobody has tried out laws of chance further than that
PRINTED = 20  # events of one cause, in a terminal
FEW = 4  # recordings that are listed there


def document(d: Diagnosis) -> dict[str, Any]:
    """Plain data in the contract's order."""
    return {
        "schema": SCHEMA,
        "data": {
            "sweeps": d.sweeps, "samples": d.samples, "repeats": d.repeats, "held_out": d.held_out,
            "recordings": [{"name": n, "offset_um": _short(o)} for n, o in d.recordings],
        },
        "baseline": {
            "model": d.baseline, "rms_nm": _short(d.rungs[0].rms_nm),
            "max_percent": _short(d.rungs[0].max_percent),
        },
        "noise_floor_nm": _short(d.noise_floor_nm),
        "findings": [_finding(f) for f in d.findings],
        "extended": {
            "rms_nm": _short(d.rungs[-1].rms_nm), "max_percent": _short(d.rungs[-1].max_percent),
        },
        "unexplained": {
            "detected": d.unexplained.detected, "rms_nm": _short(d.unexplained.rms_nm),
            "allowance_nm": _short(d.unexplained.allowance_nm),
            "pattern": {"depends_on": d.unexplained.depends_on, "text": d.unexplained.text},
        },
        "follow_up": None if d.follow_up is None else {
            "protocol": d.follow_up.protocol, "separates": d.follow_up.separates,
        },
        "notes": [*d.warnings, *d.notes],
        "assumed": list(d.assumed),
        "not_tried": dict(d.refused),
    }  # fmt: skip


def _finding(f: Finding) -> dict[str, Any]:
    return {
        "cause": f.cause, "place": f.place, "p_value": _short(max(f.p_value, LEAST_P)),
        "gain_percent": _short(f.gain_percent),
        "gain_ci95": None if f.gain_ci95 is None else [_short(x) for x in f.gain_ci95],
        "parameters": {
            n: {"value": _values(p), "unit": p.unit,
                "ci95": None if p.ci95 is None else [_short(x) for x in p.ci95]}
            for n, p in f.parameters.items()
        },
        "alternatives": f.alternatives,
        **({"events": [_event(e) for e in f.events]} if f.events else {}),
    }  # fmt: skip


def _event(e: Event) -> dict[str, Any]:
    return {
        "recording": e.recording, "sweep": e.sweep, "condition": e.condition, "repeat": e.repeat,
        "index": e.index, "time_s": _short(e.time_s), "between_s": [_short(x) for x in e.between_s],
        "size": _short(e.size), "unit": e.unit,
    }  # fmt: skip


def _values(p: Parameter) -> float | list[float | None] | None:
    """One value, or a list where there are several events."""
    several = p.values if isinstance(p, Several) else ()
    return [_short(x) for x in several] if len(several) > 1 else _short(p.value)


def _short(x: float | None) -> float | None:
    return None if x is None else float(f"{x:.6g}")


def text(d: Diagnosis) -> list[str]:
    """Lines for a technician."""
    lines = [f"warning   {w}" for w in d.warnings] + [f"note      {n}" for n in d.notes]
    lines.append(
        f"data      {d.sweeps} sweep{'' if d.sweeps == 1 else 's'}, {d.samples} samples, "
        f"up to {d.repeats} repeat{'' if d.repeats == 1 else 's'}; "
        + ("nothing held out" if d.held_out == "none" else f"held out by {d.held_out}")
    )
    lines += _offsets(d)
    floor = "not known (no repeats)" if d.noise_floor_nm is None else f"{d.noise_floor_nm:.2f} nm"
    lines += [f"noise     {floor}", "", "the ladder                     rms nm   max %     gain"]
    for i, rung in enumerate(d.rungs):
        finding = None if rung.finding is None else d.findings[rung.finding]
        label = rung.added if i == 0 else f"+ {rung.added}"
        line = f"  {label:<26}{rung.rms_nm:9.2f}{rung.max_percent:8.2f}"
        if finding is not None and finding.gain_percent is not None and finding.gain_ci95:
            low, high = finding.gain_ci95
            line += f"{finding.gain_percent:8.1f} %  [{low:.1f}, {high:.1f}]"
        lines.append(line)
    lines.append("")
    lines += _left_out(d)
    if not d.findings:
        lines.append(
            "findings  none: no known cause says what is left" if d.unexplained.detected
            else f"findings  none: {said_all(d, 'the baseline')} says all that these data can show"
        )
    for finding in d.findings:
        lines.append(
            f"finding   {finding.cause} ({finding.place}), "
            f"chance of a false alarm {_chance(finding.p_value)}"
        )
        lines += _gain(d, finding)
        for name, p in finding.parameters.items():
            if not (finding.events and name in LISTED) and not _is_chosen(finding, name):
                lines.append(f"          {name} = {_number(p)}")
        if any(_is_chosen(finding, name) for name in finding.parameters):
            lines.append("          the form of its law is chosen, not measured: see --json")
        lines += _events(d, finding)
        if finding.alternatives:
            lines.append(f"          cannot be told from: {', '.join(finding.alternatives)}")
    u = d.unexplained
    if u.detected:
        lines.append(f"unexplained  {u.text}")
    else:
        allowed = (
            f"{u.allowance_nm:.2g} nm allowed" if u.rms_nm <= u.allowance_nm
            else "which may be chance in data like these"
        )
        lines.append(
            f"the rest  nothing that stands out: {u.rms_nm:.2g} nm of structure, {allowed}"
        )
    if d.follow_up is not None:
        cause, *others = d.follow_up.separates
        lines.append(
            f"next      play {d.follow_up.protocol}: it separates {cause} from {', '.join(others)}"
            + (f"; {d.follow_up.scaled}" if d.follow_up.scaled else "")
        )
    return lines


def _offsets(d: Diagnosis) -> list[str]:
    """Where recordings begin, against the first: one by one where they are few."""
    if len(d.recordings) < 2:
        return []
    offsets = [round(offset, 3) + 0.0 for _, offset in d.recordings]  # no -0.000
    head = f"offsets   {min(offsets):+.3f} to {max(offsets):+.3f} um"
    said = [f"{head}: where recordings stand on the sensor's scale, against the first"]
    if len(offsets) > FEW:
        return [f"{said[0]}; --json lists them"]
    names = (name for name, _ in d.recordings)
    return said + [f"          {n}: {o:+.3f} um" for n, o in zip(names, offsets, strict=True)]


def _left_out(d: Diagnosis) -> list[str]:
    """Causes that were not taken in, those with the same reason together."""
    by_reason = dict[str, list[str]]()
    for cause, reason in d.refused.items():
        by_reason.setdefault(reason, []).append(cause)
    return [f"left out  {', '.join(causes)}: {reason}" for reason, causes in by_reason.items()]


def _gain(d: Diagnosis, finding: Finding) -> list[str]:
    """What a finding does to the error, from the rung before it."""
    at = d.rung_of(d.findings.index(finding))
    if at == 0 or finding.gain_percent is None or finding.gain_ci95 is None:
        return []
    low, high = finding.gain_ci95
    return [f"          gain = {finding.gain_percent:.1f} %  [{low:.1f}, {high:.1f}]: "
            f"{d.rungs[at - 1].rms_nm:.4g} to {d.rungs[at].rms_nm:.4g} nm rms"]  # fmt: skip


def _chance(p: float) -> str:
    """No smaller than anybody has tried out."""
    return f"below {TRIED_OUT:g}" if p < TRIED_OUT else f"{p:.2g}"


def _is_chosen(finding: Finding, name: str) -> bool:
    """Whether a parameter is one of the forms that a cause can have."""
    kind = CAUSES[finding.cause]
    return issubclass(kind, Cause) and name in kind.given


def _events(d: Diagnosis, finding: Finding) -> list[str]:
    """Every event of a finding, a line each."""
    if not finding.events:
        return []
    lines = [f"          {in_all(finding.events)}:"]
    for e in finding.events[:PRINTED]:
        low, high = e.between_s
        about = f" (between {low:.4f} and {high:.4f})" if high > low else ""
        lines.append(f"            {where_text(e, len(d.recordings) > 1)}, at {e.time_s:.4f} s"
                     f"{about}: {size_text(finding.cause, e)}")  # fmt: skip
    more = len(finding.events) - PRINTED
    if more > 0:
        lines.append(f"            and {more} more; --json and --report list all of them")
    return lines


def _number(p: Parameter) -> str:
    unit = "" if p.unit == "1" else f" {p.unit}"
    if not p.ci95:
        return f"{p.value:.4g}{unit}"
    low, high = p.ci95
    # digits that the interval's width can be read from
    share = max(abs(low), abs(high)) / max(high - low, 1e-300)
    digits = int(np.clip(np.ceil(np.log10(max(share, 1.0))) + 2, 4, 9))
    return f"{p.value:.{digits}g}{unit}  [{low:.{digits}g}, {high:.{digits}g}]"
