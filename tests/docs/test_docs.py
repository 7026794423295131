"""What the documents say of the program is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from piezo_rig.cli import VERBS
from piezo_rig.resources import shipped_names

CHECKOUT = Path(__file__).resolve().parents[2]
DOCS = CHECKOUT / "docs"


def test_every_setting_of_the_plant_is_documented_with_its_default():
    from drivers.simulated.plant.__main__ import table

    text = (DOCS / "simulated-bench.md").read_text()
    assert table() in text, "run: make docs"


def test_every_fault_of_the_simulated_bench_is_documented():
    from drivers.simulated.__main__ import table

    assert table() in (DOCS / "simulated-bench.md").read_text(), "run: make docs"


def test_the_page_of_causes_says_what_their_files_say_and_has_figures_for_each():
    from piezo_rig.causes import CAUSES
    from piezo_rig.studies.causes import computed_of, page

    text = (DOCS / "causes.md").read_text()
    computed = computed_of(text)
    assert set(computed) == set(CAUSES), "run: make study-causes"
    assert all(computed.values()), "run: make study-causes"
    assert text == page(computed), "run: make docs"


def test_the_readme_names_every_verb():
    text = (CHECKOUT / "README.md").read_text()
    for verb in VERBS:
        assert f"`piezo-rig {verb} " in text


def test_the_protocol_page_names_every_shipped_protocol():
    text = (DOCS / "protocols.md").read_text()
    for name in shipped_names("protocols"):
        assert f"`{name}`" in text


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", *(
    str(p.relative_to(CHECKOUT)) for p in sorted(DOCS.rglob("*.md"))
)])
def test_links_between_pages_lead_somewhere(page):
    path = CHECKOUT / page
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
        assert (path.parent / target).exists(), f"{page}: {target}"
