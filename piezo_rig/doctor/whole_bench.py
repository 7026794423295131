"""The bench as a whole: at rest, settings read back, noise, voltages, and at rest again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from piezo_rig.bench import Bench, open_bench
from piezo_rig.config import Rig
from piezo_rig.doctor.check import Check
from piezo_rig.doctor.noise import noise
from piezo_rig.doctor.voltages import steps, voltages
from piezo_rig.errors import Aborted, PiezoRigError

_ATTEMPTS = 2

Confirm = Callable[[str], bool]


def together(rig: Rig, confirm: Confirm) -> Iterator[Check]:
    """Everything that needs the whole bench; a fault that stops it is the last check but rest."""
    try:
        with open_bench(rig, confirm) as bench:
            try:
                yield from _moved(bench)
            except PiezoRigError as error:
                yield Check.of(_subject(error), error)
            except KeyboardInterrupt:
                at_rest = _to_rest(bench)
                aborted = Aborted("aborted", "stopped by the operator", "", "run doctor again")
                aborted.piezo = at_rest.text
                raise aborted from None
            finally:
                at_rest = _to_rest(bench)
            yield at_rest
    except PiezoRigError as error:
        yield Check.of(_subject(error), error)


def _subject(error: PiezoRigError) -> str:
    """Which instrument an error is about, where its text begins with one."""
    first = error.what.partition(":")[0]
    known = ("waveform_dac", "digitizer", "amplifier", "interferometer")
    return first if first in known else "bench"


def _to_rest(bench: Bench) -> Check:
    if not bench.touched:
        return Check("note", "piezo", bench.piezo())
    for attempt in range(_ATTEMPTS):  # a line that broke is opened again by the second
        try:
            moved = bench.rest()
            break
        except PiezoRigError as error:
            if attempt == _ATTEMPTS - 1:
                return Check(
                    "FAULT", "piezo", f"{bench.piezo()}: {error.what}", error.cause,
                    "switch the amplifier off by hand, then look at the generator",
                )
    return Check("ok", "piezo", f"at rest, {abs(moved['to_v']):.2f} V on the stack as read back")


def _moved(bench: Bench) -> Iterator[Check]:
    rig = bench.rig
    yield Check("ok", "bench", f"all {bench.origin}, and all that the config names")
    moved = bench.rest()
    yield Check(
        "ok", "waveform_dac", f"found at {moved['from_v']:.1f} V on the stack, brought to rest in "
        f"{moved['duration_s']:.1f} s; level, load, burst and trigger read back as set",
    )
    plan = steps(rig)
    bench.load("doctor", plan.sweeps[0].wave, plan.sample_rate)
    yield Check(
        "ok", "digitizer", f"takes {plan.sample_rate * rig.digitizer.oversampling:g} Sa/s, ranges "
        "and trigger; all read back as set",
    )
    yield from noise(bench, plan.sample_rate)
    seen = bench.play("doctor", plan.sweeps[0].wave, plan.sample_rate)
    yield Check("ok", "digitizer", "the trigger from the waveform DAC arrives")
    yield from voltages(bench, plan, seen)
