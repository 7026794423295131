"""Several events of one kind: each one is said, with its sweep, its time and its size.

They are planted here, sample by sample, in recordings that share no code with the program.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from small_bench import RATE, recordings

from piezo_rig.diagnosis import diagnose, document, text
from piezo_rig.diagnosis.events import in_all

UM_PER_V, STEP_UM = 15.48, 0.0791
# sweep (from 0), sample, size
SPIKES = [(0, 300, 0.25), (0, 1711, -0.4), (3, 920, 0.15), (6, 77, 0.9)]  # um
JUMPS = [(1, 700, 1), (1, 2100, -2), (7, 1500, 3)]  # steps
LOSSES = [(2, 900, 4), (4, 1300, 1)]  # samples


def planted():
    sweeps = recordings()
    for s, at, um in SPIKES:
        sweeps[s] = with_sensor(sweeps[s], um * (np.arange(sweeps[s].samples) == at))
    for s, at, steps in JUMPS:
        sweeps[s] = with_sensor(sweeps[s], steps * STEP_UM * (np.arange(sweeps[s].samples) >= at))
    for s, at, count in LOSSES:
        volts = np.delete(sweeps[s].sensor_v, slice(at, at + count))
        sweeps[s] = sweeps[s].with_(sensor_v=np.append(volts, np.full(count, volts[-1])))
    return sweeps


def with_sensor(sweep, change_um):
    return sweep.with_(sensor_v=sweep.sensor_v - change_um / UM_PER_V)  # polarity -1


@pytest.fixture(scope="module")
def found():
    return diagnose(planted())


def events(found, cause):
    (finding,) = (f for f in found.findings if f.cause == cause)
    return finding.events


def test_every_spike_is_listed_with_its_sample_and_height(found):
    seen = events(found, "outliers")
    assert [(e.number - 1, e.index) for e in seen] == [(s, at) for s, at, _ in SPIKES]
    for e, (s, at, um) in zip(seen, SPIKES, strict=True):
        assert e.sweep == f"sweep_{s + 1:04d}"
        assert e.time_s == pytest.approx(at / RATE)
        assert (e.size, e.unit) == (pytest.approx(1e3 * um, abs=15.0), "nm")  # 2 nm of noise


def test_every_jump_is_listed_with_its_instant_and_its_whole_steps(found):
    seen = events(found, "fringe-jump")
    assert [(e.number - 1, e.index) for e in seen] == [(s, at) for s, at, _ in JUMPS]
    assert [e.size for e in seen] == pytest.approx([n * 79.1 for _, _, n in JUMPS])


def test_every_loss_is_listed_with_its_count_and_between_which_times_it_was(found):
    seen = events(found, "dropped-samples")
    assert [(e.number - 1, e.size, e.unit) for e in seen] == [
        (s, n, "samples") for s, _, n in LOSSES
    ]
    for e, (_, at, _) in zip(seen, LOSSES, strict=True):
        low, high = e.between_s
        assert low - 2 / RATE <= at / RATE <= high + 2 / RATE


def test_the_json_has_lists_as_parameters_and_all_events_beside_them(found):
    written = json.loads(json.dumps(document(found)))
    by_cause = {f["cause"]: f for f in written["findings"]}
    jumps = by_cause["fringe-jump"]
    assert jumps["parameters"]["step"]["value"] == pytest.approx([n * 79.1 for _, _, n in JUMPS])
    assert jumps["parameters"]["time"]["value"] == pytest.approx([i / RATE for _, i, _ in JUMPS])
    assert [e["time_s"] for e in jumps["events"]] == pytest.approx([i / RATE for _, i, _ in JUMPS])
    assert [e["repeat"] for e in jumps["events"]] == [1, 1, 2]
    assert [e["condition"] for e in jumps["events"]] == ["0-50", "0-50", "75-25"]
    assert len(by_cause["outliers"]["events"]) == len(SPIKES)
    assert set(by_cause["outliers"]["parameters"]) == {"per_second"}
    assert jumps["gain_percent"] is None
    for f in written["findings"]:
        assert ("events" in f) == (f["cause"] in ("outliers", "fringe-jump", "dropped-samples"))


def test_the_terminal_has_a_line_for_each(found):
    lines = text(found)
    for s, at, _ in (*SPIKES, *JUMPS):
        assert any(re.search(rf"sweep_{s + 1:04d}.*\D{at / RATE:.4f} s", line) for line in lines)
    assert any("3 events in 2 sweeps" in line for line in lines)
    assert any("5 samples lost in all" in line for line in lines)


def test_one_event_is_said_as_one(found):
    assert in_all(events(found, "fringe-jump")[:1]) == "1 event in 1 sweep, +79.1 nm"
