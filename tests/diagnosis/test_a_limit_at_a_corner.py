"""A limit of the drive that cuts off no more than the tips of the largest triangles."""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.put_in import refitted
from piezo_rig.diagnosis.refit import refit, settle
from piezo_rig.diagnosis.scan import LEVEL, Scan, extended, scan
from piezo_rig.studies.hidden import draw
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun
from tests.more import first_of

PLAYED = (("0-30", 0.0, 30.0, 2.0), ("0-55", 0.0, 55.0, 2.0), ("0-75", 0.0, 75.0, 1.0))
FAR = 74.5  # V, a level that the linear look may like, of which a small share is there


@pytest.mark.parametrize("cut_off_v", first_of(1, [0.06, 0.12]))
def test_it_is_begun_at_its_whole_size(cut_off_v):
    """A small share of a lower limit rounds the same corners, and is another thing at its size."""
    upper = 75.0 - cut_off_v
    sweeps = recordings(conditions=PLAYED, before=lambda v: np.minimum(v, upper), repeats=4)
    space, plain = begun(sweeps)
    here = refit(space, plain)
    settle(space, here.point)
    found = scan(space, here, np.random.default_rng(0))
    i = found.result.ids.index("drive-clipping")
    forms = found.forms["drive-clipping"]
    columns, trials = min(forms, key=lambda form: abs(form[1][0]["upper"] - FAR))
    point = extended(space, here, found.candidates[i], columns, found.likelihood, trials)
    begins = point.model.stage("drive-clipping")["upper"]
    assert 0.4 * cut_off_v < 75.0 - begins < 2.0 * cut_off_v
    fitted = refitted(space, here, found, i)
    assert fitted is not None
    level = fitted.point.model.stage("drive-clipping")["upper"]
    assert 75.0 - level == pytest.approx(cut_off_v, rel=0.1)


def looked(**chances):
    """A look at some causes, each with its chance; the smaller that is, the more it says."""
    ids, chance = tuple(chances), np.array(list(chances.values()))
    said = -np.log(chance)
    return Scan(tuple(id.replace("_", "-") for id in ids), said, chance, said, 0.0 * said, {})


def test_both_limits_are_refitted_where_either_is_likely_and_have_its_chance():
    found = looked(sensor_clipping=1e-5, creep=1e-4, drive_clipping=6e-3)
    good = np.flatnonzero(found.p_family < LEVEL)
    assert found.close(good) == [0, 1]
    assert found.as_flat(good) == [2]
    assert found.of_their_kind(good, found.p_family).tolist() == [1e-5, 1e-4, 1e-5]


def test_no_limit_is_refitted_and_none_gains_where_neither_is_likely():
    found = looked(sensor_clipping=2e-2, creep=1e-4, drive_clipping=6e-3)
    good = np.flatnonzero(found.p_family < LEVEL)
    assert found.as_flat(good) == []
    assert found.of_their_kind(good, found.p_family).tolist() == found.p_family.tolist()


@pytest.mark.study
def test_which_limit_it_is_the_refits_say():
    """Beside elements that have gone after the tips, a linear look likes the other limit more."""
    case = draw("drive-clipping", 9101, "one", "1/f", 40.0, 2)
    (finding,) = diagnose(case.sweeps).findings
    assert finding.cause == "drive-clipping"
    assert finding.p_value < LEVEL
    level = finding.parameters["upper"].value
    assert level == pytest.approx(case.truth.parameters["drive-clipping"]["upper"], abs=0.02)
