"""The first model of a run: classical, by the thesis's slope scheme, and its figure.

The thesis identifies its classical model from 0-75 V and looks at it on
0-65 V (section 4.4). Where those were not played, the widest sweeps stand in,
of whole cycles if there are any: that is what slopes are read off. From other
drives they may come out anyhow, and a model that follows its own data worse
than a straight line does is not kept.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import FloatArray, Sweep

ELEMENTS = 40
CYCLES = ("triangle", "sine")
"""Waveforms that go to and fro between two voltages."""
STILL = ("blank", "hold")
"""Waveforms that no model is identified from."""


def first_model(path: Path) -> tuple[str, str]:
    """Identify and draw; returns the paths of model and figure.

    A run that holds nothing to identify (a blank, say) gives the reason instead of paths.
    """
    from piezo_rig.identification import identify, save_model
    from piezo_rig.report.figures import model_figure

    run = Run(path)
    sweeps = run.sweeps()
    try:
        train = _of_condition(sweeps, "0-75")
        if train[0].condition != "0-75":
            print(f"0-75 V was not played; {train[0].condition} stands in for it")
        print(f"identifying: classical, slopes, {ELEMENTS} elements, from "
              f"{len(train)} sweep(s) of {train[0].condition}")
        found = identify(
            train, "classical", "slopes", ELEMENTS,
            runs=[{"name": path.name, "sha256": run.sha256()}],
        )
    except InputError as error:
        print(f"no model: {error.what}")
        _say_what_else(train, path)
        return f"none ({error.code})", "none"
    shown = _of_condition(sweeps, "0-65")[0]
    predicted = found.model.simulate(shown.time_s, shown.drive_v, history=shown.history)
    measured = shown.displacement_um
    error_um = measured - predicted
    rms_nm, by_line_nm = 1e3 * float(np.std(error_um)), _by_a_line_nm(shown.drive_v, measured)
    if rms_nm > by_line_nm:
        print(f"no model: what came out is off by {rms_nm:.0f} nm rms on {shown.condition}, "
              f"a straight line by {by_line_nm:.0f} nm")
        _say_what_else(train, path)
        return "none (worse-than-a-line)", "none"
    model = save_model(found.model, path.with_name(path.stem + "_classical.json"))
    travel = float(np.ptp(measured))
    print(f"{shown.condition}, repeat {shown.repeat}: largest error "
          f"{np.abs(error_um).max() * 1e3:.0f} nm, "
          f"{100 * np.abs(error_um).max() / travel:.2f} % of {travel:.2f} um of travel; "
          f"rms {1e3 * np.sqrt(np.mean(error_um**2)):.0f} nm")
    figure = model_figure(
        path.with_suffix(".png"),
        f"{path.stem}: classical Maxwell model from {train[0].condition} V on {shown.condition} V",
        shown.time_s, shown.drive_v, measured, predicted,
    )
    return str(model), str(figure)


def _of_condition(sweeps: list[Sweep], name: str) -> list[Sweep]:
    """All sweeps of a condition; where it was not played, of the one with the widest cycles.

    Where no cycles were played either: of the one with the widest drive.
    """
    if not sweeps:
        raise InputError(
            "no-data", "the run holds no sweeps", "it was stopped at once", "run again"
        )
    chosen = [s for s in sweeps if s.condition == name]
    if not chosen:
        widest = max(sweeps, key=lambda s: (_waveform(s) in CYCLES, float(np.ptp(s.drive_v))))
        chosen = [s for s in sweeps if s.condition == widest.condition]
    return chosen


def _waveform(sweep: Sweep) -> str:
    """As the protocol has it; empty where the run does not say."""
    return str(sweep.details.get("waveform", ""))


def _by_a_line_nm(drive_v: FloatArray, measured_um: FloatArray) -> float:
    """What the best straight line of displacement over drive, both (n,), leaves: rms, nm.

    Its offset is free, so a model is held against it with its own taken out: a classical model
    knows no first rise, and is off by a constant after one.
    """
    line = np.polynomial.Polynomial.fit(drive_v, measured_um, 1)
    return 1e3 * float(np.std(measured_um - line(drive_v)))


def _say_what_else(train: list[Sweep], path: Path) -> None:
    """Why slopes do not suit a drive, and what does; nothing where that is not the reason."""
    waveform = _waveform(train[0])
    if waveform and waveform not in CYCLES + STILL:
        print(f"  slopes are read off cycles between two voltages; waveform = \"{waveform}\" is "
              "another drive")
        print(f"  by least squares: piezo-rig identify {path} --model classical --out MODEL.json")
