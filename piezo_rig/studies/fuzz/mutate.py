"""Ways to spoil a file: bytes, numbers, lines and words."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence

LARGEST = 200_000  # bytes; now and then up to LARGEST_AT_ALL
LARGEST_AT_ALL = 900_000
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-1", b"1", b"1e308", b"-1e308", b"1e-320", b"1e999", b"nan", b"inf", b"-0.0",
    b"9223372036854775808", b"4294967296", b"0.1", b"1e6", b"1000000000", b"true", b"\"x\"",
    b"[]", b"{}", b"", b"1,5", b"0x10", b"1_000", b"2147483647",
)  # fmt: skip
_INTEGERS = (0, 1, 0xFF, 0x7F, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0x7FFFFFFFFFFFFFFF,
             0xFFFFFFFFFFFFFFFF, 1 << 20, 1 << 32, 1 << 40)  # fmt: skip

Change = Callable[[random.Random, bytearray, Sequence[bytes]], None]


def spoiled(
    chance: random.Random, data: bytes, others: Sequence[bytes], words: Sequence[bytes]
) -> bytes:
    """``data`` after one to eight changes.

    Parameters
    ----------
    others : further files of the format, for pieces of them
    words : words of the format, for text; empty for binary formats
    """
    out = bytearray(data)
    changes = _BYTES + (_TEXT if words else ())
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 5, 8))):
        change = chance.choice(changes)
        change(chance, out, others if change in (_splice,) else words)
    if chance.random() < 0.002 and out:
        piece = bytes(out[chance.randrange(len(out)) :][:2000]) or b"0"
        at = chance.randrange(len(out) + 1)
        out[at:at] = piece * (chance.randrange(LARGEST_AT_ALL) // len(piece))
    return bytes(out[: LARGEST_AT_ALL if len(out) > LARGEST else LARGEST])


def _place(chance: random.Random, out: bytearray) -> int:
    return chance.randrange(len(out) + 1)


def _flip(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    if out:
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)


def _byte(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    if out:
        out[chance.randrange(len(out))] = chance.choice((0, 255, 10, 34, chance.randrange(256)))


def _integer(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    size = chance.choice((2, 4, 8))
    if len(out) >= size:
        at = chance.randrange(len(out) - size + 1)
        value = chance.choice(_INTEGERS) & ((1 << 8 * size) - 1)
        out[at : at + size] = value.to_bytes(size, "little")


def _cut(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    a, b = sorted((_place(chance, out), _place(chance, out)))
    if chance.random() < 0.7:
        b = min(b, a + chance.randrange(1, 64))
    del out[a:b]


def _truncate(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    del out[_place(chance, out) :]


def _repeat(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    a = _place(chance, out)
    out[a:a] = out[a : a + chance.choice((1, 8, 64, 512))] * chance.choice((1, 1, 3, 50))


def _splice(chance: random.Random, out: bytearray, others: Sequence[bytes]) -> None:
    other = chance.choice(others) if others else b""
    a, b = _place(chance, out), chance.randrange(len(other) + 1)
    out[a : a + chance.choice((0, 16, 128))] = other[b : b + chance.choice((16, 128, 2000))]


def _number(chance: random.Random, out: bytearray, _: Sequence[bytes]) -> None:
    found = list(_NUMBER.finditer(out[:20_000]))
    if found:
        one = chance.choice(found)
        out[one.start() : one.end()] = chance.choice(NUMBERS)


def _word(chance: random.Random, out: bytearray, words: Sequence[bytes]) -> None:
    a = _place(chance, out)
    out[a : a + chance.choice((0, 0, 4, 12))] = chance.choice(words)


def _line(chance: random.Random, out: bytearray, words: Sequence[bytes]) -> None:
    """Move, double, drop or replace a line."""
    lines = bytes(out).split(b"\n")
    a, b = chance.randrange(len(lines)), chance.randrange(len(lines))
    action = chance.randrange(4)
    if action == 0:
        lines.insert(b, lines[a])
    elif action == 1:
        del lines[a]
    elif action == 2:
        lines[a], lines[b] = lines[b], lines[a]
    else:
        lines[a] = chance.choice(words) + lines[a]
    out[:] = b"\n".join(lines)


_BYTES: tuple[Change, ...] = (_flip, _flip, _byte, _integer, _cut, _truncate, _repeat, _splice)
_TEXT: tuple[Change, ...] = (_number, _number, _number, _word, _word, _line, _line)
