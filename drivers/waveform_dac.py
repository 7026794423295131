"""The waveform DAC: a Keysight 33500B that plays one burst per sweep.

Never tried on hardware.

The amplifier adds 75 V to 7.5 times the command, so 0 V of command is full
voltage on the stack, and an output that is switched off is 0 V. Rest is -10 V.
From that follows what this driver does and what it never does:

* It never sends ``*RST``, never switches the output off, never changes FUNC
  while the output is on (one exception below), and never moves the level in
  steps larger than `STEP_V` (a guard in a hurry: `LATE_STEP_V`, under the same slew limit).
* At rest the generator sits in an idle burst of an arbitrary waveform: the
  output is the waveform's first point, code -32767, which is LOW = -10 V.
  Between sweeps only HIGH changes; before waveform memory is touched HIGH is
  pulled to within `NARROW_V` of LOW, so that no point of any waveform, wanted
  or not, lies further than that from rest.
* An output that was found off is prepared while off (the rest waveform at 0 V,
  burst mode, trigger from the bus), switched on at 0 V, which is what the stack
  sees already, and moved to rest by VOLT:OFFS. An offset ramp in the idle burst
  was preferred to one in FUNC DC because DC cannot be bursted: it would need a
  change of FUNC at rest, and whether that glitches is unverified.
* An output that was found on in FUNC DC is moved to rest in DC, with the
  amplitude first narrowed, and only then given the rest waveform: the exception.

Unverified on hardware: whether amplitude and offset steps that make the
generator switch its attenuator interrupt the output for a moment (the
instrument's range lock is not used); whether a waveform without any span may
be played at 10 mVpp.

Source: Keysight, Trueform Series Operating and Service Guide (33500-90901).
"""

from __future__ import annotations

import hashlib
import re
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.dac_codes import (
    FULL_SCALE,
    MEMORY_POINTS,
    checked_codes,
    fitted_codes,
)
from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.output_state import NARROW_V, OWN_PREFIX, REST_NAME, OutputState
from drivers.scpi_instrument import ScpiInstrument, Setting
from drivers.scpi_values import INFINITE
from drivers.transport import Transport

STEP_V = 0.02
LATE_STEP_V = 0.1
_LIMIT_V = 10.0  # of levels into a high impedance
_TOLERANCE_V = 1e-3


class WaveformDac(Protocol):
    """What plays a sweep's waveform; volts are command volts."""

    @property
    def identity(self) -> Identity | None: ...

    def connect(self) -> Identity: ...

    def output_level(self) -> float: ...

    def go_to_rest(
        self, rest_v: float = -10.0, *, slew_v_per_s: float, clock: Clock,
        largest_step_v: float = STEP_V,
    ) -> dict[str, float]: ...

    def load(
        self,
        name: str,
        codes: NDArray[np.int16],
        low_v: float,
        high_v: float,
        sample_rate: float,
    ) -> None: ...

    def start(self) -> None: ...

    def wait(self, duration_s: float) -> None: ...

    def settings(self) -> dict[str, str]: ...

    def close(self) -> None: ...


class Keysight33500B:
    """A 33500B series generator on a `Transport`. Never tried on hardware."""

    MODELS = ("335", "336")

    def __init__(self, transport: Transport) -> None:
        self._link = ScpiInstrument(transport)
        self._uploaded: dict[str, str] = {}  # digest of the codes -> name in the memory
        self._free_points: int | None = None  # None: what the memory holds is not known
        self._loaded_s = 0.0  # how long the selected waveform lasts; 0: not this driver's

    @property
    def identity(self) -> Identity | None:
        return self._link.identity

    def connect(self) -> Identity:
        """Make sure of who answers; touches nothing but the status."""
        self._uploaded.clear()
        self._free_points = None
        return self._link.connect(self.MODELS)

    def close(self) -> None:
        """Close the line; the output stays as it is."""
        self._link.close()

    # ------------------------------------------------------------------ levels

    def _look(self) -> OutputState:
        answers = self._link.query_all(*OutputState.QUERIES.values())
        try:
            return OutputState(answers)
        except ValueError as error:
            raise InstrumentError(
                "instrument-garbage", self._link.name, f"settings read back as {answers}: {error}"
            ) from error

    def output_level(self) -> float:
        """Command volts on the terminals now, from the settings read back.

        Holds between bursts. InstrumentError bench-refused when a waveform that
        is not this driver's is selected, for then the level cannot be told.
        """
        found = self._look()
        if found.level is None:
            raise self._refuse(found)
        return found.level

    def go_to_rest(
        self, rest_v: float = -10.0, *, slew_v_per_s: float, clock: Clock,
        largest_step_v: float = STEP_V,
    ) -> dict[str, float]:
        """Bring the output from whatever it was found at to rest, without a jump.

        ``slew_v_per_s`` is in command volts. Waits for a burst that is running. Steps may be as
        large as ``largest_step_v`` where the line is so slow that the slew allows it: for the one
        who is in a hurry, because the messages then depend on the time that they take.
        Returns ``from_v``, ``to_v`` and ``duration_s``. InstrumentError
        bench-refused when a foreign waveform is on the output.
        """
        begun = clock.now()
        found = self._look()
        if found.on and found.is_ours:
            self._let_burst_end(self._longest_burst(found), clock)
            found = self._look()
        from_v = found.level
        if from_v is None:
            raise self._refuse(found)
        if not found.on:
            self._prepare_rest(found, from_v)
            self._link.apply(Setting.switch("OUTP1", True))
        elif found.is_dc:
            self._link.apply(Setting.number("OUTP1:LOAD", INFINITE))
            room = _LIMIT_V - (found.high - found.low) / 2
            narrow_at = max(-room, min(room, from_v))
            if narrow_at != from_v:
                # Levels around this offset would lie beyond the limits: make room first.
                self._ramp(from_v, narrow_at, slew_v_per_s, clock)
                found = self._look()
            self._narrow_dc(found, slew_v_per_s, clock)
            self._ramp(narrow_at, rest_v + NARROW_V / 2, slew_v_per_s, clock, largest_step_v)
            found = self._look()
            self._prepare_rest(found, rest_v)
        else:
            if not found.is_ours:
                # Somebody stopped between clearing the memory and selecting a waveform.
                self._prepare_rest(found, from_v)
            self._burst_settings()
            self._pull_in(found)
        found = self._look()
        if found.level is None:
            raise self._refuse(found)
        if abs(found.level - rest_v) > _TOLERANCE_V:
            self._ramp(found.offset, rest_v + found.offset - found.low, slew_v_per_s, clock,
                       largest_step_v)
        to_v = self.output_level()
        if abs(to_v - rest_v) > 2 * _TOLERANCE_V:
            raise InstrumentError(
                "instrument-setting", self._link.name, f"rest is {rest_v:g} V, not {to_v:g} V"
            )
        return {"from_v": from_v, "to_v": to_v, "duration_s": clock.now() - begun}

    def _refuse(self, found: OutputState) -> InstrumentError:
        return InstrumentError(
            "bench-refused",
            self._link.name,
            f"plays something that is not this program's: {found.describe()}",
            "another program or a person at the front panel started a waveform",
            "ramp it to a constant level by hand (FUNC DC) and try again",
        )

    def _let_burst_end(self, longest_s: float, clock: Clock) -> None:
        """Return when no burst can be running any more, whatever ``*OPC?`` is worth."""
        begun = clock.now()
        try:
            self.wait(longest_s)
        except InstrumentError:
            self._link.recover()
            clock.sleep(longest_s - (clock.now() - begun))

    def _longest_burst(self, found: OutputState) -> float:
        """How long the burst that may be running can last, s."""
        if self._loaded_s:  # this driver's own waveform
            return found.cycles * self._loaded_s
        return found.cycles * MEMORY_POINTS / max(found.sample_rate, 1.0)

    def _prepare_rest(self, found: OutputState, level_v: float) -> None:
        """An idle burst of the rest waveform at ``level_v``, output untouched."""
        self._link.apply(Setting.number("OUTP1:LOAD", INFINITE))
        self._link.apply(Setting.word("FORM:BORD", "SWAP"))
        self._clear_memory()
        # It spans the converter, because a waveform without span may have no amplitude;
        # it is never played, and its first point is what an idle burst puts out.
        rest = np.full(8, -FULL_SCALE, np.int16)
        rest[4] = FULL_SCALE
        self._upload(REST_NAME, rest)
        self._link.apply(Setting.arb("SOUR1:FUNC:ARB", REST_NAME))
        high, low = (
            Setting.number("SOUR1:VOLT:HIGH", level_v + NARROW_V),
            Setting.number("SOUR1:VOLT:LOW", level_v),
        )
        function = Setting.word("SOUR1:FUNC", "ARB")
        if found.on:
            # DC at rest, already narrowed: the level must not move while FUNC changes.
            self._link.apply(function)
            self._link.apply(low, high)
        else:
            self._link.apply(function)
            first_high = level_v + NARROW_V > found.low + NARROW_V / 2
            for setting in (high, low) if first_high else (low, high):
                self._link.apply(setting)
        self._burst_settings()

    def _burst_settings(self) -> None:
        self._link.apply(
            Setting.number("OUTP1:LOAD", INFINITE),
            Setting.word("FORM:BORD", "SWAP"),
            Setting.word("SOUR1:FUNC:ARB:FILT", "STEP"),
            Setting.word("SOUR1:BURS:MODE", "TRIG"),
            Setting.number("SOUR1:BURS:NCYC", 1),
            Setting.word("TRIG1:SOUR", "BUS"),
            Setting.switch("SOUR1:BURS:STAT", True),
            Setting.word("OUTP:TRIG:SLOP", "POS"),
            Setting.switch("OUTP:TRIG", True),
        )

    def _narrow_dc(self, found: OutputState, slew_v_per_s: float, clock: Clock) -> None:
        """Shrink the amplitude that DC remembers, in steps that move the offset little.

        HIGH and LOW are moved in turn; each moves the offset by half its own step.
        """
        high, low, offset = found.high, found.low, found.offset
        while high - low > NARROW_V + _TOLERANCE_V:
            # HIGH first: its step moves the offset towards rest, LOW's moves it back.
            high = max(high - STEP_V, offset + NARROW_V / 2)
            self._link.apply(Setting.number("SOUR1:VOLT:HIGH", high))
            low = min(low + STEP_V, offset - NARROW_V / 2)
            self._link.apply(Setting.number("SOUR1:VOLT:LOW", low))
            clock.sleep(STEP_V / slew_v_per_s)

    def _pull_in(self, found: OutputState) -> None:
        """HIGH to just above LOW: LOW, which is the output between bursts, stays."""
        if found.high - found.low > NARROW_V + _TOLERANCE_V:
            self._link.apply(
                Setting.number("SOUR1:VOLT:HIGH", found.low + NARROW_V),
                _unchanged("SOUR1:VOLT:LOW", found.low),
            )

    def _ramp(
        self, from_v: float, to_v: float, slew_v_per_s: float, clock: Clock,
        largest_step_v: float = STEP_V,
    ) -> None:
        if largest_step_v > STEP_V:
            self._ramp_on_slow_line(from_v, to_v, slew_v_per_s, clock, largest_step_v)
            return
        steps = max(1, int(np.ceil(abs(to_v - from_v) / STEP_V - 1e-9)))
        for step in range(1, steps + 1):
            # A full wait before every step: time lost elsewhere is never made good by haste.
            clock.sleep(abs(to_v - from_v) / steps / slew_v_per_s)
            value = from_v + (to_v - from_v) * step / steps
            self._link.apply(Setting.number("SOUR1:VOLT:OFFS", value))

    def _ramp_on_slow_line(
        self, from_v: float, to_v: float, slew_v_per_s: float, clock: Clock, largest_step_v: float
    ) -> None:
        """Larger steps after longer pauses, so that a slow line does not make a slow ramp.

        A step is what the slew limit allows for the pause before it, which lies between the answer
        to one message and the next message. It is three times what the last message took.
        """
        left_v, pause_s, answered = abs(to_v - from_v), STEP_V / slew_v_per_s, clock.now()
        while left_v > 0.0:
            now = clock.sleep(pause_s)
            step_v = min(slew_v_per_s * (now - answered), largest_step_v)
            left_v = left_v - step_v if left_v > step_v + 1e-9 else 0.0
            value = to_v + (left_v if from_v > to_v else -left_v)
            self._link.apply(Setting.number("SOUR1:VOLT:OFFS", value))
            answered = clock.now()
            pause_s = min(max(STEP_V, 3.0 * (answered - now) * slew_v_per_s), largest_step_v)
            pause_s /= slew_v_per_s

    # --------------------------------------------------------------- waveforms

    def load(
        self,
        name: str,
        codes: NDArray[np.int16],
        low_v: float,
        high_v: float,
        sample_rate: float,
    ) -> None:
        """Make one sweep ready to play; the output, at rest, does not move.

        Parameters
        ----------
        name : of the sweep; shortened to what the instrument takes
        codes : (n,) DAC codes, 8 <= n <= 1,000,000; -32767 is ``low_v``, +32767 is
            ``high_v``; the first and the last are -32767
        low_v, high_v : command volts; ``low_v`` is the rest level
        sample_rate : samples/s

        ValueError for a waveform that does not begin and end at rest.
        """
        codes, high_v = fitted_codes(checked_codes(codes), low_v, high_v)
        found = self._look()
        if found.level is None or not found.on:
            raise self._refuse(found)
        if abs(found.level - low_v) > 2 * _TOLERANCE_V:
            raise InstrumentError(
                "bench-refused",
                self._link.name,
                f"the output is at {found.level:g} V, the waveform begins at {low_v:g} V",
                remedy="go to rest first",
            )
        self._pull_in(found)
        self._loaded_s = codes.size / sample_rate
        digest = hashlib.sha256(codes.tobytes()).hexdigest()
        if digest not in self._uploaded:
            if self._free_points is None or self._free_points < codes.size:
                self._clear_memory()
            self._uploaded[digest] = self._upload(self._free_name(name), codes)
        self._link.apply(
            Setting.arb("SOUR1:FUNC:ARB", self._uploaded[digest]),
            Setting.word("SOUR1:FUNC", "ARB"),
            Setting.number("SOUR1:FUNC:ARB:SRAT", sample_rate, absolute=1e-6 * sample_rate),
            Setting.word("SOUR1:FUNC:ARB:FILT", "STEP"),
        )
        self._link.apply(
            Setting.number("SOUR1:VOLT:HIGH", high_v), _unchanged("SOUR1:VOLT:LOW", low_v)
        )

    def _clear_memory(self) -> None:
        self._link.command("SOUR1:DATA:VOL:CLE")
        self._uploaded.clear()
        self._free_points = MEMORY_POINTS

    def _upload(self, name: str, codes: NDArray[np.int16]) -> str:
        self._free_points = (self._free_points or 0) - codes.size
        self._link.send_block(f"SOUR1:DATA:ARB:DAC {name},", codes.astype("<i2").tobytes())
        return name

    def _free_name(self, name: str) -> str:
        """At most 12 characters, beginning with the mark, unused."""
        stem = (OWN_PREFIX + re.sub(r"\W|_", "", name.upper(), flags=re.ASCII))[:12]
        taken = {*self._uploaded.values(), REST_NAME}
        number = 0
        candidate = stem
        while candidate in taken:
            number += 1
            candidate = f"{stem[: 12 - len(str(number))]}{number}"
        return candidate

    def start(self) -> None:
        """Begin the burst, and with it the pulse at the trigger output."""
        self._link.command("*TRG")

    def wait(self, duration_s: float) -> None:
        """Return when the burst is complete; InstrumentError instrument-timeout if it is not.

        ``duration_s`` is how long the burst lasts; a margin is added. On a
        virtual bench the answer comes at once, the clock having jumped.
        InstrumentError instrument-error-queue for what went wrong meanwhile.
        """
        margin = self._link.transport.timeout_s
        answer = self._link.query("*OPC?", timeout_s=min(duration_s, 1e6) + margin)
        if answer.lstrip("+") != "1":
            raise InstrumentError(
                "instrument-garbage", self._link.name, f"*OPC? answered {answer!r}"
            )
        # A question of another kind: had *OPC? been answered twice, it would show here.
        self._link.drain_errors("the burst")

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        queries = [*OutputState.QUERIES.values(), *_MORE_SETTINGS]
        return dict(zip(queries, self._link.query_all(*queries), strict=True))


_MORE_SETTINGS = ("SOUR1:FUNC:ARB:FILT?", "FORM:BORD?", "OUTP:TRIG?", "OUTP:TRIG:SLOP?")


def _unchanged(header: str, value: float) -> Setting:
    """Reads back a setting that must not have moved, without sending it."""
    watched = Setting.number(header, value, absolute=_TOLERANCE_V)
    return Setting("", watched.query, watched.asked, watched.agrees)
