"""Plays a drive through a model: what the sensor would show, one row per input row."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

HELP = "play a drive through a model"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_reading_arguments

    parser.add_argument("model", metavar="MODEL.json",
                        help="a model file, or the name of a shipped one (thesis_range)")
    parser.add_argument("drive", metavar="DRIVE",
                        help="a run, a recording, or a CSV with time_s,drive_v")
    parser.add_argument("--out", metavar="OUT.csv", required=True)
    parser.add_argument("--free-end", action="store_true",
                        help="the actuator alone: leave sensor and acquisition stages out")
    add_reading_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    import numpy as np

    from piezo_rig.causes.catalogue import load_model
    from piezo_rig.chain import half_loops
    from piezo_rig.resources import find

    model = load_model(find("models", args.model))
    model.check()
    args.history = history = args.history or "virgin"
    stretches = _drives(args)
    plays, begin = stretches, history
    if history == "carried" and len(stretches) > 1:
        # nothing is carried into the first of them: it begins as a drive does by default
        plays, begin = [_one_after_another(stretches)], "virgin"
    rows: list[np.ndarray] = []
    earlier: list[np.ndarray] = []
    for time, drive in plays:
        moved = model.simulate(
            time, drive, history=begin, free_end=args.free_end, earlier=tuple(earlier)
        )
        earlier.append(drive[np.append(half_loops(drive).start, drive.size - 1)])
        rows.append(np.column_stack([time, drive, moved]))
    table = np.concatenate(rows)
    table[:, 0] = np.concatenate([time for time, _ in stretches])
    write_table(Path(args.out), "time_s,drive_v,displacement_um", table)
    print(f"model     {model.name or args.model}: {', '.join(s.id for s in model.stages)}")
    print(f"drive     {table.shape[0]} samples, {table[:, 1].min():g} .. {table[:, 1].max():g} V, "
          f"history {history if begin == history else 'virgin, then carried on'}"
          f"{'' if len(stretches) == 1 else f', {len(stretches)} sweeps'}")
    for line in beyond(model.provenance.get("drive_v"), table[:, 1]):
        print(line)
    for line in beyond_curves(model.provenance.get("known_v"), [d for _, d in plays], begin):
        print(line)
    print(f"travel    {np.ptp(table[:, 2]):.3f} um")
    print(f"simulation: {args.out}")
    return 0


def beyond(identified: Any, drive: NDArray[np.float64]) -> list[str]:
    """A warning where a drive leaves the volts (lowest, highest) that a model was fitted on."""
    import numpy as np

    if not (isinstance(identified, list) and len(identified) == 2
            and all(isinstance(v, int | float) for v in identified)):
        return []
    low, high = (float(v) for v in identified)
    room = 0.01 * (high - low)
    outside = int(np.count_nonzero((drive < low - room) | (drive > high + room)))
    if not outside:
        return []
    return [f"warning: {outside} of {drive.size} samples of the drive are outside {low:g} .. "
            f"{high:g} V, on which the model was identified: there the last slope goes on"]


def beyond_curves(
    known: Any, drives: list[NDArray[np.float64]], history: str
) -> list[str]:
    """Warnings where drives go further along a curve of the model than its data went.

    Parameters
    ----------
    known : volts, ``{"first_rise": V, "branch": V}``: how far the model's data knew the first
        rise, counted from its start, and a branch, from its turning point
    drives : every shape (n,)
    history : what the actuator remembers when each begins; only ``virgin`` has a first rise
    """
    import numpy as np

    from piezo_rig.chain import half_loops
    from piezo_rig.chain.reach import reaches

    if not (isinstance(known, dict) and {"first_rise", "branch"} <= set(known)
            and all(isinstance(v, int | float) for v in known.values())):
        return []
    rise = branch = 0.0
    for drive in drives:
        turns = drive[np.append(half_loops(drive).start, drive.size - 1)]
        if history != "virgin":
            turns = np.concatenate([[turns.min(), turns.max(), turns.min()], turns])
        first, later = reaches(turns)
        rise = max(rise, float(np.max(first, initial=0.0)) if history == "virgin" else 0.0)
        branch = max(branch, float(np.max(later, initial=0.0)))
    said = []
    if rise > 1.01 * float(known["first_rise"]):
        said.append(
            f"warning: the drive goes {rise:.4g} V from its virgin start, but the model's data "
            f"knew the first rise up to {known['first_rise']:.4g} V: beyond, the last slope goes "
            "on (with --history unknown no first rise is needed)"
        )
    if branch > 1.01 * float(known["branch"]):
        said.append(
            f"warning: the drive goes {branch:.4g} V along one branch from a turning point, but "
            f"the model's data knew branches up to {known['branch']:.4g} V: beyond, the last "
            "slope goes on"
        )
    return said


def _one_after_another(
    stretches: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All sweeps as one drive; one that does not begin after the one before is set behind it."""
    import numpy as np

    times: list[NDArray[np.float64]] = []
    for time, _ in stretches:
        if times and time[0] <= times[-1][-1]:
            step = float(np.median(np.diff(times[-1])))
            time = time - time[0] + times[-1][-1] + step
        times.append(time)
    return np.concatenate(times), np.concatenate([drive for _, drive in stretches])


def _drives(args: argparse.Namespace) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Time and drive of every sweep of DRIVE; times of a recording stay as they are."""
    from piezo_rig.commands.data_options import is_run, load_data, read_recordings_as_said

    if is_run(args.drive):
        args.data, args.mixed_origin = [args.drive], False
        sweeps, _ = load_data(args)
        begin = sweeps[0].start_time
    else:
        sweeps = read_recordings_as_said([args.drive], args, require=("drive",)).sweeps
        begin = 0.0 if args.drive.lower().endswith(".csv") else sweeps[0].start_time
    return [(s.time_s + (s.start_time - begin), s.drive_v) for s in sweeps]


def write_table(path: Path, header: str, table: NDArray[np.float64]) -> None:
    """A CSV of numbers that read back as they were.

    Raises
    ------
    BenchError : the disk refuses (exit 4)
    """
    import numpy as np

    from piezo_rig.errors import BenchError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")
    except OSError as error:
        raise BenchError(
            "disk", f"could not write {path}: {error.strerror or error}",
            "the disk is full, or the folder is not yours to write", "give another --out",
        ) from None
