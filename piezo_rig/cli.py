"""The command line: parses, composes, prints, nothing else.

Each verb is one file in ``piezo_rig/commands``. Their parsers are cheap;
whatever is heavy is imported by the verb when it runs, so that ``--help``
answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import importlib
import io
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

from piezo_rig import __version__
from piezo_rig.commands.outputs import refuse_folders, refuse_overwriting
from piezo_rig.errors import ABORTED, BAD_INPUT, INSTRUMENT, InputError, PiezoRigError

# verb -> the file in piezo_rig/commands that does it
VERBS = {
    "plan": "plan",
    "run": "run",
    "import": "import_recordings",
    "identify": "identify",
    "simulate": "simulate",
    "compensate": "compensate",
    "diagnose": "diagnose",
    "challenge": "challenge",
    "bench": "bench",
    "show": "show",
    "verify": "verify",
    "calibrate": "calibrate",
    "doctor": "doctor",
    "replay": "replay",
    "export": "export",
    "watch": "watch",
}


class _Parser(argparse.ArgumentParser):
    """argparse's complaints in the shape of every other error."""

    def error(self, message: str) -> Any:
        raise InputError(
            "usage", f"{self.prog}: {message}", "a slip on the command line",
            f"see '{self.prog} --help'",
        )


def build_parser() -> argparse.ArgumentParser:
    """The parser with all verbs."""
    parser = _Parser(
        prog="piezo-rig",
        description="Plays protocols on a piezo bench, identifies hysteresis models, and names "
        "what the model gets wrong and why.",
    )
    parser.add_argument("--version", action="version", version=f"piezo-rig {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", parser_class=_Parser)
    for name, file in VERBS.items():
        module = importlib.import_module(f"piezo_rig.commands.{file}")
        sub = verbs.add_parser(name, help=module.HELP, description=module.__doc__)
        module.add_arguments(sub)
        sub.set_defaults(execute=module.execute)
    return parser


def _told_to_end(number: int, frame: object) -> None:
    """As Ctrl-C, with who it was."""
    raise KeyboardInterrupt(f"{signal.Signals(number).name}: a time limit, or another program")


def program() -> None:
    """The installed command: ``main`` in a process of its own."""
    # HDF5 complains about a full disk once more while its objects are thrown away, past every
    # ``except``. What went wrong has been said by then.
    sys.excepthook = lambda *_: None
    sys.unraisablehook = lambda _: None
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _told_to_end)  # ends the program as Ctrl-C does
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # What an instrument calls itself need not fit into the terminal's character set.
            stream.reconfigure(errors="backslashreplace")
    status = main()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # the terminal was closed; the status still tells what happened
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # Nothing is left to do but to throw away modules and compiled code one by one, which takes half
    # a second. A disk that failed under HDF5 makes its clean-up fail too, with a crash.
    if status != INSTRUMENT:
        atexit._run_exitfuncs()
    os._exit(status)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status."""
    try:
        parser = build_parser()
        args = parser.parse_args(argv)
        if not args.verb:
            parser.print_help()
            return BAD_INPUT
        refuse_overwriting(args)
        refuse_folders(args)
        status = int(args.execute(args))
        sys.stdout.flush()
        return status
    except PiezoRigError as error:
        _say(error.block())
        return error.exit_status
    except KeyboardInterrupt as stopped:
        _say(f"error[aborted]: stopped by {str(stopped) or 'the operator'}")
        return ABORTED
    except BrokenPipeError:
        # Whoever read our output has gone; say nothing more, not even while shutting down.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BAD_INPUT
    except Exception as error:  # the last net: a technician never sees a traceback
        _say(_internal(error))
        return BAD_INPUT


def _say(text: str) -> None:
    """To stderr, if anybody is there to read it."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def _internal(error: Exception) -> str:
    import traceback

    with tempfile.NamedTemporaryFile(
        "w", prefix="piezo-rig-", suffix=".log", delete=False, encoding="utf-8"
    ) as handle:
        traceback.print_exception(error, file=handle)
    return (
        f"error[internal]: {type(error).__name__}: {error}\n"
        "  cause: a fault in piezo-rig, or input that nobody thought of\n"
        f"  do:    report it with the file {handle.name}"
    )
