"""A short run, played through the drivers on the simulated bench, for tests that break it."""

from __future__ import annotations

from pathlib import Path

from drivers.clock import VirtualClock
from piezo_rig.bench import open_bench
from piezo_rig.config import load_rig
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import shipped_folder
from piezo_rig.runner import Wire, play

PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "short"
sample_rate = 2000
repeats = 3
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [40, 75]
frequency_hz = 4
cycles = 2
"""
RIG = (shipped_folder("configs") / "simulated_bench.toml").read_text()


def played(
    folder: Path, plant: str = "", protocol: str = PROTOCOL, tell=lambda text: None
) -> Path:
    """The run, in ``folder``; ``plant`` is added to the rig's config below ``[plant]``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(RIG + plant)
    (folder / "short.toml").write_text(protocol)
    rig = load_rig(str(folder / "rig.toml"))
    clock = VirtualClock()
    wire = Wire()
    with open_bench(rig, lambda question: True, wire, clock) as bench:
        plan = build_plan(load_protocol(folder / "short.toml"), rig)
        return play(plan, bench, folder / "r.h5", wire, tell)
