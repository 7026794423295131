"""A whole simulated bench: the instruments on real transports, one plant, one clock."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, MutableMapping
from types import TracebackType
from typing import Any

from drivers.clock import Clock, RealClock
from drivers.simulated.clock_server import ClockServer
from drivers.simulated.keysight_33500b import SimulatedKeysight33500B
from drivers.simulated.keysight_l4532a import SimulatedKeysightL4532A
from drivers.simulated.nidaqmx_stand_in import SENSOR, ServedCard
from drivers.simulated.servers import Device, LoopThread, PtyServer, TcpServer
from drivers.simulated.thorlabs_mdt69x import SimulatedThorlabsMDT69x
from drivers.simulated.wiring import Plant, Wiring

AMPLIFIERS: dict[str, Callable[..., Device]] = {
    "thorlabs_mdt69x": SimulatedThorlabsMDT69x, "manual": SimulatedThorlabsMDT69x,
}
"""The twins of the drivers; called with wiring, serial number, faults, set voltage and limit."""
SERIAL_NUMBERS = {"waveform_dac": "SIM00001", "digitizer": "SIM00002", "amplifier": "SIM00003"}


class SimulatedBench:
    """Serves the instruments until it is closed; a context manager.

    Parameters
    ----------
    plant : amplifier, actuator and sensor
    clock : bench time, shared by everything; with a virtual clock ``*OPC?``,
        ``*WAI`` and a fetch jump, with a real one they wait
    host : address to listen on
    ports : instrument -> TCP port; 0 or absent picks a free one
    serial_numbers : instrument -> serial number, beginning with SIM
    faults : instrument -> fault -> value, see `drivers.simulated.faults`; looked at
        in every exchange, so that a test may change them under way
    set_voltage_v, voltage_limit_v : as the amplifier is adjusted
    serial_lines : the instruments that are on a pseudo terminal; the others have a socket
    card : an NI card instead of generator and digitizer
    amplifier : which of ``AMPLIFIERS``

    ``addresses`` holds what the drivers' `open_transport` takes, for
    ``waveform_dac``, ``digitizer``, ``amplifier`` and ``clock``.
    """

    def __init__(
        self,
        plant: Plant,
        clock: Clock,
        *,
        host: str = "127.0.0.1",
        ports: Mapping[str, int] | None = None,
        serial_numbers: Mapping[str, str] | None = None,
        faults: MutableMapping[str, MutableMapping[str, Any]] | None = None,
        set_voltage_v: float = 75.0,
        voltage_limit_v: float = 75.0,
        serial_lines: Collection[str] = ("amplifier",),
        card: bool = False,
        amplifier: str = "thorlabs_mdt69x",
    ) -> None:
        serials = {**SERIAL_NUMBERS, **(serial_numbers or {})}
        for name, serial in serials.items():
            if not serial.startswith("SIM"):
                raise ValueError(f"{name}: a simulated serial number begins with SIM, not {serial}")
        self.plant = plant
        self.clock = clock
        self.faults = faults if faults is not None else {}
        for name in serials:
            self.faults.setdefault(name, {})
        self.addresses: dict[str, str] = {}
        prepare = getattr(plant, "prepare", None)
        if prepare is not None:
            prepare()
        self._wiring = Wiring(plant, clock)
        high_voltage = AMPLIFIERS[amplifier](
            self._wiring,
            serials["amplifier"],
            self.faults["amplifier"],
            set_voltage_v,
            voltage_limit_v,
        )
        generator = (self._wiring, clock, serials["waveform_dac"], self.faults["waveform_dac"])
        devices: dict[str, Device] = {
            "waveform_dac": (ServedCard if card else SimulatedKeysight33500B)(*generator),
            "amplifier": high_voltage,
            "clock": ClockServer(clock),
        }
        if card:
            self.addresses["digitizer"] = SENSOR
        else:
            devices["digitizer"] = SimulatedKeysightL4532A(
                self._wiring, clock, serials["digitizer"], self.faults["digitizer"]
            )
        paced = isinstance(clock, RealClock)
        self._servers: dict[str, TcpServer | PtyServer] = {
            name: PtyServer(device, paced) if name in serial_lines else TcpServer(device)
            for name, device in devices.items()
        }
        self._thread: LoopThread | None = LoopThread()
        try:
            self._thread.run(self._start(host, ports or {}))
        except BaseException:
            self.close()
            raise

    async def _start(self, host: str, ports: Mapping[str, int]) -> None:
        for name, server in self._servers.items():
            await server.start(host, ports.get(name, 0))
            self.addresses[name] = server.address

    async def _stop(self) -> None:
        for server in self._servers.values():
            await server.stop()

    def close(self) -> None:
        """Hang up on everyone and stop serving."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.run(self._stop())
            thread.stop()

    def __enter__(self) -> SimulatedBench:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
