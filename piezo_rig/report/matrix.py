"""What can be told from what, as a table that is also a heat map."""

from __future__ import annotations

from html import escape

import numpy as np

from piezo_rig.diagnosis import Diagnosis
from piezo_rig.diagnosis.confusion import APART
from piezo_rig.diagnosis.isolability import Isolability
from piezo_rig.report.words import listed, nm

LIKE = 0.9  # cosines from here on are worth a sentence


def told_apart(found: Diagnosis, known: Isolability) -> np.ndarray:
    """Shape (c, c). Of a finding its own alternatives count: they were looked at one by one."""
    told = known.told.copy()
    others = {f.cause: f.alternatives for f in found.findings}
    for i, cause in enumerate(known.causes):
        for j, other in enumerate(known.causes):
            if cause in others and not known.found[j]:
                told[i, j] = other not in others[cause]
    return np.asarray(told)


def too_small(known: Isolability) -> np.ndarray:
    """Shape (c,). What was not found and could hardly be seen here, whatever it is told from."""
    return ~np.asarray(known.found) & (np.asarray(known.d_prime) < APART)


def matrix_html(found: Diagnosis, known: Isolability) -> str:
    """Sentences, the table and its legend."""
    if len(known.causes) < 2:
        return "<p>These data could show fewer than two causes: there is nothing to compare.</p>"
    small = too_small(known)
    told = told_apart(found, known) | small[:, None]
    out = [f"<p>{_sentence(known, told)}{_hardly(known, small)}{_elsewhere(found, known)}</p>",
           '<p class="quiet">A row is what may be true, a column what it might be taken for: 0 is '
           "nothing in common, 1 the same in all that these data show.</p>",
           '<div class="wide"><table class="matrix"><thead><tr><th class="corner">if the truth '
           'is ↓ could it pass for →</th>']
    out += [f'<th scope="col"><span>{escape(c)}</span></th>' for c in known.causes]
    out.append("</tr></thead><tbody>")
    for i, cause in enumerate(known.causes):
        size = f"{nm(known.size_nm[i])} rms"
        short = f"found; by itself {size}" if known.found[i] else "not found"
        short += "; hardly visible here" if small[i] else ""
        if not known.found[i]:
            size = f"not found; taken at its largest plausible size, {size}"
        out.append(f'<tr class="{"member" if known.found[i] else "other"}"><th scope="row">'
                   f"{escape(cause)}<small>{short}</small></th>")  # fmt: skip
        for j, other in enumerate(known.causes):
            if i == j:
                out.append('<td class="self">·</td>')
                continue
            x = known.cosine[i, j]
            says = "told apart" if told[i, j] else "CANNOT be told apart"
            says = "too small here to be told from anything" if small[i] else says
            hint = (f"{cause} ({size}, d′ {known.d_prime[i]:.3g}) against {other}: cosine {x:.3f}, "
                    f"left of d′: {known.apart[i, j]:.3g}; {says}")  # fmt: skip
            out.append(f'<td class="{"told" if told[i, j] else "same"}" style="--c:{x:.2f}" '
                       f'title="{escape(hint)}">{x:.2f}</td>')  # fmt: skip
        out.append("</tr>")
    out.append(f"</tbody></table></div>{_legend()}")
    return "\n".join(out)


def _sentence(known: Isolability, told: np.ndarray) -> str:
    n = len(known.causes)
    same = []
    for i in range(n):
        others = [known.causes[j] for j in range(n) if j != i and not told[i, j]]
        if others:
            same.append(f"{known.causes[i]} could pass for {listed(others, 'or')}")
    if same:
        return "With the drives that were played, " + escape("; ".join(same)) + "."
    near = [f"{known.causes[j]} with {known.causes[i]}" for i in range(n) for j in range(i)
            if max(known.cosine[i, j], known.cosine[j, i]) >= LIKE]  # fmt: skip
    text = "With the drives that were played, every cause here can be told from every other"
    if near:
        text += f", once it is large enough. Much alike: {escape(', '.join(near))}"
    return text + "."


def _hardly(known: Isolability, small: np.ndarray) -> str:
    """What these data could not show."""
    names = [c for c, s in zip(known.causes, small, strict=True) if s]
    if not names:
        return ""
    return (f" {escape(listed(names))} could hardly be seen in these data at all, even at the "
            "largest plausible size.")  # fmt: skip


def _elsewhere(found: Diagnosis, known: Isolability) -> str:
    """Findings that are not in the table."""
    names = [f.cause for f in found.findings if f.cause not in known.causes]
    if not names:
        return ""
    one = len(names) == 1
    return (f" {escape(listed(names))} {'was' if one else 'were'} found elsewhere (by the drive "
            f"monitor, or in single recordings), and {'is' if one else 'are'} not in this "
            "table.")  # fmt: skip


def _legend() -> str:
    cells = "".join(
        f'<td class="told" style="--c:{c}">{c:.2f}</td>' for c in (0.0, 0.25, 0.5, 0.75, 1.0)
    )
    return (
        '<div class="legend wide"><table class="matrix"><tr>'
        f'<td class="words">nothing in common</td>{cells}'
        '<td class="words">the same</td><td class="same" style="--c:.97">0.97</td>'
        '<td class="words">framed: cannot be told apart</td></tr></table></div>'
        '<details><summary>How to read this table</summary><p>Each number is a cosine: how much of '
        "what the row's cause does to the displacement could as well be done by the column's "
        "cause, after everything else in the model has been refitted. 0 is nothing, 1 is all of "
        "it. Framed as well is what a found cause was given as an alternative: refitted in "
        "whichever form, it said as much. "
        f"Two causes are told apart when d′ × √(1 − cosine²) is {APART:g} or more, where d′ is "
        "how many standard deviations the row's cause stands out of the noise and of what no "
        "model is exact enough to say. A found cause counts at the size at which it was found, "
        "another one at the largest plausible size, in the form that these data show best. Causes "
        "that these data could not show at all, and those that are looked for in single "
        "recordings (spikes, hum), are not in the table.</p></details>"
    )
