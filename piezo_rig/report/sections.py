"""The sections of a diagnosis' page after the ladder, each a function that returns HTML."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from piezo_rig import __version__
from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.causes.mains_hum import FUNDAMENTALS_HZ
from piezo_rig.diagnosis import Diagnosis, Finding
from piezo_rig.diagnosis.events import LISTED, in_all
from piezo_rig.diagnosis.found import RIPPLE, said_all
from piezo_rig.report.events import events_html, marks_of
from piezo_rig.report.residuals import Residuals
from piezo_rig.report.spectrum import hum_plot
from piezo_rig.report.svg import Plot, draw
from piezo_rig.report.views import (
    View,
    before_and_after,
    own_scale,
    rest_views,
    ripple_view,
    single,
    views_of,
    y_label,
)
from piezo_rig.report.words import (
    PLACES,
    about,
    chance,
    gain_text,
    interval,
    listed,
    nm,
    real_minus,
    with_unit,
)

HARDLY = 0.3  # of the noise: what is beyond it may be chance
TO_TRY = {  # what is left goes with -> what shows more of it
    "clock": "record as long with the drive held still, which shows what goes by the clock",
    "frequency": "play rate_sweep, the same drive at several speeds",
    "time_since_turn": "play hold_steps, which waits after each step",
    "cycle": "let the actuator rest, and play the same condition again",
    "range": "play minor_loops, many ranges in one recording",
    "direction": "play minor_loops, which goes both ways from everywhere",
}


def findings_html(found: Diagnosis, residuals: Residuals | None) -> str:
    """One card to a finding, in the order in which they were accepted."""
    if not found.findings and found.unexplained.detected:
        return "<p>No cause was named: none that is known says what is left.</p>"
    if not found.findings:
        return (f"<p>No cause was named: {escape(said_all(found, found.baseline))} says all that "
                "these data can show.</p>")  # fmt: skip
    return "\n".join(_finding(found, i, f, residuals) for i, f in enumerate(found.findings))


def _finding(found: Diagnosis, index: int, finding: Finding, residuals: Residuals | None) -> str:
    said = about(finding.cause)
    place = escape(PLACES.get(finding.place, finding.place))
    name = escape(finding.cause)
    out = [f'<section class="finding" id="finding-{index}"><h3>{index + 1}. {name} '
           f'<span class="place">in {place}</span></h3>']
    if "meaning" in said:
        meaning = said["meaning"]
        out.append(f'<p class="meaning">{escape(meaning[:1].upper() + meaning[1:])}.</p>')
    kind = CAUSES.get(finding.cause)
    given, means = tuple[str, ...](), dict[str, str]()
    if kind is not None and issubclass(kind, Cause):
        given, means = kind.given, dict(kind.meanings)
    rows = [(name.removesuffix(f"_{p.unit}").replace("_", " "), escape(with_unit(p)),
             _said(interval(p, name in given), means.get(name, "")))
            for name, p in finding.parameters.items()
            if not (finding.events and name in LISTED)]  # fmt: skip
    if finding.events:
        count, _, more = in_all(finding.events).partition(" event")
        rows.insert(0, ("events", count, escape(real_minus(more.removeprefix("s").strip()))))
    gain, _, sure = gain_text(finding).partition(" (")
    sure = sure.rstrip(")") + "; " if sure else ""
    rows.append(("gain", escape(gain), escape(sure) + _gain_words(found, index)))
    rows.append(("chance of a false alarm", escape(chance(finding.p_value)),
                 "all causes that were tried are counted in"))  # fmt: skip
    out.append(_facts(rows))
    out.append(_alternatives(finding))
    if "Remedy" in said:
        out.append(f'<p class="remedy"><b>What to do.</b> {escape(said["Remedy"])}</p>')
    if residuals is not None:
        out.append(_figure(found, index, finding, residuals))
    if finding.events:
        at = found.rung_of(index)
        drawn = residuals if at else None
        pair = residuals.but_for(finding.cause, at) if residuals is not None and at else (0, 0)
        out.append(events_html(found, index, finding, drawn, pair))
    known = [f"<p><b>{head}.</b> {escape(said[head][:1].upper() + said[head][1:])}</p>"
             for head in ("Physics", "Shows as", "Plausible") if head in said]  # fmt: skip
    if known:
        out.append(f"<details><summary>About {escape(finding.cause)}</summary>"
                   f"{''.join(known)}</details>")  # fmt: skip
    return "\n".join([*out, "</section>"])


def _said(interval: str, meaning: str) -> str:
    """An interval, and below it what the number is."""
    return escape(interval) + (f"<br><small>{escape(meaning)}</small>" if meaning else "")


def _facts(rows: Sequence[tuple[str, str, str]]) -> str:
    cells = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{value}</td><td class="quiet">{more}</td></tr>'
        for name, value, more in rows
    )
    return f'<div class="wide"><table class="facts">{cells}</table></div>'


def _gain_words(found: Diagnosis, index: int) -> str:
    if found.findings[index].gain_percent is None:
        return ("nothing was held out" if found.held_out == "none"
                else "no model can foretell single events")  # fmt: skip
    at = found.rung_of(index)
    if at == 0:
        return ""
    before, after = found.rungs[at - 1], found.rungs[at]
    return f"rms error from {nm(before.rms_nm)} to {nm(after.rms_nm)}, on data left out of the fit"


def _alternatives(finding: Finding) -> str:
    if not finding.alternatives:
        if finding.d_prime is None:
            return ""
        return "<p><b>Told apart</b> from every other cause that was tried in these data.</p>"
    others = escape(listed(finding.alternatives, "or"))
    return (
        f'<p class="warn"><b>Cannot be told from {others}.</b> With '
        "the drives that were played, the one does to the displacement what the others would do: "
        "any of them may be the true cause, or some of each. The model predicts these drives "
        "equally well either way, but not necessarily others. "
        '<a href="#next">What to play next</a> says how to decide.</p>'
    )


def _figure(found: Diagnosis, index: int, finding: Finding, residuals: Residuals) -> str:
    at = found.rung_of(index)
    if at == 0 or at >= residuals.rungs:
        return ""
    if finding.cause == "mains-hum":
        given, pair = finding.parameters.get("frequency"), residuals.but_for(finding.cause, at)
        plot = hum_plot(residuals, pair, given.value if given else FUNDAMENTALS_HZ[0])
        text = ("What single recordings have of their own, in clock time; the dotted lines are the "
                "mains and its odd harmonics. With few repeats the heights depend on how their "
                "phases happen to lie; the amplitude above does not.")  # fmt: skip
        return figure_html(plot, text)
    out = []
    for view in views_of(finding.cause):
        marks = marks_of(finding, residuals)
        plot = before_and_after(
            residuals, residuals.but_for(finding.cause, at), finding.cause, view,
            found.noise_floor_nm, marks,
        )
        numbered = ", as numbered below" if any(text for _, text in marks) else ""
        how = f" Dotted: the events{numbered}." if marks else "" if view.envelope else (
            " Means in bins; the shade of a curve is its standard error from half loop to half "
            "loop."
        )  # fmt: skip
        out.append(figure_html(plot, view.text + how + _floor_words(found)))
    return "\n".join(out)


def _floor_words(found: Diagnosis) -> str:
    if found.noise_floor_nm is None:
        return " The noise floor is not known (no repeats)."
    return f" Grey: the noise floor of single readings, ±{nm(found.noise_floor_nm)}."


def figure_html(plot: Plot, caption: str) -> str:
    """A plot; where it has two panels, the last one by itself behind a button."""
    closer = ""
    if len(plot.panels) > 1:
        closer = (f'<div class="view" hidden>{draw(own_scale(plot))}</div>'
                  '<p class="script" hidden><button type="button" data-swap>'
                  "look closer at the last one</button></p>")
    return (f'<figure><div class="view">{draw(plot)}</div>{closer}'
            f"<figcaption>{escape(caption)}</figcaption></figure>")  # fmt: skip


def rest_html(found: Diagnosis, residuals: Residuals | None) -> str:
    """What remains after the last finding."""
    rest = found.unexplained
    if rest.detected:
        out = [f'<p class="warn"><b>Unexplained: {escape(rest.text)}.</b> '
               f"The noise is taken out of that; {nm(rest.allowance_nm)} would be allowed, for no "
               "model is exact. No cause of the catalogue does this: look at the bench (mounting, "
               "cables, what else was running), and at the figures below.</p>"]  # fmt: skip
    else:
        out = ["<p>Nothing that stands out. No pattern in drive, displacement, direction, range, "
               "time since the turning point, cycle, clock or speed is more than chance makes "
               f"likely: {nm(rest.rms_nm)} rms with the noise taken out, and up to "
               f"{nm(rest.allowance_nm)} is allowed, for no model is exact.</p>"]  # fmt: skip
    if residuals is not None:
        last = residuals.rungs - 1
        out.append(_inexact(found, residuals, last))
        out.append(_ripple(found, residuals))
        for view in rest_views(rest.depends_on):
            out.append(figure_html(_last(found, residuals, last, view),
                                   view.text + _floor_words(found)))  # fmt: skip
    return "\n".join(out)


def _ripple(found: Diagnosis, residuals: Residuals) -> str:
    """What comes back with displacement or drive: before it was set aside and after, or what is
    left.
    """
    ripple = found.unexplained.ripple
    if ripple is None:
        return ""
    view, words = ripple_view(ripple.over, ripple.period), _floor_words(found)
    at = next((i for i, r in enumerate(found.rungs) if r.added == RIPPLE), None)
    if at is None:
        return figure_html(_last(found, residuals, residuals.rungs - 1, view), view.text + words)
    plot = before_and_after(
        residuals, residuals.but_for(RIPPLE, at), "the ripple", view, found.noise_floor_nm
    )
    return figure_html(plot, view.text + words)


def _inexact(found: Diagnosis, residuals: Residuals, rung: int) -> str:
    """How far the mean over repeats is off, and how much of that the noise is."""
    rows = [residuals.mean(rung, g) for g in range(len(residuals.samples))]
    counts = [s.group.repeats for s in residuals.samples]
    if found.noise_floor_nm is None or min(counts) < 2:
        return ""
    off = float(np.sqrt(np.mean(np.concatenate([row**2 for row in rows]))))
    shares = np.concatenate([np.full(r.size, 1.0 / c) for r, c in zip(rows, counts, strict=True)])
    noise = found.noise_floor_nm * float(np.sqrt(np.mean(shares)))
    beyond = float(np.sqrt(max(off**2 - noise**2, 0.0)))
    what = "which is all of it" if beyond < HARDLY * noise else (
        f"the {nm(beyond)} beyond that are how inexact the model still is"
    )  # fmt: skip
    return (f"<p>The mean over repeats is off the model by {nm(off)} rms; noise alone makes "
            f"about {nm(noise)}, {what}.</p>")  # fmt: skip


def _last(found: Diagnosis, residuals: Residuals, rung: int, view: View) -> Plot:
    return Plot(
        [single(residuals, rung, view, "the last residual, with everything that was found")],
        view.x_label, y_label(view), f"Last residual against {view.x_label}.",
        view.log, found.noise_floor_nm, view.x_unit,
    )  # fmt: skip


def next_html(found: Diagnosis, files: Sequence[str], options: Sequence[str] = ()) -> str:
    """What to play next, as it is typed; ``options`` as they were given with the files."""
    confused = [f for f in found.findings if f.alternatives]
    if not confused:
        return _nothing_confounded(found)
    pairs = "; ".join(f"{f.cause} from {listed(f.alternatives)}" for f in confused)
    if found.follow_up is None:
        return (f"<p>Not decided yet: {escape(pairs)}. None of the shipped protocols would tell "
                "them apart.</p>")  # fmt: skip
    name = found.follow_up.protocol
    data = " ".join(shlex.quote(f) for f in files) or "DATA"
    told = "".join(f" {shlex.quote(o)}" for o in options)
    scaled = found.follow_up.scaled
    played = f"my_{name}" if scaled else name
    file = f"./{played}.toml" if scaled else shlex.quote(name)
    play = f"piezo-rig run {file} --rig YOUR_BENCH.toml --out runs"
    look = f"piezo-rig diagnose {data} runs/{played}_*.h5{told} --report decided.html"
    at_once = (f"piezo-rig diagnose {data}{told} --follow-up --rig YOUR_BENCH.toml "
               "--report decided.html")  # fmt: skip
    out = [
        f"<p>Not decided yet: {escape(pairs)}. Of the shipped protocols, <b>{escape(name)}</b> "
        f"separates {escape(' from '.join(found.follow_up.separates[:1]))} best from "
        f"{escape(listed(found.follow_up.separates[1:]))}.</p>"
    ]
    if scaled:
        out.append(
            '<p class="warn"><b>Do not play it as it is shipped.</b> It has to be '
            f"{escape(scaled)}: copy the protocol file to <code>{escape(played)}.toml</code>, "
            "change its name and its voltages, and play the copy.</p>"
        )
    out.append(
        "<p>Play it on the same stack, then diagnose everything together:</p>"
        f"<pre>{escape(play)}\n{escape(look)}</pre>"
    )
    if not scaled:
        out.append(f"<p>Or in one go:</p><pre>{escape(at_once)}</pre>")
    out.append(
        '<p class="quiet">YOUR_BENCH.toml is the config of the rig that the data come from. '
        f"<code>piezo-rig plan {escape(file)} --rig YOUR_BENCH.toml</code> checks it first, "
        "without touching hardware.</p>"
    )
    return "".join(out)


def _nothing_confounded(found: Diagnosis) -> str:
    """What may still be played where nothing is confounded."""
    out = "Nothing is confounded: no protocol is needed to tell the named causes apart."
    unseen = {c: why for c, why in found.refused.items() if "would show" in why}
    if found.unexplained.detected:
        tries = [TO_TRY[w] for w in found.unexplained.depends_on if w in TO_TRY]
        if any("play " in t for t in tries):
            tries.append("a protocol's voltages scaled to what this stack was driven with")
        out += (" More of the same does not name what is unexplained. Change one thing at a time, "
                "and see whether it stays: the mounting, cables, what else is running"
                f"{'; ' + '; '.join(dict.fromkeys(tries)) if tries else ''}.")  # fmt: skip
    if unseen:
        out += (f" These data could not show {listed(list(unseen), 'or')}: "
                f"{next(iter(unseen.values()))}.")  # fmt: skip
    return f"<p>{escape(out)}</p>"


def notes_html(found: Diagnosis) -> str:
    """Warnings, notes, and what was not tried."""
    out = []
    for title, words in (("Warnings", found.warnings), ("Remarks", found.notes)):
        if words:
            items = "".join(f"<li>{escape(w)}</li>" for w in words)
            out.append(f"<h3>{title}</h3><ul>{items}</ul>")
    if found.refused:
        items = "".join(f"<li><b>{escape(cause)}</b>: {escape(why)}</li>"
                        for cause, why in found.refused.items())  # fmt: skip
        out.append(f"<h3>Not tried or not kept, and why</h3><ul>{items}</ul>")
    return "\n".join(out) or "<p>No warnings; every cause that is known was tried.</p>"


def provenance_html(found: Diagnosis, hashes: Mapping[str, str]) -> str:
    """Where the numbers come from."""
    held = {
        "none": "nothing (see notes)", "cycles": "the last third of the cycles",
        "sweep": "one sweep after the other", "condition": "one condition after the other",
    }  # fmt: skip
    rows = [
        ("baseline", escape(found.baseline), ""),
        ("data", f"{found.sweeps} sweeps, {found.samples:,} samples",
         f"up to {found.repeats} recordings of a drive"),
        ("held out", held.get(found.held_out, escape(found.held_out)), "every error and gain"),
        ("software", f"piezo-rig {escape(__version__)}", ""),
    ]  # fmt: skip
    records = "".join(
        f"<tr><td>{escape(name)}</td><td>{real_minus(f'{offset:+.3f}')} µm</td></tr>"
        for name, offset in found.recordings if len(found.recordings) > 1
    )  # fmt: skip
    said = "".join(f"<li>{escape(line)}</li>" for line in found.assumed)
    sums = "".join(f"<tr><td>{escape(name)}</td><td><code>{escape(h)}</code></td></tr>"
                   for name, h in sorted(hashes.items()))  # fmt: skip
    return (
        _facts(rows)
        + (f"<h3>Assumed of the recordings</h3><ul>{said}</ul>" if said else "")
        + ('<div class="wide"><table class="facts"><tr><th>recording</th><th>offset against the '
           f"first</th></tr>{records}</table></div>" if records else "")
        + ('<div class="wide"><table class="facts"><tr><th>file</th><th>SHA-256</th></tr>'
           f"{sums}</table></div>" if sums else "")
    )  # fmt: skip
