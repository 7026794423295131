"""Which causes are refitted to compare them, by what a linear look said of each."""

from __future__ import annotations

import numpy as np

from piezo_rig.diagnosis.scan import Scan


def scanned(**excess: float) -> Scan:
    ids = tuple(id.replace("_", "-") for id in excess)
    said = np.array(list(excess.values()))
    nothing = np.zeros(said.size)
    return Scan(ids, nothing, said, said, nothing, {})


def close(scan: Scan, least: float = 5.0) -> set[str]:
    good = np.flatnonzero(scan.excess > least)
    return {scan.ids[i] for i in scan.close(good)}


def test_far_behind_is_not_refitted():
    assert close(scanned(creep=100.0, thermal_drift=50.0, mains_hum=30.0)) == {
        "creep", "thermal-drift",
    }  # fmt: skip


def test_a_bend_is_nobodys_rival_for_a_place():
    # what bends most looks like one: the causes behind it are refitted all the same
    scan = scanned(output_bend=400.0, direction_asymmetry=24.0, initiation_stage=20.0,
                   range_dependence=12.0)
    assert close(scan) == {
        "output-bend", "direction-asymmetry", "initiation-stage", "range-dependence",
    }  # fmt: skip


def test_all_kinds_of_bend_are_refitted_where_one_is():
    assert close(scanned(output_bend=40.0, creep=30.0, input_bend=0.1)) == {
        "output-bend", "creep", "input-bend",
    }  # fmt: skip
    assert close(scanned(output_bend=10.0, creep=30.0, input_bend=0.1)) == {"creep"}


def test_a_bend_alone_is_refitted():
    assert "output-bend" in close(scanned(output_bend=40.0, creep=1.0))
