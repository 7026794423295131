"""A diagnosis as one HTML page that needs nothing but a browser: no network, no other file.

The same diagnosis gives the same bytes. Whatever comes from a file (names of conditions, of
recordings, of models) is escaped where it is put in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from piezo_rig.diagnosis import Diagnosis
from piezo_rig.diagnosis.isolability import isolability
from piezo_rig.report.closer import closer_html
from piezo_rig.report.figures import place_for
from piezo_rig.report.ladder_svg import ladder_svg
from piezo_rig.report.matrix import matrix_html
from piezo_rig.report.residuals import Residuals
from piezo_rig.report.sections import (
    findings_html,
    next_html,
    notes_html,
    provenance_html,
    rest_html,
)
from piezo_rig.report.sheet import sheet
from piezo_rig.report.verdict import verdict
from piezo_rig.report.words import gain_text

SHOWN = 3  # warnings at the top


def report_page(
    path: Path, title: str, found: Diagnosis, files: Sequence[str] = (),
    hashes: Mapping[str, str] | None = None, options: Sequence[str] = (),
) -> Path:
    """Write the page of a diagnosis; returns the path.

    Parameters
    ----------
    title : what was diagnosed
    files : DATA as given on the command line, for the commands that the page suggests
    hashes : name of every file -> its SHA-256
    options : as given with the files, for those commands

    Raises
    ------
    BenchError : the disk refuses
    """
    text = page(title, found, files, hashes or {}, options)
    with place_for(path):
        path.write_text(text, encoding="utf-8", newline="\n")
    return path


def page(
    title: str, found: Diagnosis, files: Sequence[str], hashes: Mapping[str, str],
    options: Sequence[str] = (),
) -> str:  # fmt: skip
    """The page's text."""
    workings = found.workings
    residuals = None if workings is None else Residuals(workings, found.rung_models)
    sections = [
        ("ladder", "The ladder: what each cause takes away from the error", _ladder(found)),
        ("findings", "What was found", findings_html(found, residuals)),
        ("rest", "What remains", rest_html(found, residuals)),
        ("next", "What to play next", next_html(found, files, options)),
        ("apart", "What can be told from what", _matrix(found)),
        ("closer", "Look closer: the residual of any condition",
         "" if residuals is None else closer_html(found, residuals)),
        ("notes", "Notes", notes_html(found)),
        ("provenance", "Where this comes from", provenance_html(found, hashes)),
    ]  # fmt: skip
    said = verdict(found)
    return sheet(
        f"Diagnosis of {title}", [said.head, *said.rest], said.open, sections, _warned(found),
        said.causes,
    )


def _warned(found: Diagnosis) -> str:
    """The first warnings, which stand at the top; all of them are among the notes."""
    if not found.warnings:
        return ""
    count = len(found.warnings)
    items = "".join(f"<li>{escape(w)}</li>" for w in found.warnings[:SHOWN])
    more = f" The first {SHOWN}:" if count > SHOWN else ""
    several = "" if count == 1 else "s"
    return (f'<div class="verdict open"><p><b>{count} warning{several} about the data</b> '
            f'(<a href="#notes">all notes</a>).{more}</p><ul>{items}</ul></div>')  # fmt: skip


def _ladder(found: Diagnosis) -> str:
    held = ("Errors are of the fit itself: there was too little data to hold any out."
            if found.held_out == "none" else
            "Every error is on data that the model had not been fitted to.")  # fmt: skip
    return (f'<figure><div class="view">{ladder_svg(found)}</div><figcaption>From the top: the '
            "model as it was, then with one cause after the other added to it. A bar is the factor "
            f"by which the error falls. {held} Max: the largest error of all, in percent of its "
            "sweep's travel.</figcaption>"
            f"{_ladder_rows(found)}</figure>")  # fmt: skip


def _ladder_rows(found: Diagnosis) -> str:
    """The ladder's numbers, for a screen that is too narrow for them beside the bars."""
    rows = []
    for i, rung in enumerate(found.rungs):
        finding = None if rung.finding is None else found.findings[rung.finding]
        gain = "" if finding is None else gain_text(finding).replace("95 %: ", "")
        name = f"+ {rung.added}" if i else rung.added
        rows.append(f'<tr><th scope="row">{escape(name)}</th><td>{rung.rms_nm:.2f}</td>'
                    f"<td>{rung.max_percent:.2f}</td><td>{escape(gain)}</td></tr>")  # fmt: skip
    return ('<table class="narrow"><tr><th></th><th>rms (nm)</th><th>max (%)</th>'
            f"<th>gain (95 %)</th></tr>{''.join(rows)}</table>")  # fmt: skip


def _matrix(found: Diagnosis) -> str:
    if found.workings is None:
        return ""
    try:
        known = isolability(found.workings.space, found.workings.last)
    except np.linalg.LinAlgError:
        return "<p>These data are too few or too much alike for this table.</p>"
    return matrix_html(found, known)
