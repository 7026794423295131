"""The ladder's figure: one row to a rung, and nothing written over anything else."""

from __future__ import annotations

from itertools import combinations

import pytest

from piezo_rig.causes import load_model
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.found import Diagnosis, Finding, Rung
from piezo_rig.diagnosis.unexplained import Unexplained
from piezo_rig.errors import BenchError
from piezo_rig.report import ladder
from piezo_rig.resources import find
from tests.more import first_of

MODEL = load_model(find("models", "thesis_classical"))  # any will do
CLIMB = [  # what was added, rms nm, alternatives, parameters
    ("outliers", 301.0, [], {"per_second": ("1/s", 2.03, (1.42, 2.8))}),
    ("mains-hum", 300.5, [],
     {"frequency": ("Hz", 50.0, (49.99, 50.01)), "amplitude": ("nm", 3.02, (2.91, 3.13))}),
    ("initiation-stage", 80.1, [], {}),
    ("bend", 61.0, [], {}),
    ("range-dependence", 25.7, ["rate-dependence", "extremum-dependence", "direction-asymmetry"],
     {"slope": ("V/um/V", -2.715e-4, (-3.115e-4, -2.314e-4)),
      "offset": ("V/um", 1.546, None)}),
    ("creep", 6.2, ["thermal-drift"], {"rate_per_decade": ("1", 0.0251, (0.0248, 0.0254))}),
    ("periodic-nonlinearity", 6.25, [], {"amplitude": ("nm", 3.0, (2.8, 3.2))}),
    ("time-skew", 3.1, ["amplifier-lag"], {"delay": ("s", 5e-4, (4.8e-4, 5.2e-4))}),
]


def diagnosis(steps=CLIMB, floor=2.9, first=310.0, detected=False, held_out="condition"):
    rungs, findings, before = [Rung("classical", first, 9.41)], [], first
    for cause, rms, others, parameters in steps:
        if cause == "bend":
            rungs.append(Rung(cause, rms, rms / 50))
        else:
            rungs.append(Rung(cause, rms, rms / 50, len(findings)))
            gain = None if cause == "outliers" else 100 * (1 - rms / before)
            findings.append(Finding(
                cause, "somewhere", 1e-4, gain, None if gain is None else [gain - 1, gain + 1],
                {n: Parameter(value, unit, ci) for n, (unit, value, ci) in parameters.items()},
                others,
            ))  # fmt: skip
        before = rms
    text = ("12.4 nm that no cause in the catalogue explains; it depends on displacement, "
            "direction and range, largest near 4.0 um, on rising branches above all")
    rest = Unexplained(detected, 1e-3, 12.4, 1.5, ["displacement"], text if detected else "")
    return Diagnosis(
        18, 180018, 3, held_out, [("quick_look.h5", 0.0)], "classical", rungs, floor, findings,
        rest, None, MODEL, [],
    )  # fmt: skip


def boxes(figure):
    """Every visible text with where it stands, in pixels, and every mark."""
    renderer = figure.canvas.get_renderer()
    texts = list(figure.texts)
    for axis in figure.axes:
        low, high = axis.get_xlim()
        ticks = [t for t in axis.get_xticklabels() if low <= t.get_position()[0] <= high]
        texts += [t for t in [*axis.texts, axis.xaxis.label, *ticks]
                  if t.get_visible() and t.get_text()]
    marks = [line for axis in figure.axes for line in axis.lines if line.get_marker() == "o"]
    return (
        [(t.get_text(), t.get_window_extent(renderer)) for t in texts],
        [line.get_window_extent(renderer) for line in marks],
    )


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """A function: draw a diagnosis, return the figure instead of the file's path."""
    kept = []

    def keep(figure, path):
        figure.canvas.draw()
        kept.append(figure)
        return path

    monkeypatch.setattr(ladder, "save", keep)

    def draw(found, title="quick_look_2026-11-21_161204"):
        ladder.ladder_figure(tmp_path / "l.png", title, found)
        return kept[-1]

    return draw


@pytest.mark.parametrize("rungs", first_of(4, [1, 2, 6, 9, 3, 4, 5, 7, 8]))
def test_nothing_overlaps_and_nothing_leaves_the_figure(drawn, rungs):
    floor, detected = (2.9, None, 290.0)[rungs % 3], rungs % 2 == 1
    figure = drawn(diagnosis(CLIMB[: rungs - 1], floor, detected=detected))
    texts, marks = boxes(figure)
    for (a, here), (b, there) in combinations(texts, 2):
        assert not here.overlaps(there), f"{a!r} over {b!r}"
    for text, box in texts:
        assert figure.bbox.x0 <= box.x0, text
        assert box.x1 <= figure.bbox.x1, text
        assert figure.bbox.y0 <= box.y0, text
        assert box.y1 <= figure.bbox.y1, text
        assert not box.overlaps(figure.axes[0].bbox), text  # where the bars are
    assert len(marks) == rungs


def test_every_rung_is_named_with_its_error_and_every_finding_with_its_gain(drawn):
    texts, _ = boxes(drawn(diagnosis()))
    words = [t for t, _ in texts]
    for cause, rms, _, _ in CLIMB:
        assert f"+ {cause}" in words
        assert f"{rms:.2f}" in words
    assert "classical" in words
    assert "part of the base model" in words
    assert "75.9 %  [74.9, 76.9]" in words  # creep: 1 - 6.2 / 25.7
    assert "noise floor 2.90 nm" in words
    assert "or thermal-drift" in words


def test_a_long_name_of_a_baseline_stays_in_its_column(drawn):
    found = diagnosis()
    found.rungs[0] = Rung("model of the stack in the blue box, identified in May", 310.0, 9.4)
    texts, _ = boxes(drawn(found, "a run with a name " * 12))
    for (a, here), (b, there) in combinations(texts, 2):
        assert not here.overlaps(there), f"{a!r} over {b!r}"


def test_the_file_is_a_png_and_a_place_that_cannot_be_is_a_fault_of_the_disk(tmp_path):
    path = ladder.ladder_figure(tmp_path / "new" / "l.png", "t", diagnosis())
    assert path.read_bytes().startswith(b"\x89PNG")
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="could not write"):
        ladder.ladder_figure(tmp_path / "file" / "l.png", "t", diagnosis())
