"""Fits a model to runs and recordings, and says how good it is on data it has not seen.

All DATA are one actuator's and are joined. With a folder as --out every one of DATA is identified
by itself, several at a time; a folder among DATA is one actuator, and its files are joined.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from piezo_rig.fleet import Item
    from piezo_rig.identification import Identification
    from piezo_rig.run_file.sweep import Sweep

HELP = "fit a model to runs and recordings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_data_arguments
    from piezo_rig.commands.every_file import add_many_arguments

    add_data_arguments(parser)
    add_many_arguments(parser)
    parser.add_argument("--model", metavar="NAME", required=True,
                        help="classical, initiation, range, extremum, range-extremum, ...")
    parser.add_argument("--out", metavar="MODEL.json", required=True,
                        help="a folder: one model for every one of DATA, a table and a page")
    parser.add_argument("--scheme", choices=("least-squares", "slopes"), default="least-squares")
    parser.add_argument("--elements", type=int, metavar="N",
                        help="default: chosen by held-out data (least squares), 40 (slopes)")
    parser.add_argument("--seed", type=int, default=0, help="of the bootstrap")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.console import Progress
    from piezo_rig.commands.every_file import is_folder, many
    from piezo_rig.errors import InputError
    from piezo_rig.identification import save_model
    from piezo_rig.report.figures import place_for

    if args.elements is not None and not 1 <= args.elements <= 500:
        raise InputError("usage", f"--elements {args.elements}: expected 1 to 500",
                         "a slip on the command line", "the thesis uses 40")
    if many(args, args.out, "--out"):
        return _each(args)
    out = Path(args.out)
    if is_folder(args.out):
        out = out / f"{Path(args.data[0]).stem}_{args.model}.json"
        with place_for(out):  # the folder is made before the work begins
            pass
    progress = Progress()
    try:
        sweeps, found = _identified(
            args, lambda what, share: progress(f"{100 * share:3.0f} %  {what}")
        )
        path = save_model(found.model, out)
    finally:
        progress.close()
    print("\n".join([*_report(sweeps, found), f"model: {path}"]))
    return 0


def _identified(
    args: argparse.Namespace, tell: object = None
) -> tuple[list[Sweep], Identification]:
    """Identify all of ``args.data`` together."""
    from piezo_rig.commands.data_options import load_data
    from piezo_rig.identification import identify

    sweeps, hashes = load_data(args)
    return sweeps, identify(
        sweeps, args.model, args.scheme, args.elements, seed=args.seed,
        progress=tell,  # type: ignore[arg-type]
        runs=[{"name": name, "sha256": digest} for name, digest in sorted(hashes.items())],
    )


def _report(sweeps: list[Sweep], found: Identification) -> list[str]:
    lines = [
        f"data      {len(sweeps)} sweeps, {sum(s.samples for s in sweeps)} samples, "
        f"{len({s.condition for s in sweeps})} conditions, {sweeps[0].origin}",
        *(f"note      {note}" for note in found.left_out),
        f"model     {found.model.name}: " + ", ".join(
            f"{s.id}" + (f" ({len(s.elements)} elements)" if s.elements else "")
            for s in found.model.stages
        ),
    ]
    for stage in found.model.stages:
        for name, p in stage.parameters.items():
            interval = f"  [{p.ci95[0]:.4g}, {p.ci95[1]:.4g}]" if p.ci95 else ""
            lines.append(f"          {stage.id} {name} = {p.value:.4g} {p.unit}{interval}")
    lines.append(f"fitted    rms {found.fitted.rms_nm:.2f} nm, largest error "
                 f"{found.fitted.max_percent:.2f} % of travel")
    if found.held_out is None:
        lines.append("held out  nothing: the data hold too little to leave some of it out")
    else:
        lines.append(f"held out  by {found.held_out_kind}: rms {found.held_out.rms_nm:.2f} nm, "
                     f"largest error {found.held_out.max_percent:.2f} % of travel")
    if found.bands is not None:
        lines.append(f"condition number {found.bands.condition_number:.3g}; "
                     "95 % bands by bootstrap")
    return lines


def _each(args: argparse.Namespace) -> int:
    """Every one of DATA by itself."""
    from pathlib import Path

    from piezo_rig.causes import named_model
    from piezo_rig.commands.every_file import Job, Output, every_file, items_for

    named_model(args.model)  # a slip is said once, and at once
    outputs = [Output("out", Path(args.out), f"_{args.model}.json")]
    items = items_for(args, outputs)
    settings = {n: getattr(args, n) for n in ("model", "scheme", "elements", "seed")}
    return every_file(args, items, Job("identified", _analysed, outputs, settings))


def _analysed(options: Mapping[str, Any], item: Item, place: Path) -> dict[str, Any]:
    """One item: its model in ``place``, and its row."""
    from piezo_rig.commands.every_file import about_files
    from piezo_rig.fleet.characteristics import characteristics
    from piezo_rig.identification import save_model

    row, units = about_files(item.files), dict[str, str]()
    sweeps, found = _identified(argparse.Namespace(**options, data=list(item.files)))
    save_model(found.model, place / f"{item.name}_{options['model']}.json")
    row |= {"sweeps": len(sweeps), "samples": sum(s.samples for s in sweeps)}
    row |= {"rms_nm": found.rms_nm, "max_percent": found.max_percent,
            "held_out": found.held_out_kind, "fitted_rms_nm": found.fitted.rms_nm}  # fmt: skip
    row |= characteristics(found.model)
    for stage in found.model.stages:
        for name, parameter in stage.parameters.items():
            row[f"{stage.id}.{name}"] = parameter.value
            units[f"{stage.id}.{name}"] = parameter.unit
    return row | {"units": units}
