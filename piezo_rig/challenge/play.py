"""A case played through the drivers: instruments on real transports, the runner, a run file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import VirtualClock
from piezo_rig.bench import open_bench
from piezo_rig.challenge.hiding import Settings
from piezo_rig.challenge.rehearsal import Rehearsal, challenge_rig
from piezo_rig.errors import BenchError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.runner import Wire, play

FloatArray = NDArray[np.float64]
STEPS = 2.0  # of the digitizer, by which a run may differ from its rehearsal
CODES = 2.0**16


def played(rehearsal: Rehearsal, plant: Settings, folder: Path) -> list[Sweep]:
    """The sweeps of a run on a simulated bench with this plant.

    The run's own config is the shipped bench's, so that the run does not tell what is hidden.

    Raises
    ------
    BenchError : an instrument failed, or the run is not what was rehearsed
    """
    rig = challenge_rig(plant)
    path = folder / "run.h5"
    with open_bench(rig, lambda question: True, wire := Wire(), VirtualClock()) as bench:
        play(rehearsal.plan, bench, path, wire, quiet=True)
    sweeps = Run(path).sweeps()
    expected = rehearsal.displacements(plant, clean=False)
    step_um = 2.0 * rig.digitizer.sensor_range_v / CODES * rig.sensitivity_um_per_v
    for sweep, row, start in zip(sweeps, expected, rehearsal.starts_s, strict=True):
        off = float(np.abs(sweep.displacement_um - row).max())
        late = abs(sweep.start_time - start)
        if off > STEPS * step_um or late > 1e-6:
            raise BenchError(
                "challenge-bench",
                f"{sweep.name}: the run differs from what was sealed by {1e3 * off:.3g} nm, and "
                f"began {late:.3g} s beside its time",
                "drivers, instruments or runner do not play what the plan says",
                "report it with the seed and the case's number",
            )
    return sweeps
