"""The digitizer: a Keysight L4532A that records one sweep per trigger.

Never tried on hardware.

Its lowest input filter is 200 kHz, so a record at 5 kSa/s aliases. Whether a
record is complete is found by asking for its last samples, because the bits of
the instrument's operation register are unverified. Unverified too: that after
INIT the previous record can no longer be fetched.

Source: Agilent, L4532A/L4534A 20 MSa/s Digitizers User's Guide (L4532-90001).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, RealClock
from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.scpi_instrument import ScpiInstrument, Setting
from drivers.scpi_values import NO_DATA, parse_number, same_number, same_word
from drivers.transport import Transport

RANGES_V = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
SMALLEST_RECORD = 8
RECORD_STEP = 4
_FULL_SCALE = 32767
_POLL_S = 0.02
_CODE_NO_DATA = -32768  # as volts it is one step below anything that the range can hold
_BYTES_PER_SAMPLE = 4
_BYTES_PER_SECOND = 1e6  # of a slow network


class Digitizer(Protocol):
    """What records the drive monitor and the sensor at the same instants."""

    @property
    def identity(self) -> Identity | None: ...

    def connect(self) -> Identity: ...

    def configure(
        self,
        sample_rate: float,
        count: int,
        ranges_v: Mapping[int, float],
        trigger: str = "EXT",
    ) -> None: ...

    def arm(self) -> None: ...

    def fetch(
        self, channels: Sequence[int], count: int, *, timeout_s: float | None = None
    ) -> dict[int, NDArray[np.float64]]: ...

    @property
    def overflows(self) -> dict[int, int]: ...

    def settings(self) -> dict[str, str]: ...

    def close(self) -> None: ...


def rate_on_grid(sample_rate: float) -> bool:
    """Whether the instrument has this rate: {1, 2, 5} x 10^n, 1 kSa/s to 20 MSa/s."""
    if not 1e3 <= sample_rate <= 20e6:
        return False
    mantissa = float(f"{sample_rate:.9e}".partition("e")[0])
    return mantissa in (1.0, 2.0, 5.0)


def record_length(count: int) -> int:
    """The shortest record that holds ``count`` samples: at least 8, a multiple of 4."""
    return max(SMALLEST_RECORD, -(-count // RECORD_STEP) * RECORD_STEP)


def range_for(peak_v: float) -> float:
    """The smallest range that holds +-``peak_v``; ValueError when none does."""
    for range_v in RANGES_V:
        if peak_v <= range_v:
            return range_v
    raise ValueError(f"{peak_v:g} V is beyond the largest range, {RANGES_V[-1]:g} V")


class KeysightL4532A:
    """An L4532A digitizer on a `Transport`. Never tried on hardware.

    Parameters
    ----------
    transport : line to the instrument
    clock : passes the time between two looks at an unfinished record
    block_samples : samples per channel in one transfer
    """

    MODELS = ("L453",)

    def __init__(
        self, transport: Transport, clock: Clock | None = None, block_samples: int = 100_000
    ) -> None:
        self._link = ScpiInstrument(transport)
        self._clock = clock if clock is not None else RealClock()
        self._block_samples = block_samples
        self._ranges_v: dict[int, float] = {}
        self._sample_rate = 0.0
        self._overflows: dict[int, int] = {}

    @property
    def identity(self) -> Identity | None:
        return self._link.identity

    @property
    def overflows(self) -> dict[int, int]:
        """Channel -> samples at or beyond full scale in the record fetched last."""
        return dict(self._overflows)

    def connect(self) -> Identity:
        return self._link.connect(self.MODELS)

    def close(self) -> None:
        self._link.close()

    # --------------------------------------------------------------- recording

    def configure(
        self,
        sample_rate: float,
        count: int,
        ranges_v: Mapping[int, float],
        trigger: str = "EXT",
    ) -> None:
        """Set up one record per trigger and read every setting back.

        Parameters
        ----------
        sample_rate : samples/s, on the instrument's grid
        count : samples per channel; the record is made a multiple of 4
        ranges_v : channel -> full scale in volts, one of `RANGES_V`
        trigger : EXT (the pulse from the waveform DAC), SOFT or IMM

        ValueError for a rate or a range that the instrument does not have;
        InstrumentError instrument-setting for more samples than it says it can hold.
        """
        if not rate_on_grid(sample_rate):
            raise ValueError(f"{sample_rate:g} Sa/s is not on the grid of 1, 2, 5 x 10^n")
        for channel, range_v in ranges_v.items():
            if range_v not in RANGES_V:
                raise ValueError(f"channel {channel}: there is no range of {range_v:g} V")
        length = record_length(count)
        most = self._number("CONF:ACQ:SCO:MAX?")
        if length > most:
            raise InstrumentError(
                "instrument-setting",
                self._link.name,
                f"{length} samples are needed, its memory takes {most:.0f}",
                remedy="play fewer cycles at once, or use less oversampling",
            )
        self._link.command("ABOR")
        settings = [
            Setting.word("FORM:BORD", "SWAP"),
            Setting("FORM:DATA:REAL REAL,32", "FORM:DATA:REAL?", "REAL,32", _is_real_32),
            Setting.number("CONF:ACQ:SRAT", sample_rate, absolute=1e-6 * sample_rate),
            Setting.number("CONF:ACQ:SCO", length, absolute=0.5),
            Setting.number("CONF:ACQ:SPR", 0, absolute=0.5),
            Setting.number("CONF:ACQ:REC", 1, absolute=0.5),
        ]
        for channel, range_v in ranges_v.items():
            settings += [
                _of_channel("CONF:CHAN:RANG", channel, f"{range_v:g}", range_v),
                _of_channel("CONF:CHAN:COUP", channel, "DC"),
                _of_channel("CONF:CHAN:FILT", channel, "LP_200_KHZ"),
            ]
        settings += [
            Setting.word("CONF:ARM:SOUR", "IMM"),
            Setting.word("CONF:TRIG:SOUR", trigger),
            Setting.word("CONF:EXT:INP", "POS"),
        ]
        self._link.apply(*settings)
        self._ranges_v = dict(ranges_v)
        self._sample_rate = sample_rate

    def _number(self, query: str) -> float:
        answer = self._link.query(query)
        try:
            return parse_number(answer)
        except ValueError:
            raise InstrumentError(
                "instrument-garbage", self._link.name, f"{query} answered {answer[:80]!r}"
            ) from None

    def arm(self) -> None:
        """Wait for the trigger from now on, having given up any earlier wait."""
        self._overflows = {}
        self._link.command("ABOR;:INIT")

    def trigger(self) -> None:
        """The trigger from the program itself, where its source is SOFT."""
        self._link.command("TRIG:IMM")

    def fetch(
        self, channels: Sequence[int], count: int, *, timeout_s: float | None = None
    ) -> dict[int, NDArray[np.float64]]:
        """The volts recorded since the trigger, channel -> (count,).

        Waits up to ``timeout_s`` (the link's own when None) for the record to be
        complete. InstrumentError:
        instrument-no-trigger when nothing was recorded, instrument-no-data when
        the record has gaps, instrument-block for a transfer of the wrong size,
        instrument-garbage for values that no range can hold.
        """
        if timeout_s is None:
            timeout_s = self._link.transport.timeout_s
        wanted = list(channels)
        self._await_record(wanted, count, timeout_s)
        volts = np.empty((len(wanted), count))
        for offset in range(0, count, self._block_samples):
            size = min(self._block_samples, count - offset)
            block = self._fetch_block(wanted, offset, size)
            if block is None:
                raise self._short(size)
            volts[:, offset : offset + size] = block
        # A question of another kind: had a block come twice, what follows would be out of
        # step, and it would show here.
        self._link.drain_errors("the transfer")
        missing = self._missing(wanted, volts).any(axis=0)
        if missing.any():
            raise InstrumentError(
                "instrument-no-data",
                self._link.name,
                f"{int(missing.sum())} of {count} samples were not recorded, "
                f"the first is number {int(missing.argmax())}",
                "the record was stopped or is shorter than the sweep",
            )
        for row, channel in zip(volts, wanted, strict=True):
            self._check(channel, row)
        return {channel: volts[i].copy() for i, channel in enumerate(wanted)}

    def _await_record(self, channels: list[int], count: int, timeout_s: float) -> None:
        # On a virtual clock an instrument that is slow in real time would otherwise be
        # asked for hours.
        deadline, patience = self._clock.now() + timeout_s, RealClock()
        last = max(0, count - RECORD_STEP)
        while not self._is_recorded(channels, last, count - last, timeout_s):
            if self._clock.now() >= deadline or patience.now() >= timeout_s:
                break
            self._clock.sleep(_POLL_S)
        else:
            return
        if not self._is_recorded(channels, 0, min(count, RECORD_STEP), timeout_s):
            raise self._no_trigger(timeout_s)

    def _is_recorded(
        self, channels: list[int], offset: int, size: int, timeout_s: float
    ) -> bool:
        """Whether these samples are there; a short block or a complaint means "not yet"."""
        try:
            samples = self._fetch_block(channels, offset, size)
        except InstrumentError as error:
            if error.code == "instrument-timeout":
                # Alive but without an answer: it has nothing to send.
                self._link.recover()
                raise self._no_trigger(timeout_s) from error
            if error.code == "instrument-error-queue":
                return False
            raise
        return samples is not None and not bool(self._missing(channels, samples).any())

    def _no_trigger(self, timeout_s: float) -> InstrumentError:
        return InstrumentError(
            "instrument-no-trigger",
            self._link.name,
            f"nothing was recorded within {timeout_s:g} s",
            "no trigger came: the cable from the waveform DAC's trigger output to the "
            "external trigger input is missing, or the slope is wrong",
            "connect it and run again",
        )

    def _fetch_block(
        self, channels: list[int], offset: int, size: int
    ) -> NDArray[np.float64] | None:
        """(channels, size) volts, None when fewer came; the instrument interleaves the channels."""
        listed = ",".join(str(channel) for channel in channels)
        message = f"FETC:WAV:VOLT? (@{listed}),{offset},{size},(@1)"
        expected = size * len(channels) * _BYTES_PER_SAMPLE
        allowed_s = self._link.transport.timeout_s + expected / _BYTES_PER_SECOND
        payload = self._link.query_block(message, expected, timeout_s=allowed_s)
        if len(payload) != expected:
            self._link.drain_errors(message)
            return None
        with np.errstate(invalid="ignore"):  # bytes in the wrong order may spell any NaN
            return np.frombuffer(payload, "<f4").reshape(size, len(channels)).T.astype(float)

    def _short(self, size: int) -> InstrumentError:
        return InstrumentError(
            "instrument-block", self._link.name, f"fewer samples came than the {size} asked for"
        )

    def _missing(self, channels: list[int], volts: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which samples (channels, n) stand for ones that were never recorded."""
        ranges = np.array([[self._ranges_v.get(channel, RANGES_V[-1])] for channel in channels])
        code = volts * (_FULL_SCALE / ranges)
        no_data = np.abs(volts / NO_DATA - 1) < 1e-3
        return np.asarray(no_data | (np.abs(code - _CODE_NO_DATA) < 0.25))

    def _check(self, channel: int, volts: NDArray[np.float64]) -> None:
        range_v = self._ranges_v.get(channel, RANGES_V[-1])
        beyond = np.abs(volts)
        # Swapped bytes turn volts into huge or denormal numbers.
        strange = ~np.isfinite(volts) | (beyond > 1.5 * range_v) | ((beyond > 0) & (beyond < 1e-12))
        if strange.any():
            raise InstrumentError(
                "instrument-garbage",
                self._link.name,
                f"channel {channel}: {int(strange.sum())} samples lie outside anything that the "
                f"range of {range_v:g} V can hold, the first is {volts[strange.argmax()]:g}",
                "the byte order is not the one that was set",
            )
        self._overflows[channel] = int((beyond >= range_v * (1 - 0.5 / _FULL_SCALE)).sum())

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        queries = list(_SETTINGS)
        for channel in self._ranges_v:
            queries += [f"CONF:CHAN:{what}? (@{channel})" for what in ("RANG", "COUP", "FILT")]
        return dict(zip(queries, self._link.query_all(*queries), strict=True))


_SETTINGS = (
    "CONF:ACQ:SRAT?",
    "CONF:ACQ:SCO?",
    "CONF:ACQ:SPR?",
    "CONF:ACQ:REC?",
    "CONF:ARM:SOUR?",
    "CONF:TRIG:SOUR?",
    "CONF:EXT:INP?",
    "FORM:BORD?",
    "FORM:DATA:REAL?",
)


def _is_real_32(answer: str) -> bool:
    kind, _, bits = answer.replace('"', "").partition(",")
    if answer.strip().lstrip("+") == "32":
        return True
    return same_word("REAL", kind) and (not bits or same_number(32, bits))


def _of_channel(header: str, channel: int, text: str, number: float | None = None) -> Setting:
    return Setting(
        f"{header} (@{channel}),{text}",
        f"{header}? (@{channel})",
        text,
        (lambda answer: same_word(text, answer))
        if number is None
        else (lambda answer: same_number(number, answer)),
    )
