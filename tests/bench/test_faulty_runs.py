"""`piezo-rig run` on a bench that fails: what is said, where the stack ends, what is kept.

Where the stack is, is asked of the plant's own record, never of an instrument.
"""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import piezo_rig.bench
from drivers.clock import VirtualClock
from piezo_rig.cli import main
from piezo_rig.resources import shipped_folder
from piezo_rig.run_file.reader import Run

TIMEOUT_S = 0.5  # a machine that is busy may answer late, but not so late
SETTLED_S = 0.001  # of the stack behind its last step, which may be this very instant
SHORT = """
schema = "piezo-rig/protocol/1"
name = "short"
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [20, 25, 30]
frequency_hz = 10
cycles = 2
"""
LATER = 2.0  # s on the bench's clock: the first sweep is stored, the second not begun


@dataclass
class Outcome:
    status: int
    said: str
    printed: str
    stack_v: np.ndarray  # the plant's own record
    took_s: float
    run: Path | None

    @property
    def code(self) -> str:
        found = re.match(r"error\[([a-z-]+)\]: ", self.said)
        return found.group(1) if found else ""


@pytest.fixture(scope="module")
def played(tmp_path_factory) -> Callable[[str], Outcome]:
    """``played(toml)`` is what became of a run on the simulated bench with this in its config."""
    text = (shipped_folder("configs") / "simulated_bench.toml").read_text()
    linked = r'(driver = "(?:keysight|thorlabs).*)'
    text = re.sub(linked, rf"\1\ntimeout_s = {TIMEOUT_S}", text)
    text = text.replace("recovery_s = 30.0", "recovery_s = 1.0")

    def play(more: str, **changed: str) -> Outcome:
        folder = tmp_path_factory.mktemp("run")
        protocol, rig = folder / "short.toml", folder / "rig.toml"
        protocol.write_text(SHORT)
        config = text
        for old, new in changed.items():
            config = config.replace(f'driver = "{old}"', f'driver = "{old}"\n{new}')
        rig.write_text(f"{config}\n{more}\n")
        with pytest.MonkeyPatch.context() as patch:
            rows: list[np.ndarray] = []
            clock, make_plant = VirtualClock(), piezo_rig.bench.simulated_plant
            plants = []

            def watched_plant(rig):
                plants.append(make_plant(rig))
                plants[-1].keep_history(lambda time_s, stack_v: rows.append(stack_v))
                return plants[-1]

            patch.setattr(piezo_rig.bench, "simulated_plant", watched_plant)
            patch.setattr(piezo_rig.bench, "VirtualClock", lambda: clock)
            with redirect_stdout(io.StringIO()) as printed, redirect_stderr(io.StringIO()) as said:
                begun = time.monotonic()
                status = main(["run", str(protocol), "--rig", str(rig), "--out", str(folder)])
                took = time.monotonic() - begun
            for plant in plants:
                plant.flush_history(clock.now() + SETTLED_S)
        runs = list(folder.glob("*.h5"))
        assert not list(folder.glob("*.part*")), "a run was left open"
        return Outcome(
            status, said.getvalue(), printed.getvalue(), np.concatenate([[75.0], *rows]), took,
            runs[0] if runs else None,
        )

    return play


@pytest.fixture(scope="module")
def clean(played) -> Outcome:
    outcome = played("")
    assert outcome.status == 0, outcome.said
    return outcome


def fault(instrument: str, kind: str, **settings: object) -> str:
    lines = [f"[faults.{instrument}.{kind}]", f"from_s = {LATER}"]
    for key, value in settings.items():
        lines.append(f"{key} = " + (f'"{value}"' if isinstance(value, str) else str(value)))
    return "\n".join(lines)


TIMEOUT, HANGUP, GARBAGE = "instrument-timeout", "instrument-hangup", "instrument-garbage"
BLOCK, QUEUE, SETTING = "instrument-block", "instrument-error-queue", "instrument-setting"
NO_TRIGGER = "instrument-no-trigger"
UNDER_WAY = [
    ("waveform_dac", "silent", {}, TIMEOUT),
    ("waveform_dac", "silent", {"message": "*OPC?", "times": 1}, TIMEOUT),
    ("waveform_dac", "late_reply", {"value": 1.2, "message": "*TRG"}, TIMEOUT),
    ("waveform_dac", "hang_up", {"message": "*OPC?"}, HANGUP),
    ("waveform_dac", "garbage", {}, GARBAGE),
    ("waveform_dac", "twice", {}, GARBAGE),
    ("waveform_dac", "answer", {"value": "0", "message": "*OPC?"}, GARBAGE),
    ("waveform_dac", "error_queue", {"message": "*TRG"}, QUEUE),
    ("waveform_dac", "stuck_queue", {}, QUEUE),
    ("waveform_dac", "setting_not_taken", {"value": ["SOUR1:VOLT:HIGH"]}, SETTING),
    ("digitizer", "silent", {}, TIMEOUT),
    ("digitizer", "silent", {"message": "FETC"}, NO_TRIGGER),
    ("digitizer", "trickle", {"value": 0.05, "message": "FETC"}, BLOCK),
    ("digitizer", "hang_up", {"message": "FETC"}, HANGUP),
    ("digitizer", "twice", {}, GARBAGE),
    ("digitizer", "byte_order", {}, GARBAGE),
    ("digitizer", "error_queue", {}, QUEUE),
    ("digitizer", "no_trigger", {}, NO_TRIGGER),
    ("digitizer", "no_data", {"value": 400}, "instrument-no-data"),
    ("amplifier", "late_reply", {"value": 1.2}, TIMEOUT),
    ("amplifier", "hang_up", {}, HANGUP),
    ("amplifier", "adjusted", {"value": 60}, SETTING),
]


# as on every line by itself, in `tests/drivers/test_fault_table.py`
AS_OTHERS = {
    ("waveform_dac", "silent", ""), ("waveform_dac", "twice", ""), ("digitizer", "twice", ""),
    ("waveform_dac", "answer", "*OPC?"), ("waveform_dac", "stuck_queue", ""),
    ("digitizer", "silent", "FETC"), ("digitizer", "error_queue", ""), ("amplifier", "hang_up", ""),
}  # fmt: skip


def _named(row):
    key = row[0], row[1], row[2].get("message", "")
    marks = [pytest.mark.study] if key in AS_OTHERS else []
    return pytest.param(*row, id="-".join(key), marks=marks)


@pytest.mark.parametrize(
    ("instrument", "kind", "settings", "code"), [_named(row) for row in UNDER_WAY]
)
def test_a_fault_under_way_is_named_and_leaves_the_stack_at_rest_and_the_run_intact(
    played, clean, instrument, kind, settings, code
):
    outcome = played(fault(instrument, kind, **settings))
    assert (outcome.code, outcome.status) == (code, 4), outcome.said
    if kind != "adjusted":  # by another set voltage rest is not 0 V, and nobody but a hand helps
        assert abs(outcome.stack_v[-1]) < 0.05
    assert outcome.stack_v.max() < 75.01
    assert outcome.took_s < 2 * clean.took_s + TIMEOUT_S + 2.0
    assert f"{instrument}: " in outcome.said
    assert "piezo: at 0 V" in outcome.said or "NOT known" in outcome.said
    assert outcome.run is not None
    kept, whole = Run(outcome.run), Run(clean.run)
    assert kept.sweep_names == ["sweep_0001"]
    np.testing.assert_array_equal(kept.sweeps()[0].sensor_v, whole.sweeps()[0].sensor_v)
    assert [e["code"] for e in kept.events() if e["event"] == "error"] == [code]


AT_THE_START = [
    ("[faults.waveform_dac]\nrefuse = true", "instrument-refused"),
    ("[faults.amplifier]\nrefuse = true", "instrument-refused"),
    ("[faults.waveform_dac]\ndrop_at_once = true", HANGUP),
    ('[faults.digitizer.answer]\nmessage = "*IDN?"\nvalue = "Agilent,L4532A,SIM1"', GARBAGE),
    ("[faults.waveform_dac]\nstuck_queue = true", QUEUE),
    ("[faults.amplifier]\nadjusted = 60", SETTING),
]


@pytest.mark.parametrize(("more", "code"), AT_THE_START)
def test_a_fault_at_the_start_is_named_before_anything_moves(played, clean, more, code):
    outcome = played(more)
    assert (outcome.code, outcome.status) == (code, 4), outcome.said
    assert "piezo: not touched" in outcome.said
    assert outcome.run is None
    assert outcome.took_s < 2 * clean.took_s + TIMEOUT_S + 2.0


@pytest.mark.parametrize(
    ("driver", "name"), [("keysight_33500b", "waveform_dac"), ("keysight_l4532a", "digitizer"),
                         ("thorlabs_mdt69x", "amplifier")],
)  # fmt: skip
def test_a_serial_number_that_is_not_yesterdays_is_named(played, driver, name):
    outcome = played("", **{driver: 'serial = "SIM12345"'})
    assert outcome.code == "instrument-identity"
    assert name in outcome.said
    assert "SIM12345" in outcome.said
    assert "piezo: not touched" in outcome.said


STOPPING = [
    ("[plant.beam_interruption]\non = true\ntimes = [2.6]\nduration = 900", "beam-interruption"),
    ("[plant.beam_interruption]\non = true\ntimes = [1.9]\nduration = 9\nvolts = 10",
     "beam-interruption"),
    ("[plant.switch_turned]\non = true\ntime = 2\nswitch = 4", "sensor-sensitivity"),
    ("[plant.switch_turned]\non = true\ntime = 2\nswitch = 2", "sensor-sensitivity"),
    ("[plant.sensor]\nlimit_v = 0.21", "sensor-clipping"),
]  # fmt: skip


@pytest.mark.parametrize(("more", "code"), STOPPING)
def test_what_spoils_all_that_follows_stops_the_run_after_its_sweep_is_stored(played, more, code):
    outcome = played(more)
    assert (outcome.code, outcome.status) == (code, 4), outcome.said
    assert f"flag[{code}]: sweep_0002" in outcome.printed
    assert abs(outcome.stack_v[-1]) < 0.05
    run = Run(outcome.run)
    assert run.sweep_names == ["sweep_0001", "sweep_0002"]
    assert [e["code"] for e in run.events() if e["event"] == "flag"] == [code]


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ("[plant.beam_interruption]\non = true\ntimes = [2.55]\nduration = 0.02",
         "beam-interruption"),
        ("[plant.drive_clipping]\non = true\nupper = 22", "drive-clipping"),
    ],
)  # fmt: skip
def test_what_is_over_is_flagged_at_once_and_the_run_goes_on_to_an_error(played, more, code):
    outcome = played(more)
    assert (outcome.code, outcome.status) == (code, 4), outcome.said
    assert f"flag[{code}]: sweep_0002" in outcome.printed
    assert outcome.printed.splitlines()[-3].startswith("run: ")
    run = Run(outcome.run)
    assert run.complete
    assert len(run.sweep_names) == 3
    events = [e["event"] for e in run.events()]
    assert events.index("flag") < len(events) - 2  # while the run still played
    assert abs(outcome.stack_v[-1]) < 0.05


def test_a_noisy_plateau_of_the_sensor_is_flagged_and_left_to_the_diagnosis(played):
    outcome = played("[plant.sensor_clipping]\non = true\nlevel = 2.0")
    assert outcome.status == 0, outcome.said
    assert "flag[sensor-clipping]: sweep_0001" in outcome.printed


@pytest.mark.parametrize("more", ["[faults.digitizer]\nno_triger = true", "[faults]\nlaser = 1"])
def test_a_slip_in_the_faults_is_bad_input(played, more):
    outcome = played(more)
    assert (outcome.code, outcome.status) == ("config", 2)
    assert "[faults]" in outcome.said


def test_what_an_instrument_calls_itself_need_not_fit_the_terminal(tmp_path):
    text = (shipped_folder("configs") / "simulated_bench.toml").read_text()
    rig = tmp_path / "rig.toml"
    named = 'message = "*IDN?"\nvalue = "Ägilent,L4532A,SIM00002,1"'
    rig.write_text(f"{text}\n[faults.digitizer.answer]\n{named}\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "piezo_rig", "run", "blank", "--rig", rig, "--out", tmp_path],
        capture_output=True, text=True, env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "gilent,L4532A,SIM00002,1" in done.stdout
