"""Hides effects in the simulated bench, sealed, plays them through the drivers, and scores the
diagnosis against an oracle that knows them. docs/challenge.md explains every figure.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from piezo_rig.scoring.counts import Row

HELP = "hide effects in a simulated bench and score the diagnosis"
MOST_CASES = 9999


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=24, metavar="N", help="how many; 24")
    parser.add_argument("--seed", type=int, default=0, metavar="S",
                        help="the same seed makes the same cases, however many; 0")
    parser.add_argument("--out", metavar="DIR",
                        help="keep the recordings, the sealed truth and the answers there")
    parser.add_argument("--score", metavar="ANSWERS",
                        help="a folder of case_0001.json ...: score these answers to the cases in "
                        "--out DIR, and play nothing")
    parser.add_argument("--figure", metavar="OUT.png",
                        help="the isolation matrix; default: isolation.png in the folder of the "
                        "answers, or challenge_isolation.png here")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="cases at a time; 2")


def execute(args: argparse.Namespace) -> int:
    import tempfile
    from pathlib import Path

    from piezo_rig.challenge.contest import contest, scored
    from piezo_rig.errors import InputError

    if not 1 <= args.cases <= MOST_CASES or args.seed < 0 or args.jobs < 1:
        raise InputError("usage", f"--cases {args.cases} --seed {args.seed} --jobs {args.jobs}: "
                         f"1 to {MOST_CASES} cases, a seed of 0 or more, 1 job or more",
                         "a slip on the command line", "see 'piezo-rig challenge --help'")
    if args.score:
        if not args.out:
            raise InputError("usage", "--score needs --out DIR, where the cases are",
                             "a slip on the command line", "see 'piezo-rig challenge --help'")
        answers = Path(args.score)
        if not answers.is_dir():
            raise InputError("file-missing", f"{answers}: no such folder", "a slip in the name",
                             "give the folder that holds case_0001.json ...")
        rows = scored(Path(args.out), answers)
        return _finished(args, rows, answers, f"{answers}: {len(rows)} cases of {args.out}")
    title = f"piezo-rig, {args.cases} cases of seed {args.seed}"
    if args.out:
        folder = Path(args.out)
        _make_room(folder)
        rows = contest(args.seed, args.cases, folder, args.jobs, _tell)
        return _finished(args, rows, folder / "answers", title)
    with tempfile.TemporaryDirectory(prefix="piezo-rig-challenge-") as folder_name:
        rows = contest(args.seed, args.cases, Path(folder_name), args.jobs, _tell)
    return _finished(args, rows, None, title)


def _finished(
    args: argparse.Namespace, rows: Sequence[Row], answers: Path | None, title: str
) -> int:
    """Print and draw; the exit status."""
    from pathlib import Path

    from piezo_rig.challenge.figure import isolation_figure
    from piezo_rig.challenge.score import LEAST_FIRST, MOST_FALSE, figures, score_text
    from piezo_rig.report.figures import place_for

    text = score_text(rows)
    print(f"\n{text}\n")
    if args.figure:
        figure = Path(args.figure)
    else:
        figure = answers / "isolation.png" if answers else Path("challenge_isolation.png")
    isolation_figure(figure, rows, title)
    if answers:
        path = answers / "score.md"
        with place_for(path):
            path.write_text(f"# {title}\n\n{text}\n", encoding="utf-8", newline="\n")
        print(f"cases: {args.out}")
        print(f"score: {path}")
    print(f"figure: {figure}")
    got = figures(rows)
    if got.passed:
        return 0
    print(f"failed: {got.false_alarms} false alarms in {got.nulls} nulls (at most "
          f"{100 * MOST_FALSE:g} %), {got.first_fair} right first findings of {got.known} (at "
          f"least {100 * LEAST_FIRST:g} %)")
    return 1


def _make_room(folder: Path) -> None:
    """Refuse a folder that holds something; make it otherwise.

    Raises
    ------
    InputError : it is not empty
    BenchError : the disk refuses
    """
    from piezo_rig.errors import BenchError, InputError

    try:
        folder.mkdir(parents=True, exist_ok=True)
        holds = any(folder.iterdir())
    except OSError as error:
        raise BenchError("disk", f"could not write into {folder}: {error.strerror or error}",
                         "the name is taken, or the folder is not yours to write",
                         "give another --out") from None
    if holds:
        raise InputError("folder-exists", f"{folder} is not empty",
                         "another challenge was kept there", "give another --out")


def _tell(line: str) -> None:
    print(line, flush=True)
