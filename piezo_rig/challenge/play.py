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
RARE = 1e-3  # of the samples may lie a step of the sensor's own converter aside, see `beside`
CODES = 2.0**16


def played(rehearsal: Rehearsal, plant: Settings, folder: Path) -> list[Sweep]:
    """The sweeps of a run on a simulated bench with this plant.

    The run's own config is the shipped bench's, so that the run does not tell what is hidden.

    Raises
    ------
    BenchError : an instrument failed, or the run is not what was rehearsed
    """
    from drivers.simulated.plant import PlantConfig

    rig = challenge_rig(plant)
    path = folder / "run.h5"
    with open_bench(rig, lambda question: True, wire := Wire(), VirtualClock()) as bench:
        play(rehearsal.plan, bench, path, wire, quiet=True)
    sweeps = Run(path).sweeps()
    expected = rehearsal.displacements(plant, clean=False)
    step_um = 2.0 * rig.digitizer.sensor_range_v / CODES * rig.sensitivity_um_per_v
    own = PlantConfig.from_mapping(plant).quantisation
    own_um = 2.0 * own.full_scale / 2.0**own.bits * rig.sensitivity_um_per_v if own.on else 0.0
    for sweep, row, start in zip(sweeps, expected, rehearsal.starts_s, strict=True):
        off_um = beside(sweep.displacement_um - row, STEPS * step_um, own_um)
        late = abs(sweep.start_time - start)
        if off_um or late > 1e-6:
            raise BenchError(
                "challenge-bench",
                f"{sweep.name}: the run differs from what was sealed by {1e3 * off_um:.3g} nm, and "
                f"began {late:.3g} s beside its time",
                "drivers, instruments or runner do not play what the plan says",
                "report it with the seed and the case's number",
            )
    return sweeps


def beside(off_um: FloatArray, alike_um: float, step_um: float) -> float:
    """How far a run lies beside its rehearsal, um; 0 where they agree.

    A sensor voltage halfway between two steps of the sensor's converter goes to either, as the
    last bit of a sum falls out. So one sample in a thousand may be a step aside, and where that is
    the one that a sweep is counted from, all of them may.

    Parameters
    ----------
    off_um : (n,) run less rehearsal, each from its first sample
    alike_um : what the digitizer explains
    step_um : of the sensor's converter
    """
    first = float(np.median(off_um))
    first = first if abs(abs(first) - step_um) <= alike_um else 0.0
    off_um = np.abs(off_um - first)
    aside = np.abs(off_um - step_um) <= alike_um
    rest = off_um[~aside] if np.mean(aside) <= RARE else off_um
    most = float(rest.max(initial=0.0))
    return most if most > alike_um else 0.0
