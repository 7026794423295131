"""What a run was played with, built again from the run alone."""

from __future__ import annotations

import json
import re
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from piezo_rig.bench import Bench
from piezo_rig.config import Rig, load_rig
from piezo_rig.config.calibration import parts_of
from piezo_rig.errors import InputError, PiezoRigError
from piezo_rig.protocol import Plan, build_plan
from piezo_rig.protocol.drive_file import unpack
from piezo_rig.protocol.protocol_file import recorded_protocol
from piezo_rig.replay.tape import Comparison, TapeKeeper, TapeTransport
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.transcript import INSTRUMENTS, WireRecord

_HEADER = re.compile(r"^\s*\[+\s*([^\]\s]+)\s*\]+")
_CALIBRATION = re.compile(r"^\s*calibration\s*=")


def plan_of(run: Run) -> Plan:
    """The plan that a run was played from.

    Raises
    ------
    InputError : (replay) the run does not hold it, or this version does not understand it
    """
    for key in ("protocol_text", "rig_config"):
        if not run.texts.get(key):
            raise _cannot(run, f"holds no {key}")
    with tempfile.TemporaryDirectory(prefix="piezo-rig-") as folder:
        config = Path(folder) / "rig.toml"
        files = _calibration_files(run, Path(folder))
        config.write_text(_with_calibrations(run.texts["rig_config"], files), encoding="utf-8")
        try:
            rig = load_rig(str(config))
            played = unpack(run.texts.get("protocol_files", ""), str(run.path))
            protocol = recorded_protocol(run.texts["protocol_text"], "protocol", played)
            return build_plan(protocol, rig)
        except PiezoRigError as error:
            raise _cannot(run, f"its plan cannot be made again: {error.what}") from None


def _cannot(run: Run, why: str) -> InputError:
    return InputError(
        "replay", f"{run.path}: {why}",
        "the run is of an early version, was imported, or is damaged",
        "check it with 'piezo-rig verify'",
    )


def _calibration_files(run: Run, folder: Path) -> dict[str, Path]:
    """Instrument -> a file with the calibration that the run used."""
    try:
        texts = list(json.loads(run.texts.get("calibration_texts", "{}")).values())
        if not all(isinstance(text, str) for text in texts):
            raise ValueError
    except (ValueError, AttributeError, RecursionError):
        raise _cannot(run, "its calibrations cannot be read") from None
    files: dict[str, Path] = {}
    for number, text in enumerate(texts or _told_by_sweeps(run)):
        place = folder / f"calibration_{number}.toml"
        place.write_text(text, encoding="utf-8")
        try:
            files |= dict.fromkeys(parts_of(tomllib.loads(text)), place)
        except (ValueError, RecursionError):
            raise _cannot(run, "its calibrations cannot be read") from None
    for instrument in ("amplifier", "interferometer"):
        if instrument not in files:
            raise _cannot(run, f"holds no calibration of the {instrument}")
    return files


def _told_by_sweeps(run: Run) -> list[str]:
    """The calibrations of a run of an early version, which holds none: as its sweeps tell them."""
    if not run.sweep_names:
        raise _cannot(run, "holds neither calibrations nor sweeps")
    (sweep,) = run.sweeps(run.sweep_names[:1])
    table = [sweep.sensitivity_um_per_v] * 7
    schema = 'schema = "piezo-rig/calibration/1"\n'
    return [
        f'{schema}instrument = "amplifier"\ngain = {sweep.gain!r}\noffset_v = {sweep.offset_v!r}\n',
        f'{schema}instrument = "interferometer"\nprinted_um_per_v = {table}\n'
        f"exact_um_per_v = {table}\n",
    ]


def _with_calibrations(text: str, files: Mapping[str, Path]) -> str:
    """The rig's config with its calibrations taken from ``files``."""
    lines = []
    table = ""
    for line in text.splitlines():
        header = _HEADER.match(line)
        if header:
            table = header.group(1)
        if table in files and _CALIBRATION.match(line):
            continue
        lines.append(line)
        if header and table in files:
            lines.append(f"calibration = {json.dumps(str(files[table]))}")
    return "\n".join(lines) + "\n"


def past_bench(
    rig: Rig, records: Sequence[WireRecord], comparison: Comparison
) -> tuple[Bench, list[TapeTransport]]:
    """The bench of a session, its instruments played from a recording."""
    from drivers.interferometer import SiosSPS120
    from drivers.kinds import make_amplifier, make_dac, make_digitizer

    links = {
        "waveform_dac": rig.waveform_dac, "digitizer": rig.digitizer.link,
        "amplifier": rig.amplifier,
    }
    tapes = {
        name: TapeTransport(
            name, [r for r in records if r.instrument == name], comparison, links[name].timeout_s
        )
        for name in INSTRUMENTS if name in links
    }
    clock = comparison.clock
    amplifier = make_amplifier(
        rig.amplifier.driver, lambda: tapes["amplifier"], rig.set_voltage_v,
        rig.limits.drive_max_v, rig.amplifier.serial,
    )
    dac = make_dac(rig.waveform_dac.driver, tapes["waveform_dac"], clock)
    bench = Bench(
        rig, clock, dac, make_digitizer(
            rig.digitizer.link.driver, tapes["digitizer"], dac, clock, rig.digitizer.link.address,
            rig.digitizer.sensor_channel,
        ), amplifier,
        SiosSPS120(
            lambda question: True,  # the operator has answered then
            rig.interferometer_calibration.sensitivities_um_per_v, rig.interferometer.serial,
        ),
        TapeKeeper(tapes["waveform_dac"]),
    )
    return bench, list(tapes.values())
