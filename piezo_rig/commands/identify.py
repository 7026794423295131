"""Fits a model to runs and recordings, and says how good it is on data it has not seen."""

from __future__ import annotations

import argparse

HELP = "fit a model to runs and recordings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_data_arguments

    add_data_arguments(parser)
    parser.add_argument("--model", metavar="NAME", required=True,
                        help="classical, initiation, range, extremum, range-extremum, ...")
    parser.add_argument("--out", metavar="MODEL.json", required=True)
    parser.add_argument("--scheme", choices=("least-squares", "slopes"), default="least-squares")
    parser.add_argument("--elements", type=int, metavar="N",
                        help="default: chosen by held-out data (least squares), 40 (slopes)")
    parser.add_argument("--seed", type=int, default=0, help="of the bootstrap")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.console import Progress
    from piezo_rig.commands.data_options import load_data
    from piezo_rig.errors import InputError
    from piezo_rig.identification import identify, save_model

    if args.elements is not None and not 1 <= args.elements <= 1000:
        raise InputError("usage", f"--elements {args.elements}: expected 1 to 1000",
                         "a slip on the command line", "the thesis uses 40")
    sweeps, hashes = load_data(args)
    progress = Progress()
    found = identify(
        sweeps, args.model, args.scheme, args.elements, seed=args.seed,
        progress=lambda what, share: progress(f"{100 * share:3.0f} %  {what}"),
        runs=[{"name": name, "sha256": digest} for name, digest in sorted(hashes.items())],
    )
    progress.close()
    path = save_model(found.model, Path(args.out))
    samples = sum(s.samples for s in sweeps)
    print(f"data      {len(sweeps)} sweeps, {samples} samples, "
          f"{len({s.condition for s in sweeps})} conditions, {sweeps[0].origin}")
    for note in found.left_out:
        print(f"note      {note}")
    print(f"model     {found.model.name}: "
          + ", ".join(f"{s.id}" + (f" ({len(s.elements)} elements)" if s.elements else "")
                      for s in found.model.stages))
    for stage in found.model.stages:
        for name, p in stage.parameters.items():
            interval = f"  [{p.ci95[0]:.4g}, {p.ci95[1]:.4g}]" if p.ci95 else ""
            print(f"          {stage.id} {name} = {p.value:.4g} {p.unit}{interval}")
    print(f"fitted    rms {found.fitted.rms_nm:.2f} nm, largest error "
          f"{found.fitted.max_percent:.2f} % of travel")
    if found.held_out is None:
        print("held out  nothing: the data hold too little to leave some of it out")
    else:
        print(f"held out  by {found.held_out_kind}: rms {found.held_out.rms_nm:.2f} nm, "
              f"largest error {found.held_out.max_percent:.2f} % of travel")
    if found.bands is not None:
        print(f"condition number {found.bands.condition_number:.3g}; 95 % bands by bootstrap")
    print(f"model: {path}")
    return 0
