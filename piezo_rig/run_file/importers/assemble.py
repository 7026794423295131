"""From files to sweeps: calibration, zero, history and one clock for all.

Everything that a file does not say and the user did not say either is assumed here,
once, and written down as a sentence.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.conditions import Conditions
from piezo_rig.run_file.importers.csv_text import read_csv
from piezo_rig.run_file.importers.damage import compare_span, saturation
from piezo_rig.run_file.importers.file_name import NameSays, distinct_names, parse_name
from piezo_rig.run_file.importers.guards import advised
from piezo_rig.run_file.importers.lvm import read_lvm
from piezo_rig.run_file.importers.mat import read_mat
from piezo_rig.run_file.importers.options import (
    DISPLACEMENT,
    DRIVE,
    SWITCH_UM_PER_V,
    Imported,
    ImportOptions,
    parse_sensitivity,
)
from piezo_rig.run_file.importers.said import Said
from piezo_rig.run_file.importers.sentences import Sentences
from piezo_rig.run_file.importers.tdms import read_tdms
from piezo_rig.run_file.importers.timing import timing_of
from piezo_rig.run_file.importers.traces import Trace, joined, traces_of
from piezo_rig.run_file.sweep import Sweep

_READERS = {".lvm": read_lvm, ".tdms": read_tdms, ".csv": read_csv, ".mat": read_mat}
DEFAULT_POLARITY = -1


def read_recordings(
    paths: Sequence[str | Path],
    options: ImportOptions | None = None,
    require: Collection[str] = (DRIVE, DISPLACEMENT),
) -> Imported:
    """Recordings that this program never made, as sweeps of origin IMPORTED.

    Parameters
    ----------
    paths : .lvm, .tdms and .csv files; given together they share one clock
    options : what the user said; None for nothing
    require : what every recording must hold, ``("drive", "displacement")``; with only one
        of them the other may be missing, and its volts are then NaN

    Raises
    ------
    InputError : exit status 2, naming file, line or sample
    """
    options = options or ImportOptions()
    if not paths:
        raise InputError("import-file", "no recording was given", remedy="name at least one file")
    names = distinct_names([Path(given) for given in paths])
    told, warned = Sentences(names), Sentences(names)
    sweeps: list[Sweep] = []
    clocks: dict[str, str] = {}
    said: list[Said | None] = []
    conditions = Conditions(told, warned)
    for given in paths:
        path = Path(given)
        with advised():
            traces = _read(path, options, require, told, warned)
        says = parse_name(path.stem)
        for part, trace in enumerate(traces, start=1):
            part_of = part if len(traces) > 1 and trace.said is None else 0
            sweep = _sweep(path, trace, says, part_of, options, require, told, warned)
            stated = trace.said is not None
            sweeps.append(conditions.numbered(sweep, len(sweeps) + 1, stated))
            clocks.setdefault(trace.clock, names[path])
            said.append(trace.said)
    sweeps = _with_history(sweeps, said, options, told, warned)
    _compare_clocks(sweeps, clocks, warned)
    earliest = min(sweep.start_time for sweep in sweeps)
    return Imported(
        sweeps=sweeps,
        assumptions=told.lines(),
        warnings=warned.lines(),
        offsets_s=[sweep.start_time - earliest for sweep in sweeps],
    )


def _read(
    path: Path,
    options: ImportOptions,
    require: Collection[str],
    told: Sentences,
    warned: Sentences,
) -> list[Trace]:
    reader = _READERS.get(path.suffix.lower())
    if path.is_dir():
        raise InputError(
            "import-file",
            f"{path}: is a folder, not a recording",
            cause="recordings of one analysis are given one by one",
            remedy=f"give {path}/*.lvm or the like for one analysis of all; a folder as output, "
            "with a / at its end, for one analysis of each",
        )
    if reader is None:
        raise InputError(
            "import-file",
            f"{path}: is not a recording that can be read",
            cause=f"its extension is {path.suffix[:20]!r}; a recording is .lvm, .tdms or .csv",
            remedy="export it as .csv with the header time_s,drive_v,displacement_um",
        )
    traces: list[Trace] = []
    for recording in reader(path):
        told.add(path, recording.notes)
        warned.add(path, recording.warnings)
        traces += traces_of(recording, options, require)
    whole = joined(path, traces)
    if len(whole) > 1 and whole[0].said is None:
        warned.add(
            path,
            [f"holds {len(whole)} parts that do not follow each other in time; each is a sweep"],
        )
    for trace in whole:
        told.add(path, trace.assumed)
        warned.add(path, trace.warnings)
    return whole


@dataclass(frozen=True)
class _Calibration:
    gain: float = 1.0
    offset_v: float = 0.0
    sensitivity_um_per_v: float = 1.0
    polarity: int = 1


def _sweep(
    path: Path,
    trace: Trace,
    says: NameSays,
    part: int,
    options: ImportOptions,
    require: Collection[str],
    told: Sentences,
    warned: Sentences,
) -> Sweep:
    if trace.even_step_s is not None:
        rate, times = 1 / trace.even_step_s, None
    else:
        timing = timing_of(trace.times_s, trace.declared_step_s, str(path))
        told.add(path, timing.notes)
        warned.add(path, timing.warnings)
        rate, times = timing.sample_rate, timing.sample_times_s
    told.add(path, [f"{rate:.10g} samples/s, {trace.rate_from}"])
    calibration = _calibrate(path, trace, says, options, require, told, warned)
    missing = np.full(trace.samples, np.nan)
    sensor = trace.sensor if trace.sensor is not None else missing
    if trace.is_displacement or trace.sensor is None:
        zero = 0.0
    else:
        zero = float(sensor[0])
        if trace.said is None:
            told.add(path, ["displacement is counted from the sensor's first sample"])
    said = trace.said
    if said is not None:
        told.add(path, [said.sentence()])
        if trace.sensor is not None and not trace.is_displacement:
            zero = said.zero_v
    span = says.span_v if part == 0 and said is None else None
    if trace.command is not None:
        drive = calibration.gain * trace.command + calibration.offset_v
        if trace.sensor is not None:
            warned.add(path, saturation(drive, sensor, trace.where))
        warned.add(path, compare_span(drive, span))
    return Sweep(
        name="",
        command_v=trace.command if trace.command is not None else missing.copy(),
        sensor_v=sensor,
        sample_rate=rate,
        gain=calibration.gain,
        offset_v=calibration.offset_v,
        sensitivity_um_per_v=calibration.sensitivity_um_per_v,
        polarity=calibration.polarity,
        zero_v=zero,
        condition=_condition(says, said, part),
        repeat=said.repeat if said else says.repeat or 1,
        history=said.history if said and not options.given("history") else options.history,
        start_time=trace.start_s,
        origin="IMPORTED",
        drive_monitor_v=trace.monitor,
        sample_times_s=times,
        source=f"{told.name(path)} part {part}" if part else told.name(path),
        details={
            "as_given_drive": trace.is_drive, "as_given_displacement": trace.is_displacement,
            **(said.details if said else {}),
        },
    )


def _condition(says: NameSays, said: Said | None, part: int) -> str:
    name = said.condition if said else says.condition
    return f"{name} part {part}" if part else name


def _calibrate(
    path: Path,
    trace: Trace,
    says: NameSays,
    options: ImportOptions,
    require: Collection[str],
    told: Sentences,
    warned: Sentences,
) -> _Calibration:
    """What turns the recorded numbers into volts on the stack and micrometres."""
    calibration = _Calibration()
    said = trace.said
    if trace.is_drive:
        words = (("gain", "gain"), ("offset", "offset_v"))
        ignored = [word for word, name in words if options.given(name)]
        if ignored:
            warned.add(
                path,
                [f"the {' and '.join(ignored)} given was ignored: drive_v is taken as it is"],
            )
        told.add(path, ["drive_v is volts on the actuator and taken as it is"])
    elif trace.command is not None:
        stated = said is not None
        calibration = replace(
            calibration,
            gain=said.gain if said and not options.given("gain") else options.gain,
            offset_v=said.offset_v if said and not options.given("offset_v") else options.offset_v,
        )
        if not options.given("gain") and not stated:
            told.add(path, [f"gain {options.gain:g} (drive volts per volt of command)"])
        if not options.given("offset_v") and not stated:
            told.add(path, [f"offset {options.offset_v:g} V (drive at 0 V of command)"])
    if trace.monitor is not None:
        told.add(path, ["the drive monitor is volts on the actuator and taken as it is"])
    if trace.is_displacement:
        if options.given("sensitivity"):
            warned.add(path, ["the sensitivity given was ignored: displacement_um is micrometres"])
        if options.given("polarity") and options.polarity == -1:
            told.add(path, ["displacement_um is micrometres, its sign turned by --polarity -1"])
            return replace(calibration, polarity=-1)
        told.add(path, ["displacement_um is micrometres and taken as it is"])
        return calibration
    if trace.sensor is None:
        return calibration
    polarity = options.polarity
    if polarity is None and said is not None:
        polarity = said.polarity
    if polarity is None:
        polarity = DEFAULT_POLARITY
        told.add(path, [f"polarity {polarity:+d} (a falling sensor voltage is extension)"])
    if said is not None and options.sensitivity is None:
        return replace(
            calibration, polarity=polarity, sensitivity_um_per_v=said.sensitivity_um_per_v
        )
    sensitivity = _sensitivity(path, says, options, DISPLACEMENT in require, told, warned)
    return replace(calibration, polarity=polarity, sensitivity_um_per_v=sensitivity)


def _sensitivity(
    path: Path,
    says: NameSays,
    options: ImportOptions,
    needed: bool,
    told: Sentences,
    warned: Sentences,
) -> float:
    """Micrometres per volt: as given, else as the file's name says, else an error."""
    named = says.switch
    if named is not None and named >= len(SWITCH_UM_PER_V):
        warned.add(path, [f"its name says sense{named}, which the switch (0 to 6) has not"])
        named = None
    if options.sensitivity is not None:
        value, switch = parse_sensitivity(options.sensitivity)
        if switch is not None:
            told.add(
                path, [f"sensitivity switch {switch} is {value:g} um/V, by the printed table"]
            )
        if named is not None and SWITCH_UM_PER_V[named] != value:
            warned.add(
                path,
                [
                    f"its name says sensitivity switch {named} ({SWITCH_UM_PER_V[named]:g} um/V), "
                    f"but {options.sensitivity.strip()} was given: {value:g} um/V is used"
                ],
            )
        return value
    if named is not None:
        told.add(
            path,
            [
                f"sensitivity {SWITCH_UM_PER_V[named]:g} um/V: its name says switch {named}, "
                "by the printed table"
            ],
        )
        return SWITCH_UM_PER_V[named]
    if not needed:
        return 1.0
    raise InputError(
        "import-sensitivity",
        f"{path}: its sensitivity is not known",
        cause="the sensor is in volts, and neither an option nor the file's name says how many "
        "micrometres a volt is",
        remedy="give --sensitivity 3 (the switch, 0 to 6) or --sensitivity 3.87um/V; for an "
        "uncalibrated sensor --sensitivity 1um/V",
    )


def _with_history(
    sweeps: list[Sweep], said: Sequence[Said | None], options: ImportOptions, told: Sentences,
    warned: Sentences,
) -> list[Sweep]:
    """History as given, else as stated; carried by a user's word, the first zero is carried too."""
    if not options.given("history"):
        sweeps = _as_stated(sweeps, said, warned)
    if options.history != "carried":
        if not options.given("history") and None in said:
            told.add("", [f"history {options.history} (what the actuator remembers at the start)"])
        return sweeps
    told.add(
        "", [f"{sweeps[0].source} is the first recording, so nothing carries into it: unknown"]
    )
    first = sweeps[0]
    carried = [first.with_(history="unknown")]
    for sweep in sweeps[1:]:
        if _scale(sweep) == _scale(first):
            sweep = sweep.with_(zero_v=first.zero_v)
        else:
            warned.add(
                sweep.source,
                [
                    "its calibration differs from the first recording's, so its "
                    "zero is its own although history is carried"
                ],
            )
        carried.append(sweep)
    return carried


def _as_stated(
    sweeps: list[Sweep], said: Sequence[Said | None], warned: Sentences
) -> list[Sweep]:
    """A history that is carried, from a sweep that does not stand before it, is unknown."""
    out: list[Sweep] = []
    before: Said | None = None
    for sweep, own in zip(sweeps, said, strict=True):
        stands = before and own and (before.run, before.sweep) == (own.run, own.follows)
        if own and sweep.history == "carried" and not stands:
            warned.add(sweep.source, [
                f"carries the history of {own.follows or 'another sweep'}, which was not "
                "given before it: its history is unknown"
            ])
            sweep = sweep.with_(history="unknown")
        out.append(sweep)
        before = own
    return out


def _scale(sweep: Sweep) -> tuple[float, int, object]:
    details = sweep.details["as_given_displacement"]
    return sweep.sensitivity_um_per_v, sweep.polarity, details


def _compare_clocks(sweeps: list[Sweep], clocks: dict[str, str], warned: Sentences) -> None:
    """Say where recordings that are given together cannot have one clock."""
    if len(sweeps) < 2:
        return
    if len(clocks) > 1:
        kinds = "; ".join(f"{file} by {clock}" for clock, file in clocks.items())
        warned.add("", [f"the recordings do not share one clock: {kinds}"])
        return
    ordered = sorted(sweeps, key=lambda sweep: sweep.start_time)
    overlapping = []
    for earlier, later in pairwise(ordered):
        if later.start_time < earlier.start_time + earlier.time_s[-1] - 0.5 / earlier.sample_rate:
            overlapping.append((earlier, later))
    if overlapping:
        a, b = overlapping[0]
        more = f" ({len(overlapping)} such pairs)" if len(overlapping) > 1 else ""
        warned.add(
            "",
            [
                f"{b.source} begins before {a.source} ends{more}: by their times the recordings "
                "overlap, so what happened between them cannot be told"
            ],
        )
    elif [sweep.name for sweep in ordered] != [sweep.name for sweep in sweeps]:
        given = [str(sweep.source) for sweep in sweeps]
        if len(set(given)) > 1 and given == sorted(given):
            return  # as a pattern gives them, by name: nobody meant an order
        warned.add("", ["the recordings were not given in the order of their times"])
