"""A limit of the drive that cuts off no more than the tips of the largest triangles."""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.put_in import refitted
from piezo_rig.diagnosis.refit import refit, settle
from piezo_rig.diagnosis.scan import LEVEL, extended, scan
from piezo_rig.studies.hidden import draw
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun

PLAYED = (("0-30", 0.0, 30.0, 2.0), ("0-55", 0.0, 55.0, 2.0), ("0-75", 0.0, 75.0, 1.0))
FAR = 74.5  # V, a level that the linear look may like, of which a small share is there


@pytest.mark.parametrize("cut_off_v", [0.06, 0.12])
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


def test_which_limit_it_is_the_refits_say():
    """Beside elements that have gone after the tips, a linear look likes the other limit more."""
    case = draw("drive-clipping", 9101, "one", "1/f", 40.0, 2)
    (finding,) = diagnose(case.sweeps).findings
    assert finding.cause == "drive-clipping"
    assert finding.p_value < LEVEL
    level = finding.parameters["upper"].value
    assert level == pytest.approx(case.truth.parameters["drive-clipping"]["upper"], abs=0.02)
