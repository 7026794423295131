"""Follows a run that is being recorded, from another terminal; the recording cannot notice.

On a terminal the latest loop is drawn again and again, with its noise and its flags; elsewhere
every sweep is a line. Ends when the run is closed; Ctrl-C ends the watching and nothing else.
Where nothing is being recorded yet, it waits half a minute for a run to begin. After that the
latest run of a folder is shown once, and so is a run that is given by its name and closed already.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from drivers.clock import Clock
    from piezo_rig.run_file.live import Look, Stored
    from piezo_rig.run_file.sweep import Sweep

HELP = "follow a run that is being recorded"
POLL_S = 1.0
WAIT_S = 30.0  # until a run that is begun in another terminal has made its file
PATIENCE = 20  # looks in a row that may fail
STILL_S = 10.0  # without a word before the writer is asked after
FEWEST = 20  # samples of a hold


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN",
                        help="the run (.h5, .part.h5), or the folder that it is recorded in")


def execute(args: argparse.Namespace) -> int:
    import sys
    from pathlib import Path

    from drivers.clock import RealClock

    try:
        follow(Path(args.run), sys.stdout, RealClock())
    except KeyboardInterrupt:
        print("\nwatching ended; the recording goes on")
    return 0


def follow(given: Path, screen: TextIO, clock: Clock) -> None:
    """Wait for a run to begin, and show it until it is closed, or its writer is gone.

    Parameters
    ----------
    given : a run, its part file, or a folder
    screen : where to; a terminal is redrawn
    clock : passes the time between two looks

    Raises
    ------
    InputError : no run, or one that cannot be read
    """
    from piezo_rig.errors import InputError
    from piezo_rig.run_file.live import begun, both_paths, look, writer_is_gone

    if not begun(given) and not _waited(given, screen, clock):
        return
    part, path = both_paths(given)
    shown: _Lines | _Picture = _Picture(screen) if screen.isatty() else _Lines(screen)
    changed: tuple[int, int] | None = None
    still_since = clock.now()
    failed = 0
    while True:
        mark = _mark(part)
        if mark is None or mark != changed:
            try:
                seen = look(path)
                shown.show(seen)
            except InputError:
                failed += 1
                if failed >= PATIENCE or (mark is None and _mark(part) is None):
                    raise
            else:
                failed, changed, still_since = 0, mark, clock.now()
                if not seen.recording:
                    shown.end(seen)
                    return
        elif clock.now() - still_since > STILL_S and writer_is_gone(part):
            shown.gone(part)
            return
        else:
            shown.tick()
        clock.sleep(POLL_S)


def _waited(given: Path, screen: TextIO, clock: Clock) -> bool:
    """Let a run begin, or time pass; False where the operator would not wait."""
    from piezo_rig.run_file.live import begun

    what = "nothing is being recorded there" if given.is_dir() else "not there"
    print(f"{given}: {what}; waiting {WAIT_S:g} s for a run to begin (Ctrl-C ends)", file=screen,
          flush=True)
    until = clock.now() + WAIT_S
    try:
        while not begun(given) and clock.now() < until:
            clock.sleep(POLL_S)
    except KeyboardInterrupt:
        print("\nwaiting ended; nothing has begun", file=screen)
        return False
    return True


def _mark(part: Path) -> tuple[int, int] | None:
    """What changes when a part file does; None where there is none."""
    try:
        stat = part.stat()
    except FileNotFoundError:
        return None
    return stat.st_mtime_ns, stat.st_size


class _Lines:
    """A line for every sweep, for a pipe or a log."""

    def __init__(self, screen: TextIO) -> None:
        self.screen = screen
        self.last = ""
        self.flagged = 0
        self.begun = False

    def say(self, text: str) -> None:
        print(text, file=self.screen, flush=True)

    def show(self, seen: Look) -> None:
        from dataclasses import replace

        from piezo_rig.run_file.live import latest

        new = [s for s in seen.stored if s.name > self.last]
        if not self.begun:
            self.say(f"{_plain(seen.title)}, {seen.origin}: {_state(seen)}")
            if not seen.recording:
                new = new[-1:]
        self.begun = True
        for stored in new:
            count = seen.stored.index(stored) + 1
            sweep, before = latest(replace(seen, stored=seen.stored[:count]))
            self.say(f"{_sweep(stored, sweep, before)}; {count} of {seen.planned}{_left(seen)}")
            self.last = stored.name
        flags = seen.flags()  # they follow their sweep at once, but may miss its line
        for flag in flags[self.flagged:]:
            self.say(_flag(flag))
        self.flagged = len(flags)

    def tick(self) -> None:
        """Nothing new."""

    def end(self, seen: Look) -> None:
        self.say(_end(seen))

    def gone(self, part: Path) -> None:
        self.say(_gone(part))


class _Picture:
    """The latest loop, redrawn."""

    def __init__(self, screen: TextIO) -> None:
        self.screen = screen
        self.seen: Look | None = None
        self.loop: list[str] = []
        self.screen.write("\x1b[2J")

    def show(self, seen: Look) -> None:
        import numpy as np

        from piezo_rig.report.terminal import draw
        from piezo_rig.run_file.live import latest

        last, before = latest(seen)
        self.seen, self.loop = seen, []
        if last is not None:
            drive, moved = last.drive_v, last.displacement_um
            good = np.isfinite(drive) & np.isfinite(moved)
            if good.sum() > 1:
                self.loop += [draw(drive[good], moved[good], width=60, height=16, x_label="V",
                                   y_label=f"displacement of {_plain(last.condition)}, um"), ""]
            self.loop += [_sweep(seen.stored[-1], last, before)]
        self.tick()

    def tick(self) -> None:
        """The same with the time that is left now."""
        seen = self.seen
        if seen is None:
            return
        flagged = len(seen.flags())
        lines = [f"{_plain(seen.title)}  {seen.origin}  {_state(seen)}", "", *self.loop]
        if seen.stored:
            lines.append(_flags(seen, seen.stored[-1].name))
        lines.append(f"{len(seen.stored)} of {seen.planned} sweeps{_left(seen)}"
                     + (f"; {flagged} flags in all" if flagged else ""))
        if seen.recording:
            lines.append(_plain(seen.doing))
        # home, each line cleared to its end, and what was below it
        body = "\n".join(f"{line}\x1b[K" for line in "\n".join(lines).split("\n"))
        self.screen.write(f"\x1b[H{body}\n\x1b[J")
        self.screen.flush()

    def end(self, seen: Look) -> None:
        print(_end(seen), file=self.screen, flush=True)

    def gone(self, part: Path) -> None:
        print(_gone(part), file=self.screen, flush=True)


def _state(seen: Look) -> str:
    if seen.recording:
        return f"recording, {len(seen.stored)} of {seen.planned} sweeps stored"
    return f"closed, {'complete' if seen.closed_whole else 'INCOMPLETE'}"


def _sweep(stored: Stored, sweep: Sweep | None, before: Sweep | None) -> str:
    """One sweep in a line: what was played, how far it went, how quiet it is."""
    import numpy as np

    line = f"{stored.name}  {_plain(stored.condition)}, repeat {stored.repeat}"
    if sweep is None:
        return line
    drive, moved = sweep.drive_v, sweep.displacement_um
    if not (np.isfinite(drive).all() and np.isfinite(moved).all()):
        return f"{line}: samples are missing"
    return (f"{line}: {drive.min():.2f} .. {drive.max():.2f} V, travel {np.ptp(moved):.3f} um, "
            f"{noise(sweep, before)}")


def noise(sweep: Sweep, before: Sweep | None) -> str:
    """How quiet a sweep is: against its last repeat, else at its longest hold, nm."""
    import numpy as np

    moved = sweep.displacement_um
    if before is not None and before.samples == sweep.samples:
        apart = moved - before.displacement_um
        return f"noise {1e3 * float(np.std(apart)) / np.sqrt(2.0):.1f} nm between repeats"
    a, b = longest_hold(sweep.drive_v)
    if b - a < FEWEST:
        return "noise: needs a repeat or a hold"
    t = np.arange(b - a, dtype=float)
    held = moved[a:b]
    rest = held - np.polynomial.Polynomial.fit(t, held, 1)(t)
    return f"noise {1e3 * float(np.std(rest)):.1f} nm at a hold"


def longest_hold(drive_v: np.ndarray) -> tuple[int, int]:
    """First sample, and one past the last, of the longest stretch at one drive."""
    import numpy as np

    edges = np.concatenate([[0], np.flatnonzero(np.diff(drive_v)) + 1, [drive_v.size]])
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]), int(edges[k + 1])


def _flags(seen: Look, sweep: str) -> str:
    return "\n".join(map(_flag, seen.flags(sweep))) or "no flags of beam, sensor or drive"


def _flag(event: dict[str, Any]) -> str:
    code, sweep, what = (_plain(event.get(k, "")) for k in ("code", "sweep", "what"))
    return f"flag[{code}]: {sweep}: {what}"


def _left(seen: Look) -> str:
    import time

    from piezo_rig.commands.console import seconds

    left = seen.seconds_left(time.time())
    return "" if left is None else f", about {seconds(left)} left"


def _end(seen: Look) -> str:
    said = f"run: {seen.path} ({_state(seen)}, {len(seen.stored)} of {seen.planned} sweeps)"
    return said if seen.closed_whole or not seen.doing else f"{said}\n{_plain(seen.doing)}"


def _gone(part: Path) -> str:
    return (f"{part}: no program records it any more; it was killed. What is stored is kept: the "
            "next 'piezo-rig run' in that folder closes it")


def _plain(value: object) -> str:
    """A text of the file as one line that does nothing to a terminal."""
    return "".join(c if c.isprintable() else "?" for c in str(value)[:300])
