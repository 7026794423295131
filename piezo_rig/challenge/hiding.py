"""What can be hidden in the simulated bench: tables of its ``[plant]``, each with a size.

The physics is the plant's. This file only says which setting makes an effect larger, what else
about it is drawn, and which of its settings mean the same as a parameter of the catalogue.

Three causes of the catalogue are not here. ``drive-gain`` and ``sensor-scale``: a model that is
refitted to the recordings shows neither, and nothing but the recordings is handed out.
``clock-ratio``: the generator puts out steps, so a digitizer whose clock slips past them records
whole steps too early or too late and nothing in between, which no bench with a filter does.

The steps matter to delays too. The first sample after a step sees it; anything that delays at all
makes it see the step before. So a skew comes in whole samples here, a lag's tau is not what a
smooth drive would show of it, and a slew limit brings a delay of one sample along.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Settings = dict[str, Any]
Rng = np.random.Generator


@dataclass(frozen=True)
class Reach:
    """How far drive and displacement go in a case, V and um, and how fast the drive, V/s."""

    drive_v: float
    travel_um: float
    slew_v_per_s: float


def _nothing(rng: Rng, reach: Reach) -> Settings:
    return {}


@dataclass(frozen=True)
class Kind:
    """One effect of the plant.

    Attributes
    ----------
    cause : its id in the catalogue, or ``stranger:NAME``
    table : of the plant, dots for a table within a table
    place : where in the signal chain it acts
    at : size -> the settings that have it
    start, least, most : sizes to begin a search with, and how small and large it may become;
        ``most`` None: it comes as it is, and never beside another
    drawn : what else about it is random, given how far the case goes; also in rivals
    below : a setting that was drawn and lies lower by the size
    signed : the size may be of either sign
    parameters : settings that the catalogue defines in the same way, as cause's name -> setting
    clock : locked to the clock, so that repeats differ
    lumpy : happens now and then, so that nothing foretells it; no signature, no gain
    """

    cause: str
    table: str
    place: str
    at: Callable[[float], Settings]
    start: float
    most: float | None
    least: float = 0.0
    drawn: Callable[[Rng, Reach], Settings] = _nothing
    below: str = ""
    signed: bool = False
    parameters: dict[str, str] = field(default_factory=dict)
    clock: bool = False
    lumpy: bool = False

    def plant(self, size: float, more: Settings) -> Settings:
        """The plant's table with this effect in this size, nested."""
        out: Settings = {"on": True, **more, **self.at(size)}
        if self.below:
            out[self.below] = more[self.below] - size
        for name in reversed(self.table.split(".")):
            out = {name: out}
        return out


def _at_all(size: float) -> Settings:
    return {}


def _is(name: str) -> Callable[[float], Settings]:
    return lambda size: {name: size}


CAUSES: tuple[Kind, ...] = (
    Kind("drive-clipping", "drive_clipping", "drive", _at_all, 0.5, 20.0, below="upper",
         drawn=lambda rng, reach: {"upper": reach.drive_v}, parameters={"upper": "upper"}),
    Kind("slew-limit", "slew_limit", "drive", _at_all, 1.0, None,
         drawn=lambda rng, reach: {"limit": float(rng.uniform(0.93, 0.99)) * reach.slew_v_per_s},
         parameters={"limit": "limit"}),
    Kind("amplifier-lag", "amplifier_lag", "drive", _at_all, 1.0, None,
         drawn=lambda rng, reach: {"tau": float(rng.uniform(1e-4, 2e-3))}),
    Kind("initiation-stage", "initiation_stage", "actuator", _is("size"), 0.1, 1.5, signed=True,
         drawn=lambda rng, reach: {"scale": float(rng.uniform(12.0, 30.0))}),
    Kind("range-dependence", "range_dependence", "actuator", _is("size"), 0.05, 0.8, signed=True,
         drawn=lambda rng, reach: {"fade": float(rng.uniform(12.0, 25.0))}),
    Kind("extremum-dependence", "extremum_dependence", "actuator", _is("size"), 0.05, 0.8,
         signed=True),
    Kind("direction-asymmetry", "direction_asymmetry", "actuator",
         lambda size: {"ratio": 1.0 + size}, 0.05, 0.7, signed=True),
    Kind("creep", "creep", "actuator", _is("rate_per_decade"), 0.01, 0.15,
         parameters={"rate_per_decade": "rate_per_decade"}),
    Kind("rate-dependence", "rate_dependence", "actuator", _is("lag_um"), 0.02, 1.0,
         drawn=lambda rng, reach: {"exponent": float(rng.uniform(0.35, 1.0))},
         parameters={"lag_um": "lag_um", "exponent": "exponent"}),
    Kind("resonance", "resonance", "actuator", _is("participation"), 0.05, 0.8,
         drawn=lambda rng, reach: {"frequency": float(rng.uniform(90.0, 240.0)),
                            "damping": float(rng.uniform(0.01, 0.06))},
         parameters={"frequency": "frequency", "damping": "damping"}),
    Kind("cycle-aging", "cycle_aging", "actuator", _is("rate_per_decade"), 0.01, 0.15, signed=True,
         parameters={"rate_per_decade": "rate_per_decade"}),
    Kind("remanence", "remanence", "actuator", _is("fraction"), 0.05, 0.9, clock=True,
         parameters={"fraction": "fraction"}),
    Kind("thermal-drift", "thermal_drift", "sensor", _is("rate"), 1.0, 500.0, signed=True,
         clock=True, parameters={"rate": "rate"}),
    Kind("periodic-nonlinearity", "periodic_nonlinearity", "sensor", _is("amplitude"), 2.0, 60.0,
         drawn=lambda rng, reach: {"phase": float(rng.uniform(0.0, 6.28)),
                            "second_harmonic": float(rng.uniform(0.0, 0.4))},
         parameters={"amplitude": "amplitude"}),
    Kind("fringe-jump", "fringe_jump", "sensor", lambda size: {"per_second": 0.25}, 1.0, None,
         clock=True, lumpy=True),
    Kind("sensor-clipping", "sensor_clipping", "sensor", _at_all, 0.05, 3.0, below="level",
         drawn=lambda rng, reach: {"level": reach.travel_um}, parameters={"level": "level"}),
    Kind("mains-hum", "mains_hum", "sensor", _is("amplitude"), 3.0, 60.0, clock=True,
         drawn=lambda rng, reach: {
             "frequency": float(rng.choice([50.0, 60.0]) + rng.normal(0.0, 0.02)),
             "third": float(rng.uniform(0.0, 0.5)), "fifth": float(rng.uniform(0.0, 0.3)),
         },
         parameters={"frequency": "frequency", "amplitude": "amplitude"}),
    Kind("outliers", "outliers", "sensor", _is("height"), 100.0, 2000.0, least=60.0, clock=True,
         lumpy=True, drawn=lambda rng, reach: {"per_second": float(rng.uniform(0.5, 4.0))},
         parameters={"per_second": "per_second"}),
    Kind("time-skew", "time_skew", "acquisition", _at_all, 1.0, None,
         drawn=lambda rng, reach: {"delay": 1e-3 * int(rng.integers(1, 4))},
         parameters={"delay": "delay"}),
    Kind("dropped-samples", "dropped_samples", "acquisition", lambda size: {"per_second": 0.3}, 1.0,
         None, clock=True, lumpy=True),
)  # fmt: skip

STRANGERS: tuple[Kind, ...] = (
    Kind("stranger:stiction-bump", "strangers.stiction_bump", "actuator", _is("size"), 0.02, 0.5,
         drawn=lambda rng, reach: {"place": float(rng.uniform(2.0, 6.0)),
                            "width": float(rng.uniform(0.3, 0.9))}),
    Kind("stranger:period-two", "strangers.period_two", "actuator", _is("size"), 0.02, 0.5),
    Kind("stranger:curvature-change", "strangers.curvature_change", "actuator", _is("size"), 0.02,
         0.5, drawn=lambda rng, reach: {"beyond": float(rng.uniform(25.0, 50.0))}),
    Kind("stranger:backlash", "strangers.backlash", "actuator", _is("gap"), 0.02, 0.5),
    Kind("stranger:self-heating", "strangers.self_heating", "actuator", _is("size"), 0.02, 2.0,
         drawn=lambda rng, reach: {"tau": float(rng.uniform(3.0, 15.0))}),
)  # fmt: skip

# What the plant does by default; a case holds its body, noise, and what is hidden, no more.
QUIET: Settings = {
    name: {"on": False}
    for name in ("amplifier_lag", "initiation_stage", "range_dependence", "direction_asymmetry",
                 "creep", "resonance", "white_noise", "one_over_f_noise", "ar_noise")
}  # fmt: skip


def merged(tables: Sequence[Settings]) -> Settings:
    """Nested tables laid over each other; later ones win."""
    out: Settings = {}
    for table in tables:
        for key, value in table.items():
            old = out.get(key)
            nested = isinstance(value, dict) and isinstance(old, dict)
            out[key] = merged([old, value]) if nested else value  # type: ignore[list-item]
    return out


def body(rng: Rng) -> Settings:
    """An actuator of its own: travel, share and reach of the hysteresis, curvature."""
    curved = rng.uniform() < 0.4
    return {
        "stack": {
            "reversible": float(rng.uniform(0.075, 0.105)),
            "curvature": float(rng.uniform(-1.0, 1.0) * 1.5e-4) if curved else 0.0,
            "irreversible": float(rng.uniform(1.5e-3, 2.5e-3)),
            "edge": float(rng.uniform(22.0, 36.0)),
            "width": float(rng.uniform(2.0, 6.0)),
            "branch": float(rng.uniform(2.0, 4.0)),
        }
    }
