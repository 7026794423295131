"""The guard's watch: passes the runner's bytes on and listens for signs of life.

    passing on --(runner says finished)--> end
    passing on --(runner gone or silent), never armed--> end, nothing touched
    passing on --(runner gone or silent), armed--> rest --> report --> end

One thing at a time: while a read from the generator is under way, nobody listens for
signs of life, because the generator is at work and the runner waits for it.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.errors import InstrumentError
from drivers.transport import Transport, open_transport
from piezo_rig.guard import frames
from piezo_rig.guard.frames import Kind
from piezo_rig.guard.orders import Orders, Report
from piezo_rig.guard.rest import bring_to_rest

Opener = Callable[[str, str, float], Transport]

GONE = "the runner is gone"
SILENT = "the runner stood still"


class Watch:
    """One watch, from the start of the guard to its end.

    Parameters
    ----------
    runner : socket to the runner
    beats : descriptor of a pipe: an empty line is a sign of life, ``arm SERIAL`` and
        ``step NAME`` are one too
    opener : opens the generator's line
    """

    def __init__(
        self, runner: socket.socket, beats: int, orders: Orders, opener: Opener = open_transport
    ) -> None:
        self._runner = runner
        self._beats = beats
        self._orders = orders
        self._opener = opener
        self._generator: Transport | None = None
        self._serial: str | None = None  # of the generator that may be moved
        self._step = "starting"
        self._owed_s = 0.0  # timeout of an answer that is still to come; 0: none
        self._broken = False  # the last transfer failed: the line may hold anything
        self._finished = False
        self._unread = b""
        runner.settimeout(orders.silence_s)
        os.set_blocking(beats, False)

    def keep(self) -> Report | None:
        """Watch until the runner is done (None) or was given up (what was done about it)."""
        reason = self._pass_on()
        if not self._finished:
            self._hear()  # what it said last
        if self._finished or self._serial is None:
            report = None
        else:
            report = self._take_over(reason)
        if self._generator is not None:
            self._generator.close()
        return report

    # -------------------------------------------------------------- passing on

    def _pass_on(self) -> str:
        """Serve the runner until it is finished, gone or silent; why."""
        heard = time.monotonic()
        while not self._finished:
            left = heard + self._orders.silence_s - time.monotonic()
            either: list[Any] = [self._runner, self._beats]
            ready = select.select(either, [], [], max(0.0, left))[0]
            if not ready and self._serial is not None:
                return SILENT
            if self._beats in ready and not self._hear():
                return GONE
            if self._runner in ready:
                try:
                    frame = frames.receive(self._runner)
                except (TimeoutError, ValueError):  # half a frame, or none that is known
                    return SILENT
                if frame is None:
                    return GONE
                try:
                    self._serve(*frame)
                except OSError:
                    return GONE
                except Exception as error:  # a fault of the guard's own must not end the watch
                    self._broken = True
                    return f"the guard could not serve the runner ({error!r})"
            heard = time.monotonic()
        return ""

    def _hear(self) -> bool:
        """Read the signs of life; False when there will be none any more."""
        try:
            data = os.read(self._beats, 1 << 16)
        except BlockingIOError:
            return True
        *lines, self._unread = (self._unread + data).split(b"\n")
        for line in lines:
            word, _, rest = line.decode().partition(" ")
            if word == "arm":
                self._serial = rest
            elif word == "step":
                self._step = rest
        return bool(data)

    def _serve(self, kind: Kind, seconds: float, payload: bytes) -> None:
        try:
            answer = self._do(kind, seconds, payload)
        except InstrumentError as error:
            self._broken = True
            frames.send(self._runner, Kind.FAILED, 0.0, frames.pack_error(error))
        else:
            frames.send(self._runner, Kind.DONE, 0.0, answer)

    def _do(self, kind: Kind, seconds: float, payload: bytes) -> bytes:
        if kind == Kind.FINISHED:
            self._finished = True
            return b""
        if kind == Kind.OPEN or self._generator is None:
            self._generator = self._opener(self._orders.address, "waveform_dac", seconds)
            return b""
        line = self._generator
        line.timeout_s = seconds
        if kind == Kind.REOPEN:
            line.reopen()
            self._owed_s, self._broken = 0.0, False
        elif kind == Kind.WRITE:
            self._owed_s = seconds if asks(payload) else 0.0
            line.write(payload)
        elif kind == Kind.UNTIL:
            answer = line.read_until(payload)
            self._owed_s = 0.0
            return answer
        elif kind == Kind.EXACTLY:
            return line.read_exactly(int(payload))
        elif kind == Kind.SOME:
            return line.read_some()
        elif kind == Kind.UNASKED:
            return line.take_unasked()
        return b""

    # ------------------------------------------------------------- taking over

    def _take_over(self, reason: str) -> Report:
        report = Report(reason=reason, step=self._step, at_rest=False)
        try:
            moved = bring_to_rest(self._clean_line(), self._orders, self._serial or "")
        except InstrumentError as error:
            report = replace(report, failure=str(error))
        else:
            report = replace(
                report, at_rest=True, from_v=moved["from_v"], to_v=moved["to_v"],
                duration_s=moved["duration_s"],
            )
        report = replace(report, wall_time=datetime.now(UTC).isoformat(timespec="seconds"))
        self._tell(report)
        return report

    def _clean_line(self) -> Transport:
        """The generator's line with nothing on its way."""
        line = self._generator
        assert line is not None  # it was armed over this line
        broken = self._broken
        if self._owed_s and not broken:
            line.timeout_s = self._owed_s
            try:
                line.read_until(b"\n")
            except InstrumentError:
                broken = True
        line.timeout_s = self._orders.timeout_s
        if broken:
            with contextlib.suppress(InstrumentError):
                line.reopen()
        return line

    def _tell(self, report: Report) -> None:
        """The runner, if it wakes up; the file; the terminal. None of them may be there."""
        with contextlib.suppress(OSError):
            frames.send(self._runner, Kind.TAKEN, 0.0, report.to_json().encode())
        with contextlib.suppress(OSError):
            print(f"\nguard: {report.sentence()}", file=sys.stderr, flush=True)
        if self._orders.report:
            with contextlib.suppress(OSError):
                Path(self._orders.report).write_text(report.to_json() + "\n", encoding="utf-8")


def asks(message: bytes) -> bool:
    """Whether a message has an answer; a question mark inside a block does not count."""
    return b"?" in message.partition(b",#")[0]
