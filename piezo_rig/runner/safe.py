"""The way out of a run that does not end as planned: rest first, then the file."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from piezo_rig.bench import Bench
from piezo_rig.errors import PiezoRigError
from piezo_rig.run_file.writer import RunWriter
from piezo_rig.runner.stop import say

LONGEST_CLOSING_S = 3600.0  # a large run on a slow disk; the stack is at rest by then
REST_V = 0.05  # nearer to 0 V than this there is nothing to announce
_ATTEMPTS = 2  # a line that broke is opened again by the second


def make_safe(
    bench: Bench, writer: RunWriter | None, error: PiezoRigError | None,
    now: Callable[[], float], quiet: bool = False,
) -> None:
    """Bring the stack to rest and close the run.

    A failure of either does not hide the error that led here; ``error`` is told where the piezo
    is and where the data are.
    """
    moved = come_to_rest(bench, quiet)
    if error is not None:
        error.piezo = error.piezo or bench.piezo()
    if writer is None:
        return  # nothing was played
    with suppress(PiezoRigError):
        if moved:
            writer.log(now(), "made safe", **{k: round(v, 3) for k, v in moved.items()})
        if error is not None:
            writer.log(now(), "error", code=error.code, what=error.what)
    kept = writer.part
    bench.step("closing the run", LONGEST_CLOSING_S)
    with suppress(PiezoRigError):
        kept = writer.finish()
    with suppress(PiezoRigError):
        writer.release()
    if error is not None:
        error.remedy = (error.remedy + "; " if error.remedy else "") + f"what was recorded: {kept}"


def come_to_rest(bench: Bench, quiet: bool = False) -> dict[str, float] | None:
    """Rest, and say how long it takes and that it is done; None where that failed."""
    tell: Callable[[str], None] = (lambda text: None) if quiet else say
    if not bench.touched:
        return None
    for _ in range(_ATTEMPTS):
        with suppress(PiezoRigError):
            if left_s := bench.burst_left_s():
                tell(f"the burst that plays ends at rest, in {left_s:.1f} s\n")
            elif abs(volts := bench.drive_v()) > REST_V:
                tell(f"the stack is at {volts:.2f} V; the ramp to rest takes "
                    f"{bench.ramp_s(volts):.1f} s\n")
            moved = bench.rest()
            tell(f"done: the stack is at {abs(moved['to_v']):.2f} V, read back\n")
            return moved
    return None
