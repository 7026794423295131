"""The page of a diagnosis: all of it in one file, true to the diagnosis, safe with any name."""

from __future__ import annotations

import html
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_diagnoses import HOSTILE, diagnosis, sweeps

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Parameter
from piezo_rig.cli import main
from piezo_rig.commands.data_options import reading_options
from piezo_rig.diagnosis.document import text
from piezo_rig.diagnosis.follow_up import FollowUp
from piezo_rig.diagnosis.found import Rung
from piezo_rig.diagnosis.isolability import isolability
from piezo_rig.errors import BenchError
from piezo_rig.report import views
from piezo_rig.report.matrix import matrix_html
from piezo_rig.report.page import page, report_page
from piezo_rig.report.sections import findings_html, next_html
from piezo_rig.report.verdict import verdict
from piezo_rig.report.words import about, gain_text, interval, scaled, with_unit

KINDS = ("many", "quiet", "alone", "fixed")
VOID = ("meta", "input", "img", "br")


class Reader(HTMLParser):
    """Elements with their attributes, visible text, and whether tags close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.words, self.wrong = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def read(kind, title="run"):
    return Reader(page(title, diagnosis(kind), ["run.h5"], {"run.h5": "0f" * 32}))


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_needs_nothing_but_itself(kind):
    text = page("run", diagnosis(kind), [], {})
    assert "http" not in text
    assert "@import" not in text
    assert "url(" not in text
    for tag, attributes in Reader(text).elements:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base"), tag
        assert "src" not in attributes, tag
        assert attributes.get("href", "#").startswith("#"), tag
        assert not any(name.startswith("on") for name in attributes), tag


@pytest.mark.parametrize("kind", KINDS)
def test_tags_close_ids_are_unique_and_links_lead_somewhere(kind):
    seen = read(kind)
    assert not seen.wrong
    assert not seen.open
    ids = [a["id"] for _, a in seen.elements if "id" in a]
    assert len(ids) == len(set(ids))
    for _, a in seen.elements:
        if a.get("href", "#") != "#":
            assert a["href"][1:] in ids


def test_names_from_files_are_text_and_never_markup():
    text = page(HOSTILE, diagnosis("many"), [HOSTILE], {HOSTILE: "00"})
    assert "<img" not in text
    assert "<i>" not in text
    assert text.count("</script>") == 2  # the data of the closer look, and the script
    assert HOSTILE in Reader(text).text


def test_the_same_diagnosis_gives_the_same_bytes():
    assert page("run", diagnosis("many"), [], {}) == page("run", diagnosis("many"), [], {})


def test_every_finding_has_its_section_with_units_intervals_and_a_figure():
    found = diagnosis("many")
    assert {"outliers", "creep"} <= {f.cause for f in found.findings}
    text = page("run", found, [], {})
    for i, finding in enumerate(found.findings):
        part = text[text.index(f'id="finding-{i}"') :].split("</section>")[0]
        assert about(finding.cause)["Physics"][1:60] in html.unescape(part)
        assert "chance of a false alarm" in part
        assert part.count("<svg") >= 2  # before and after, and after on its own scale
        for name, p in finding.parameters.items():
            times, unit = scaled(p)
            assert unit in part
            if not finding.events:
                assert CAUSES[finding.cause].meanings[name] in html.unescape(part)
            if p.ci95:
                assert f"{times * p.ci95[1]:.4g}".replace("-", "\u2212") in part
        if finding.gain_ci95:
            assert f"{finding.gain_ci95[0]:.1f}" in part


def test_every_event_has_a_row_a_mark_and_a_figure_to_step_through():
    found = diagnosis("many")
    index = next(i for i, f in enumerate(found.findings) if f.cause == "outliers")
    planted = 12  # three in each of four recordings
    assert len(found.findings[index].events) == planted
    text = page("run", found, [], {})
    part = text[text.index(f'id="finding-{index}"') :].split("</section>")[0]
    assert part.count("<tr><td>") == planted
    assert part.count('class="step"') == planted
    overview = part.split('class="view"')[1]
    assert overview.count('class="mark"') == 2 * planted  # before and after
    for k, e in enumerate(found.findings[index].events):
        assert f"{e.time_s:.4f} s" in part
        assert f'href="#event-{index}-{k}"' in part
        assert 900 < e.size < 1100  # 1 um was put in
    assert f"outliers ({planted} events)" in " ".join(verdict(found).lines)


def test_what_is_wrong_with_the_data_stands_at_the_top():
    warned = [f"sweep_000{k} is left out: <b>{k}</b>" for k in range(5)]
    found = replace(diagnosis("quiet"), warnings=warned)
    text = page("run", found, [], {})
    top = text[: text.index('id="ladder"')]
    assert "5 warnings about the data" in top
    assert "sweep_0000 is left out: &lt;b&gt;0" in top
    notes = text[text.index('id="notes"') :]
    assert all(html.escape(w) in notes for w in warned)


def test_intervals_have_the_digits_that_they_need():
    narrow = Parameter(1.02043, "1", (1.01999, 1.02086))
    assert with_unit(narrow) == "1.0204"
    assert interval(narrow) == "95 %: 1.0200 to 1.0209"
    one = replace(diagnosis("many").findings[-1], gain_percent=0.06, gain_ci95=[0.03, 0.1])
    assert gain_text(one) == "0.06\u00a0% (95 %: 0.03 to 0.10 %)"


def test_what_could_not_be_seen_is_not_said_to_pass_for_everything():
    found = diagnosis("many")
    known = isolability(found.workings.space, found.workings.last)
    k = next(i for i, f in enumerate(known.found) if not f)
    here = np.arange(len(known.causes)) == k
    faint = replace(known, d_prime=np.where(here, 0.5, known.d_prime),
                    apart=np.where(here[:, None], 0.5, 100.0) * np.ones_like(known.apart))
    seen = Reader(matrix_html(replace(found, findings=[]), faint)).text
    assert f"{known.causes[k]} could hardly be seen in these data at all" in seen
    assert "could pass for" not in seen


def test_the_ladder_has_the_numbers_of_the_terminal():
    found, text = diagnosis("many"), read("many").text
    for rung in found.rungs:
        assert f"{rung.rms_nm:.2f}" in text
        assert f"{rung.max_percent:.2f}" in text


def test_a_diagnosis_without_findings_says_so():
    text = read("quiet").text
    assert "No cause was named" in text
    assert "Nothing is confounded" in text


def test_without_repeats_the_noise_floor_is_said_to_be_unknown():
    assert diagnosis("alone").noise_floor_nm is None
    assert "noise floor is not known" in read("alone").text


def test_a_model_that_is_held_fixed_has_a_page_as_well():
    assert "What can be told from what" in read("fixed").text


def test_what_to_do_stands_before_the_table_for_those_who_look_closer():
    said = read("fixed").text
    titles = ["What was found", "What remains", "What to play next", "What can be told from what"]
    places = [said.rindex(title) for title in titles]
    assert places == sorted(places)


def test_what_cannot_be_told_apart_is_said_with_what_to_type_next():
    found = diagnosis("many")
    confused = [replace(f, alternatives=["thermal-drift"] if f.cause == "creep" else [])
                for f in found.findings]  # fmt: skip
    found = replace(found, findings=confused,
                    follow_up=FollowUp("hold_steps", ["creep", "thermal-drift"], 0.1))  # fmt: skip
    text = page("run", found, ["my run.h5"], {})
    seen = Reader(text).text
    assert "Cannot be told from thermal-drift" in seen
    assert "piezo-rig run hold_steps --rig" in seen
    assert "piezo-rig diagnose 'my run.h5' runs/hold_steps_*.h5" in seen
    assert 'class="same"' in text.split('class="legend"')[0]  # framed in the table
    (line,) = (c for c in verdict(found).causes if c.startswith("creep"))
    assert "It may as well be thermal-drift" in line


def test_the_verdict_is_a_line_to_a_cause_and_a_few_sentences():
    for kind in KINDS:
        found = diagnosis(kind)
        said = verdict(found)
        assert len(said.causes) <= len(found.findings)
        assert 2 <= len(said.rest) <= 5
        assert all(len(line.split()) <= 60 for line in said.lines)


def test_small_values_are_written_in_smaller_units():
    assert scaled(Parameter(1.5e-4, "s")) == (1e6, "\u00a0µs")
    assert scaled(Parameter(0.006, "um")) == (1e3, "\u00a0nm")
    assert scaled(Parameter(0.02, "1")) == (100.0, "\u00a0%")
    assert scaled(Parameter(0.97, "1")) == (1.0, "")


def test_every_cause_of_the_catalogue_has_words_and_a_view():
    for cause in CAUSES:
        assert {"meaning", "Physics", "Shows as"} <= set(about(cause)), cause
        assert views.views_of(cause)
    assert views.views_of("never heard of")[0] is views.DRIVE


@pytest.mark.study
def test_two_causes_are_as_much_alike_the_one_way_as_the_other():
    workings = diagnosis("two").workings
    known = isolability(workings.space, workings.last)
    found = [i for i, c in enumerate(known.causes) if known.found[i]]
    a, b = found  # both as they are, with no forms to choose from: their cosine has no direction
    assert known.cosine[a, b] == pytest.approx(known.cosine[b, a], rel=1e-6)
    assert np.all((known.cosine >= 0) & (known.cosine <= 1))
    assert known.found[known.causes.index("creep")]
    finding = next(f for f in diagnosis("two").findings if f.cause == "creep")
    assert known.d_prime[known.causes.index("creep")] == pytest.approx(finding.d_prime, rel=0.02)


def test_a_place_that_cannot_be_written_is_a_fault_of_the_disk(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="could not write"):
        report_page(tmp_path / "file" / "r.html", "run", diagnosis("quiet"))


def test_the_command_line_writes_the_page_and_says_where(tmp_path, capsys):
    (sweep,) = sweeps(effect=False, repeats=1, names=("0-50",))
    table = np.column_stack([sweep.time_s, sweep.drive_v, sweep.displacement_um])
    data = tmp_path / "first.csv"
    np.savetxt(data, table, delimiter=",", header="time_s,drive_v,displacement_um", comments="")
    assert main(["diagnose", str(data), "--report", f"{tmp_path}/out/"]) == 0
    where = tmp_path / "out" / "first_report.html"
    assert f"report: {where}" in capsys.readouterr().out.splitlines()
    text = where.read_text(encoding="utf-8")
    assert re.search(r"[0-9a-f]{64}", text)  # of the file
    assert "Diagnosis of first" in text


def test_where_something_is_left_the_model_is_not_said_to_say_all():
    rest = replace(diagnosis("quiet").unexplained, detected=True, text="5 nm rms are left")
    found = replace(diagnosis("quiet"), unexplained=rest)
    assert "no known cause says what is left" in "\n".join(text(found))
    assert "none that is known says what is left" in findings_html(found, None)
    said = " ".join(verdict(found).lines)
    assert "none that is known says what is left" in said
    assert "says all that these data can show" not in said


def test_where_the_base_had_to_be_bent_the_baseline_alone_is_not_said_to_say_all():
    plain = diagnosis("quiet")
    bent = replace(plain, rungs=[plain.rungs[0], Rung("output-bend", 2.0, 0.1)])
    for found, said in ((plain, "baseline says all"), (bent, "with a memoryless bend, says all")):
        assert said in "\n".join(text(found))
    assert "with a memoryless bend, says all" in findings_html(bent, None)
    assert "with a memoryless bend, says all" in " ".join(verdict(bent).lines)


@pytest.mark.parametrize(("p_value", "said"), [(2e-299, "below 1e-06"), (0.0004, "0.0004")])
def test_no_chance_is_printed_that_nobody_has_tried_out(p_value, said):
    found = diagnosis("many")
    first = replace(found.findings[0], p_value=p_value)
    found = replace(found, findings=[first, *found.findings[1:]])
    assert f"false alarm {said}\n" in "\n".join(text(found))


@pytest.mark.parametrize(("files", "options", "data"), [
    (["a.csv"], ["--history=virgin", "--mixed-origin"],
     "a.csv runs/hold_steps_*.h5 --history=virgin --mixed-origin"),
    (["a.h5"], [], "a.h5 runs/hold_steps_*.h5"),
])  # fmt: skip
def test_what_to_type_next_says_again_how_data_are_read(files, options, data):
    plain = diagnosis("many")
    first = replace(plain.findings[0], alternatives=["thermal-drift"])
    found = replace(plain, findings=[first, *plain.findings[1:]],
                    follow_up=FollowUp("hold_steps", ["creep", "thermal-drift"], 0.1))  # fmt: skip
    said = next_html(found, files, options)
    assert f"piezo-rig diagnose {data} --report" in said
    assert all(o in said.split("one go")[1] for o in options)


def test_what_form_a_law_has_is_not_printed_among_what_was_measured():
    found = diagnosis("many")
    law = {"slope": Parameter(0.01, "V/um/V", (0.008, 0.012)), "closing": Parameter(1.0, "1")}
    first = replace(found.findings[0], cause="range-dependence", parameters=law, events=())
    said = "\n".join(text(replace(found, findings=[first, *found.findings[1:]])))
    assert "slope = 0.01 V/um/V" in said
    assert "closing" not in said
    assert "the form of its law is chosen, not measured" in said


@pytest.mark.parametrize(("origin", "mixed", "said"), [
    ("IMPORTED", False, ["--history=virgin", "--mixed-origin"]),
    ("REAL", False, ["--history=virgin"]), ("REAL", True, ["--history=virgin", "--mixed-origin"]),
])  # fmt: skip
def test_no_bench_plays_what_was_imported_so_that_joining_it_has_to_be_meant(origin, mixed, said):
    args = SimpleNamespace(history="virgin", gain=None, mixed_origin=mixed)
    assert reading_options(args, [s.with_(origin=origin) for s in sweeps()]) == said
