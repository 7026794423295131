"""Waveform DAC and digitizer in one: the analog output and an input of an NI card.

Never tried on hardware; tested against a stand-in of the ``nidaqmx`` package.

What is different from a generator, and what follows:

* A card has no idle state to fall back to: its output holds the last level it was given, 0 V
  (75 V on the stack) after power-up. Its level is therefore measured before anything is played,
  through the card's internal channel or a wire to an input, and every way to rest is a ramp of
  samples under the slew limit that ends at rest exactly.
* A burst that its process does not survive freezes where it is. The tasks are the guard's, see
  `drivers.nidaqmx_card`; if the guard is killed in a burst, the runner finds the stack at that
  level and ramps it down; if both are killed, nobody does.
* One sample clock: the input samples at the instants at which the output is updated. A multiplexed
  card converts a few microseconds later, which diagnosis calls `time-skew`.
* 16 bit over +-10 V is 2.3 mV on the stack, whatever the range of the sweep.

Source: NI-DAQmx Help; nidaqmx-python 1.x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, RealClock
from drivers.dac_codes import FULL_SCALE, checked_codes
from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.scpi_instrument import ScpiInstrument, Setting
from drivers.transport import Transport
from drivers.waveform_dac import STEP_V

RANGES_V = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Of the inputs of most cards; NI-DAQmx takes the smallest of its own that holds the one asked."""
AT_REST_V = 0.02
"""Of command, 0.15 V on the stack: what a measured level may be off without being elsewhere."""
RAMP_RATE = 5000.0
_POLL_S = 0.005
_LOOK_S = 0.1
_BLOCK_SAMPLES = 250_000
_FULL_SCALE = 32767


class NidaqmxOutput:
    """The analog output of a card as a waveform DAC. Never tried on hardware."""

    def __init__(self, transport: Transport, clock: Clock | None = None) -> None:
        self.link = ScpiInstrument(transport)
        self._clock = clock if clock is not None else RealClock()

    @property
    def identity(self) -> Identity | None:
        return self.link.identity

    def connect(self) -> Identity:
        """Make sure of who answers; touches nothing but the status."""
        identity = self.link.connect(("",))
        if not identity.manufacturer.upper().startswith("NATIONAL INSTRUMENTS"):
            raise InstrumentError(
                "instrument-identity", self.link.name,
                f"{self.link.transport.address} answers as {identity.raw!r}, not as an NI card",
                "the rig's config names another driver's instrument", "correct the address",
            )
        return identity

    def close(self) -> None:
        """Close the line; the output holds its level."""
        self.link.close()

    # ------------------------------------------------------------------ levels

    def output_level(self) -> float:
        """Command volts on the terminal now, measured.

        InstrumentError bench-refused while a burst plays, or where they cannot be measured.
        """
        if not self._is_done():
            raise InstrumentError(
                "bench-refused", self.link.name, "a burst is playing",
                "another run plays on this card", "wait until it is done",
            )
        try:
            level = self._number("AO:LEV?")
        except InstrumentError as error:
            if error.code != "instrument-timeout":
                raise
            complaints = self.link.recover()
            raise InstrumentError(
                "bench-refused", self.link.name,
                "the output's level cannot be measured: "
                + "; ".join(str(entry) for entry in complaints),
                "the card has no internal channel for it, or another program holds the inputs",
                "wire the output to a free input as well, and name both: "
                'address = "Dev1/ao0,ai7"',
            ) from error
        if not abs(level) < 11.0:
            raise InstrumentError("instrument-garbage", self.link.name, f"AO:LEV? said {level}")
        return level

    def go_to_rest(
        self, rest_v: float = -10.0, *, slew_v_per_s: float, clock: Clock,
        largest_step_v: float = STEP_V,
    ) -> dict[str, float]:
        """Bring the output from the level that it is found at to rest, in one hardware-timed ramp.

        ``slew_v_per_s`` is in command volts; ``largest_step_v`` is not needed, because the ramp's
        steps do not wait for a line. Waits for a burst that plays. Returns ``from_v``, ``to_v``,
        ``duration_s``.
        """
        begun = clock.now()
        if not self._is_done():  # somebody else's, perhaps: the card knows how long it is
            longest_s = self._number("AO:POIN?") / self._number("AO:RATE?")
            self._await_end(longest_s, clock)
        from_v = self.output_level()
        points = max(2, math.ceil(abs(from_v - rest_v) / slew_v_per_s * RAMP_RATE))
        ramp = np.append(np.linspace(from_v, rest_v, points), rest_v)
        self._send(np.clip(ramp, -10.0, 10.0), RAMP_RATE)
        self._drop_input()
        self.start()
        self._await_end(ramp.size / RAMP_RATE, clock)
        to_v = self.output_level()
        if abs(to_v - rest_v) > AT_REST_V:
            raise InstrumentError(
                "instrument-setting", self.link.name,
                f"the output should be at {rest_v:g} V and is measured at {to_v:.3f} V",
                "the wire to the reading-back input is off, or the output is overloaded",
                "measure the output with a voltmeter",
            )
        return {"from_v": from_v, "to_v": to_v, "duration_s": clock.now() - begun}

    def _drop_input(self) -> None:
        """An acquisition that waits for the clock of the output would take the ramp for it."""
        self.link.command("AI:ABOR")

    # --------------------------------------------------------------- waveforms

    def load(
        self, name: str, codes: NDArray[np.int16], low_v: float, high_v: float, sample_rate: float
    ) -> None:
        """Make one sweep ready to play; the output, at rest, does not move.

        Parameters as of `drivers.waveform_dac.Keysight33500B.load`. ValueError for a waveform that
        does not begin and end at rest; InstrumentError bench-refused when the output is not there.
        """
        codes = checked_codes(codes)
        level = self.output_level()
        if abs(level - low_v) > AT_REST_V:
            raise InstrumentError(
                "bench-refused", self.link.name,
                f"the output is at {level:.3f} V, the waveform begins at {low_v:g} V",
                remedy="go to rest first",
            )
        step_v = (high_v - low_v) / (2 * FULL_SCALE)
        self._send(low_v + (codes.astype(float) + FULL_SCALE) * step_v, sample_rate)

    def _send(self, volts: NDArray[np.float64], sample_rate: float) -> None:
        self.link.apply(Setting.number("AO:RATE", sample_rate, absolute=1e-6 * sample_rate))
        self.link.send_block(f"AO:DATA {volts.size},", volts.astype("<f8").tobytes())
        if int(self._number("AO:POIN?")) != volts.size:
            raise InstrumentError("instrument-setting", self.link.name, "samples were lost")

    def start(self) -> None:
        """Begin the burst, and with it the acquisition that waits for its clock."""
        self.link.command("AO:STAR")

    def wait(self, duration_s: float) -> None:
        """Return when the burst is complete; InstrumentError instrument-timeout if it is not."""
        self._await_end(duration_s, self._clock)
        self.link.drain_errors("the burst")

    def _is_done(self) -> bool:
        return self._number("AO:DONE?") != 0

    def _await_end(self, duration_s: float, clock: Clock) -> None:
        """Return when no burst plays; at most its length and the line's timeout.

        It looks again and again, because a guard that is gone in mid-burst has left the output
        frozen, and shows only when it is asked.
        """
        begun, margin_s = clock.now(), self.link.transport.timeout_s
        patience, left_s = RealClock(), duration_s
        while True:
            clock.sleep(min(_LOOK_S, left_s) if left_s > 0 else _POLL_S)
            if self._is_done():
                return
            left_s = duration_s - (clock.now() - begun)
            # On a virtual clock real time stands for the instrument's own slowness.
            if left_s < -margin_s or patience.now() > duration_s + margin_s:
                raise InstrumentError(
                    "instrument-timeout", self.link.name,
                    f"a burst of {duration_s:.3g} s did not end",
                    "the card's sample clock stands still", "look at the card in NI MAX",
                )

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        queries = ("AO:LEV?", "AO:RATE?", "AO:POIN?", "AO:DONE?")
        return dict(zip(queries, self.link.query_all(*queries), strict=True))

    def _number(self, query: str) -> float:
        answer = self.link.query(query)
        try:
            return float(answer)
        except ValueError:
            raise InstrumentError(
                "instrument-garbage", self.link.name, f"{query} answered {answer[:80]!r}"
            ) from None


class NidaqmxInput:
    """An input of the same card as a digitizer, clocked by the output. Never tried on hardware.

    Parameters
    ----------
    output : whose line it shares
    channel : ``Dev1/ai0``, of the sensor; empty for the first one
    number : of the channel in the rig's config
    """

    def __init__(self, output: NidaqmxOutput, channel: str, number: int = 2) -> None:
        self._link = output.link
        self._clock = output._clock
        self._channel = channel.rpartition("/")[2] or "ai0"
        self._number = number
        self._range_v = RANGES_V[-1]
        self.identity: Identity | None = None
        self.overflows: dict[int, int] = {}

    def connect(self) -> Identity:
        """The card has been identified as the waveform DAC; it is the same."""
        assert self._link.identity is not None, "the output connects first"
        self.identity = self._link.identity
        return self.identity

    def close(self) -> None:
        """The line is the output's."""

    def configure(
        self, sample_rate: float, count: int, ranges_v: Mapping[int, float], trigger: str = "EXT"
    ) -> None:
        """Set up one record per burst and read every setting back.

        Parameters as of `drivers.digitizer.KeysightL4532A.configure`; ``trigger`` is EXT (the
        output's sample clock) or IMM. ValueError for another channel or range.
        """
        if set(ranges_v) != {self._number}:
            raise ValueError(f"channels {sorted(ranges_v)}: only {self._number} is wired")
        if (range_v := ranges_v[self._number]) not in RANGES_V:
            raise ValueError(f"there is no range of {range_v:g} V")
        self._link.command("AI:ABOR")
        self._link.apply(
            Setting.word("AI:CHAN", self._channel),
            Setting.number("AI:RANG", range_v),
            Setting.number("AI:COUN", max(2, count), absolute=0.5),
            Setting.word("AI:TRIG", "AO" if trigger == "EXT" else "IMM"),
        )
        if trigger != "EXT":  # otherwise the rate is that of the waveform, which stands
            self._link.apply(Setting.number("AO:RATE", sample_rate, absolute=1e-6 * sample_rate))
        elif abs(float(self._link.query("AO:RATE?")) - sample_rate) > 1e-6 * sample_rate:
            raise ValueError("input and output share one sample clock: no oversampling")
        self._range_v = range_v

    def arm(self) -> None:
        """Record from the next update of the output on, having given up any earlier wait."""
        self.overflows = {}
        self._link.command("AI:ARM")

    def fetch(
        self, channels: Sequence[int], count: int, *, timeout_s: float | None = None
    ) -> dict[int, NDArray[np.float64]]:
        """The volts recorded, channel -> (count,).

        InstrumentError instrument-no-trigger when nothing was recorded, instrument-block for a
        transfer of the wrong size, instrument-garbage for values that no range can hold.
        """
        if timeout_s is None:
            timeout_s = self._link.transport.timeout_s
        self._await_record(count, timeout_s)
        volts = np.empty(count)
        for offset in range(0, count, _BLOCK_SAMPLES):
            size = min(_BLOCK_SAMPLES, count - offset)
            payload = self._link.query_block(f"AI:DATA? {offset},{size}", 8 * size)
            if len(payload) != 8 * size:
                raise InstrumentError(
                    "instrument-block", self._link.name,
                    f"{len(payload) // 8} samples came, {size} were asked for",
                )
            volts[offset : offset + size] = np.frombuffer(payload, "<f8")
        self._link.drain_errors("the transfer")
        if not (np.abs(volts) < 1.5 * self._range_v).all():
            raise InstrumentError(
                "instrument-garbage", self._link.name,
                f"samples beyond anything that the range of {self._range_v:g} V can hold",
            )
        full = self._range_v * (1 - 0.5 / _FULL_SCALE)
        self.overflows[self._number] = int((np.abs(volts) >= full).sum())
        return {self._number: volts}

    def _await_record(self, count: int, timeout_s: float) -> None:
        deadline, patience = self._clock.now() + timeout_s, RealClock()
        while self._link.query("AI:DONE?") != "1":
            if self._clock.now() >= deadline or patience.now() >= timeout_s:
                raise InstrumentError(
                    "instrument-no-trigger", self._link.name,
                    f"{count} samples were not recorded within {timeout_s:g} s",
                    "the output's sample clock does not reach the input: not every card can route "
                    "ao/SampleClock to its inputs",
                    "look at 'Device Routes' in NI MAX",
                )
            self._clock.sleep(_POLL_S)

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        queries = ("AI:CHAN?", "AI:RANG?", "AI:COUN?", "AI:TRIG?", "AO:RATE?")
        return dict(zip(queries, self._link.query_all(*queries), strict=True))
