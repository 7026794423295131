"""What runner and guard say to each other: one kind, one number, some bytes.

A frame that is cut short, because the runner died while it sent it, is no
frame: half a message never reaches the generator.
"""

from __future__ import annotations

import json
import socket
import struct
from enum import IntEnum

from drivers.errors import InstrumentError

_HEAD = struct.Struct("<BdI")  # kind, seconds, length of what follows
LONGEST = 1 << 28


class Kind(IntEnum):
    """Requests of the runner, each answered once; then the guard's answers."""

    OPEN = 1  # open the line
    WRITE = 2  # send these bytes to the generator
    UNTIL = 3  # receive up to and including these bytes
    EXACTLY = 4  # receive as many bytes as this decimal number says
    REOPEN = 5  # close the line and open it again
    FINISHED = 6  # the stack is at rest, or was never moved: the guard may go
    SOME = 7  # receive what there is, at least one byte
    UNASKED = 8  # take what has come without being asked for
    DONE = 16  # with what was received
    FAILED = 17  # with an InstrumentError
    TAKEN = 18  # unasked: the guard has taken over, with its report


def send(line: socket.socket, kind: Kind, seconds: float = 0.0, payload: bytes = b"") -> None:
    """Send one frame; OSError when the other side is gone or does not read."""
    line.sendall(_HEAD.pack(kind, seconds, len(payload)) + payload)


def receive(line: socket.socket) -> tuple[Kind, float, bytes] | None:
    """One frame, or None when the other side is gone; TimeoutError as the socket is set."""
    head = _exactly(line, _HEAD.size)
    if head is None:
        return None
    kind, seconds, length = _HEAD.unpack(head)
    payload = _exactly(line, length) if length <= LONGEST else None
    return None if payload is None else (Kind(kind), seconds, payload)


def _exactly(line: socket.socket, count: int) -> bytes | None:
    data = bytearray()
    while len(data) < count:
        try:
            part = line.recv(min(count - len(data), 1 << 20))
        except ConnectionError:
            return None
        if not part:
            return None
        data += part
    return bytes(data)


def pack_error(error: InstrumentError) -> bytes:
    return json.dumps([error.code, error.what, error.cause, error.remedy]).encode()


def unpack_error(payload: bytes, instrument: str) -> InstrumentError:
    code, what, cause, remedy = json.loads(payload)
    return InstrumentError(code, instrument, what, cause, remedy)
