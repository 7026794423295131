"""The bench in a bluesky plan."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from drivers.clock import VirtualClock
from piezo_rig.config import load_rig
from piezo_rig.errors import InputError
from piezo_rig.protocol import build_plan, load_protocol

pytest.importorskip("ophyd_async")

PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "ophyd"
sample_rate = 1000
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [40, 75]
frequency_hz = 4
cycles = 2
"""


@pytest.fixture
def device(tmp_path):
    from piezo_rig.ophyd_devices import PiezoBench

    (tmp_path / "p.toml").write_text(PROTOCOL)
    plan = build_plan(load_protocol(tmp_path / "p.toml"), load_rig())
    return PiezoBench(plan, lambda question: True, clock=VirtualClock())


def test_a_trigger_plays_a_sweep_and_reads_it_as_arrays(device):
    async def experiment():
        await device.connect()
        await device.stage()
        await device.condition.set("0-75")
        await device.trigger()
        reading, described = await device.read(), await device.describe()
        configured = await device.read_configuration()
        at_rest_before = device._bench
        await device.unstage()
        return reading, described, configured, at_rest_before

    reading, described, configured, bench = asyncio.run(experiment())
    drive = reading["piezo-drive_v"]["value"]
    travel = reading["piezo-displacement_um"]["value"]
    assert drive.shape == travel.shape == (500,)
    assert float(np.ptp(drive)) == pytest.approx(75.0, abs=0.01)
    assert float(np.ptp(travel)) == pytest.approx(11.0, abs=1.0)  # some 0.15 um/V
    assert described["piezo-displacement_um"]["units"] == "um"
    assert configured["piezo-condition"]["value"] == "0-75"
    assert bench.at_rest


def test_what_is_not_in_the_plan_is_not_played(device):
    async def experiment():
        await device.connect()
        with pytest.raises(InputError, match="not staged"):
            await device.trigger()
        await device.stage()
        await device.condition.set("0-80")
        with pytest.raises(InputError, match="no condition '0-80'"):
            await device.trigger()
        await device.unstage()

    asyncio.run(experiment())
