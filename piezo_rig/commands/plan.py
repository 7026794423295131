"""Builds the samples of a protocol and checks them, without touching hardware."""

from __future__ import annotations

import argparse

HELP = "build and check the samples of a protocol"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("protocol", metavar="PROTOCOL",
                        help="a file, or the name of a shipped one")
    parser.add_argument("--rig", metavar="CONFIG", help="default: the simulated bench")
    parser.add_argument("--figure", metavar="FILE.png", help="also draw the drive into a picture")


def execute(args: argparse.Namespace) -> int:
    from piezo_rig.bench import plant_config, simulated_faults
    from piezo_rig.commands.console import seconds, size
    from piezo_rig.config import DEFAULT_RIG, load_rig
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.protocol.checks import extremes
    from piezo_rig.protocol.plan import DAC_MAX_POINTS
    from piezo_rig.report.terminal import draw
    from piezo_rig.resources import find

    rig = load_rig(args.rig or DEFAULT_RIG)
    if rig.simulated:
        plant_config(rig)
        simulated_faults(rig)
    plan = build_plan(load_protocol(find("protocols", args.protocol)), rig)
    protocol, limits, worst = plan.protocol, rig.limits, extremes(plan)
    print(f"protocol  {protocol.name}: {protocol.description or '(no description)'}")
    print(f"rig       {rig.name} ({rig.path})")
    print(f"plan      {len(plan.sweeps)} sweeps, {protocol.repeats} repeats, "
          f"{protocol.order}, {protocol.history}; hash {plan.hash[:16]}")
    print(f"samples   {plan.samples} at {plan.sample_rate:g} Sa/s")
    print(f"duration  {seconds(plan.duration_s)}: {seconds(plan.play_s)} of drive, "
          f"{plan.waits} x {rig.recovery_s:g} s at rest before virgin sweeps")
    print(f"file      up to {size(plan.file_bytes)}")
    print()
    print("condition              samples   drive V          slew V/s")
    for condition, wave in plan.conditions():
        slew = float(abs(wave.drive_v[1:] - wave.drive_v[:-1]).max()) * plan.sample_rate
        print(f"{condition.name:<22} {wave.drive_v.size:>7}   "
              f"{wave.drive_v.min():5.2f} .. {wave.drive_v.max():5.2f}   {slew:8.1f}")
    print()
    longest = max(s.samples for s in plan.sweeps)
    command_high = max(w.high_v for _, w in plan.conditions())
    table = [
        ("drive", f"{worst.drive_min_v:.3f} .. {worst.drive_max_v:.3f} V",
         f"{limits.drive_min_v:g} .. {limits.drive_max_v:g} V"),
        ("command", f"{rig.rest_command_v:.3f} .. {command_high:.3f} V",
         f"{rig.command_min_v:g} .. {rig.command_max_v:g} V"),
        ("slew rate", f"{worst.slew_v_per_s:.4g} V/s", f"{limits.slew_v_per_s:g} V/s"),
        ("current C dV/dt", f"{worst.current_a * 1e3:.3g} mA", f"{limits.current_a * 1e3:g} mA"),
        ("DAC step on the stack", f"{worst.dac_lsb_v * 1e3:.3g} mV", "16 bit"),
        ("DAC memory", f"{longest + 1} points", f"{DAC_MAX_POINTS} points"),
        ("digitizer record", f"{longest * rig.digitizer.oversampling} samples",
         f"{plan.sample_rate * rig.digitizer.oversampling:g} Sa/s"),
        ("sensor output", f"{worst.sensor_v:.3g} V ({worst.travel_um:.3g} um)",
         f"{rig.digitizer.sensor_range_v:g} V at {rig.sensitivity_um_per_v:g} um/V"),
    ]
    print("checked                 asked for                  limit")
    for name, asked, limit in table:
        print(f"{name:<23} {asked:<26} {limit}")
    if rig.rest_drive_v > 0.005:
        print(f"note: the generator's lowest level leaves {rig.rest_drive_v:.3f} V on the stack "
              "at rest; drives below that are played as that")
    condition, wave = max(plan.conditions(), key=lambda c: float(c[1].drive_v.max()))
    print()
    print(draw(
        [i / plan.sample_rate for i in range(wave.drive_v.size)], wave.drive_v,
        x_label="s", y_label=f"drive of {condition.name}, V",
    ))
    if args.figure:
        from pathlib import Path

        from piezo_rig.report.figures import plan_figure

        print(f"figure: {plan_figure(plan, Path(args.figure))}")
    return 0
