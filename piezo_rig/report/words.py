"""Plain words: what a cause means, numbers as people read them.

What is known of a cause stands in its own file's docstring; nothing of it is repeated here.
"""

from __future__ import annotations

import inspect
import re

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis import Finding
from piezo_rig.diagnosis.document import TRIED_OUT

PLACES = {
    "drive": "the drive (amplifier)",
    "actuator": "the actuator itself",
    "sensor": "the sensor (interferometer)",
    "acquisition": "the recording (digitizer)",
}
_MICRO = re.compile(r"\bu(?=m\b)|(?<=\d )u(?=[sF]\b)")  # um; us and uF behind a number
SMALLER = (("s", 1e-3, 1e6, "µs"), ("s", 1.0, 1e3, "ms"), ("um", 0.1, 1e3, "nm"),
           ("1", 0.5, 1e2, "%"))  # fmt: skip
SAID = ("Physics", "Shows as", "Remedy", "Plausible")
TOLD = {
    "drive": "the drive", "displacement": "the displacement", "direction": "the direction",
    "range": "the range of the half loop before", "time_since_turn": "the time since the turning "
    "point", "cycle": "the number of cycles played", "clock": "clock time",
    "frequency": "the speed of the drive",
}  # fmt: skip


def about(cause: str) -> dict[str, str]:
    """What a cause's file says of it: ``meaning``, and `SAID` of it."""
    kind = CAUSES.get(cause)
    module = inspect.getmodule(kind) if kind is not None else None
    text = inspect.cleandoc(module.__doc__ or "") if module is not None else ""
    out: dict[str, str] = {}
    for i, paragraph in enumerate(re.split(r"\n\s*\n", text)):
        line = " ".join(paragraph.split())
        head, found, rest = line.partition(": ")
        if i == 0:
            out["meaning"] = (rest if found else line).rstrip(".")
        elif found and head in SAID:
            out[head] = rest
    return {k: _MICRO.sub("µ", v.replace("`", "")) for k, v in out.items() if v}


def with_unit(p: Parameter) -> str:
    """A value with its unit, in a size that people read; a bare number has none."""
    times, unit = scaled(p)
    return significant(times * p.value, digits_of(p)) + unit


def scaled(p: Parameter) -> tuple[float, str]:
    """Factor and unit that make a value neither tiny nor huge; its interval takes the same."""
    size = abs(p.value)
    for unit, limit, times, other in SMALLER:
        if p.unit == unit and 0.0 < size < limit:
            return times, f"\N{NO-BREAK SPACE}{other}"
    if p.unit == "1":
        return 1.0, ""
    return 1.0, f"\N{NO-BREAK SPACE}{p.unit.replace('um', 'µm')}"


def digits_of(p: Parameter) -> int:
    """Digits that the width of the interval can be read from, four at least."""
    if p.ci95 is None:
        return 4
    low, high = p.ci95
    share = max(abs(low), abs(high)) / max(high - low, 1e-300)
    return int(np.clip(np.ceil(np.log10(max(share, 1.0))) + 1, 4, 9))


def significant(value: float, digits: int = 4) -> str:
    """So many digits, with a real minus sign."""
    return real_minus(f"{value:.{digits}g}")


def real_minus(text: str) -> str:
    """Numbers with a minus sign instead of a hyphen."""
    return text.replace("-", "\N{MINUS SIGN}")


def interval(p: Parameter, given: bool = False) -> str:
    """The 95 % interval; ``given``: the parameter is a choice of form that is not fitted."""
    if p.ci95 is None:
        return "the form that fits best; not fitted" if given else "no interval"
    times, unit = scaled(p)
    # with their zeros, so that both ends are as exact as they look
    low, high = (real_minus(f"{times * x:#.{digits_of(p)}g}".rstrip(".")) for x in p.ci95)
    return f"95 %: {low} to {high}{unit}"


def gain_text(finding: Finding) -> str:
    """By how much the error fell, and how sure that is."""
    if finding.gain_percent is None:
        return "not given"
    low, high = finding.gain_ci95 or (np.nan, np.nan)
    digits = 2 if high - low < 0.2 else 1  # ends that differ are to look different
    gain = f"{finding.gain_percent:.{digits}f}\N{NO-BREAK SPACE}%"
    if finding.gain_ci95 is None:
        return real_minus(gain)
    return real_minus(f"{gain} (95 %: {low:.{digits}f} to {high:.{digits}f} %)")


def chance(p: float) -> str:
    """The chance of a false alarm as people say it."""
    if p < TRIED_OUT:
        return "less than one in a million"
    if p >= 0.0999:
        return f"{100 * p:.0f} in 100"
    return f"about 1 in {float(f'{1 / p:.1g}' if p < 0.01 else f'{1 / p:.2g}'):,.0f} (p = {p:.2g})"


def nm(value: float) -> str:
    """A length in nm, three digits."""
    return f"{float(f'{value:.3g}'):,g}\N{NO-BREAK SPACE}nm"


def listed(words: list[str], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
