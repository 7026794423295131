"""The frame of every page: one HTML file that needs nothing but a browser, light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from piezo_rig.report.assets import script, style


def sheet(
    title: str, verdict: Sequence[str], open_: bool, sections: Sequence[tuple[str, str, str]],
    after: str = "", items: Sequence[str] = (),
) -> str:  # fmt: skip
    """The page's text.

    Parameters
    ----------
    title : plain text, as are the sentences of the verdict
    open_ : whether the verdict leaves something to be done
    sections : id, heading and HTML; those without HTML are left out
    after : HTML that follows the verdict
    items : of a list behind the verdict's first sentence
    """
    sections = [s for s in sections if s[2]]
    links = "\n".join(
        f'<a href="#{id}">{escape(head.split(":")[0])}</a>' for id, head, _ in sections
    )
    body = "\n".join(
        f'<section id="{id}"><h2>{escape(head)}</h2>\n{html}</section>'
        for id, head, html in sections
    )
    head, *rest = (f"<p>{escape(s)}</p>" for s in verdict)
    listed = "".join(f"<li>{escape(item)}</li>" for item in items)
    sentences = head + (f"<ul>{listed}</ul>" if items else "") + "".join(rest)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<style>
{style()}</style></head>
<body><main>
<h1>{escape(title)}</h1>
<nav>{links}</nav>
<div class="verdict{" open" if open_ else ""}">{sentences}</div>
{after}
{body}
</main>
<script>
{script()}</script>
</body></html>
"""
