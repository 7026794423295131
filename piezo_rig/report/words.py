"""Plain words: what a cause means, and what a diagnosis amounts to.

What is known of a cause stands in its own file's docstring; nothing of it is repeated here.
"""

from __future__ import annotations

import inspect
import re

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis import Diagnosis, Finding

PLACES = {
    "drive": "the drive (amplifier)",
    "actuator": "the actuator itself",
    "sensor": "the sensor (interferometer)",
    "acquisition": "the recording (digitizer)",
}
SMALLER = (("s", 1e-3, 1e6, "µs"), ("s", 1.0, 1e3, "ms"), ("um", 0.1, 1e3, "nm"))
TOLD = {
    "drive": "the drive", "displacement": "the displacement", "direction": "the direction",
    "range": "the range of the half loop before", "time_since_turn": "the time since the turning "
    "point", "cycle": "the number of cycles played", "clock": "clock time",
    "frequency": "the speed of the drive",
}  # fmt: skip


def about(cause: str) -> dict[str, str]:
    """What a cause's file says of it: ``meaning``, ``Physics``, ``Shows as``, ``Plausible``."""
    kind = CAUSES.get(cause)
    module = inspect.getmodule(kind) if kind is not None else None
    text = inspect.cleandoc(module.__doc__ or "") if module is not None else ""
    out: dict[str, str] = {}
    for i, paragraph in enumerate(re.split(r"\n\s*\n", text)):
        line = " ".join(paragraph.split())
        head, found, rest = line.partition(": ")
        if i == 0:
            out["meaning"] = (rest if found else line).rstrip(".")
        elif found and head in ("Physics", "Shows as", "Plausible"):
            out[head] = rest
    return {k: v for k, v in out.items() if v}


def with_unit(p: Parameter) -> str:
    """A value with its unit, in a size that people read; a bare number has none."""
    times, unit = scaled(p)
    return significant(times * p.value) + unit


def scaled(p: Parameter) -> tuple[float, str]:
    """Factor and unit that make a value neither tiny nor huge; its interval takes the same."""
    size = abs(p.value)
    for unit, limit, times, other in SMALLER:
        if p.unit == unit and 0.0 < size < limit:
            return times, f"\N{NO-BREAK SPACE}{other}"
    if p.unit == "1":
        return 1.0, ""
    return 1.0, f"\N{NO-BREAK SPACE}{p.unit.replace('um', 'µm')}"


def significant(value: float) -> str:
    """Four digits, with a real minus sign."""
    return f"{value:.4g}".replace("-", "\N{MINUS SIGN}")


def interval(p: Parameter, given: bool = False) -> str:
    """The 95 % interval; ``given``: the parameter is a choice of form that is not fitted."""
    if p.ci95 is None:
        return "the form that fits best; not fitted" if given else "no interval"
    times, unit = scaled(p)
    low, high = (significant(times * x) for x in p.ci95)
    return f"95 %: {low} to {high}{unit}"


def gain_text(finding: Finding) -> str:
    """By how much the error fell, and how sure that is."""
    if finding.gain_percent is None:
        return "not given"
    gain = f"{finding.gain_percent:.1f}\N{NO-BREAK SPACE}%"
    if finding.gain_ci95 is None:
        return gain
    low, high = finding.gain_ci95
    return f"{gain} (95 %: {low:.1f} to {high:.1f} %)".replace("-", "\N{MINUS SIGN}")


def chance(p: float) -> str:
    """The chance of a false alarm as people say it."""
    if p < 1e-6:
        return "less than one in a million"
    if p >= 0.0999:
        return f"{100 * p:.0f} in 100"
    return f"about 1 in {float(f'{1 / p:.1g}' if p < 0.01 else f'{1 / p:.2g}'):,.0f} (p = {p:.2g})"


def verdict(d: Diagnosis) -> list[str]:
    """Two to four sentences for somebody in a hurry."""
    first, last = d.rungs[0], d.rungs[-1]
    repeats = f", each condition up to {d.repeats} times" if d.repeats > 1 else ""
    one = d.sweeps == 1
    held = "in the fit itself (too few cycles to hold any out)" if d.held_out == "none" else (
        "on data it had not been fitted to"
    )  # fmt: skip
    out = [
        f"{d.sweeps} recorded sweep{'' if one else 's'} ({d.samples:,} samples{repeats}) "
        f"{'was' if one else 'were'} compared with a simulation by the model {d.baseline}: it "
        f"was off by {nm(first.rms_nm)} rms, at worst by {first.max_percent:.2g} % of the "
        f"travel, {held}."
    ]
    count = len(d.findings)
    if d.findings:
        names = listed([f.cause for f in d.findings])
        out.append(f"{'One cause was' if count == 1 else f'{count} causes were'} named: {names}.")
    else:
        out.append("No cause was named: the model says all that these data can show.")
    if len(d.rungs) > 1:
        times = first.rms_nm / max(last.rms_nm, 1e-12)
        falls = "falls" if times >= 1.0 else "comes"
        smaller = f", {times:.2g} times smaller" if times >= 1.05 else ""
        out.append(f"With {'it' if count == 1 else 'all of that'} the error {falls} to "
                   f"{nm(last.rms_nm)} rms and {last.max_percent:.2g} % at worst{smaller}.")
    floor = "" if d.noise_floor_nm is None else (
        f" Repeats of the same drive differ by {nm(d.noise_floor_nm)} among themselves; no model "
        "can do better than that."
    )  # fmt: skip
    rest = d.unexplained
    verdict = "Nothing that remains stands out of the noise."
    if rest.detected:
        verdict = f"Something remains that no known cause explains: {nm(rest.rms_nm)} rms."
    unsure = [f"{f.cause} may as well be {listed(f.alternatives, 'or')}"
              for f in d.findings if f.alternatives]  # fmt: skip
    if unsure:
        verdict += f" Not decided by these data: {'; '.join(unsure)}."
    out.append(verdict + floor)
    return out


def nm(value: float) -> str:
    """A length in nm, three digits."""
    return f"{float(f'{value:.3g}'):,g}\N{NO-BREAK SPACE}nm"


def listed(words: list[str], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
