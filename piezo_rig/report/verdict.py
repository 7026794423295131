"""What a diagnosis amounts to, for somebody in a hurry: on the page and in a terminal."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, field
from pathlib import Path

from piezo_rig.diagnosis import Diagnosis, Finding
from piezo_rig.diagnosis.found import RIPPLE, Rung, said_all
from piezo_rig.report.words import (
    PLACES,
    TOLD,
    about,
    interval,
    listed,
    nm,
    real_minus,
    with_unit,
)

WEIGHTY = 2.0  # % of the error: a cause that takes less is there, and matters little
MOST = 0.5  # of all that fell
WIDTH = 100  # columns of a terminal
PLAIN = str.maketrans({"\N{NO-BREAK SPACE}": " ", "µ": "u", "\N{MINUS SIGN}": "-"})


@dataclass
class Verdict:
    """``head`` first, then a line for every cause that matters, then ``rest``; plain text.

    ``open`` : whether something is left to be done or decided
    """

    head: str
    causes: list[str] = field(default_factory=list)
    rest: list[str] = field(default_factory=list)
    open: bool = False

    @property
    def lines(self) -> list[str]:
        """All of it."""
        return [self.head, *self.causes, *self.rest]

    def in_a_terminal(self) -> list[str]:
        """Lines of a terminal's width, in plain letters."""
        out = []
        for i, line in enumerate(self.lines):
            before = "verdict   " if i == 0 else 10 * " " + ("- " if line in self.causes else "")
            out += textwrap.wrap(
                line, WIDTH, initial_indent=before, subsequent_indent=12 * " ",
                break_long_words=False, break_on_hyphens=False,
            )  # fmt: skip
        return [line.translate(PLAIN) for line in out]


def verdict(d: Diagnosis) -> Verdict:
    """What is wrong, how much, how sure; what remains; what to do."""
    weighty = [f for f in d.findings if _weight(f) != "little"]
    light = [f for f in d.findings if _weight(f) == "little"]
    worse = d.rungs[-1].rms_nm > d.rungs[0].rms_nm
    out = Verdict(_head(d, len(weighty)), [_line(d, f) for f in _by_weight(d, weighty)])
    if light:
        names = listed([f"{f.cause}{_size(f)}" for f in light])
        out.rest.append(f"There as well, with hardly any of the error: {names}.")
    out.rest.append(_errors(d))
    rest, unsure = d.unexplained, [f for f in d.findings if f.alternatives]
    if rest.detected:
        out.rest.append(_remains(d))
    elif d.at_home_nm is not None:
        out.rest.append(_changed(d, d.at_home_nm))
    elif not worse:
        out.rest.append("Nothing that remains stands out of the noise.")
    # a remedy may be to use the extended model
    out.rest += _to_do(d, [] if worse else weighty or light, unsure)
    out.rest.append(_data(d))
    out.open = rest.detected or bool(unsure) or worse or d.at_home_nm is not None
    return out


def _weight(finding: Finding) -> str:
    """Of what weight a finding is: "much", "doubtful", "worse" or "little"."""
    if finding.gain_percent is None or finding.gain_ci95 is None:
        return "much"
    low, high = finding.gain_ci95
    if high < -WEIGHTY:
        return "worse"
    if high <= WEIGHTY:
        return "little"
    return "much" if low > 0.0 else "doubtful"


def _head(d: Diagnosis, weighty: int) -> str:
    if weighty:
        named = "One cause was" if weighty == 1 else f"{weighty} causes were"
        return f"{named} named for what the model {d.baseline} gets wrong:"
    if d.findings:
        return f"No cause was named that matters: {said_all(d, 'the model')} says the rest."
    if d.unexplained.detected:
        return "No cause was named: none that is known says what is left."
    return (f"No cause was named: {said_all(d, 'the model')} says all that these data can "
            "show.")  # fmt: skip


def _by_weight(d: Diagnosis, findings: list[Finding]) -> list[Finding]:
    """What nothing foretells first, then by the share of the error that each takes."""
    return sorted(findings, key=lambda f: -(1e3 if f.gain_percent is None else f.gain_percent))


def _line(d: Diagnosis, finding: Finding) -> str:
    n = len(finding.events)
    name = finding.cause + (f" ({n} event{'' if n == 1 else 's'})" if n else "")
    said = f"{name}, in {PLACES.get(finding.place, finding.place)}{_size(finding, True)}"
    return f"{said}{_fall(d, finding)}{_or(finding)}."


def _size(finding: Finding, wide: bool = False) -> str:
    """Its first number; ``wide`` : with its interval."""
    for name, p in finding.parameters.items():
        if finding.events or p.ci95 is None:
            continue
        name = name.removesuffix(f"_{p.unit}").replace("_", " ")
        if not wide:
            return f" ({name} {with_unit(p)})"
        return f": {name} {with_unit(p)} ({interval(p).removeprefix('95 %: ')})"
    return ""


def _fall(d: Diagnosis, finding: Finding) -> str:
    at = d.rung_of(d.findings.index(finding))
    if at == 0 or finding.gain_percent is None:
        return ""
    before, after = d.rungs[at - 1], d.rungs[at]
    said = f"; the error goes from {nm(before.rms_nm)} to {nm(after.rms_nm)}"
    weight = _weight(finding)
    if weight == "worse":
        return f"{said}: what was held out is predicted worse with it"
    low, high = finding.gain_ci95 or (finding.gain_percent, finding.gain_percent)
    if weight == "doubtful":
        gain = real_minus(f"{finding.gain_percent:.0f} % ({low:.0f} to {high:.0f} %)")
        return f"{said}, {gain} less: whether it helps to predict is not sure"
    return f"{said}, {finding.gain_percent:.0f} % less"


def _or(finding: Finding) -> str:
    if not finding.alternatives:
        return ""
    return f". It may as well be {listed(finding.alternatives, 'or')}"


def _errors(d: Diagnosis) -> str:
    """From the baseline to everything, and what took most of that away if no cause did."""
    first, last = d.rungs[0], d.rungs[-1]
    held = "in the fit itself" if d.held_out == "none" else "on data that it was not fitted to"
    error = f"{nm(first.rms_nm)} rms, at worst by {first.max_percent:.2g} % of the travel, {held}"
    if len(d.rungs) == 1:
        return f"The model {d.baseline} is off by {error}.{_floor(d)}"
    then = f"With all that was added it is {nm(last.rms_nm)} and {last.max_percent:.2g} %"
    if last.rms_nm > first.rms_nm:
        then += ": WORSE than before. Do not use the extended model"
    elif first.rms_nm > 1.05 * last.rms_nm:
        less = float(f"{first.rms_nm / max(last.rms_nm, 1e-12):.2g}")
        then += f", {less:,g} times less"
    return f"The model {d.baseline} is off by {error}. {then}.{_base(d)}{_floor(d)}"


def _base(d: Diagnosis) -> str:
    """What a rung that is no finding took, if that is most of it."""
    def fall(i: int) -> float:
        return d.rungs[i - 1].rms_nm - d.rungs[i].rms_nm

    own = [i for i, r in enumerate(d.rungs) if i and r.finding is None]
    most, whole = max(own, key=fall, default=0), d.rungs[0].rms_nm - d.rungs[-1].rms_nm
    if not most or whole <= 0.0 or fall(most) < MOST * whole:
        return ""
    rung: Rung = d.rungs[most]
    ripple = d.unexplained.ripple
    over = ripple.over if ripple is not None else "displacement"
    what = f"{rung.added}, a part of the base model that the baseline lacks and no fault"
    if rung.added == RIPPLE:
        what = f"an error that comes back with {TOLD.get(over, over)}, set aside"
    return f" Most of that went with {what}."


def _floor(d: Diagnosis) -> str:
    if d.noise_floor_nm is None:
        return ""
    return (f" Repeats of one drive differ by {nm(d.noise_floor_nm)} among themselves: no model "
            "foretells a single reading better.")  # fmt: skip


def _remains(d: Diagnosis) -> str:
    rest = d.unexplained
    on = [TOLD.get(w, w) for w in rest.depends_on]
    goes = f", which goes with {listed(on)}" if on else ""
    often = f", every {rest.ripple.often}" if rest.ripple is not None else ""
    size = f"{float(f'{rest.rms_nm:.2g}'):g}\N{NO-BREAK SPACE}nm"  # as the text of it says it
    said = f"Something remains that no known cause explains: {size} rms{goes}{often}."
    if d.tried_in_vain:
        said += " Much was tried on it in vain: what is named may stand in for it."
    return said


def _changed(d: Diagnosis, at_home_nm: float) -> str:
    return (f"Nothing that remains has a shape of its own, but the given model is off by "
            f"{nm(d.rungs[-1].rms_nm)} rms with all that was found, and was by {nm(at_home_nm)} "
            "where it was identified: something has changed that these data do not name, or these "
            "drives ask more of it.")  # fmt: skip


def _to_do(d: Diagnosis, named: list[Finding], unsure: list[Finding]) -> list[str]:
    """What to do about the weightiest cause, or how to find out which it is."""
    if unsure and d.follow_up is not None:
        name = Path(d.follow_up.protocol).stem
        scaled = f", {d.follow_up.scaled}" if d.follow_up.scaled else ""
        return [f"Next: play {name}{scaled}: it tells {d.follow_up.separates[0]} from "
                f"{listed(d.follow_up.separates[1:])}."]  # fmt: skip
    if not named or _weight(named[0]) == "little":
        return []
    remedy = about(_by_weight(d, named)[0].cause).get("Remedy", "")
    return [f"To do: {remedy[:1].lower()}{remedy[1:]}"] if remedy else []


def _data(d: Diagnosis) -> str:
    repeats = f", each condition up to {d.repeats} times" if d.repeats > 1 else ""
    return f"From {d.sweeps} recorded sweep{'' if d.sweeps == 1 else 's'} of {d.samples:,} " \
           f"samples{repeats}."
