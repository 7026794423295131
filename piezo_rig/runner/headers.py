"""What a run says about itself and about its sweeps before they are played."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

from piezo_rig import __version__
from piezo_rig.bench import Bench
from piezo_rig.protocol import Plan, PlannedSweep
from piezo_rig.protocol.drive_file import pack
from piezo_rig.run_file.layout import RunHeader, SweepHeader
from piezo_rig.runner.resume import Seam


def run_header(plan: Plan, bench: Bench, clock_s: float) -> RunHeader:
    """What the run file says about itself; ``clock_s`` is now on the run's clock."""
    rig = plan.rig
    stack = rig.actuator
    return RunHeader(
        title=plan.protocol.name, origin=bench.origin, protocol_text=plan.protocol.text,
        plan_hash=plan.hash, rig_config=rig.text,
        protocol_files=pack(plan.protocol.files),
        rig_path=str(Path(rig.path).resolve()), operator=rig.operator,
        actuator={
            "model": stack.model, "serial": stack.serial, "mounting": stack.mounting,
            "capacitance_f": stack.capacitance_f,
        },
        start_time=datetime.now(UTC).isoformat(timespec="seconds"),
        clock_start=clock_s, software_version=__version__, git_revision=git_revision(),
        instruments=bench.instruments, monitor=bool(rig.digitizer.monitor_channel),
        calibrations={
            rig.amplifier_calibration.path: rig.amplifier_calibration.sha256,
            rig.interferometer_calibration.path: rig.interferometer_calibration.sha256,
        },
        calibration_texts={
            rig.amplifier_calibration.path: rig.amplifier_calibration.text,
            rig.interferometer_calibration.path: rig.interferometer_calibration.text,
        },
    )


def sweep_header(plan: Plan, sweep: PlannedSweep, seam: Seam | None = None) -> SweepHeader:
    """The attributes of one sweep that are known before it is played."""
    rig = plan.rig
    return SweepHeader(
        name=sweep.name, samples=sweep.samples, sample_rate=plan.sample_rate, gain=rig.gain,
        offset_v=rig.offset_v, sensitivity_um_per_v=rig.sensitivity_um_per_v,
        polarity=rig.polarity, condition=sweep.condition.name, repeat=sweep.repeat,
        history=sweep.history, oversampling=rig.digitizer.oversampling,
        details=dict(sweep.condition.details),
        supersedes=seam.supersedes.get(sweep.name, "") if seam else "",
    )


def git_revision() -> str:
    """The revision of the checkout that runs, empty outside one."""
    package = Path(__file__).resolve().parent.parent
    if not (package.parent / ".git").exists():
        return ""
    try:
        return subprocess.run(
            ["git", "-C", str(package.parent), "rev-parse", "HEAD"],
            capture_output=True, text=True, timeout=5, check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
