"""No verb writes over what it reads, or a file in place of a folder."""

from __future__ import annotations

import argparse
import os

INPUTS = ("data", "file", "files", "drive", "runs", "run", "protocol", "rig", "target", "points",
          "update")  # fmt: skip
NAMES_OR_FILES = ("model", "baseline")  # a name such as `range` is no file, whatever lies about
ONE_FILE = ("calibrate", "compensate", "import", "simulate")  # verbs whose --out is never a folder
OUTPUTS = ("out", "json", "report", "save_model", "figure", "record", "config_out")


def refuse_overwriting(args: argparse.Namespace) -> None:
    """Raise InputError where an output of a verb is one of its inputs, by whatever name."""
    from piezo_rig.errors import InputError

    given = vars(args)
    inputs: list[str] = []
    for name in INPUTS:
        value = given.get(name)
        values = value if isinstance(value, list) else [value]
        inputs += [v for v in values if isinstance(v, str)]
    for name in NAMES_OR_FILES:
        value = given.get(name)
        inputs += [value] if isinstance(value, str) and os.path.splitext(value)[1] else []
    for name in OUTPUTS:
        out = given.get(name)
        if not isinstance(out, str):
            continue
        for path in inputs:
            if _same(path, out):
                raise InputError(
                    "overwrites-input",
                    f"--{name.replace('_', '-')} {out} is the input {path}",
                    "a slip on the command line; nothing was read or written",
                    "give another name to write to",
                )


def refuse_folders(args: argparse.Namespace) -> None:
    """Raise InputError where a folder stands for the one file that a verb writes."""
    from piezo_rig.errors import InputError

    if args.verb in ONE_FILE and os.path.isdir(args.out):
        raise InputError("usage", f"--out {args.out}: a folder, not a file",
                         "a slip on the command line; nothing was read or written",
                         f"give a file, such as {os.path.join(args.out, 'NAME')}")


def _same(path: str, out: str) -> bool:
    """Whether both are one file that exists; a folder is no file."""
    try:
        return os.path.isfile(out) and os.path.samefile(path, out)
    except (OSError, ValueError):
        return False
