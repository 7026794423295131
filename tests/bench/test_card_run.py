"""A run on an NI card: the same protocol, the same checks, another instrument."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
from piezo_rig.bench import open_bench
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.errors import InputError
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import shipped_folder
from piezo_rig.run_file.reader import Run
from piezo_rig.runner import Wire, play

RIG = (shipped_folder("configs") / "simulated_nidaqmx.toml").read_text()
PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "card"
sample_rate = 1000
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [40, 75]
frequency_hz = 4
cycles = 2
"""


def test_a_run_on_a_card_verifies_and_replays(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "p.toml").write_text(PROTOCOL)
    rig, wire, clock = load_rig(str(tmp_path / "rig.toml")), Wire(), VirtualClock()
    with open_bench(rig, lambda question: True, wire, clock) as bench:
        plan = build_plan(load_protocol(tmp_path / "p.toml"), rig)
        path = play(plan, bench, tmp_path / "r.h5", wire)
        assert bench.drive_v() == pytest.approx(0.0, abs=0.01)
    run = Run(path)
    assert (run.origin, run.complete) == ("SIMULATED", True)
    sweep = run.sweeps()[1]
    assert sweep.drive_monitor_v is None
    # a triangle of 75 V at 4 Hz; the stack moves some 0.15 um/V
    assert float(np.ptp(sweep.drive_v)) == pytest.approx(75.0, abs=0.01)
    assert float(np.ptp(sweep.displacement_um)) == pytest.approx(11.0, abs=1.0)
    assert abs(int(sweep.displacement_um.argmax()) - int(sweep.drive_v.argmax())) % 250 <= 4
    assert main(["verify", str(path)]) == 0
    assert main(["replay", str(path)]) == 0
    assert "are the same" in capsys.readouterr().out


@pytest.mark.parametrize(("old", "new", "says"), [
    ('driver = "nidaqmx"\nmonitor', 'driver = "keysight_l4532a"\nmonitor', "name nidaqmx under"),
    ("monitor_channel = 0 ", "monitor_channel = 1 ", "set monitor_channel = 0"),
    ("sensor_range_v = 1", "sensor_range_v = 4", "use one of"),
    ("sensor_range_v = 1", "sensor_range_v = 1\noversampling = 10", "set oversampling = 1"),
    ('driver = "nidaqmx"\nmonitor', 'driver = "nidaqmx"\naddress = "Dev2/ai0"\nmonitor',
     "two channels of one card"),
])
def test_what_a_card_cannot_do_is_told_from_the_config(tmp_path, old, new, says):
    assert old in RIG
    text = RIG.replace(old, new)
    if "Dev2" in new:
        text = text.replace('[waveform_dac]\n', '[waveform_dac]\naddress = "Dev1/ao0"\n')
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_rig(str(tmp_path / "rig.toml"))
    assert says in caught.value.remedy
