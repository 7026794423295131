"""What `identify` and `diagnose` do with a folder as output: every one of DATA by itself.

A folder among DATA is one actuator: its runs and recordings are joined. Outputs are written as they
come, a journal beside them says what is done, and a table and a page follow at the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from piezo_rig.fleet import Item, Outcome

SHOWN = 20  # files, failures and outliers that are named on the terminal
NOT_OPTIONS = (
    "execute", "verb", "data", "scheduler", "out", "json", "report", "save_model", "figure",
)  # fmt: skip


@dataclass(frozen=True)
class Output:
    """One kind of output: the option that asks for it, its folder, how its files' names end."""

    option: str
    folder: Path
    ending: str

    def path(self, name: str) -> Path:
        """Where it goes for the item of that name."""
        return self.folder / f"{name}{self.ending}"


@dataclass(frozen=True)
class Job:
    """What is done with every item.

    Attributes
    ----------
    what : the verb's participle
    analyse : called with options (those of the command line; ``outputs`` are the endings), the
        item and an empty folder. It leaves its outputs there as ``NAME + ending`` and returns a
        row. A function of a module, so that another process can import it
    outputs : the first one's folder gets journal and summary
    settings : whatever the outputs depend on besides the input, as plain data
    """

    what: str
    analyse: Callable[[Mapping[str, Any], Item, Path], dict[str, Any]]
    outputs: Sequence[Output]
    settings: Mapping[str, Any]


def add_many_arguments(parser: argparse.ArgumentParser) -> None:
    """Options for many inputs at once."""
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="with a folder as output: hand the work to this Dask cluster")


def many(args: argparse.Namespace, output: str | None, option: str) -> bool:
    """Whether every one of DATA is to be analysed by itself.

    It is where the output is a folder (it exists, ends in /, or there are several DATA and it has
    no ending) and there is more than one file.

    Raises
    ------
    InputError : ``--scheduler`` without a folder to write to
    """
    import os
    from pathlib import Path

    from piezo_rig.errors import InputError

    several = len(args.data) > 1 or Path(args.data[0]).is_dir() or bool(args.scheduler)
    folder = output is not None and (is_folder(output) or (
        several and not os.path.splitext(output)[1] and not Path(output).exists()
    ))
    if args.scheduler and not folder:
        raise InputError("usage", f"--scheduler goes with a folder as {option}",
                         "one analysis alone is not handed to a cluster",
                         f"give {option} FOLDER/, or leave --scheduler out")
    return folder and several


def is_folder(output: str) -> bool:
    """Whether an output was given as a folder."""
    from pathlib import Path

    return output.endswith(("/", "\\")) or Path(output).is_dir()


def items_for(args: argparse.Namespace, outputs: Sequence[Output]) -> list[Item]:
    """The items of DATA, once it is clear that their outputs can be written.

    Raises
    ------
    InputError : an output is an input
    BenchError : the disk refuses (exit 4)
    """
    from piezo_rig.commands.outputs import refuse_overwriting
    from piezo_rig.errors import BenchError
    from piezo_rig.fleet import items_of

    items = items_of(args.data, [output.ending for output in outputs])
    for item in items:
        for output in outputs:
            refuse_overwriting(argparse.Namespace(**{
                "baseline": getattr(args, "baseline", None), "files": [*item.files],
                output.option: str(output.path(item.name)),
            }))  # fmt: skip
    for output in outputs:
        try:
            output.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            option = output.option.replace("_", "-")
            raise BenchError(
                "disk", f"could not write {output.folder}: {error.strerror or error}",
                "the name is taken, or the folder above is not yours to write",
                f"give another --{option}",
            ) from None
    return items


def about_files(files: Sequence[str]) -> dict[str, Any]:
    """What a row says of its files: origin and actuator.

    Raises
    ------
    InputError : a file is no run, or the runs are of different actuators
    """
    from piezo_rig.commands.data_options import is_run
    from piezo_rig.errors import InputError
    from piezo_rig.run_file.reader import Run

    runs = [Run(f) for f in files if is_run(f)]
    serials = {str(run.actuator().get("serial", "")) for run in runs} - {""}
    if len(serials) > 1:
        raise InputError(
            "different-actuators", f"the runs are of {' and '.join(sorted(serials))}",
            "a folder among DATA stands for one actuator; its files are joined",
            "give the files themselves, so that each is analysed by itself: FOLDER/*.h5",
        )
    origins = {run.origin for run in runs} | ({"IMPORTED"} if len(runs) < len(files) else set())
    return {"origin": " and ".join(sorted(origins)), "actuator": "".join(serials)}


def every_file(args: argparse.Namespace, items: Sequence[Item], job: Job) -> int:
    """Analyse every item; returns 0, or the worst status where none could be analysed.

    Raises
    ------
    BenchError : the disk refuses, or the cluster went away
    Aborted : the operator stopped it; what was done is kept
    """
    import time
    from functools import partial

    from piezo_rig import __version__
    from piezo_rig.commands.console import Progress, seconds
    from piezo_rig.errors import Aborted, PiezoRigError
    from piezo_rig.fleet import Work
    from piezo_rig.fleet.journal import Journal, key_of

    options: dict[str, Any] = {k: v for k, v in vars(args).items() if k not in NOT_OPTIONS}
    options["outputs"] = [output.ending for output in job.outputs]
    summary = job.outputs[0].folder
    journal = Journal(summary, key_of({
        "what": job.what, "options": options, "settings": job.settings,
        "software": __version__,
    }))  # fmt: skip
    done = _Done(job, journal, {item.name: item for item in items})
    progress, begun = Progress(), time.monotonic()
    stopped: PiezoRigError | None = None
    outcomes = _outcomes(args.scheduler, Work(partial(job.analyse, options)), done.to_do())
    try:
        for outcome in outcomes:
            done.add(outcome)
            count = len(done.rows)
            left = (time.monotonic() - begun) / count * (len(items) - count)
            progress(f"{count} of {len(items)} files, {len(done.failures)} failed, "
                     f"{seconds(left)} left")
    except PiezoRigError as error:
        if not done.rows:
            raise
        stopped = error
    except KeyboardInterrupt:
        stopped = Aborted("aborted", "stopped by the operator", "",
                          "give the same command again: it goes on with what is missing")
    finally:
        outcomes.close()
        progress.close()
    missing = [item.given for item in items if item.name not in done.rows]
    if stopped is not None:
        stopped.what += (f"; {len(done.rows)} of {len(items)} files were done and are kept in "
                         f"{summary}; not done: {_listed(missing)}")
    if done.rows:
        _tell(done, summary, [done.rows[i.name] for i in items if i.name in done.rows])
    if stopped is not None:
        raise stopped
    return done.status()


class _Done:
    """What has come back so far: rows in memory, outputs and journal on the disk."""

    def __init__(self, job: Job, journal: Any, items: Mapping[str, Item]) -> None:
        self.job, self.journal, self.items = job, journal, items
        self.rows: dict[str, dict[str, Any]] = {}
        self.units: dict[str, str] = {}
        self.said: dict[str, list[str]] = {}
        self.failures: dict[str, Outcome] = {}
        self.unchanged = 0
        self._lines = {name: journal.known(name) for name in items}

    def to_do(self) -> list[Item]:
        """All items, each with the hash of the input that its outputs stand for."""
        from dataclasses import replace

        return [replace(item, known=(self._lines[name] or {}).get("sha256", ""))
                for name, item in self.items.items()]  # fmt: skip

    def add(self, outcome: Outcome) -> None:
        item = self.items[outcome.name]
        line = self._lines.pop(outcome.name)
        if outcome.error:
            self.failures[outcome.name] = outcome
            self.rows[outcome.name] = {
                "file": item.given, "sha256": outcome.sha256 or None, "status": "failed",
                "error_code": outcome.code, "error_text": outcome.text,
            }
            return
        if outcome.unchanged:
            assert line is not None
            self.unchanged += 1
        else:
            line = self._written(outcome)
        row = dict(line["row"])
        self.units |= row.pop("units", {})
        for text in line["said"]:
            self.said.setdefault(text, []).append(item.given)
        self.rows[outcome.name] = {
            "file": item.given, "sha256": outcome.sha256, "status": "done",
            "output": str(self.job.outputs[0].path(outcome.name)), **row,
        }

    def _written(self, outcome: Outcome) -> dict[str, Any]:
        """Put the outputs in their places, whole or not at all, and note that they stand."""
        from piezo_rig.report.figures import place_for

        places = {o.ending: o.path(outcome.name) for o in self.job.outputs}
        for ending, content in outcome.files.items():
            path = places[ending]
            draft = path.with_name(path.name + ".tmp")
            with place_for(path):
                draft.write_bytes(content)
                draft.replace(path)
        line = {"name": outcome.name, "sha256": outcome.sha256, "row": outcome.row,
                "said": outcome.said, "seconds": outcome.seconds}  # fmt: skip
        self.journal.add(line, {places[e]: content for e, content in outcome.files.items()})
        return line

    def status(self) -> int:
        """0; the largest status of all failures where nothing else came out."""
        if len(self.failures) < len(self.rows):
            return 0
        return max(o.exit_status for o in self.failures.values())


def _outcomes(
    scheduler: str | None, work: Any, items: Sequence[Item]
) -> Generator[Outcome, None, None]:
    if scheduler:
        from piezo_rig.fleet.cluster import on_cluster

        yield from on_cluster(scheduler, work, items)
    else:
        from piezo_rig.fleet.local import on_this_computer

        yield from on_this_computer(work, items)


def _tell(done: _Done, folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """The table, the page, and the last lines on the terminal; failures on stderr."""
    import sys

    from piezo_rig.fleet import page, table
    from piezo_rig.report.figures import place_for

    settings = {k: str(v) for k, v in done.job.settings.items() if v is not None}
    overview = page.Overview(done.job.what, rows, settings, done.units)
    table.write_table(rows, folder / table.NAME, done.units)
    sheet = folder / "summary.html"
    with place_for(sheet):
        sheet.write_text(page.page(overview), encoding="utf-8", newline="\n")
    for text, files in done.said.items():
        print(text if len(rows) == 1 else f"{text}  ({_listed(files)})")
    for row in rows[:SHOWN]:
        if row["status"] == table.DONE:
            print(f"{row['file']}: rms {row['rms_nm']:.4g} nm, largest error "
                  f"{row['max_percent']:.3g} % of travel; {row['output']}")
    if len(rows) > SHOWN:
        print(f"and {len(rows) - SHOWN} more: {folder / table.NAME}")
    outliers = overview.outliers()
    for o in outliers[:SHOWN]:
        unit = overview.unit(o.column)
        print(f"outlier   {o.file}: {o.column} = {o.value:.4g}{unit}, median {o.median:.4g}{unit}, "
              f"robust z {o.z:.1f}")
    if len(outliers) > SHOWN:
        print(f"outlier   and {len(outliers) - SHOWN} more: {sheet}")
    sys.stdout.flush()
    for failure in list(done.failures.values())[:SHOWN]:
        print(failure.error, file=sys.stderr)
    kept = f", {done.unchanged} of them unchanged since before" if done.unchanged else ""
    bad = [done.items[name].given for name in done.failures]
    print(f"{len(rows) - len(bad)} of {len(rows)} {done.job.what}{kept}"
          + (f"; failed: {_listed(bad)}" if bad else ""))
    print(f"summary: {folder / table.NAME}")
    print(f"page: {sheet}")


def _listed(files: Sequence[str]) -> str:
    """At most so many names, and how many more."""
    more = f" and {len(files) - SHOWN} more" if len(files) > SHOWN else ""
    return ", ".join(files[:SHOWN]) + more
