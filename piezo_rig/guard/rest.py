"""The guard brings the stack to rest: whatever the runner left behind, under the slew limit."""

from __future__ import annotations

import contextlib
import time

from drivers.clock import BenchClock, Clock, RealClock
from drivers.errors import InstrumentError
from drivers.kinds import make_dac
from drivers.transport import Transport
from drivers.waveform_dac import LATE_STEP_V
from piezo_rig.guard.orders import GIVE_UP_S, Orders

_RETRY_S = 1.0
_CLOCK_TIMEOUT_S = 2.0
_LOOK_S = 0.005


def bring_to_rest(
    line: Transport, orders: Orders, serial: str, give_up_s: float = GIVE_UP_S
) -> dict[str, float]:
    """Wait for a burst that plays, ramp to rest, read back.

    Parameters
    ----------
    line : to the generator; nothing that it still owes may be on its way
    serial : of the generator that was armed; no other is moved

    Returns
    -------
    from_v, to_v : V on the stack
    duration_s : how long it took, s

    Raises
    ------
    InstrumentError : the last failure, when nothing helped for ``give_up_s``
    """
    until = time.monotonic() + give_up_s
    while True:
        try:
            return _attempt(line, orders, serial)
        except Exception as error:  # whatever it is, giving up is no better than trying again
            if time.monotonic() >= until:
                if isinstance(error, InstrumentError):
                    raise
                raise InstrumentError("internal", line.instrument, repr(error)) from error
            RealClock().sleep(_RETRY_S)
            with contextlib.suppress(InstrumentError):
                line.reopen()


def _attempt(line: Transport, orders: Orders, serial: str) -> dict[str, float]:
    clock = _clock(orders.clock)
    try:
        dac = make_dac(orders.driver, line, clock)
        found = dac.connect().serial
        if found != serial:
            raise InstrumentError(
                "instrument-identity", line.instrument, f"serial number {found}, not {serial}"
            )
        moved = dac.go_to_rest(
            orders.rest_command_v, slew_v_per_s=orders.slew_v_per_s, clock=clock,
            largest_step_v=LATE_STEP_V,
        )
    finally:
        if isinstance(clock, BenchClock):
            clock.close()
    return {
        "from_v": orders.gain * moved["from_v"] + orders.offset_v,
        "to_v": orders.gain * moved["to_v"] + orders.offset_v,
        "duration_s": moved["duration_s"],
    }


def _clock(name: str) -> Clock:
    """The computer's clock; a bench's own, where it stands still while nobody asks it."""
    own = RealClock()
    if name == "real":
        return own
    try:
        bench = BenchClock(name, _CLOCK_TIMEOUT_S)
        begun, own_begun = bench.now(), own.now()
        own.sleep(_LOOK_S)
        looked_s = own.now() - own_begun
        if bench.now() - begun < looked_s:
            return bench
        bench.close()
    except InstrumentError:
        pass  # nobody answers there
    return own
