"""A rig: which instruments, where they are, and within which limits they may play."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from piezo_rig.config.calibration import (
    AmplifierCalibration,
    InterferometerCalibration,
    load_amplifier,
    load_interferometer,
)
from piezo_rig.config.environment import Environment, environment_of
from piezo_rig.config.toml_text import Document, Table
from piezo_rig.resources import find

DEFAULT_RIG = "simulated_bench"
DAC_DRIVERS = ("keysight_33500b", "nidaqmx")
DIGITIZER_DRIVERS = ("keysight_l4532a", "nidaqmx")
AMPLIFIER_DRIVERS = ("thorlabs_mdt69x", "manual")
"""The names of `drivers.kinds`; a config is read without the drivers."""
KEYSIGHT_RANGES_V = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 128.0, 256.0)
CARD_RANGES_V = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
COMMAND_MAX_V, DRIVE_MAX_V = 0.0, 75.0
"""Of a config that does not say otherwise."""
SHIFT_V = 0.5
"""On the stack: so far a measured gain and offset may put its ends from those of the generator."""


@dataclass(frozen=True)
class Link:
    """How one instrument is reached. ``serial`` empty: any instrument of the kind is accepted."""

    driver: str
    address: str
    timeout_s: float
    serial: str


@dataclass(frozen=True)
class DigitizerSetup:
    """Wiring and ranges of the digitizer; a monitor channel of 0 means that it is not wired."""

    link: Link
    sensor_channel: int
    sensor_range_v: float
    monitor_channel: int
    monitor_range_v: float
    oversampling: int


@dataclass(frozen=True)
class Actuator:
    """The stack and what the plan has to know of it.

    ``capacitance_f`` is the small-signal value; ``large_signal_factor`` scales it for currents.
    ``travel_um_per_v`` bounds the travel that the sensor must be able to show.
    """

    model: str
    serial: str
    mounting: str
    capacitance_f: float
    large_signal_factor: float
    travel_um_per_v: float


@dataclass(frozen=True)
class Limits:
    """What the stack and the amplifier may be asked for. Drive in volts on the actuator."""

    drive_min_v: float
    drive_max_v: float
    slew_v_per_s: float
    current_a: float
    rest_slew_v_per_s: float


@dataclass(frozen=True)
class Rig:
    """Everything that a config file says."""

    name: str
    path: str
    text: str
    simulated: bool
    clock: str
    operator: str
    waveform_dac: Link
    command_min_v: float
    command_max_v: float
    digitizer: DigitizerSetup
    amplifier: Link
    amplifier_calibration: AmplifierCalibration
    interferometer: Link
    interferometer_calibration: InterferometerCalibration
    sensitivity_switch: int
    polarity: int
    actuator: Actuator
    limits: Limits
    recovery_s: float
    environment: Environment = field(default_factory=Environment)
    plant: dict[str, Any] = field(default_factory=dict)
    faults: dict[str, Any] = field(default_factory=dict)

    @property
    def is_card(self) -> bool:
        """Whether one card is waveform DAC and digitizer, on the waveform DAC's line."""
        return self.waveform_dac.driver == "nidaqmx"

    @property
    def gain(self) -> float:
        return self.amplifier_calibration.gain

    @property
    def offset_v(self) -> float:
        return self.amplifier_calibration.offset_v

    @property
    def set_voltage_v(self) -> float:
        """What the amplifier itself tells of its offset."""
        return self.amplifier_calibration.set_voltage_v

    @property
    def sensitivity_um_per_v(self) -> float:
        return self.interferometer_calibration.sensitivities_um_per_v[self.sensitivity_switch]

    @property
    def rest_command_v(self) -> float:
        """The command at which the stack sees 0 V, or as little as the generator reaches."""
        return max(-self.offset_v / self.gain, self.command_min_v)

    @property
    def rest_drive_v(self) -> float:
        """V on the stack at rest: 0 but for what a calibration moved it beyond the generator."""
        return self.gain * self.rest_command_v + self.offset_v

    @property
    def top_drive_v(self) -> float:
        """V on the stack, to the hundredth, up to which the limits of drive and command go."""
        by_command = self.gain * self.command_max_v + self.offset_v
        return min(self.limits.drive_max_v, math.floor(100.0 * by_command + 1e-4) / 100.0)

    @property
    def way_to_the_top(self) -> str:
        """What to do where the command ends before ``drive_max_v``; empty where it does not.

        Who has calibrated may raise the command's limit by as much as a calibration shifts; where
        more is missing, the limit is meant, or the calibration wrong.
        """
        top, wanted = self.top_drive_v, self.limits.drive_max_v
        if top >= wanted:
            return ""
        stay = f"play to {top:g} V at most"
        if wanted - top > SHIFT_V:
            return stay
        command_v = command_max_for(wanted, self.gain, self.offset_v)
        return f"set command_max_v = {command_v:g} under [waveform_dac] in {self.path}, or {stay}"


def command_max_for(drive_v: float, gain: float, offset_v: float) -> float:
    """The least ``command_max_v``, in whole mV but written in V, with which a drive is reached."""
    return math.ceil(1e3 * (drive_v - offset_v) / gain - 1e-6) / 1e3


def _link(
    root: Table, key: str, drivers: tuple[str, ...], simulated: bool, without_link: tuple[str, ...]
) -> tuple[Table, Link]:
    table = root.table(key)
    driver = table.text("driver", choices=drivers)
    needs_address = not simulated and driver not in without_link
    return table, Link(
        driver=driver,
        address=table.text("address") if needs_address else table.text("address", ""),
        timeout_s=table.number("timeout_s", 2.0, above=0.0, high=60.0),
        serial=table.text("serial", ""),
    )


def _check_card(table: Table, setup: DigitizerSetup, dac: Link) -> None:
    """What a card cannot do."""
    if setup.monitor_channel:
        raise table.error(
            "monitor_channel", "the inputs of a card take 10 V, the drive is up to 75 V",
            "set monitor_channel = 0",
        )
    if setup.oversampling != 1:
        raise table.error(
            "oversampling", "input and output of a card share one sample clock",
            "set oversampling = 1, and raise sample_rate in the protocol",
        )
    devices = {link.address.partition("/")[0] for link in (dac, setup.link) if link.address
               and not link.address.upper().startswith("TCPIP")}
    if len(devices) > 1:
        raise table.error(
            "address", f"{setup.link.address} is not on the card of {dac.address}",
            "input and output share the card's clock: name two channels of one card",
        )


def _same_serial(table: Table, link: Link, calibrated: str) -> None:
    """A calibration belongs to one instrument."""
    if link.serial and calibrated and link.serial != calibrated:
        raise table.error(
            "serial", f"is '{link.serial}'; the calibration is of '{calibrated}'",
            "name the calibration of this instrument, or calibrate it",
        )


def load_rig(name: str = DEFAULT_RIG) -> Rig:
    """Read a rig's config, by path or by the name of a shipped one.

    Raises
    ------
    InputError : the file or a calibration that it names is missing or wrong; names line and key
    """
    path = find("configs", name)
    document = Document.load(path, "config", "rig config")
    root = document.root()
    root.text("schema", choices=("piezo-rig/rig/1",))
    rig_name = root.text("name", path.stem)
    bench = root.table("bench", required=False)
    simulated = bench.flag("simulated", False)
    clock = bench.text("clock", "virtual" if simulated else "real")
    if clock not in ("virtual", "real") and not clock.upper().startswith("TCPIP"):
        raise bench.error(
            "clock", f"'{clock}' is neither virtual, real, nor the address of a bench's clock"
        )
    if clock == "virtual" and not simulated:
        raise bench.error("clock", "a virtual clock needs 'simulated = true'")
    operator = bench.text("operator", "")
    bench.finish()

    dac, dac_link = _link(root, "waveform_dac", DAC_DRIVERS, simulated, ())
    command_min = dac.number("command_min_v", -10.0, low=-10.0, high=10.0)
    command_max = dac.number("command_max_v", COMMAND_MAX_V, low=-10.0, high=10.0)
    dac.finish()

    digitizer, digitizer_link = _link(root, "digitizer", DIGITIZER_DRIVERS, simulated, ())
    card = dac_link.driver == "nidaqmx"
    if card != (digitizer_link.driver == "nidaqmx"):
        raise digitizer.error(
            "driver", "a card is waveform DAC and digitizer, or neither",
            "input and output share the card's clock: name nidaqmx under both",
        )
    ranges = CARD_RANGES_V if card else KEYSIGHT_RANGES_V

    def full_scale(key: str, default: float) -> float:
        value = digitizer.number(key, default)
        if value not in ranges:
            raise digitizer.error(
                key, f"{value:g} is no range of the digitizer",
                "use one of " + ", ".join(f"{r:g}" for r in ranges),
            )
        return value

    setup = DigitizerSetup(
        link=digitizer_link,
        sensor_channel=digitizer.integer("sensor_channel", 2, low=1, high=2),
        sensor_range_v=full_scale("sensor_range_v", 1.0),
        monitor_channel=digitizer.integer("monitor_channel", 1, low=0, high=2),
        monitor_range_v=full_scale("monitor_range_v", 10.0 if card else 128.0),
        oversampling=digitizer.integer("oversampling", 1, low=1, high=100),
    )
    if card:
        _check_card(digitizer, setup, dac_link)
    if setup.monitor_channel == setup.sensor_channel:
        raise digitizer.error("monitor_channel", "the same channel as the sensor")
    digitizer.finish()

    amplifier, amplifier_link = _link(
        root, "amplifier", AMPLIFIER_DRIVERS, simulated, ("manual",)
    )
    amplifier_calibration = load_amplifier(
        find("calibration", amplifier.text("calibration", "amplifier"), path.parent)
    )
    _same_serial(amplifier, amplifier_link, amplifier_calibration.serial)
    amplifier.finish()

    sensor, sensor_link = _link(
        root, "interferometer", ("sios_sp_s120",), simulated, ("sios_sp_s120",)
    )
    table = sensor.text("sensitivity_table", "printed", choices=("printed", "exact"))
    sensor_calibration = load_interferometer(
        find("calibration", sensor.text("calibration", "sios_sp_s120"), path.parent), table
    )
    _same_serial(sensor, sensor_link, sensor_calibration.serial)
    switch = sensor.integer("sensitivity", low=0, high=6)
    polarity = sensor.integer("polarity", sensor_calibration.polarity or -1)
    if polarity not in (-1, 1):
        raise sensor.error("polarity", "expected 1 or -1")
    if polarity == -sensor_calibration.polarity:
        raise sensor.error(
            "polarity", f"is {polarity}; the calibration {sensor_calibration.path} measured "
            f"{sensor_calibration.polarity}",
            "leave polarity out of the config; if the beam was turned since, calibrate again",
        )
    sensor.finish()

    stack = root.table("actuator", required=False)
    actuator = Actuator(
        model=stack.text("model", "PI P-885.51"),
        serial=stack.text("serial", ""),
        mounting=stack.text("mounting", ""),
        capacitance_f=stack.number("capacitance_f", 1.5e-6, above=0.0, high=1.0),
        large_signal_factor=stack.number("large_signal_factor", 1.7, low=1.0, high=5.0),
        travel_um_per_v=stack.number("travel_um_per_v", 0.15, above=0.0),
    )
    stack.finish()

    bounds = root.table("limits", required=False)
    limits = Limits(
        drive_min_v=bounds.number("drive_min_v", 0.0),
        drive_max_v=bounds.number("drive_max_v", DRIVE_MAX_V),
        slew_v_per_s=bounds.number("slew_v_per_s", 10_000.0, above=0.0),
        current_a=bounds.number("current_a", 0.05, above=0.0),
        rest_slew_v_per_s=bounds.number("rest_slew_v_per_s", 300.0, above=0.0),
    )
    if limits.drive_max_v <= limits.drive_min_v:
        raise bounds.error("drive_max_v", "must be above drive_min_v")
    if not limits.drive_min_v <= 0.0 <= limits.drive_max_v:
        raise bounds.error("drive_min_v", "0 V, the rest level, must lie within the limits")
    bounds.finish()

    environment = environment_of(root.table("environment", required=False))
    recovery_s = root.number("recovery_s", 30.0, low=0.0, high=86_400.0)
    plant, faults = root.raw("plant"), root.raw("faults")
    for key, given in (("plant", plant), ("faults", faults)):
        if given and not simulated:
            raise root.error(key, f"only a simulated bench has a table [{key}]")
    root.finish()

    rest = -amplifier_calibration.offset_v / amplifier_calibration.gain
    slack = SHIFT_V / amplifier_calibration.gain
    if not command_min - slack <= rest <= command_max + 1e-9:
        raise dac.error(
            "command_min_v",
            f"rest (0 V on the stack) needs {rest:g} V of command, outside "
            f"{command_min:g} .. {command_max:g} V",
        )
    return Rig(
        name=rig_name, path=str(path), text=document.text, simulated=simulated, clock=clock,
        operator=operator, waveform_dac=dac_link, command_min_v=command_min,
        command_max_v=command_max, digitizer=setup, amplifier=amplifier_link,
        amplifier_calibration=amplifier_calibration, interferometer=sensor_link,
        interferometer_calibration=sensor_calibration, sensitivity_switch=switch,
        polarity=polarity, actuator=actuator, limits=limits, recovery_s=recovery_s,
        environment=environment, plant=plant, faults=faults,
    )
