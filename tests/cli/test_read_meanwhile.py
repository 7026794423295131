"""Recordings are read by another process while a diagnosis gets ready: nothing else changes."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

RATE, CYCLES = 1000.0, 4

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux only")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Triangles of 2 Hz through an elastic body with noise; volts of an uncalibrated sensor."""
    rng = np.random.default_rng(5)
    time = np.arange(int(CYCLES * RATE / 2)) / RATE
    command = 4.0 * (1.0 - np.abs((4.0 * time) % 2.0 - 1.0)) - 10.0
    sensor = -0.1 * (7.5 * command + 75.0) + 0.003 * rng.standard_normal(time.size)
    path = tmp_path_factory.mktemp("data") / "0-30 test 1.csv"
    table = np.column_stack([time, command, sensor])
    np.savetxt(path, table, delimiter=",", header="time_s,command_v,sensor_v", comments="")
    return path


def said(*words: str, processors: int) -> tuple[int, str, str]:
    if (os.cpu_count() or 1) < processors:
        pytest.skip("one processor")
    # whatever the tests themselves are kept to
    only = f"import os; os.sched_setaffinity(0, range({processors}))"
    code = f"{only}; import sys; from piezo_rig.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, "diagnose", *words], capture_output=True, text=True,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def test_what_is_printed_is_the_same_on_one_processor_and_on_two(recording):
    words = [str(recording), "--sensitivity", "1um/V"]
    one, two = (said(*words, processors=n) for n in (1, 2))
    assert one[0] == 0, one[2]
    assert "assumed: " in one[1]
    assert one[:2] == two[:2]


@pytest.mark.study
def test_so_is_what_is_wrong_with_the_data(tmp_path, recording):
    broken = tmp_path / "broken.csv"
    broken.write_text("time_s,drive_v\n0,1\n", encoding="utf-8")
    for words in ([str(broken)], [str(tmp_path / "nothere.h5")], [str(recording)]):
        one, two = (said(*words, processors=n) for n in (1, 2))
        assert one == two
        assert one[0] == 2
        assert one[2].startswith("error[")
