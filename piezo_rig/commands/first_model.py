"""The first model of a run: classical, by the thesis's slope scheme, and its figure.

The thesis identifies its classical model from 0-75 V and looks at it on
0-65 V (section 4.4). Where those were not played, the widest sweeps stand in.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import Sweep

ELEMENTS = 40


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
        return f"none ({error.code})", "none"
    model = save_model(found.model, path.with_name(path.stem + "_classical.json"))
    shown = _of_condition(sweeps, "0-65")[0]
    predicted = found.model.simulate(shown.time_s, shown.drive_v, history=shown.history)
    measured = shown.displacement_um
    error_um = measured - predicted
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
    """All sweeps of a condition; of the one with the widest drive where it was not played."""
    if not sweeps:
        raise InputError(
            "no-data", "the run holds no sweeps", "it was stopped at once", "run again"
        )
    chosen = [s for s in sweeps if s.condition == name]
    if not chosen:
        widest = max(sweeps, key=lambda s: float(np.ptp(s.drive_v)))
        chosen = [s for s in sweeps if s.condition == widest.condition]
    return chosen
