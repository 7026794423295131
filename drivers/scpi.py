"""SCPI on the wire, without any wire: bytes in, messages out.

Shared by the drivers and the simulated instruments, which makes it the only
place that knows how a message is framed. It performs no I/O, holds no clock
and knows no instrument. A malformed message is a `ScpiSyntaxError` carrying
the SCPI error number that an instrument would queue for it.

Sources: IEEE 488.2-1992 sections 7 and 8 (syntax, blocks), SCPI-1999 volume 1
sections 5 and 6 (mnemonics, compound headers) and volume 2 section 21
(error queue).
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from functools import lru_cache

MAX_MESSAGE_BYTES = 64 * 1024 * 1024

_INTERESTING = re.compile(rb"[\n#'\"]")
_MNEMONIC = re.compile(r"[A-Z]+[a-z]*|[0-9]+|[:\[\]*?_]|[a-z]+")


class ScpiSyntaxError(ValueError):
    """A message that breaks the syntax; ``code`` is the SCPI error number."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code
        self.text = text


# ---------------------------------------------------------------- blocks


def encode_block(payload: bytes | memoryview, digits: int = 0) -> bytes:
    """A definite-length block: ``#``, the number of digits, the length, the payload.

    ``digits`` pads the length with zeros to that many digits (some instruments
    always send ``#9``).
    """
    size = len(payload) if isinstance(payload, bytes) else payload.nbytes
    length = str(size).rjust(digits, "0")
    if len(length) > 9:
        raise ScpiSyntaxError(-161, f"a block cannot hold {size} bytes")
    return b"#%d%s" % (len(length), length.encode()) + bytes(payload)


class BlockParser:
    """Takes in one definite-length block piece by piece.

    ``needed`` is the number of bytes that may be fed next without running past
    the end of the block; 0 when the block is complete and ``payload`` holds it.
    """

    def __init__(self) -> None:
        self._header = b""
        self._body = bytearray()
        self._size: int | None = None

    @property
    def needed(self) -> int:
        if self._size is not None:
            return self._size - len(self._body)
        if len(self._header) < 2:
            return 2 - len(self._header)
        return 2 + int(self._header[1:2]) - len(self._header)

    @property
    def begun(self) -> bool:
        """Whether anything was fed."""
        return bool(self._header)

    @property
    def size(self) -> int | None:
        """The length that the header announces; None until the header is complete."""
        return self._size

    @property
    def payload(self) -> bytes:
        return bytes(self._body)

    def feed(self, data: bytes) -> None:
        """Add bytes, at most ``needed``; ScpiSyntaxError when this is no block."""
        if len(data) > self.needed:
            raise ScpiSyntaxError(-161, "bytes beyond the end of the block")
        if self._size is not None:
            self._body += data
            return
        self._header += data
        head = self._header
        if head[:1] != b"#" or (len(head) > 1 and not b"1" <= head[1:2] <= b"9"):
            raise ScpiSyntaxError(-161, f"no block header: {head!r}")
        if not head[2:].isdigit() and len(head) > 2:
            raise ScpiSyntaxError(-161, f"no block length: {head!r}")
        if len(head) > 2 and len(head) == 2 + int(head[1:2]):
            self._size = int(head[2:])


def block_end(data: bytes | bytearray, start: int) -> int | None:
    """Where the block that begins at ``data[start]`` ends.

    None when more bytes are needed to tell; ``start`` itself when the ``#`` does
    not begin a definite-length block (a hexadecimal number, an indefinite block).
    """
    if len(data) < start + 2:
        return None
    digit = data[start + 1]
    if not 0x31 <= digit <= 0x39:
        return start
    body = start + 2 + digit - 0x30
    length = bytes(data[start + 2 : body])
    if length and not length.isdigit():
        return start
    return body + int(length) if len(data) >= body else None


# -------------------------------------------------------------- messages


class MessageSplitter:
    """Cuts a byte stream into program messages at line feeds outside blocks.

    Several messages in one packet and one message over several packets both
    work; carriage returns before the line feed are dropped, empty lines too.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._scanned = 0  # everything before this index has been looked at
        self._protected = 0  # everything before this index may belong to a block

    def feed(self, data: bytes) -> list[bytes]:
        """The messages that ``data`` completes, without their terminators."""
        self._buffer += data
        messages: list[bytes] = []
        while True:
            found = _INTERESTING.search(self._buffer, self._scanned)
            if found is None:
                self._scanned = len(self._buffer)
                break
            mark, at = found.group(), found.start()
            if mark == b"\n":
                carriage = at > self._protected and self._buffer[at - 1 : at] == b"\r"
                messages.append(bytes(self._buffer[: at - carriage]))
                del self._buffer[: at + 1]
                self._scanned = self._protected = 0
            elif mark == b"#":
                end = block_end(self._buffer, at)
                if end is None or end > len(self._buffer):
                    self._scanned = at
                    break
                self._scanned = self._protected = max(end, at + 1)
            else:
                closing = self._buffer.find(mark, at + 1)
                newline = self._buffer.find(b"\n", at + 1)
                if closing < 0 and newline < 0:
                    self._scanned = at
                    break
                # A quote that the line feed cuts off ends with the message.
                broken = closing < 0 or 0 <= newline < closing
                self._scanned = newline if broken else closing + 1
        if len(self._buffer) > MAX_MESSAGE_BYTES:
            self._buffer.clear()
            self._scanned = self._protected = 0
            raise ScpiSyntaxError(-363, "Input buffer overrun")
        return [message for message in messages if message.strip()]


def split_outside(data: bytes, separator: bytes) -> list[bytes]:
    """Split at ``separator`` outside quotes, parentheses and blocks."""
    parts: list[bytes] = []
    pattern = re.compile(b"[()'\"#" + re.escape(separator) + b"]")
    begin = at = depth = 0
    while (found := pattern.search(data, at)) is not None:
        mark, at = found.group(), found.end()
        if mark == b"(":
            depth += 1
        elif mark == b")":
            depth = max(0, depth - 1)
        elif mark == b"#":
            at = max(block_end(data, found.start()) or at, at)
        elif mark in (b"'", b'"'):
            closing = data.find(mark, at)
            at = len(data) if closing < 0 else closing + 1
        elif depth == 0:
            parts.append(data[begin : found.start()])
            begin = at
    parts.append(data[begin:])
    return parts


@dataclass(frozen=True)
class Unit:
    """One command or query of a program message, its header made absolute."""

    header: str  # upper case, no leading colon, no question mark
    query: bool
    arguments: tuple[bytes, ...]
    written: str = ""  # the header as it stood, before the path was put in front

    def text(self, index: int) -> str:
        """An argument as text; ScpiSyntaxError -109 when it is missing."""
        if index >= len(self.arguments):
            raise ScpiSyntaxError(-109, "Missing parameter")
        return self.arguments[index].decode("latin-1").strip()


def parse_message(message: bytes) -> list[Unit]:
    """The units of a program message, after SCPI's rules for compound headers.

    A header without a leading colon continues the path of the one before it,
    common commands (``*...``) leave the path alone, a leading colon returns to
    the root.
    """
    units = []
    path = ""
    for part in split_outside(message, b";"):
        # Trailing bytes may belong to a block: only the front is stripped here.
        words = part.lstrip().split(maxsplit=1)
        if not words:
            continue
        header = words[0].decode("latin-1").upper()
        query = header.endswith("?")
        header = written = header.rstrip("?")
        if not header.startswith("*"):
            if header.startswith(":"):
                header = header[1:]
            elif path:
                header = f"{path}:{header}"
            path = header.rpartition(":")[0]
        rest = words[1] if len(words) > 1 else b""
        arguments = tuple(_trim(item) for item in split_outside(rest, b",")) if rest else ()
        if any(not item for item in arguments):
            raise ScpiSyntaxError(-103, "Invalid separator")
        units.append(Unit(header, query, arguments, written))
    return units


def _trim(argument: bytes) -> bytes:
    argument = argument.lstrip()
    end = block_end(argument, 0) if argument[:1] == b"#" else 0
    if end and end <= len(argument):
        return argument[:end] + argument[end:].rstrip()
    return argument.rstrip()


def block_argument(argument: bytes) -> bytes:
    """The payload of a block argument; ScpiSyntaxError -161 when it is damaged."""
    end = block_end(argument, 0) if argument[:1] == b"#" else 0
    if not end or end != len(argument):
        raise ScpiSyntaxError(-161, "Invalid block data")
    return argument[2 + argument[1] - 0x30 :]


def split_answers(line: str) -> list[str]:
    """The answers of a compound query, split at semicolons outside quotes."""
    return [part.decode("latin-1").strip() for part in split_outside(line.encode("latin-1"), b";")]


# -------------------------------------------------------------- mnemonics


@lru_cache(maxsize=1024)
def header_pattern(pattern: str) -> re.Pattern[str]:
    """Compile ``[SOURce[1]:]VOLTage[:LEVel]:HIGH`` into what headers it stands for.

    Capitals are the short form, brackets are optional; matched without case.
    """
    out = []
    for token in _MNEMONIC.findall(pattern):
        if token == "[":
            out.append("(?:")
        elif token == "]":
            out.append(")?")
        elif token.isalpha() and not token.isupper():
            short = token.rstrip("abcdefghijklmnopqrstuvwxyz")
            out.append(f"{short}(?:{token[len(short) :]})?")
        else:
            out.append(re.escape(token))
    return re.compile("".join(out) + r"\Z", re.IGNORECASE)


def matches(pattern: str, word: str) -> bool:
    """Whether a header or a parameter word is one of the forms of ``pattern``."""
    return header_pattern(pattern).match(word) is not None


def short_form(pattern: str) -> str:
    """``NORMal`` -> ``NORM``: what an instrument answers."""
    return "".join(ch for ch in pattern if not ch.islower())


# ----------------------------------------------------------- error queue


@dataclass(frozen=True)
class ErrorEntry:
    """One entry of an instrument's error queue; code 0 means that it is empty."""

    code: int
    text: str

    def __str__(self) -> str:
        return f'{self.code:+d},"{self.text}"'


NO_ERROR = ErrorEntry(0, "No error")
QUEUE_OVERFLOW = ErrorEntry(-350, "Queue overflow")
_ENTRY = re.compile(r"\s*([+-]?\d+)(?:\.0*)?\s*(?:,\s*(.*))?\Z", re.DOTALL)


def parse_error_entry(answer: str) -> ErrorEntry:
    """Read ``-222,"Data out of range"``; ScpiSyntaxError when it is nothing of the kind."""
    found = _ENTRY.match(answer)
    if found is None:
        raise ScpiSyntaxError(-102, f"no error entry: {answer!r}")
    return ErrorEntry(int(found.group(1)), (found.group(2) or "").strip().strip('"'))


def event_status_bit(code: int) -> int:
    """The bit of the standard event status register that an error number sets, as a mask."""
    if code == 0:
        return 0
    if -200 < code <= -100:
        return 1 << 5
    if -300 < code <= -200:
        return 1 << 4
    if -500 < code <= -400:
        return 1 << 2
    return 1 << 3


class ErrorQueue:
    """First in, first out; the entry that overfills it becomes ``Queue overflow``."""

    def __init__(self, capacity: int = 20) -> None:
        self._capacity = capacity
        self._entries: deque[ErrorEntry] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def push(self, entry: ErrorEntry) -> None:
        if len(self._entries) < self._capacity:
            self._entries.append(entry)
        else:
            self._entries[-1] = QUEUE_OVERFLOW

    def pop(self) -> ErrorEntry:
        return self._entries.popleft() if self._entries else NO_ERROR

    def clear(self) -> None:
        self._entries.clear()
