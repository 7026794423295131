"""The chosen columns of a recording, checked sample by sample and placed in time."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.channels import Choice, choose
from piezo_rig.run_file.importers.options import DISPLACEMENT, DRIVE, ImportOptions
from piezo_rig.run_file.importers.recording import Recording, quoted
from piezo_rig.run_file.importers.said import Said
from piezo_rig.run_file.importers.timing import first_backward_step
from piezo_rig.run_file.sweep import FloatArray

MOST_PARTS = 5000
_ABSOLUTE_FROM_S = 1e9  # a later time counts from 1970 by itself
_LARGEST = 1e12  # no volts, micrometres or seconds of any bench
_CONTIGUOUS_WITHIN = 0.5  # steps

OWN_CLOCK, DATED, UNDATED = "time_s", "date and time", "times of its own, without a date"


@dataclass(frozen=True)
class Trace:
    """One uninterrupted stretch of recorded numbers, not yet calibrated.

    Attributes
    ----------
    times_s : shape (n,), relative to ``stamp_s``; where ``even_step_s`` is set, computed from it
    even_step_s : spacing that the file declares where it records no times, else None
    declared_step_s : spacing that the header gives beside recorded times, else None
    stamp_s : seconds since 1970, or 0 for a clock of its own
    clock : what places it among other recordings
    command, sensor, monitor : shape (n,), None where there is none
    where : words for the place of a sample
    continues : whether it goes on under the header of the stretch before it
    said : the settings that the file states of itself
    """

    times_s: FloatArray
    even_step_s: float | None
    declared_step_s: float | None
    stamp_s: float
    clock: str
    rate_from: str
    command: FloatArray | None
    sensor: FloatArray | None
    monitor: FloatArray | None
    is_drive: bool
    is_displacement: bool
    where: Callable[[int], str]
    continues: bool = False
    said: Said | None = None
    assumed: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def samples(self) -> int:
        return int(self.times_s.size)

    @property
    def start_s(self) -> float:
        return self.stamp_s + float(self.times_s[0])

    def part(self, start: int, stop: int) -> Trace:
        """The samples from start up to stop."""
        return replace(
            self,
            times_s=self.times_s[start:stop],
            command=_cut(self.command, start, stop),
            sensor=_cut(self.sensor, start, stop),
            monitor=_cut(self.monitor, start, stop),
            where=lambda sample: self.where(start + sample),
        )


def _cut(values: FloatArray | None, start: int, stop: int) -> FloatArray | None:
    return None if values is None else values[start:stop]


def traces_of(
    recording: Recording, options: ImportOptions, require: Collection[str]
) -> list[Trace]:
    """The traces of one recording: one, or more where blocks of it begin again in time.

    Raises
    ------
    InputError : channels that cannot be told, cells that are missing, times that run backwards
    """
    choice = choose(recording, options, require)
    if DISPLACEMENT not in require and not _sensor_is_usable(choice, options):
        choice.sensor = None
    if DRIVE not in require and choice.command is not None and not choice.is_drive:
        choice.command = None
    arrays = dict(zip(choice.taken(), recording.load(choice.taken()), strict=True))
    warnings = choice.warned + _trim(recording, choice, arrays)
    for index, values in arrays.items():
        _refuse_holes(recording, index, values)
    trace = _placed(recording, choice, arrays, warnings)
    parts = _split(recording, trace)
    for part in parts:
        if part.samples < 2:
            raise InputError(
                f"import-{recording.kind}",
                f"{recording.path}: holds {part.samples} sample at {part.where(0)}; "
                "a sweep needs two at least",
                cause="the recording was stopped at once, or the file was cut off",
            )
    return parts


def _sensor_is_usable(choice: Choice, options: ImportOptions) -> bool:
    return choice.is_displacement or options.sensitivity is not None


def _trim(recording: Recording, choice: Choice, arrays: dict[int, FloatArray]) -> list[str]:
    """Bring columns of unequal length to the shortest; a .csv has no such excuse."""
    if recording.kind == "csv":
        return []
    lengths = {}
    for index, values in arrays.items():
        filled = np.flatnonzero(~np.isnan(values[::-1]))
        lengths[index] = values.size - int(filled[0]) if filled.size else 0
    shortest, longest = min(lengths.values()), max(lengths.values())
    if shortest == 0:
        empty = next(index for index, length in lengths.items() if length == 0)
        raise InputError(
            f"import-{recording.kind}",
            f"{recording.path}: column {quoted(recording.columns[empty])} holds no numbers",
            remedy=f"choose another of {recording.listing()}",
        )
    if all(values.size == shortest for values in arrays.values()):
        return []
    for index in arrays:
        arrays[index] = arrays[index][:shortest]
    if shortest == longest:
        return [f"the last rows are empty; {shortest} samples are used"]
    short = next(index for index, length in lengths.items() if length == shortest)
    return [
        f"its channels have unequal lengths, {shortest} to {longest} samples; all were cut to "
        f"the {shortest} of {quoted(recording.columns[short])}"
    ]


def _refuse_holes(recording: Recording, index: int, values: FloatArray) -> None:
    with np.errstate(invalid="ignore"):
        wrong = np.flatnonzero(~(np.abs(values) < _LARGEST))
    if not wrong.size:
        return
    first = int(wrong[0])
    value = values[first]
    what = "empty or NaN" if np.isnan(value) else f"{value:.6g}"
    raise InputError(
        f"import-{recording.kind}",
        f"{recording.path}: {recording.where(first)}, column {quoted(recording.columns[index])} "
        f"is {what}"
        + _counted(recording, first)
        + (f" ({wrong.size} samples in all)" if wrong.size > 1 else ""),
        cause="the acquisition lost samples, or the file is damaged",
        remedy="cut the recording before that place, or record it again; nothing is filled in",
    )


def _counted(recording: Recording, sample: int) -> str:
    """The number of a sample, and of its segment, where its place in the file is a line."""
    of = f" of segment {recording.segment}" if recording.segment else ""
    return f" at sample {sample}{of}" if of or recording.where(sample) != f"sample {sample}" else ""


def _placed(
    recording: Recording, choice: Choice, arrays: dict[int, FloatArray], warnings: list[str]
) -> Trace:
    """The trace with its times: recorded ones, else those that the file declares."""
    lead = choice.command if choice.command is not None else choice.sensor
    if lead is None:
        raise InputError(
            "import-channel",
            f"{recording.path}: nothing was chosen from it",
            remedy=f"choose from {recording.listing()}",
        )
    column = recording.columns[lead]
    assumed = list(choice.assumed)
    even_step: float | None = None
    times: FloatArray
    if choice.time is not None:
        times = arrays[choice.time]
        rate_from = f"from the times in column {quoted(recording.columns[choice.time])}"
    elif column.step_s is not None and column.step_s > 0:
        even_step = column.step_s
        times = column.first_s + np.arange(arrays[lead].size, dtype=np.float64) * even_step
        rate_from = f"as the file declares for {quoted(column)}"
    else:
        raise InputError(
            "import-time",
            f"{recording.path}: says nowhere when its samples of {quoted(column)} were taken",
            cause="it has no time channel and declares "
            + (
                "no spacing (Delta_X, wf_increment)"
                if column.step_s is None
                else f"a spacing (Delta_X, wf_increment) of {column.step_s:g} s, which is none"
            ),
            remedy="choose a time channel with --time, or export it as .csv with time_s",
        )
    _compare_channels(recording, choice, lead, times, warnings)
    absolute = times[0] > _ABSOLUTE_FROM_S
    if recording.kind == "csv":
        stamp, clock = 0.0, OWN_CLOCK
        assumed.append("its place on the clock of recordings given together is its time_s")
    elif recording.said is not None:
        stamp, clock = column.stamp or 0.0, OWN_CLOCK
        assumed.append("its place on the clock is the start_time that it states")
    elif absolute or column.stamp is not None:
        stamp, clock = (0.0 if absolute else column.stamp or 0.0), DATED
        zone = "read as UTC" if recording.kind == "lvm" else "which is UTC"
        assumed.append(f"its place on the clock is its date and time, {zone}")
    else:
        stamp, clock = 0.0, UNDATED
        assumed.append("it has no date and time, so its clock begins at its own zero")
    return Trace(
        times_s=times,
        even_step_s=even_step,
        declared_step_s=column.step_s if (column.step_s or 0.0) > 0 else None,
        stamp_s=stamp,
        clock=clock,
        rate_from=rate_from,
        command=None if choice.command is None else arrays[choice.command],
        sensor=None if choice.sensor is None else arrays[choice.sensor],
        monitor=None if choice.monitor is None else arrays[choice.monitor],
        is_drive=choice.is_drive,
        is_displacement=choice.is_displacement,
        where=recording.where,
        continues=recording.continues,
        said=recording.said,
        assumed=assumed,
        warnings=warnings,
    )


def _compare_channels(
    recording: Recording, choice: Choice, lead: int, times: FloatArray, warnings: list[str]
) -> None:
    """Channels with times of their own must agree with the leading one's to within a sample."""
    reference = recording.columns[lead]
    if choice.time not in (None, reference.time_column):
        return  # the user has named the one time column that counts
    step = float(np.median(np.diff(times))) if times.size > 1 else 0.0
    for index in (choice.sensor, choice.monitor):
        if index is None or index == lead:
            continue
        other = recording.columns[index]
        if other.time_column not in (None, reference.time_column, choice.time):
            own = recording.load([other.time_column])[0][: times.size]
        elif choice.time is None and other.step_s is not None and other.step_s > 0:
            own = other.first_s + np.arange(times.size, dtype=np.float64) * other.step_s
        else:
            continue
        absolute = times[0] > _ABSOLUTE_FROM_S
        shift = 0.0 if absolute else (other.stamp or 0.0) - (reference.stamp or 0.0)
        if own.size < times.size or np.isnan(own).any():
            late = np.inf
        else:
            late = float(np.abs(own + shift - times).max())
        if not late < step:
            raise InputError(
                "import-time",
                f"{recording.path}: {quoted(other)} was not sampled when {quoted(reference)} was",
                cause="the two channels have different rates or start times",
                remedy="resample them onto one time base and export them as .csv",
            )
        if late > 1e-3 * step:
            warnings.append(
                f"{quoted(other)} was sampled up to {late:.3g} s away from {quoted(reference)}; "
                "they are kept side by side"
            )


def _split(recording: Recording, trace: Trace) -> list[Trace]:
    """Split where a block without a header begins again in time; refuse other backward steps."""
    if trace.even_step_s is not None:
        return [trace]
    times = trace.times_s
    restarts = [b for b in recording.breaks if 0 < b < times.size and times[b] <= times[b - 1]]
    if len(restarts) > MOST_PARTS:
        raise InputError(
            f"import-{recording.kind}", f"{recording.path}: has more than {MOST_PARTS} blocks"
        )
    bounds = [0, *restarts, times.size]
    parts = []
    for start, stop in pairwise(bounds):
        wrong = first_backward_step(times[start:stop])
        if wrong is not None:
            sample = start + wrong
            before, after = times[sample - 1], times[sample]
            moves = "stands still" if after == before else "runs backwards"
            raise InputError(
                "import-time",
                f"{recording.path}: time {moves} at sample {sample} ({trace.where(sample)}): "
                f"{after:.9g} s after {before:.9g} s",
                cause="recordings joined by hand, too few decimals in the time column, or a "
                "column that is not time",
                remedy="split the recording there, export more decimals, or choose another "
                "column with --time",
            )
        parts.append(trace.part(start, stop) if len(bounds) > 2 else trace)
    return parts


def joined(path: Path, traces: list[Trace]) -> list[Trace]:
    """Traces of one file in which those that follow without a gap are one.

    A trace whose place in time is unknown and that begins again is kept apart and
    placed straight after the one before it, with a warning.
    """
    if len(traces) > MOST_PARTS:
        raise InputError("import-file", f"{path}: has more than {MOST_PARTS} parts")
    groups: list[list[Trace]] = []
    restarted = False
    for trace in traces:
        if groups and (shifted := _following(groups[-1][-1], trace)) is not None:
            groups[-1].append(shifted)
            continue
        if groups:
            last = groups[-1][-1]
            end = last.start_s + float(last.times_s[-1] - last.times_s[0])
            if trace.clock == UNDATED and trace.start_s <= end:
                warnings = list(trace.warnings)
                if not restarted:
                    warnings.append(
                        f"the part that begins at {trace.where(0)} has no date and starts its "
                        "time again; it, and others like it, are placed straight after the part "
                        "before them"
                    )
                restarted = True
                stamp = end + _step(last) - float(trace.times_s[0])
                trace = replace(trace, stamp_s=stamp, warnings=warnings)
        groups.append([trace])
    return [_merged(group) for group in groups]


def _step(trace: Trace) -> float:
    return trace.even_step_s or float(np.median(np.diff(trace.times_s)))


def _following(last: Trace, trace: Trace) -> Trace | None:
    """The trace with times that continue the last one's, None where it does not continue it."""
    same = (
        last.said is None
        and trace.said is None
        and (last.command is None) == (trace.command is None)
        and (last.sensor is None) == (trace.sensor is None)
        and (last.monitor is None) == (trace.monitor is None)
        and (last.is_drive, last.is_displacement, last.even_step_s, last.clock)
        == (trace.is_drive, trace.is_displacement, trace.even_step_s, trace.clock)
    )
    if not same:
        return None
    step = _step(last)
    expected = float(last.times_s[-1]) + step
    found = trace.stamp_s - last.stamp_s + float(trace.times_s[0])
    follows_by_layout = trace.continues and trace.even_step_s is not None
    if abs(found - expected) > _CONTIGUOUS_WITHIN * step and not follows_by_layout:
        return None
    times = trace.times_s - float(trace.times_s[0]) + expected
    exact = trace.stamp_s == last.stamp_s and trace.even_step_s is None
    return replace(trace, times_s=trace.times_s if exact else times, stamp_s=last.stamp_s)


def _merged(group: list[Trace]) -> Trace:
    if len(group) == 1:
        return group[0]
    first = group[0]
    starts = np.cumsum([0, *(trace.samples for trace in group)])

    def where(sample: int) -> str:
        part = int(np.searchsorted(starts, sample, side="right")) - 1
        return group[part].where(sample - int(starts[part]))

    def together(values: list[FloatArray | None]) -> FloatArray | None:
        present = [v for v in values if v is not None]
        return np.concatenate(present) if present else None

    times = np.concatenate([trace.times_s for trace in group])
    return replace(
        first,
        times_s=times,
        command=together([t.command for t in group]),
        sensor=together([t.sensor for t in group]),
        monitor=together([t.monitor for t in group]),
        where=where,
        assumed=list(dict.fromkeys(s for t in group for s in t.assumed)),
        warnings=list(dict.fromkeys(s for t in group for s in t.warnings)),
    )
