"""Fits a model to runs and recordings, and says how good it is on data it has not seen.

With a folder as --out every file is identified by itself, in parallel.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

HELP = "fit a model to runs and recordings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from piezo_rig.commands.data_options import add_data_arguments

    add_data_arguments(parser)
    parser.add_argument("--model", metavar="NAME", required=True,
                        help="classical, initiation, range, extremum, range-extremum, ...")
    parser.add_argument("--out", metavar="MODEL.json", required=True,
                        help="a folder (it exists, or ends in /): one model for every file")
    parser.add_argument("--scheme", choices=("least-squares", "slopes"), default="least-squares")
    parser.add_argument("--elements", type=int, metavar="N",
                        help="default: chosen by held-out data (least squares), 40 (slopes)")
    parser.add_argument("--seed", type=int, default=0, help="of the bootstrap")


def execute(args: argparse.Namespace) -> int:
    from pathlib import Path

    from piezo_rig.commands.console import Progress
    from piezo_rig.errors import InputError

    if args.elements is not None and not 1 <= args.elements <= 500:
        raise InputError("usage", f"--elements {args.elements}: expected 1 to 500",
                         "a slip on the command line", "the thesis uses 40")
    if args.out.endswith(("/", "\\")) or Path(args.out).is_dir():
        return _every_file(args, Path(args.out))
    progress = Progress()
    try:
        print(_identified(
            args, Path(args.out), lambda what, share: progress(f"{100 * share:3.0f} %  {what}")
        ))
    finally:
        progress.close()
    return 0


def _identified(args: argparse.Namespace, out: Path, tell: object = None) -> str:
    """Identify all of ``args.data`` together; returns the report."""
    from piezo_rig.commands.data_options import load_data
    from piezo_rig.identification import identify, save_model

    sweeps, hashes = load_data(args)
    found = identify(
        sweeps, args.model, args.scheme, args.elements, seed=args.seed,
        progress=tell,  # type: ignore[arg-type]
        runs=[{"name": name, "sha256": digest} for name, digest in sorted(hashes.items())],
    )
    path = save_model(found.model, out)
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
    return "\n".join([*lines, f"model: {path}"])


def _alone(args: argparse.Namespace, name: str, out: Path) -> tuple[str, str, int]:
    """One file by itself, in a process of its own: name, report, exit status."""
    import contextlib
    import io

    from piezo_rig.errors import PiezoRigError

    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            report = _identified(argparse.Namespace(**{**vars(args), "data": [name]}), out)
    except PiezoRigError as error:
        return name, error.block(), error.exit_status
    return name, said.getvalue() + report, 0


def _every_file(args: argparse.Namespace, folder: Path) -> int:
    """Each file to its own model; one that cannot be identified stops none of the others."""
    import os
    import sys
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context
    from pathlib import Path

    from piezo_rig.commands.console import Progress
    from piezo_rig.errors import BenchError, InputError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError("disk", f"could not make {folder}: {error.strerror or error}",
                         "the name is taken, or the folder above is not yours to write",
                         "give another --out") from None
    stems = [Path(name).stem for name in args.data]
    if len(set(stems)) != len(stems):
        raise InputError("usage", "two files have the same name, so their models would too",
                         "files of one name from different folders", "rename one of them")
    plain = argparse.Namespace(**{k: v for k, v in vars(args).items() if k != "execute"})
    progress, status, results = Progress(), 0, {}
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        waiting = [
            pool.submit(_alone, plain, name, folder / f"{stem}_{args.model}.json")
            for name, stem in zip(args.data, stems, strict=True)
        ]
        for done, future in enumerate(as_completed(waiting), start=1):
            name, report, code = future.result()
            results[name] = (report, code)
            progress(f"{done} of {len(waiting)} files")
    progress.close()
    for name in args.data:
        report, code = results[name]
        status = max(status, code)
        print(f"== {name}" if not code else f"== {name}: failed")
        print(report, file=sys.stderr if code else sys.stdout)
    print(f"{sum(not code for _, code in results.values())} of {len(results)} identified; "
          f"models: {folder}")
    return status
