"""What SCPI parameters mean: numbers, booleans, words, channel lists, and when two agree.

No I/O and no instrument, like `drivers.scpi`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from drivers.scpi import ScpiSyntaxError, header_pattern, matches, short_form

INFINITE = 9.9e37
"""SCPI's stand-in for infinity (SCPI-1999 volume 1, 7.2.1.4)."""
NO_DATA = 9.91e37
"""SCPI's stand-in for not-a-number."""

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:\s*[eE]\s*[+-]?\d+)?)\s*([A-Za-z]*)\Z")
_BASES = {"H": 16, "Q": 8, "B": 2}
# IEEE 488.2 table 7-2; M before HZ and OHM is mega, elsewhere milli.
_PREFIX = {"": 1.0, "K": 1e3, "MA": 1e6, "G": 1e9, "M": 1e-3, "U": 1e-6, "N": 1e-9}
_UNITS = ("VPP", "HZ", "OHM", "PCT", "DEG", "S", "V", "SA")


def parse_number(text: str, words: dict[str, float] | None = None) -> float:
    """A decimal, hexadecimal, octal or binary number, with or without a unit.

    ``words`` gives the values of MINimum, MAXimum, DEFault and the like.
    ScpiSyntaxError: -104 for something that is no number, -131 for a wrong suffix.
    """
    text = text.strip()
    for word, value in (words or {}).items():
        if matches(word, text):
            return value
    if matches("INFinity", text):
        return INFINITE
    if matches("NINFinity", text):
        return -INFINITE
    if text[:1] == "#" and text[1:2].upper() in _BASES:
        try:
            return float(int(text[2:], _BASES[text[1].upper()]))
        except ValueError:
            raise ScpiSyntaxError(-104, "Data type error") from None
    found = _NUMBER.match(text)
    if found is None:
        raise ScpiSyntaxError(-104, "Data type error")
    value = float(found.group(1).replace(" ", ""))
    return value * _scale(found.group(2).upper())


def _scale(suffix: str) -> float:
    if not suffix:
        return 1.0
    for unit in _UNITS:
        if suffix.endswith(unit):
            prefix = suffix[: -len(unit)]
            if prefix == "M" and unit in ("HZ", "OHM", "SA"):
                prefix = "MA"
            if prefix in _PREFIX:
                return _PREFIX[prefix]
    raise ScpiSyntaxError(-131, "Invalid suffix")


def parse_boolean(text: str) -> bool:
    """ON, OFF or a number, where anything that rounds to zero is OFF."""
    word = text.strip().upper()
    if word in ("ON", "TRUE"):
        return True
    if word in ("OFF", "FALSE"):
        return False
    return abs(parse_number(word)) >= 0.5


def unquote(text: str) -> str:
    """The text without the quotes around it, doubled quotes inside made single."""
    text = text.strip()
    if len(text) >= 2 and text[0] in "'\"" and text[-1] == text[0]:
        return text[1:-1].replace(text[0] * 2, text[0])
    return text


def parse_word(text: str, choices: Iterable[str]) -> str:
    """The short form of the choice that ``text`` stands for; ScpiSyntaxError -224 if none."""
    for choice in choices:
        if header_pattern(choice).match(unquote(text)):
            return short_form(choice)
    raise ScpiSyntaxError(-224, "Illegal parameter value")


def parse_channel_list(text: str) -> list[int]:
    """``(@1,3:5)`` or ``(@2)`` -> channel numbers; ScpiSyntaxError -171 when it is none."""
    found = re.fullmatch(r"\(\s*@([\d\s,:]*)\)", text.strip())
    if found is None:
        raise ScpiSyntaxError(-171, "Invalid expression")
    channels: list[int] = []
    for item in found.group(1).replace(" ", "").split(","):
        first, _, last = item.partition(":")
        if not first:
            raise ScpiSyntaxError(-171, "Invalid expression")
        channels += range(int(first), int(last or first) + 1)
    return channels


def format_number(value: float, decimals: int = 14) -> str:
    """A number the way the instruments answer: ``+1.00000000000000E+01``."""
    return f"{value:+.{decimals}E}"


# ------------------------------------------------------ do two values agree


def same_number(
    asked: float, answered: str, relative: float = 1e-4, absolute: float = 5e-4
) -> bool:
    """Whether an answer is the number asked for; infinities of any kind are alike."""
    try:
        value = parse_number(unquote(answered))
    except ScpiSyntaxError:
        return False
    if math.isnan(value):
        return False
    if abs(asked) >= INFINITE * 0.99 or abs(value) >= INFINITE * 0.99:
        return abs(asked) >= INFINITE * 0.99 and abs(value) >= INFINITE * 0.99
    return abs(value - asked) <= max(absolute, relative * abs(asked))


def same_boolean(asked: bool, answered: str) -> bool:
    """Whether an answer such as ``1``, ``ON`` or ``+1`` is the state asked for."""
    try:
        return parse_boolean(unquote(answered)) is asked
    except ScpiSyntaxError:
        return False


def same_word(asked: str, answered: str) -> bool:
    """Whether two mnemonics agree: any case, quoted or not, short form or long."""
    first, second = unquote(asked).upper(), unquote(answered).upper()
    if first == second:
        return True
    shorter, longer = sorted((first, second), key=len)
    return len(shorter) >= 3 and longer.startswith(shorter)


def arb_name(answered: str) -> str:
    """The bare name of a waveform: ``"INT:\\SWEEP.ARB"`` -> ``SWEEP``."""
    name = re.split(r"[\\/:]", unquote(answered).upper())[-1]
    return name.removesuffix(".ARB").removesuffix(".BARB")


def same_arb(asked: str, answered: str) -> bool:
    """Whether two waveform names mean the same waveform, whatever the folder or case."""
    return arb_name(asked) == arb_name(answered)
