"""A law's reach that was found while a table was missing is looked for once more beside it."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import refit
from piezo_rig.studies.hidden import draw
from tests.diagnosis.spaces import begun, with_member

FAR_UM = 2.0  # where a law ended that had to make up for a first rise


@pytest.fixture(scope="module")
def fitted():
    """A range law, its reach known from a look at all, and held up far out."""
    case = draw("range-dependence", 9400, "matrix", "white", 150.0, 2)
    space, plain = begun(case.sweeps)
    sizes = {"slope": 0.002, "offset": 0.02}
    law = with_member(
        plain, "range-dependence", sizes, slope=0.002, offset=0.0, reach=FAR_UM, closing=0.0,
        taper=0.0,
    )  # fmt: skip
    return space, refit(space, plain), refit(space, law, 8, held=True)


def search_of(space, first, error, *steps):
    search = Search(
        space, first, np.random.default_rng(0), lambda text: None, [(error, 1.03)], 2.0, 0,
        lambda less, fitted, unseen=True: unseen,
    )  # fmt: skip
    search.steps = list(steps)
    return search


def test_it_is_looked_for_over_all_reaches(fitted):
    space, first, far = fitted
    search = search_of(space, first, lambda f: 3.0, Step("range-dependence", 1e-9, far))
    search.reach_anew("range-dependence")
    there = search.fitted
    assert there.evidence > far.evidence + 50.0
    assert there.point.model.stage("range-dependence")["reach"] < 0.5 * FAR_UM


def test_it_stays_where_it_is_if_that_predicts_worse(fitted):
    space, first, far = fitted
    search = search_of(
        space, first, lambda f: 3.0 if f is far else 3.1, Step("range-dependence", 1e-9, far)
    )
    search.reach_anew("range-dependence")
    assert search.fitted is far


@pytest.mark.parametrize(("newest", "error_nm", "asked"), [
    ("initiation-stage", 3.0, True),
    ("initiation-stage", 2.05, False),  # nothing is amiss any more
    ("mains-hum", 3.0, False),  # nothing that a reach could have made up for
])  # fmt: skip
def test_it_is_looked_for_beside_a_table_where_much_is_amiss(
    fitted, monkeypatch, newest, error_nm, asked
):
    space, first, far = fitted
    steps = Step("range-dependence", 1e-9, far), Step(newest, 1e-9, far)
    search = search_of(space, first, lambda f: error_nm, *steps)
    heard = []
    monkeypatch.setattr(Search, "reach_anew", lambda self, id: heard.append(id))
    search.scan_anew()
    assert heard == ["range-dependence"] * asked


@pytest.mark.parametrize(("share", "asked"), [(0.05, False), (0.5, True)])
def test_what_says_a_tenth_of_a_law_does_not_ask_for_it_once_more(
    fitted, monkeypatch, share, asked
):
    space, first, far = fitted
    gained = far.evidence - first.evidence
    assert gained > 0.0
    newest = replace(far, evidence=far.evidence + share * gained)
    steps = Step("range-dependence", 1e-9, far), Step("initiation-stage", 1e-9, newest)
    search = search_of(space, first, lambda f: 3.0, *steps)
    heard = []
    monkeypatch.setattr(Search, "reach_anew", lambda self, id: heard.append(id))
    search.scan_anew()
    assert heard == ["range-dependence"] * asked
