"""Says what a model gets wrong on runs and recordings, why, and how much better it gets."""

from __future__ import annotations

import argparse

HELP = "name what the model gets wrong, and why"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_data_arguments

    add_data_arguments(parser)
    parser.add_argument(
        "--baseline",
        metavar="NAME or MODEL.json",
        default="classical",
        help="a NAME is refitted to the data, a MODEL.json is held fixed; classical",
    )
    parser.add_argument("--json", metavar="OUT", help="write the diagnosis as JSON")
    parser.add_argument("--save-model", metavar="OUT.json", help="write the extended model")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated nulls")


def execute(args: argparse.Namespace) -> int:
    import json
    from pathlib import Path

    from piezo_rig.causes import NAMED_MODELS, load_model
    from piezo_rig.commands.console import Progress
    from piezo_rig.commands.data_options import load_data
    from piezo_rig.diagnosis import diagnose, document, text
    from piezo_rig.errors import BenchError
    from piezo_rig.identification import save_model
    from piezo_rig.resources import find

    baseline = args.baseline
    if baseline not in NAMED_MODELS:
        baseline = load_model(find("calibration", baseline))
    sweeps, hashes = load_data(args)
    progress = Progress()
    try:
        found = diagnose(sweeps, baseline, args.seed, progress)
    finally:
        progress.close()
    print("\n".join(text(found)))
    if args.json:
        try:
            Path(args.json).write_text(
                json.dumps(document(found), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
                encoding="utf-8",
                newline="\n",
            )
        except OSError as error:
            raise BenchError(
                "disk",
                f"could not write {args.json}: {error.strerror or error}",
                "the folder is missing, full, or not yours to write",
                "give another --json",
            ) from None
        print(f"json: {args.json}")
    if args.save_model:
        runs = [{"name": n, "sha256": h} for n, h in sorted(hashes.items())]
        from piezo_rig import __version__

        model = found.model.with_(provenance={
            "runs": runs, "held_out": found.held_out, "scheme": "diagnosis",
            "software": f"piezo-rig {__version__}",
        })  # fmt: skip
        print(f"model: {save_model(model, args.save_model)}")
    return 0
