"""What can go wrong with a simulated instrument and its line, switched on by name.

A rig's config, or a test, gives a mapping of faults for each instrument::

    {"no_trigger": True, "late_reply": {"value": 5, "message": "FETC", "from_s": 40}}

A fault is ``true``, a value, or a table of ``value`` (`KINDS` says of what),
``message`` (only exchanges that contain this text), ``from_s`` (bench time from
which it may strike) and ``times`` (how often it strikes; 0: always). The mapping
is looked at in every exchange, so it may be changed under way; a fault that has
struck its last time is taken out of it.

`spoil` makes the faults of the line, for sockets and serial lines alike; the
others are made by the instruments.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, fields
from typing import Any

from drivers.clock import Clock


@dataclass(frozen=True)
class Kind:
    """What a fault is by default: its value, how often it strikes, and for whom it exists."""

    text: str
    value: Any = True
    times: int = 0
    instruments: tuple[str, ...] = ("waveform_dac", "digitizer", "amplifier")


_SCPI = ("waveform_dac", "digitizer")
_RECORD = ("digitizer",)

KINDS = {
    "refuse": Kind("nothing listens at the address; a serial line is not there"),
    "drop_at_once": Kind("a connection is closed as soon as it is made", instruments=_SCPI),
    "silent": Kind("no answer"),
    "late_reply": Kind("seconds of real time before the answer", 3.0, 1),
    "trickle": Kind("seconds of real time before every single byte", 0.2, 1),
    "hang_up": Kind("the line ends within the answer; a serial line is unplugged", True, 1),
    "torn": Kind("half of the answer, then nothing more", True, 1),
    "short_block": Kind("bytes missing from a block that is otherwise whole", 8, 1, _RECORD),
    "wrong_length": Kind("bytes that a block's header announces too many", 8, 1, _RECORD),
    "twice": Kind("every answer comes twice"),
    "garbage": Kind("noise with NUL bytes for an answer", True, 1),
    "endless": Kind("bytes of an answer that never ends", 1_000_000, 1),
    "answer": Kind("another answer, this text", "0"),
    "error_queue": Kind("an entry in the error queue", '-310,"System error"', 1, _SCPI),
    "stuck_queue": Kind("the error queue never empties", instruments=_SCPI),
    "setting_not_taken": Kind("headers whose settings are swallowed", [], 0, _SCPI),
    "byte_order": Kind("bytes come in the other order than was set", instruments=_RECORD),
    "no_trigger": Kind("the trigger cable is not connected", instruments=_RECORD),
    "no_data": Kind("sample at which the record ends; 9.91E37 follows", 100, 0, _RECORD),
    "no_data_as_codes": Kind("the volts of code -32768 stand for no data", instruments=_RECORD),
    "adjusted": Kind("V of set voltage, turned at the front panel", 60.0, 0, ("amplifier",)),
}
_NOISE = b"\x00\x13\xfe#\x00\xb5\x07 noise \x00\xff"


@dataclass(frozen=True)
class Fault:
    """One fault as it is switched on."""

    value: Any
    message: str = ""
    from_s: float = 0.0
    times: int = 0

    @classmethod
    def of(cls, kind: str, given: Any) -> Fault:
        """Read ``true``, a value or a table; ValueError when it is none of them."""
        default = KINDS[kind]
        if not isinstance(given, Mapping):
            return cls(default.value if given is True else given, times=default.times)
        unknown = set(given) - {field.name for field in fields(cls)}
        if unknown:
            raise ValueError(f"{kind}.{min(unknown)}: unknown; known here: value, message, "
                             "from_s, times")  # fmt: skip
        fault = cls(**{"value": default.value, "times": default.times, **given})
        for name in ("from_s", "times"):
            number = getattr(fault, name)
            if isinstance(number, bool) or not isinstance(number, int | float) or number < 0:
                raise ValueError(f"{kind}.{name}: expected a number from 0 on, got {number!r}")
        return fault


def check_faults(given: Any) -> dict[str, dict[str, Any]]:
    """The faults of a whole bench, instrument -> fault -> value, copied.

    ValueError for an unknown instrument or fault; the message begins with its path.
    """
    if not isinstance(given, Mapping):
        raise ValueError(f"expected tables of instruments, got {given!r}")
    checked: dict[str, dict[str, Any]] = {}
    for instrument, its in given.items():
        known = [name for name, kind in KINDS.items() if instrument in kind.instruments]
        if not known:
            raise ValueError(f"{instrument}: no instrument that has faults; known here: "
                             "waveform_dac, digitizer, amplifier")  # fmt: skip
        if not isinstance(its, Mapping):
            raise ValueError(f"{instrument}: expected a table of faults, got {its!r}")
        for name, value in its.items():
            if name not in known:
                raise ValueError(f"{instrument}.{name}: unknown fault; known here: "
                                 + ", ".join(known))  # fmt: skip
            try:
                _check_value(name, Fault.of(name, value).value)
            except ValueError as error:
                raise ValueError(f"{instrument}.{error}") from None
        checked[instrument] = dict(its)
    return checked


def _check_value(name: str, value: Any) -> None:
    default = KINDS[name].value
    number = isinstance(default, int | float) and not isinstance(default, bool)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number != number or (not number and not isinstance(value, type(default))):
        raise ValueError(f"{name}: expected something like {default!r}, got {value!r}")


class Faults:
    """The faults of one instrument, as they strike."""

    def __init__(self, given: MutableMapping[str, Any] | None, clock: Clock) -> None:
        self._given = given if given is not None else {}
        self._clock = clock
        self._struck: dict[str, int] = {}

    def strike(self, kind: str, message: bytes = b"") -> Fault | None:
        """The fault, if it is on and strikes in this exchange; counts it."""
        given = self._given.get(kind)
        if given is None or given is False:
            self._struck.pop(kind, None)
            return None
        fault = Fault.of(kind, given)
        about = fault.message.upper().encode("latin-1") in message.upper()
        if not about or self._clock.now() < fault.from_s:
            return None
        self._struck[kind] = self._struck.get(kind, 0) + 1
        if fault.times and self._struck[kind] >= fault.times:
            del self._given[kind], self._struck[kind]
        return fault


@dataclass
class Spoilt:
    """What goes over the line instead of an answer.

    pieces : seconds of real time to wait, and the bytes that are sent then
    hang_up : whether the line ends thereafter
    """

    pieces: list[tuple[float, bytes]]
    hang_up: bool = False


def spoil(faults: Faults, message: bytes, answer: bytes) -> Spoilt:
    """What the faults of the line make of an answer to ``message``."""
    if faults.strike("silent", message):
        return Spoilt([])
    if fault := faults.strike("answer", message):
        end = answer[len(answer.rstrip(b"\r\n >*")) :]
        answer = str(fault.value).encode() + end
    if faults.strike("garbage", message):
        answer = _NOISE + b"\n"
    if fault := faults.strike("endless", message):
        answer = b"x" * int(fault.value)
    if answer[:1] == b"#":
        answer = _damaged_block(faults, message, answer)
    if faults.strike("twice", message):
        answer += answer
    if faults.strike("hang_up", message):
        return Spoilt([(0.0, answer[: len(answer) // 2])], hang_up=True)
    if faults.strike("torn", message):
        answer = answer[: len(answer) // 2]
    if fault := faults.strike("trickle", message):
        return Spoilt([(float(fault.value), bytes([byte])) for byte in answer])
    late = faults.strike("late_reply", message)
    return Spoilt([(float(late.value) if late else 0.0, answer)])


def _damaged_block(faults: Faults, message: bytes, answer: bytes) -> bytes:
    head = re.match(rb"#\d", answer)
    if head is None:
        return answer
    digits = int(answer[1:2])
    size = int(answer[2 : 2 + digits])
    payload, rest = answer[2 + digits : 2 + digits + size], answer[2 + digits + size :]
    if fault := faults.strike("short_block", message):
        payload = payload[: max(0, size - int(fault.value))]
        size = len(payload)
    if fault := faults.strike("wrong_length", message):
        size = max(0, size + int(fault.value))
    return b"#%d%0*d%s%s" % (digits, digits, size, payload, rest)
