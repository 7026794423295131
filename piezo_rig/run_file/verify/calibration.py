"""What turns volts into physics, against everything that the run recorded about it."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from piezo_rig.config.calibration import parts_of
from piezo_rig.errors import InputError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify.verdict import Verdict

_SET_VOLTAGE_V = 0.3  # an amplifier tells tenths of a volt
_NUMBER = re.compile(r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
SIMULATED_PREFIX = "SIM"
LARGEST_V = 256.0  # the largest range that any digitizer here has


@dataclass(frozen=True)
class Recorded:
    """What a run knows of its own calibration; None where it does not say.

    ``sources`` names where each expected value stands, for messages.
    """

    expected: dict[str, float] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    serials: dict[str, str] = field(default_factory=dict)
    command_limits_v: tuple[float, float] = (-10.0, 10.0)
    sensor_range_v: float = LARGEST_V
    monitor_range_v: float = LARGEST_V
    monitor_wired: bool = False
    travel_um_per_v: float = 0.15
    set_voltage_v: float = math.nan
    problems: tuple[str, ...] = ()

    @classmethod
    def of(cls, run: Run) -> Recorded:
        """Gather it from the calibrations, the rig's config and the instruments' settings."""
        if run.origin == "IMPORTED":
            return cls()
        problems: list[str] = []
        rig = _toml(run.texts.get("rig_config", ""))
        if rig is None:
            problems.append("rig_config is not a rig's config")
            rig = {}
        try:
            instruments = run.instruments()
        except InputError as error:
            problems.append(f"instrument: {error.what}")
            instruments = {}
        settings = {name: said["settings"] for name, said in instruments.items()}
        expected: dict[str, float] = {}
        sources: dict[str, str] = {}

        def expect(key: str, value: Any, source: str) -> None:
            if isinstance(value, int | float) and not isinstance(value, bool):
                expected.setdefault(key, float(value))
                sources.setdefault(key, source)

        sensor = _table(rig, "interferometer")
        polarity, set_voltage_v = -1, None
        for calibration in _calibrations(run, problems):
            parts = parts_of(calibration)
            amplifier = parts.get("amplifier", {})
            expect("gain", amplifier.get("gain"), "the amplifier's calibration")
            expect("offset_v", amplifier.get("offset_v"), "the amplifier's calibration")
            set_voltage_v = amplifier.get("set_voltage_v", set_voltage_v)
            beam = parts.get("interferometer", {})
            polarity = beam.get("polarity", polarity)
            expect("sensitivity_um_per_v", _sensitivity(beam, sensor),
                   "the interferometer's calibration")
        for key, name, query in (
            ("sensitivity_um_per_v", "interferometer", "sensitivity_um_per_v"),
            ("sample_rate", "waveform_dac", "SOUR1:FUNC:ARB:SRAT?"),
            ("sample_rate", "waveform_dac", "AO:RATE?"),
            ("measured_rate", "digitizer", "CONF:ACQ:SRAT?"),
            ("set_voltage", "amplifier", "xvoltage?"),
            ("set_voltage", "amplifier", "set_voltage_v"),
        ):
            expect(key, _number(settings.get(name, {}).get(query, "")), f"the {name}'s settings")
        setup = _table(rig, "digitizer")
        if rig:
            expect("polarity", sensor.get("polarity", polarity), "the rig's config")
            expect("oversampling", setup.get("oversampling", 1), "the rig's config")
        monitor = setup.get("monitor_channel", 1)
        ranges = {
            channel: _number(settings.get("digitizer", {}).get(f"CONF:CHAN:RANG? (@{channel})", ""))
            for channel in (monitor, setup.get("sensor_channel", 2))
        }
        dac = _table(rig, "waveform_dac")
        return cls(
            expected=expected, sources=sources,
            serials={n: str(said.get("serial", "")) for n, said in instruments.items()},
            command_limits_v=(
                _within(dac.get("command_min_v"), -10.0), _within(dac.get("command_max_v"), 0.0),
            ) if rig else (-LARGEST_V, LARGEST_V),
            sensor_range_v=ranges.get(setup.get("sensor_channel", 2)) or LARGEST_V,
            monitor_range_v=ranges.get(monitor) or LARGEST_V,
            monitor_wired="digitizer" in rig and monitor != 0,
            travel_um_per_v=_within(_table(rig, "actuator").get("travel_um_per_v"), 0.15),
            set_voltage_v=_within(set_voltage_v, math.nan),
            problems=tuple(problems),
        )


def _sensitivity(beam: dict[str, Any], sensor: dict[str, Any]) -> Any:
    """What a calibration says of the rig's switch; None where it says nothing."""
    switch, table = sensor.get("sensitivity"), beam.get(
        f"{sensor.get('sensitivity_table', 'printed')}_um_per_v"
    )
    measured = beam.get("measured", [])
    for one in measured if isinstance(measured, list) else []:
        if isinstance(one, dict) and one.get("switch") == switch:
            return one.get("sensitivity_um_per_v")
    if isinstance(table, list) and isinstance(switch, int) and 0 <= switch < len(table):
        return table[switch]
    return None


def _toml(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text[:100_000])
    except (ValueError, RecursionError):
        return None


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    found = data.get(key)
    return found if isinstance(found, dict) else {}


def _within(value: Any, default: float) -> float:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6
    return float(value) if usable else default


def _number(answer: str) -> float | None:
    """The number in an instrument's answer, as in ``[  75.0]``."""
    found = _NUMBER.search(answer[:100])
    return float(found.group()) if found else None


def _calibrations(run: Run, problems: list[str]) -> list[dict[str, Any]]:
    """The calibration files as the run holds them, with their hashes made sure of."""
    if "calibration_texts" not in run.texts:
        return []  # a run of an earlier version
    try:
        texts = json.loads(run.texts["calibration_texts"])
        hashes = json.loads(run.texts.get("calibrations", "{}"))
        if not isinstance(texts, dict) or not isinstance(hashes, dict):
            raise ValueError
    except (ValueError, RecursionError):
        problems.append("the calibrations cannot be read")
        return []
    found = []
    for path, text in texts.items():
        if not isinstance(text, str) or (
            hashlib.sha256(text.encode(errors="replace")).hexdigest() != hashes.get(path)
        ):
            problems.append(f"the calibration {path} is not the one whose hash was recorded")
        parsed = _toml(text) if isinstance(text, str) else None
        if parsed is None:
            problems.append(f"the calibration {path} is no calibration file")
        else:
            found.append(parsed)
    return found


def check_calibration(
    a: dict[str, Any], recorded: Recorded, origin: str
) -> list[tuple[bool, str]]:
    """A sweep's attributes against what the run recorded of its calibration."""
    problems: list[tuple[bool, str]] = []
    if a["origin"] != origin:
        problems.append((True, f"origin {a['origin']} in a run of origin {origin}"))
    if not a["gain"] > 0:
        problems.append((True, f"gain is {a['gain']:g}"))
    simulated = [s.upper().startswith(SIMULATED_PREFIX) for s in recorded.serials.values() if s]
    if simulated and a["origin"] != ("SIMULATED" if any(simulated) else "REAL"):
        serials = ", ".join(s for s in recorded.serials.values() if s)
        problems.append((
            True, f"origin {a['origin']}, but the instruments' serial numbers are {serials}",
        ))
    values = {**a, "measured_rate": a["sample_rate"] * a["oversampling"]}
    for key, expected in recorded.expected.items():
        value = float(values["offset_v" if key == "set_voltage" else key])
        if key == "set_voltage" and not math.isnan(recorded.set_voltage_v):
            value = recorded.set_voltage_v
        slack = _SET_VOLTAGE_V if key == "set_voltage" else 1e-6 * abs(expected)
        if key == "sensitivity_um_per_v":
            slack = 1e-4 * abs(expected)  # settings tell it to six figures
        if abs(value - expected) > slack:
            name = {"set_voltage": "offset_v", "measured_rate": "sample_rate x oversampling"}
            problems.append((
                True, f"{name.get(key, key)} is {value:.8g}, {recorded.sources[key]} says "
                f"{expected:.8g}",
            ))
    return problems


def odd_ones_out(read: dict[str, dict[str, Any]]) -> list[Verdict]:
    """Sweeps of a run from the bench that differ from most in what is one for all.

    ``read`` holds the attributes of every sweep that has them, by name.
    """
    found: list[Verdict] = []
    if any(a["origin"] == "IMPORTED" for a in read.values()):
        return found
    for key in ("gain", "offset_v", "sensitivity_um_per_v", "polarity", "sample_rate",
                "oversampling"):
        counts = Counter(a[key] for a in read.values())
        if len(counts) < 2:
            continue
        usual, _ = counts.most_common(1)[0]
        found += [
            Verdict(name, True, f"{key} is {a[key]:g}, that of the other sweeps is {usual:g}")
            for name, a in read.items() if a[key] != usual
        ]
    return found
