"""The bench as an ophyd-async device, for labs whose experiments are bluesky plans.

Thin on purpose: one device plays one sweep per trigger and reads it as arrays, through the same
plan, limits, drivers and guard as `piezo-rig run`. There is no run file; what is to be kept is the
caller's to keep (`run` is the way to a run). Needs the extra ``ophyd``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any, TypeVar

import numpy as np
from ophyd_async.core import (
    Array1D,
    AsyncStatus,
    StandardReadable,
    StandardReadableFormat,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

from piezo_rig.bench import Bench, open_bench
from piezo_rig.errors import InputError
from piezo_rig.protocol import Plan
from piezo_rig.run_file.reader import decimate

T = TypeVar("T")


class PiezoBench(StandardReadable):
    """A bench that plays the conditions of a plan.

    ``stage`` connects the instruments and brings the stack to rest, ``trigger`` plays the sweep of
    ``condition`` (waiting for the actuator to forget first, where its history is virgin),
    ``unstage`` brings the stack to rest and lets go. Errors are those of the bench, as
    `PiezoRigError`. Instruments are blocking: all of it happens on one thread of its own.

    Parameters
    ----------
    plan : the checked samples of a protocol on a rig
    confirm : asks the operator where the sensitivity switch stands
    clock : replaces the clock that the rig's config names
    """

    def __init__(
        self, plan: Plan, confirm: Callable[[str], bool], name: str = "piezo", clock: Any = None
    ) -> None:
        self._plan, self._confirm, self._clock = plan, confirm, clock
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="piezo bench")
        self._open = ExitStack()
        self._bench: Bench | None = None
        first = plan.sweeps[0].condition.name
        with self.add_children_as_readables():
            self.drive_v, self._set_drive = soft_signal_r_and_setter(Array1D[np.float64], units="V")
            self.displacement_um, self._set_displacement = soft_signal_r_and_setter(
                Array1D[np.float64], units="um"
            )
            self.start_s, self._set_start = soft_signal_r_and_setter(float, units="s", precision=6)
        with self.add_children_as_readables(StandardReadableFormat.CONFIG_SIGNAL):
            self.condition = soft_signal_rw(str, first)
            self.sample_rate, _ = soft_signal_r_and_setter(float, plan.sample_rate, units="Hz")
            self.plan_hash, _ = soft_signal_r_and_setter(str, plan.hash)
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def stage(self) -> None:
        await self._do(self._connect)

    @AsyncStatus.wrap
    async def unstage(self) -> None:
        await self._do(self._leave)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        wanted = await self.condition.get_value()
        drive_v, displacement_um, start_s = await self._do(lambda: self._play(wanted))
        self._set_drive(drive_v)
        self._set_displacement(displacement_um)
        self._set_start(start_s)

    async def _do(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _connect(self) -> None:
        self._bench = self._open.enter_context(
            open_bench(self._plan.rig, self._confirm, clock=self._clock)
        )
        try:
            self._bench.rest()
        except BaseException:
            self._bench = None
            self._open.close()  # the guard goes on with what is not at rest
            raise

    def _leave(self) -> None:
        bench, self._bench = self._bench, None
        with self._open:
            if bench is not None and bench.touched:
                bench.rest()

    def _play(self, wanted: str) -> tuple[np.ndarray, np.ndarray, float]:
        sweep = next((s for s in self._plan.sweeps if s.condition.name == wanted), None)
        if sweep is None or self._bench is None:
            why = f"the plan has no condition '{wanted}'" if self._bench else "it is not staged"
            raise InputError("ophyd", f"nothing is played: {why}", "a slip in the bluesky plan",
                             "stage the device, and set one of the plan's conditions")
        bench, rig = self._bench, self._plan.rig
        bench.check_guard()
        if sweep.history == "virgin":
            bench.step(f"recovering before {wanted}", rig.recovery_s)
            bench.clock.sleep(rig.recovery_s)
        recorded = bench.play(sweep.name, sweep.wave, self._plan.sample_rate)
        volts = decimate(recorded.sensor_v, rig.digitizer.oversampling)
        displacement_um = rig.polarity * (volts - volts[0]) * rig.sensitivity_um_per_v
        return sweep.wave.drive_v, displacement_um, recorded.start_time
