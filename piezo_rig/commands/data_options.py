"""What the verbs that read data have in common: runs and recordings, and how to read them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from piezo_rig.run_file.importers import Imported
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.sweep import Sweep
    from piezo_rig.run_file.verify import Verdict

_GIVEN = ("gain", "offset", "polarity", "sensitivity", "command", "sensor", "monitor", "time",
          "history")


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Options that say how recordings are read."""
    group = parser.add_argument_group(
        "recordings", "how .lvm, .tdms and .csv files are read; a run knows all this itself"
    )
    group.add_argument("--gain", type=float, metavar="G", help="drive = G x command + offset; 7.5")
    group.add_argument("--offset", type=float, metavar="V", help="default: 75")
    group.add_argument("--polarity", metavar="+1|-1", help="of the sensor; default: -1")
    group.add_argument("--sensitivity", metavar="S",
                       help="the switch, 0..6, or a value as in 3.87um/V")
    for name in ("command", "sensor", "monitor", "time"):
        group.add_argument(f"--{name}", metavar="CH", help=f"the {name} channel: name or number")
    group.add_argument("--history", choices=("virgin", "carried", "unknown"),
                       help="what the actuator remembers when a recording begins; unknown")


def reading_options(args: argparse.Namespace, sweeps: Sequence[Sweep]) -> list[str]:
    """The options that say how DATA are read, as they are typed to join a run of a bench to them.

    ``sweeps`` : what was read; no bench plays anything IMPORTED
    """
    said = [f"--{n}={v}" for n in _GIVEN if (v := getattr(args, n, None)) is not None]
    mixed = args.mixed_origin or any(s.origin == "IMPORTED" for s in sweeps)
    return [*said, *(["--mixed-origin"] if mixed else [])]


def add_data_arguments(parser: argparse.ArgumentParser) -> None:
    """DATA..., how to read them, and whether origins may be mixed."""
    parser.add_argument("data", metavar="DATA", nargs="+",
                        help="runs (.h5) and recordings (.lvm, .tdms, .csv)")
    parser.add_argument("--mixed-origin", action="store_true",
                        help="join REAL, SIMULATED and IMPORTED data")
    add_reading_arguments(parser)


def read_recordings_as_said(
    paths: Sequence[str], args: argparse.Namespace,
    require: Sequence[str] = ("drive", "displacement"),
) -> Imported:
    """Recordings read with the options given; assumptions and warnings are printed."""
    from pathlib import Path

    from piezo_rig.errors import InputError
    from piezo_rig.run_file.importers import ImportOptions, read_recordings

    said = {name: getattr(args, name) for name in _GIVEN if getattr(args, name) is not None}
    explicit = frozenset("offset_v" if name == "offset" else name for name in said)
    if "offset" in said:
        said["offset_v"] = said.pop("offset")
    if "polarity" in said:
        if said["polarity"] not in ("+1", "1", "-1"):
            raise InputError("usage", f"--polarity {said['polarity']}: expected +1 or -1",
                             "a slip on the command line", "give --polarity=+1 or --polarity=-1")
        said["polarity"] = int(said["polarity"])
    for name in ("command", "sensor", "monitor", "time"):
        if name in said and said[name].isdigit():
            said[name] = int(said[name])
    options = ImportOptions(explicit=explicit, **said)
    imported = read_recordings([Path(p) for p in paths], options, require)
    for line in imported.assumptions:
        print(f"assumed: {line}")
    for line in imported.warnings:
        print(f"warning: {line}")
    return imported


def is_run(path: str) -> bool:
    """Whether a name is that of a run; everything else is a recording."""
    return path.lower().endswith((".h5", ".hdf5", ".nxs"))


def load_data(
    args: argparse.Namespace, for_diagnosis: bool = False, warned: list[str] | None = None,
    assumed: list[str] | None = None,
) -> tuple[list[Sweep], dict[str, str]]:  # fmt: skip
    """All sweeps of DATA, and the SHA-256 of every file, by a name that no other file has.

    Sweeps that ``verify`` finds faulty are left out, and said; ``for_diagnosis`` keeps those whose
    faults all have a physical cause that diagnosis can name. Names are made unique by counting
    on over all files, in the order given. What is said of files is added to ``warned`` as well,
    and what is assumed of recordings to ``assumed``.

    Raises
    ------
    InputError : nothing usable, unreadable, or origins mixed without ``--mixed-origin``
    """
    import hashlib
    from pathlib import Path

    from piezo_rig.errors import InputError
    from piezo_rig.run_file.importers import distinct_names
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import require_run

    sweeps: list[Sweep] = []
    hashes: dict[str, str] = {}
    given = _once(args.data, warned)
    shown = distinct_names([Path(name) for name in given])
    recordings = [p for p in given if not is_run(p)]
    by_recording: dict[str, list[Sweep]] = {}
    if recordings:
        imported = read_recordings_as_said(recordings, args)
        if warned is not None:
            warned += imported.warnings
        if assumed is not None:
            assumed += imported.assumptions
        for sweep in imported.sweeps:
            by_recording.setdefault(sweep.source, []).append(sweep)
    for name in given:
        path = Path(name)
        if name in recordings:
            continue
        run = Run(require_run(path))
        hashes[shown[path]] = run.sha256()
        sweeps += _usable_sweeps(run, shown[path], for_diagnosis, warned)
    for found_sweeps in by_recording.values():
        sweeps += found_sweeps
    for name in recordings:
        hashes[shown[Path(name)]] = hashlib.sha256(Path(name).read_bytes()).hexdigest()
    if not sweeps:
        raise InputError("no-data", f"{', '.join(args.data)}: no sweep that may be used",
                         "every sweep is faulty; the reasons are above", "see 'piezo-rig verify'")
    origins = sorted({s.origin for s in sweeps})
    if len(origins) > 1 and not args.mixed_origin:
        raise InputError(
            "mixed-origin", f"the data are {' and '.join(origins)}",
            "files of different origin were given together",
            "give files of one origin, or --mixed-origin if you mean it",
        )
    if len(args.data) > 1:
        sweeps = [s.with_(name=f"sweep_{i + 1:04d}") for i, s in enumerate(sweeps)]
    return sweeps, hashes


def _once(names: Sequence[str], warned: list[str] | None) -> list[str]:
    """Every file once, in the order given: a copy is no repeat."""
    from pathlib import Path

    files: dict[Path, str] = {}
    copies: dict[str, None] = {}
    for name in names:
        if (path := Path(name).resolve()) in files:
            copies[name] = None
        else:
            files[path] = name
    for name in copies:
        said = f"{name}: given more than once, read once: a copy is no repeat"
        print(f"warning: {said}")
        if warned is not None:
            warned.append(said)
    return list(files.values())


def load_while(
    meanwhile: Callable[[], None], args: argparse.Namespace, warned: list[str],
    assumed: list[str],
) -> tuple[list[Sweep], dict[str, str]]:  # fmt: skip
    """`load_data` for a diagnosis, by another process while this one does something else.

    What a diagnosis needs takes as long to import as its data to read.
    """
    import contextlib
    import io
    import pickle

    from piezo_rig.forked import Forked, worth_it

    def load(into: BinaryIO) -> None:
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            loaded = load_data(args, True, warned, assumed)
        pickle.dump((said.getvalue(), loaded, warned, assumed), into, pickle.HIGHEST_PROTOCOL)

    if worth_it():
        # a process that fails is not heard of: the same is found here again
        with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError), Forked(load) as other:
            meanwhile()
            said, loaded, warned[:], assumed[:] = pickle.loads(other.found())
            print(said, end="")
            return loaded
    return load_data(args, True, warned, assumed)


def _usable_sweeps(
    run: Run, shown: str, for_diagnosis: bool, warned: list[str] | None
) -> list[Sweep]:
    """The sweeps of one run that may be used; every one that is left out is said, with why."""
    from piezo_rig.errors import InputError
    from piezo_rig.run_file.verify import verify

    def warn(text: str) -> None:
        print(f"warning: {shown}: {text}")
        if warned is not None:
            warned.append(f"{shown}: {text}")

    _, found = verify(run.path)
    for verdict in found:
        if verdict.fault and not verdict.sweep:
            warn(verdict.text)
    by_sweep: dict[str, list[Verdict]] = {}
    for verdict in found:
        if verdict.fault:
            by_sweep.setdefault(verdict.sweep, []).append(verdict)
    kept: list[str] = []
    for name in run.active_names:
        faults = by_sweep.get(name, [])
        if faults and not (for_diagnosis and all(v.cause for v in faults)):
            warn(f"{name} is left out: {'; '.join(v.text for v in faults)}")
            continue
        if faults:
            causes = ", ".join(dict.fromkeys(v.cause for v in faults))
            warn(f"{name}: {'; '.join(v.text for v in faults)}; kept, because diagnosis knows "
                 f"that cause ({causes})")
        kept.append(name)
    sweeps: list[Sweep] = []
    for name, sweep in run.each(kept):
        if isinstance(sweep, InputError):
            warn(f"{name} is left out: {sweep.what}")
        else:
            sweeps.append(sweep)
    return sweeps
