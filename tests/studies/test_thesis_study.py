"""The study's helpers compute what they say, on cases with a closed form."""

import numpy as np
import pytest

from piezo_rig.studies import half_loops, pairing
from piezo_rig.studies.document import fill


def test_springs_that_equal_their_range_are_found_so_when_paired_correctly():
    pairs = pairing.paired_correctly(pairing.measure(lambda s: s.range_v))
    np.testing.assert_array_equal(pairs.k1, pairs.range_v)
    assert pairs.on_range == pytest.approx((1.0, 0.0, 1.0), abs=1e-12)


def test_springs_that_equal_their_extremum_are_found_so_when_paired_correctly():
    pairs = pairing.paired_correctly(pairing.measure(lambda s: 2.0 * s.start_v - 3.0))
    assert pairs.on_extremum == pytest.approx((2.0, -3.0, 1.0), abs=1e-12)


def test_the_printed_pairing_is_shifted_by_the_sections_it_forgot_to_skip():
    pairs = pairing.paired_as_printed(pairing.measure(lambda s: s.range_v))
    r = pairs.range_v
    ups = pairs.k1[:14]
    # two sections late, 5 V apart: k1 of 0-10 V stands at 20 V
    np.testing.assert_array_equal(ups[1:], r[1:14] - 10.0)
    assert ups[0] == 5.0
    # the next two are still from 0 V, then three late
    np.testing.assert_array_equal(pairs.k1[14:16], [70.0, 75.0])
    np.testing.assert_array_equal(pairs.k1[16:27], r[16:27] - 15.0)
    assert pairs.on_range[2] < 0.5


def test_there_are_59_sections_and_54_of_them_are_kept():
    all_of_them = pairing.sections()
    assert len(all_of_them) == 59
    skipped = [all_of_them[i] for i in pairing.SKIPPED]
    assert [s.range_v for s in skipped] == [5.0] * 5
    assert pairing.paired_correctly(np.zeros(59)).range_v.min() == 10.0


def test_slopes_and_springs_of_a_piecewise_line():
    # 8 V/um over the first 0.5 um, 5 V/um over the next, 4 V/um from there on
    x = np.linspace(0.0, 1.75, 1751)
    v = np.interp(x, [0.0, 0.5, 1.0, 2.0], [0.0, 4.0, 6.5, 10.5])
    slopes = half_loops.segment_slopes(v, x, 0.5)
    np.testing.assert_allclose(slopes, [8.0, 5.0, 4.0, 4.0], rtol=5e-3)
    np.testing.assert_allclose(half_loops.springs(slopes), [3.0, 1.0, 0.0, 4.0], atol=5e-2)


def test_a_document_with_a_gap_or_a_leftover_is_refused():
    assert fill("a {{x}} b", {"x": "1"}) == "a 1 b"
    with pytest.raises(KeyError, match="y"):
        fill("a {{x}} {{y}}", {"x": "1"})
    with pytest.raises(KeyError, match="z"):
        fill("a {{x}}", {"x": "1", "z": "2"})
