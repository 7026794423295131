"""What the displacement of a sweep is uncertain by, part by part.

Source: JCGM 100:2008 (GUM), sections 4.3 (rectangular distributions) and 5.1.2 (parts that do not
depend on one another add in squares). A part is *random* when it differs from sample to sample, a
*scale* when it grows with the displacement and is the same for all samples, an *offset* when it
shifts a sweep as a whole. Averaging over repeats lowers the random parts only.

The budget is computed from what the run recorded; it is stored nowhere.
"""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_rig.config.calibration import InterferometerCalibration, interferometer_of, parts_of
from piezo_rig.config.environment import Environment, environment_of
from piezo_rig.config.toml_text import Document
from piezo_rig.errors import InputError
from piezo_rig.run_file.air import per_hpa, per_kelvin
from piezo_rig.run_file.sweep import Sweep

SCALE, OFFSET, RANDOM = "scale", "offset", "random"
_TO_SIGMA = 1.4826  # of the median of absolute deviations, for a normal distribution


@dataclass(frozen=True)
class Part:
    """One source of uncertainty.

    Attributes
    ----------
    name : what it is
    kind : ``scale``, ``offset`` or ``random``
    value : standard uncertainty; relative for a scale, nm else
    source : where the figure is from
    """

    name: str
    kind: str
    value: float
    source: str


@dataclass(frozen=True)
class DisplacementBudget:
    """Standard uncertainty of displacement; ``left_out`` says what is not known and not in it."""

    parts: tuple[Part, ...]
    left_out: tuple[str, ...] = ()

    def _sum(self, kind: str) -> float:
        return math.hypot(*(p.value for p in self.parts if p.kind == kind))

    @property
    def scale(self) -> float:
        """Relative, common to all samples of all sweeps at this sensitivity."""
        return self._sum(SCALE)

    @property
    def offset_nm(self) -> float:
        """Common to the samples of a sweep, nm."""
        return self._sum(OFFSET)

    @property
    def random_nm(self) -> float:
        """Of every sample by itself, nm."""
        return self._sum(RANDOM)

    def systematic_um(self, displacement_um: ArrayLike) -> NDArray[np.float64]:
        """What averaging does not lower: scale and offset, um, in the shape given."""
        x = np.asarray(displacement_um, float)
        return np.hypot(self.scale * x, 1e-3 * self.offset_nm)

    def u_um(self, displacement_um: ArrayLike) -> NDArray[np.float64]:
        """Combined standard uncertainty of every displacement, um, in the shape given."""
        return np.hypot(self.systematic_um(displacement_um), 1e-3 * self.random_nm)


@dataclass(frozen=True)
class _Setup:
    """What a run says of its sensor, digitizer and air; None where it does not."""

    calibration: InterferometerCalibration | None
    switch: int
    range_v: float
    environment: Environment


def budget_of(sweep: Sweep, texts: dict[str, str]) -> DisplacementBudget:
    """The budget of a sweep's displacement.

    Parameters
    ----------
    sweep : with its raw volts
    texts : of the run that it is from, as in ``Run.texts``; empty for a recording
    """
    setup = _setup(texts)
    parts: list[Part] = []
    left_out: list[str] = []
    stated = setup.calibration
    if stated is not None and not _is_of(stated, setup.switch, sweep):
        stated = None
    _add_scale(sweep, stated, setup.switch, parts, left_out)
    factor = float(sweep.sensitivity_um_per_v) * 1e3  # nm per V
    if stated is None or math.isnan(stated.noise_nm):
        parts.append(Part("noise", RANDOM, factor * _scatter_v(sweep.sensor_v),
                          "second differences of the sweep; slow noise is not in it"))
    else:
        parts.append(Part("noise", RANDOM, stated.noise_nm, "calibration: rms within 1 s at rest"))
    if stated is None or math.isnan(stated.output_noise_v):
        left_out.append("no calibration states the noise of the sensor's analog output "
                        "(output_noise_v)")
    else:
        parts.append(Part("analog output", RANDOM, factor * stated.output_noise_v,
                          "calibration: quantisation of the sensor's output"))
    if math.isnan(setup.range_v):
        step_v, source = _step_v(sweep.sensor_v), "smallest step in the recording"
    else:
        step_v, source = 2 * setup.range_v / 65_536, f"16 bit over +-{setup.range_v:g} V"
    parts.append(Part("quantisation", RANDOM, factor * step_v / math.sqrt(12), source))
    random_nm = math.hypot(*(p.value for p in parts if p.kind == RANDOM))
    parts.append(Part("zero", OFFSET, random_nm, "the sweep's zero is one sample"))
    _add_dead_path(setup.environment, parts, left_out)
    return DisplacementBudget(tuple(parts), tuple(left_out))


def _is_of(calibration: InterferometerCalibration, switch: int, sweep: Sweep) -> bool:
    table = calibration.sensitivities_um_per_v
    return 0 <= switch < len(table) and math.isclose(
        table[switch], sweep.sensitivity_um_per_v, rel_tol=1e-4
    )


def _add_scale(
    sweep: Sweep, stated: InterferometerCalibration | None, switch: int, parts: list[Part],
    left_out: list[str],
) -> None:
    value = sweep.sensitivity_um_per_v
    if stated is not None and not math.isnan(stated.sensitivities_u_um_per_v[switch]):
        measured = stated.sensitivities_u_um_per_v[switch] / value
        parts.append(Part("sensitivity", SCALE, measured, f"calibrated {stated.date}".rstrip()))
    elif stated is not None and stated.table == "printed":
        half = 0.5 * 10.0 ** -len(f"{value!r}".partition(".")[2])
        parts.append(Part("sensitivity", SCALE, half / value / math.sqrt(3),
                          "rounding of the printed value only"))
        left_out.append("the sensitivity itself was not measured ('piezo-rig calibrate')")
    else:
        left_out.append(f"nothing is known of how well {value:g} um/V holds")


def _add_dead_path(air: Environment, parts: list[Part], left_out: list[str]) -> None:
    """Air that changes between the beam splitter and the stack looks like displacement."""
    if not air.has_dead_path:
        left_out.append("dead path and air were not logged ([environment] in the rig's config)")
        return
    state = (_or(air.temperature_c, 20.0), _or(air.pressure_hpa, 1013.25),
             _or(air.humidity_percent, 50.0))
    for name, slope, u, unit in (
        ("temperature", per_kelvin(*state), air.temperature_u_k, "K"),
        ("pressure", per_hpa(*state), air.pressure_u_hpa, "hPa"),
    ):
        each = abs(slope) * air.dead_path_mm * 1e6  # nm per unit
        if math.isnan(u):
            left_out.append(f"{air.dead_path_mm:g} mm of dead path are {each:.3g} nm per {unit}, "
                            f"but no change of {name} was logged")
        else:
            parts.append(Part(f"dead path, {name}", OFFSET, each * u,
                              f"{air.dead_path_mm:g} mm, {each:.3g} nm per {unit}, {u:g} {unit}"))


def _or(value: float, default: float) -> float:
    return default if math.isnan(value) else value


def _scatter_v(volts: NDArray[np.float64]) -> float:
    """Rms of white noise on a smooth curve: its second differences are sqrt(6) times as large."""
    second = np.diff(volts[np.isfinite(volts)], 2)
    if not second.size:
        return 0.0
    return float(_TO_SIGMA * np.median(np.abs(second - np.median(second))) / math.sqrt(6.0))


def _step_v(volts: NDArray[np.float64]) -> float:
    """The smallest difference between two samples that are not the same, V."""
    levels = np.unique(np.round(volts[np.isfinite(volts)], 9))
    return float(np.diff(levels).min()) if levels.size > 1 else 0.0


def _setup(texts: dict[str, str]) -> _Setup:
    """What the run recorded; what cannot be read is not known."""
    rig = _parsed(texts.get("rig_config", ""))
    sensor, digitizer = _table(rig, "interferometer"), _table(rig, "digitizer")
    calibration = None
    try:
        for text in json.loads(texts.get("calibration_texts", "{}")).values():
            if "interferometer" in parts_of(_parsed(text)):
                calibration = interferometer_of(
                    Document(text, "calibration", "calibration"),
                    str(sensor.get("sensitivity_table", "printed")),
                )
    except (ValueError, AttributeError, TypeError, KeyError, RecursionError, InputError):
        calibration = None
    try:
        root = Document(texts.get("rig_config", ""), "rig_config", "config").root()
        air = environment_of(root.table("environment", required=False))
    except InputError:
        air = Environment()
    switch, range_v = sensor.get("sensitivity"), digitizer.get("sensor_range_v", 1.0)
    known = bool(rig) and isinstance(range_v, int | float)
    return _Setup(
        calibration, switch if isinstance(switch, int) else -1,
        float(range_v) if known else float("nan"), air,
    )


def _parsed(text: Any) -> dict[str, Any]:
    try:
        return tomllib.loads(text[:100_000])
    except (ValueError, TypeError, RecursionError):
        return {}


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    found = data.get(key)
    return found if isinstance(found, dict) else {}
