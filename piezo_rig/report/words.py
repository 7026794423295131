"""Plain words: what a cause means, and what a diagnosis amounts to.

What is known of a cause stands in its own file's docstring; nothing of it is repeated here.
"""

from __future__ import annotations

import inspect
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis import Diagnosis, Finding
from piezo_rig.diagnosis.document import TRIED_OUT
from piezo_rig.diagnosis.found import RIPPLE, said_all

PLACES = {
    "drive": "the drive (amplifier)",
    "actuator": "the actuator itself",
    "sensor": "the sensor (interferometer)",
    "acquisition": "the recording (digitizer)",
}
_MICRO = re.compile(r"\bu(?=m\b)|(?<=\d )u(?=[sF]\b)")  # um; us and uF behind a number
SMALLER = (("s", 1e-3, 1e6, "µs"), ("s", 1.0, 1e3, "ms"), ("um", 0.1, 1e3, "nm"),
           ("1", 0.5, 1e2, "%"))  # fmt: skip
WEIGHTY = 2.0  # % of the error: a cause that takes less is there, and matters little
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
    return {k: _MICRO.sub("µ", v.replace("``", "`")) for k, v in out.items() if v}


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


def verdict(d: Diagnosis) -> list[str]:
    """Two to four sentences for somebody in a hurry."""
    first, last = d.rungs[0], d.rungs[-1]
    repeats = f", each condition up to {d.repeats} times" if d.repeats > 1 else ""
    one = d.sweeps == 1
    held = "in the fit itself (nothing could be held out)" if d.held_out == "none" else (
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
        names = listed([_counted(f) + _hardly(f) for f in d.findings])
        out.append(f"{'One cause was' if count == 1 else f'{count} causes were'} named: {names}."
                   f"{_most(d)}")  # fmt: skip
    elif d.unexplained.detected:
        out.append("No cause was named: none that is known says what is left.")
    else:
        out.append(f"No cause was named: {said_all(d, 'the model')} says all that these data can "
                   "show.")  # fmt: skip
    if len(d.rungs) > 1:
        times = first.rms_nm / max(last.rms_nm, 1e-12)
        falls = "falls" if times >= 1.0 else "comes"
        smaller = f", {times:.2g} times smaller" if times >= 1.05 else ""
        said = "it" if count == 1 else "all of that"
        if any(r.added == RIPPLE for r in d.rungs):
            aside = "an error that comes back with displacement set aside"
            said = f"{said}, and {aside}," if count else aside
        out.append(f"With {said} the error {falls} to "
                   f"{nm(last.rms_nm)} rms and {last.max_percent:.2g} % at worst{smaller}.")
    floor = "" if d.noise_floor_nm is None else (
        f" Repeats of the same drive differ by {nm(d.noise_floor_nm)} among themselves; no model "
        "foretells a single reading better than that."
    )  # fmt: skip
    rest = d.unexplained
    verdict = "Nothing that remains stands out of the noise."
    if rest.detected:
        on = [TOLD.get(w, w) for w in rest.depends_on]
        often = f", every {1e3 * rest.period_um:.4g} nm" if rest.period_um is not None else ""
        verdict = (f"Something remains that no known cause explains: {nm(rest.rms_nm)} rms"
                   f"{', which goes with ' + listed(on) if on else ''}{often}.")  # fmt: skip
    unsure = [f"{f.cause} may as well be {listed(f.alternatives, 'or')}"
              for f in d.findings if f.alternatives]  # fmt: skip
    if unsure:
        verdict += f" Not decided by these data: {'; '.join(unsure)}."
        if d.follow_up is not None:
            verdict += f" To decide it, play {Path(d.follow_up.protocol).stem}"
            verdict += f", {d.follow_up.scaled}." if d.follow_up.scaled else "."
    out.append(verdict + floor)
    return out


def _counted(finding: Finding) -> str:
    n = len(finding.events)
    return finding.cause + (f" ({n} event{'' if n == 1 else 's'})" if n else "")


def _hardly(finding: Finding) -> str:
    """A word on a cause that is there, and of no weight."""
    if finding.gain_ci95 is None or finding.gain_ci95[1] > WEIGHTY:
        return ""
    return " (there, but hardly any of the error)"


def _most(d: Diagnosis) -> str:
    """Which of several causes took most of the error away."""
    falls = [
        (before.rms_nm - after.rms_nm, before, after)
        for before, after in pairwise(d.rungs) if after.finding is not None
    ]  # fmt: skip
    if len(falls) < 2:
        return ""
    fall, before, after = max(falls, key=lambda f: f[0])
    if fall <= 0.0:
        return ""
    return (f" Most of the error went with {after.added}: from {nm(before.rms_nm)} to "
            f"{nm(after.rms_nm)}.")  # fmt: skip


def nm(value: float) -> str:
    """A length in nm, three digits."""
    return f"{float(f'{value:.3g}'):,g}\N{NO-BREAK SPACE}nm"


def listed(words: list[str], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
