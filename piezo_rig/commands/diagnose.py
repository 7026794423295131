"""Says what a model gets wrong on runs and recordings, why, and how much better it gets.

Everything in DATA goes into one diagnosis. An output may be a folder (it exists, or ends in /):
the file in it is then named after the first of DATA. With a folder as --json every one of DATA is
diagnosed by itself, several at a time; a folder among DATA is one actuator, and its files are
joined.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from piezo_rig.diagnosis import Diagnosis
    from piezo_rig.fleet import Item

HELP = "name what the model gets wrong, and why"
IN_FOLDER = {
    "json": ".json", "save_model": "_extended.json", "figure": "_ladder.png",
    "report": "_report.html",
}  # fmt: skip
FIGURES = (".png", ".svg", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_data_arguments
    from piezo_rig.commands.every_file import add_many_arguments

    add_data_arguments(parser)
    add_many_arguments(parser)
    parser.add_argument(
        "--baseline",
        metavar="NAME or MODEL.json",
        default="classical",
        help="a NAME is refitted to the data, a MODEL.json is held fixed (one by identify that "
        "was far off is refitted, but for gain and sensitivity); classical",
    )
    parser.add_argument("--json", metavar="OUT", help="write the diagnosis as JSON")
    parser.add_argument(
        "--report", metavar="OUT.html", help="write one page that explains all of it"
    )
    parser.add_argument("--save-model", metavar="OUT.json", help="write the extended model")
    parser.add_argument("--figure", metavar="OUT.png", help="draw the ladder of errors")
    parser.add_argument(
        "--follow-up", action="store_true",
        help="play the protocol that separates confounded causes, and diagnose everything again",
    )
    parser.add_argument(
        "--rig", metavar="CONFIG", help="the bench that --follow-up plays on: that of the data"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulated nulls")


def execute(args: argparse.Namespace) -> int:
    from piezo_rig.commands.every_file import many

    return _each(args) if many(args, args.json, "--json") else _together(args)


def _together(args: argparse.Namespace) -> int:
    """All of DATA in one diagnosis."""
    from dataclasses import replace
    from pathlib import Path

    from piezo_rig.commands.data_options import load_data, load_while, reading_options

    _check_follow_up(args)
    outputs = _outputs(args)
    warned: list[str] = []
    assumed: list[str] = []
    sweeps, hashes = load_while(_get_ready, args, warned, assumed)

    from piezo_rig.causes import NAMED_MODELS, load_model
    from piezo_rig.commands.console import Progress, seconds
    from piezo_rig.commands.follow_up import lines, play_follow_up
    from piezo_rig.diagnosis import diagnose, document, text
    from piezo_rig.diagnosis.follow_up import decide
    from piezo_rig.identification import save_model
    from piezo_rig.report.ladder import ladder_figure
    from piezo_rig.report.page import report_page
    from piezo_rig.report.verdict import verdict
    from piezo_rig.resources import find

    baseline = args.baseline
    if baseline not in NAMED_MODELS:
        baseline = load_model(find("models", baseline))

    def diagnosed() -> Diagnosis:
        progress, begun = Progress(), time.monotonic()

        def step(text: str) -> None:
            # what is no terminal gets the same for the same data, whatever the time
            after = f"after {seconds(time.monotonic() - begun)}: " if progress.tty else "progress  "
            progress(after + text)

        try:
            found = diagnose(sweeps, baseline, args.seed, step)
        finally:
            progress.close()
        print("\n".join([*text(found), "", *verdict(found).in_a_terminal()]))
        # said on loading; whoever reads a file only has to know it too
        return replace(found, warnings=[*warned, *found.warnings], assumed=list(assumed))

    found = diagnosed()
    followed: dict[str, object] = {}
    if args.follow_up and found.follow_up is None:
        print("follow-up nothing is confounded: nothing is played")
    elif args.follow_up and found.follow_up is not None:
        advice = found.follow_up
        run = play_follow_up(advice, args.rig, args.data, sweeps, args.mixed_origin)
        args.data = [*args.data, str(run)]
        warned.clear()
        assumed.clear()
        sweeps, hashes = load_data(args, for_diagnosis=True, warned=warned, assumed=assumed)
        found = diagnosed()
        decision = decide(advice.separates, {f.cause: f.alternatives for f in found.findings})
        print("\n".join(lines(decision, run)))
        followed = {"followed_up": {
            "run": str(run), "protocol": advice.protocol, "separates": advice.separates,
            "decided": decision.decided, "kept": decision.kept, "fell": decision.fell,
            "still_confounded": decision.still,
        }}  # fmt: skip
    if "json" in outputs:
        _write_json(document(found) | followed, outputs["json"])
        print(f"json: {outputs['json']}")
    if "save_model" in outputs:
        runs = [{"name": n, "sha256": h} for n, h in sorted(hashes.items())]
        from piezo_rig import __version__

        model = found.model.with_(provenance={
            "runs": runs, "held_out": found.held_out, "scheme": "diagnosis",
            "rms_nm": round(found.rungs[-1].rms_nm, 4), "software": f"piezo-rig {__version__}",
        })  # fmt: skip
        print(f"model: {save_model(model, outputs['save_model'])}")
    more = f" and {len(args.data) - 1} more" if len(args.data) > 1 else ""
    title = f"{Path(args.data[0]).stem}{more}"
    if "report" in outputs:
        page = report_page(
            outputs["report"], title, found, args.data, hashes, reading_options(args, sweeps)
        )
        print(f"report: {page}")
    if "figure" in outputs:
        print(f"figure: {ladder_figure(outputs['figure'], title, found)}")
    return 0


def _get_ready() -> None:
    """Import what a diagnosis needs, and call a compiled kernel: the first one takes a while."""
    import numpy as np

    from piezo_rig.chain.kernels import turning_points

    turning_points(np.zeros(2), 0.0)


def _each(args: argparse.Namespace) -> int:
    """Every one of DATA by itself."""
    import hashlib
    from pathlib import Path

    from piezo_rig.causes import NAMED_MODELS, load_model
    from piezo_rig.chain.model_file import model_text
    from piezo_rig.commands.every_file import Job, Output, every_file, is_folder, items_for
    from piezo_rig.errors import InputError
    from piezo_rig.resources import find

    _check_follow_up(args)
    if args.follow_up:
        raise InputError(
            "usage", "--follow-up plays on one bench, for one actuator",
            "with a folder as --json every one of DATA is diagnosed by itself",
            "give a file as --json, or diagnose that actuator alone",
        )
    outputs = []
    for name, ending in IN_FOLDER.items():
        given = getattr(args, name)
        if given is not None:
            if name != "json" and not is_folder(given):
                raise InputError(
                    "usage", f"--{name.replace('_', '-')} {given} is no folder",
                    "with a folder as --json every one of DATA has outputs of its own",
                    "give a folder (it exists, or ends in /), or a file as --json",
                )
            outputs.append(Output(name, Path(given), ending))
    items = items_for(args, outputs)
    settings: dict[str, Any] = {"baseline": args.baseline, "seed": args.seed}
    if args.baseline not in NAMED_MODELS:  # a slip is said once, and at once
        path = find("models", args.baseline)
        text = model_text(load_model(path))
        args.baseline = str(path.absolute())
        settings["baseline_sha256"] = hashlib.sha256(text.encode()).hexdigest()
    return every_file(args, items, Job("diagnosed", _analysed, outputs, settings))


def _analysed(options: Mapping[str, Any], item: Item, place: Path) -> dict[str, Any]:
    """One item: its outputs in ``place``, and its row."""
    import json

    from piezo_rig.commands.every_file import about_files
    from piezo_rig.fleet.diagnosis_row import row_of

    wanted = options["outputs"]
    about = about_files(item.files)
    _together(argparse.Namespace(**options, data=list(item.files), **{
        name: str(place / f"{item.name}{ending}") if ending in wanted else None
        for name, ending in IN_FOLDER.items()
    }))  # fmt: skip
    text = (place / f"{item.name}{IN_FOLDER['json']}").read_text(encoding="utf-8")
    return about | row_of(json.loads(text))


def _check_follow_up(args: argparse.Namespace) -> None:
    """Raise InputError where --follow-up and --rig do not come together."""
    from piezo_rig.errors import InputError

    if args.follow_up != bool(args.rig):
        raise InputError(
            "usage", "--follow-up needs --rig CONFIG, the bench to play on" if args.follow_up
            else "--rig goes with --follow-up", "a slip on the command line",
            "see 'piezo-rig diagnose --help'",
        )


def _outputs(args: argparse.Namespace) -> dict[str, Path]:
    """Where each output goes, by option; checked before the diagnosis, which takes a while.

    Raises
    ------
    InputError : two outputs are one file, an output is an input, or a figure of an unknown kind
    BenchError : the disk refuses (exit 4)
    """
    import os
    from pathlib import Path

    from piezo_rig.commands.outputs import refuse_overwriting
    from piezo_rig.errors import InputError

    outputs: dict[str, Path] = {}
    for name, ending in IN_FOLDER.items():
        given = getattr(args, name)
        if given is None:
            continue
        path = Path(given)
        if given.endswith(("/", "\\")) or path.is_dir():
            path = path / f"{Path(args.data[0]).stem}{ending}"
        outputs[name] = path
    refuse_overwriting(argparse.Namespace(**{**vars(args), **{
        name: str(path) for name, path in outputs.items()
    }}))  # fmt: skip
    if len({os.path.abspath(path) for path in outputs.values()}) < len(outputs):
        raise InputError("usage", "two outputs are to go into one file",
                         "a slip on the command line", "give each a name of its own")
    figure = outputs.get("figure")
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise InputError("usage", f"--figure {figure}: a figure is one of {', '.join(FIGURES)}",
                         "a slip on the command line", "give a name that ends in .png")
    for name, path in outputs.items():
        _make_room(name, path)
    return outputs


def _make_room(name: str, path: Path) -> None:
    """Make the folder of an output and see that it can be written to."""
    import os

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(21, "it is a folder")
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise PermissionError(13, "not yours to write")
    except OSError as error:
        raise _refused(name, path, error) from None


def _write_json(document: dict[str, object], path: Path) -> None:
    import json

    try:
        path.write_text(
            json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n",
            encoding="utf-8", newline="\n",
        )  # fmt: skip
    except OSError as error:
        raise _refused("json", path, error) from None


def _refused(name: str, path: Path, error: OSError) -> Exception:
    from piezo_rig.errors import BenchError

    option = f"--{name.replace('_', '-')}"
    return BenchError("disk", f"could not write {path}: {error.strerror or error}",
                      "the name is taken, the disk is full, or the folder is not yours to write",
                      f"give another {option}")  # fmt: skip
