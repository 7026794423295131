"""A protocol played through the drivers, the transports and the simulated instruments."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.clock import VirtualClock
from piezo_rig.bench import open_bench, simulated_instruments
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import shipped_folder
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify import verify
from piezo_rig.runner import Wire, play

SHORT = """
schema = "piezo-rig/protocol/1"
name = "short"
repeats = 2
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [65, 75]
frequency_hz = 5
cycles = 4
[[condition]]
waveform = "triangle"
lower_v = 50
upper_v = 75
start = "upper"
frequency_hz = 5
cycles = 4
"""

SIMULATED = (shipped_folder("configs") / "simulated_bench.toml").read_text()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("bench")


@pytest.fixture(scope="module")
def protocol(folder) -> Path:
    path = folder / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def played(folder, protocol) -> tuple[Run, str]:
    """A run made by the command line, and what was printed."""
    out = folder / "runs"
    done = subprocess.run(
        [sys.executable, "-m", "piezo_rig", "run", str(protocol), "--out", str(out)],
        capture_output=True, text=True,
    )
    assert done.returncode == 0, done.stderr
    (path,) = out.glob("*.h5")
    return Run(path), done.stdout


def test_the_last_lines_name_run_model_and_figure(played):
    run, printed = played
    lines = [line.split(": ", 1) for line in printed.splitlines()[-3:]]
    assert [what for what, _ in lines] == ["run", "model", "figure"]
    assert Path(lines[0][1]) == run.path
    assert json.loads(Path(lines[1][1]).read_text())["schema"] == "piezo-rig/model/1"
    assert Path(lines[2][1]).read_bytes().startswith(b"\x89PNG")


def test_every_planned_sweep_is_recorded_and_verified(played, protocol):
    run, _ = played
    plan = build_plan(load_protocol(protocol), load_rig())
    sweeps = run.sweeps()
    assert [s.condition for s in sweeps] == [s.condition.name for s in plan.sweeps]
    for sweep, planned in zip(sweeps, plan.sweeps, strict=True):
        np.testing.assert_array_equal(sweep.command_v, planned.wave.command_v)
        assert sweep.history == "virgin"
    assert run.texts["plan_hash"] == plan.hash
    assert verify(run.path)[1] == []
    assert run.complete


def test_simulated_data_say_so(played):
    run, _ = played
    assert run.origin == "SIMULATED"
    assert {s.origin for s in run.sweeps()} == {"SIMULATED"}
    assert all(i["serial"].startswith("SIM") for n, i in run.instruments().items()
               if n != "interferometer")


def test_the_monitor_shows_the_planned_drive(played):
    run, _ = played
    for sweep in run.sweeps():
        # one sample late at 750 V/s: the generator's step and the amplifier's lag
        assert np.abs(sweep.drive_monitor_v - sweep.drive_v).max() < 750 / 5000 + 0.02


def test_the_wire_transcript_holds_every_trigger(played):
    run, _ = played
    with h5py.File(run.path) as f:
        data = f["entry/wire_transcript"][...].tobytes()
    assert data.count(b"*TRG") == len(run.sweep_names)


def test_the_log_ends_at_rest(played):
    run, _ = played
    last = run.events()[-1]
    assert last["event"] == "finished"
    assert abs(last["stack_v"]) < 0.05


@contextmanager
def bench_process(folder: Path) -> Iterator[tuple[Path, Path]]:
    """A bench served by a process of its own: a rig config for it, and its record of the stack."""
    config, record = folder / "served.toml", folder / "record.csv"
    with subprocess.Popen(
        [sys.executable, "-m", "piezo_rig", "bench", "--clock", "virtual",
         "--record", str(record), "--config-out", str(config)],
        stdout=subprocess.PIPE, text=True,
    ) as process:
        assert process.stdout is not None
        try:
            assert any(line.startswith("serving") for line in process.stdout)
            yield config, record
        finally:
            process.send_signal(signal.SIGTERM)
            assert process.wait(20) == 0


def stack(record: Path) -> np.ndarray:
    with record.open() as handle:
        rows = list(csv.reader(handle))
    assert rows[0] == ["time_s", "stack_v"]
    return np.array(rows[1:], dtype=float)


def first_above(time: np.ndarray, volts: np.ndarray, level: float = 30.0) -> float:
    """When a rise crosses a level, between samples."""
    k = int(np.argmax(volts > level))
    return float(np.interp(level, volts[k - 1 : k + 1], time[k - 1 : k + 1]))


def test_what_the_stack_saw_is_what_was_planned(folder, protocol):
    out = folder / "served_runs"
    with bench_process(folder) as (config, record):
        assert main(["run", str(protocol), "--rig", str(config), "--out", str(out)]) == 0
    seen = stack(record)
    (path,) = out.glob("*.h5")
    run = Run(path)
    assert seen[:, 1].max() < 75.01
    assert seen[:, 1].min() > -0.05
    assert abs(seen[-1, 1]) < 0.01
    for sweep in run.sweeps():
        # start_time is the host's, the trigger comes a message later: align at the first 30 V
        after = seen[seen[:, 0] > sweep.start_time]
        begun = first_above(after[:, 0], after[:, 1]) - first_above(sweep.time_s, sweep.drive_v)
        inside = (after[:, 0] > begun) & (after[:, 0] < begun + 0.79)
        assert inside.sum() > 500
        planned = np.interp(after[inside, 0] - begun, sweep.time_s, sweep.drive_v)
        assert np.abs(planned - after[inside, 1]).max() < 750 / 5000 + 0.02
    # over 2 ms, so that the generator's single steps of 0.15 V do not count as slew
    grid = np.arange(seen[0, 0], seen[-1, 0], 2e-3)
    slew = np.diff(np.interp(grid, seen[:, 0], seen[:, 1])) / 2e-3
    assert np.abs(slew).max() < 1000


@pytest.mark.parametrize("number", [
    signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.study),
    pytest.param(signal.SIGHUP, marks=pytest.mark.study),
])  # fmt: skip
def test_a_stopped_run_ends_at_rest_with_what_was_recorded(tmp_path, protocol, number):
    long = tmp_path / "long.toml"
    long.write_text(SHORT.replace("repeats = 2", "repeats = 60"))
    out = tmp_path / "runs"
    with bench_process(tmp_path) as (config, record), subprocess.Popen(
        [sys.executable, "-m", "piezo_rig", "run", str(long), "--rig", str(config),
         "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as runner:
        assert runner.stdout is not None
        assert any(line.startswith("sweep 1") for line in runner.stdout)  # it plays
        os.kill(runner.pid, number)
        _, said = runner.communicate(timeout=30)
        assert runner.returncode == 5, said
        assert said.startswith("error[aborted]: ")
        assert "at 0 V" in said
    assert abs(stack(record)[-1, 1]) < 0.01
    (path,) = out.glob("*.h5")
    assert not list(out.glob("*.part.h5"))
    run = Run(path)
    assert not run.complete
    assert run.events()[-1]["event"] == "error"


def test_an_instrument_that_fails_leaves_the_stack_at_rest_and_the_run_intact(tmp_path, protocol):
    from drivers.simulated.bench import SimulatedBench
    from drivers.simulated.plant import Plant
    from piezo_rig.errors import BenchError

    clock, plant, faults = VirtualClock(), Plant(), {}
    with SimulatedBench(plant, clock, faults=faults) as served:
        rig = served_rig_of(tmp_path, served.addresses)
        wire = Wire()
        with open_bench(rig, lambda question: True, wire, clock) as bench:
            plan = build_plan(load_protocol(protocol), rig)
            played = []

            def tell(text: str) -> None:
                played.append(text)
                if len(played) == 3:
                    faults["digitizer"]["no_trigger"] = True

            with pytest.raises(BenchError) as caught:
                play(plan, bench, tmp_path / "r.h5", wire, tell)
        assert caught.value.code == "instrument-no-trigger"
        assert "at 0 V" in caught.value.piezo
        assert abs(plant.stack_v(clock.now())) < 0.01
    run = Run(tmp_path / "r.h5")
    assert len(run.sweep_names) == 2
    assert not run.complete


def served_rig_of(folder: Path, addresses: dict[str, str]):
    from piezo_rig.commands.rig_text import served_rig

    path = folder / "rig.toml"
    path.write_text(served_rig(SIMULATED, addresses, "real"))
    return load_rig(str(path))


@pytest.fixture
def real_bench(tmp_path, monkeypatch):
    """Instruments that count as real ones; their rig, plant and clock."""
    from drivers.simulated.bench import SimulatedBench
    from drivers.simulated.plant import Plant

    clock, plant = VirtualClock(), Plant()
    with SimulatedBench(plant, clock) as served:
        # what marks a simulated serial number is not what these instruments answer with
        monkeypatch.setattr("drivers.identity.SIMULATED_PREFIX", "OTHER")
        yield served_rig_of(tmp_path, served.addresses), plant, clock


def test_a_real_bench_does_not_move_before_the_operator_has_said_yes(real_bench):
    from piezo_rig.errors import BenchError

    rig, plant, clock = real_bench
    asked = []
    with pytest.raises(BenchError) as caught, open_bench(rig, asked.append, None, clock):
        pass
    assert caught.value.code == "instrument-setting"
    assert ["sensitivity switch at 3" in question for question in asked] == [True]
    assert plant.stack_v(clock.now()) == 75.0  # as it was found


def test_a_real_bench_plays_under_a_guard(real_bench, tmp_path, protocol):
    rig, plant, clock = real_bench
    wire = Wire()
    with open_bench(rig, lambda question: True, wire, clock) as bench:
        assert bench.keeper.pid > 0
        plan = build_plan(load_protocol(protocol), rig)
        run = Run(play(plan, bench, tmp_path / "r.h5", wire))
    assert run.origin == "REAL"
    assert run.complete
    assert abs(plant.stack_v(clock.now())) < 0.01


def test_the_settings_in_the_run_are_those_it_was_played_with(played):
    run, _ = played
    settings = run.instruments()["waveform_dac"]["settings"]
    assert float(settings["SOUR1:FUNC:ARB:SRAT?"]) == 5000.0
    assert settings["SOUR1:FUNC?"].upper().startswith("ARB")
    assert float(settings["SOUR1:VOLT:LOW?"]) == -10.0
    assert any("RANG" in query for query in run.instruments()["digitizer"]["settings"])


def test_a_setting_that_is_not_taken_is_named(tmp_path, protocol):
    from drivers.simulated.bench import SimulatedBench
    from drivers.simulated.plant import Plant
    from piezo_rig.errors import BenchError

    clock, faults = VirtualClock(), {"digitizer": {"setting_not_taken": ["CONF:ACQ:SRAT"]}}
    with SimulatedBench(Plant(), clock, faults=faults) as served:
        rig = served_rig_of(tmp_path, served.addresses)
        with open_bench(rig, lambda question: True, None, clock) as bench:
            plan = build_plan(load_protocol(protocol), rig)
            with pytest.raises(BenchError) as caught:
                play(plan, bench, tmp_path / "r.h5", Wire())
    assert caught.value.code == "instrument-setting"
    for word in ("digitizer", "SRAT", "5000"):
        assert word in caught.value.what


def test_another_serial_number_than_the_configs_is_refused(tmp_path):
    from piezo_rig.errors import BenchError

    path = tmp_path / "rig.toml"
    path.write_text(SIMULATED.replace(
        'driver = "keysight_l4532a"', 'driver = "keysight_l4532a"\nserial = "MY123"'
    ))
    with pytest.raises(BenchError) as caught, open_bench(load_rig(str(path)), lambda q: True):
        pass
    assert caught.value.code == "instrument-identity"
    assert "MY123" in caught.value.what


def test_a_wrong_plant_setting_is_named(tmp_path, capsys):
    path = tmp_path / "rig.toml"
    path.write_text(SIMULATED + "\n[plant.creep]\non = true\nspeed = 3\n")
    assert main(["run", "quick_look", "--rig", str(path), "--out", str(tmp_path)]) == 2
    text = capsys.readouterr().err
    assert text.startswith("error[config]: ")
    assert "creep.speed" in text


def test_recovery_is_waited_for_on_the_benchs_clock(tmp_path, protocol):
    rig = load_rig()
    clock = VirtualClock()
    with simulated_instruments(rig, clock) as wired:
        from dataclasses import replace

        wired = replace(wired, simulated=False)
        wire = Wire()
        with open_bench(wired, lambda question: True, wire, clock) as bench:
            plan = build_plan(load_protocol(protocol), wired)
            run = Run(play(plan, bench, tmp_path / "r.h5", wire))
    starts = [s.start_time for s in run.sweeps()]
    assert np.diff(starts).min() >= rig.recovery_s + 0.8
