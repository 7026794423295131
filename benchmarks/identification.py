"""Speed of identification: three repeats of the thesis's matrix from loaded arrays.

    python benchmarks/identification.py [--json FILE]

The reference is scipy's `nnls` on the full matrix of band states of one repeat, decimated
to 20,000 samples, scaled up linearly.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
from forward import CALIBRATION, best

from piezo_rig.causes import load_model
from piezo_rig.identification import identify, least_squares, prepare, uncertainty
from piezo_rig.identification.breakpoints import equal_volts
from piezo_rig.identification.normal import pieces_of
from piezo_rig.run_file import Sweep


def matrix(repeats: int, noise_um: float = 0.005) -> list[Sweep]:
    """The 27 conditions, ten cycles at 2 Hz and 5 kSa/s, played by the range model."""
    model = load_model(CALIBRATION / "thesis_range.json")
    rng = np.random.default_rng(0)
    sweeps: list[Sweep] = []

    def ramp(a: float, b: float) -> np.ndarray:
        return np.linspace(a, b, 1250, endpoint=False)

    for repeat in range(1, repeats + 1):
        drives = {
            f"0-{v}": np.tile(np.concatenate([ramp(0, v), ramp(v, 0)]), 10)
            for v in range(10, 80, 5)
        }
        for v in range(65, 0, -5):
            cycles = np.tile(np.concatenate([ramp(75, v), ramp(v, 75)]), 10)
            drives[f"75-{v}"] = np.concatenate([ramp(0, 75), cycles, ramp(75, 0)])
        for name, drive in drives.items():
            y = model.simulate(np.arange(drive.size) / 5000.0, drive)
            y = y + noise_um * rng.standard_normal(y.size)
            sweeps.append(
                Sweep(
                    f"sweep_{len(sweeps) + 1:04d}", (drive - 75) / 7.5, -y / 3.87, 5000.0, 7.5,
                    75.0, 3.87, -1, 0.0, name, repeat, "virgin", 0.0, "SIMULATED",
                )
            )  # fmt: skip
    return sweeps


def measure() -> dict[str, Any]:
    rows = []
    for repeats in (1, 3):
        sweeps = matrix(repeats)
        n = sum(s.samples for s in sweeps)

        def fit(sweeps: list[Sweep] = sweeps) -> Any:
            data = prepare(sweeps)
            knots = equal_volts(75.0, 40)
            start = least_squares._start(data, True, knots, 2 * knots)
            return data, *least_squares.linear(data, start, pieces_of(data))

        seconds = best(fit, 5)
        data, curves, _ = fit()
        normal = uncertainty.linearised(data, curves, pieces_of(data))
        floor = least_squares.floor_of(data)
        boot = best(lambda d=data, c=curves, m=normal, f=floor: uncertainty.bands(d, c, m, f, 0), 5)
        rows += [
            {"what": f"classical, 40 thresholds, {repeats} repeats", "samples": n, "s": seconds},
            {"what": f"1000 bootstrap refits, {repeats} repeats", "samples": n, "s": boot},
        ]
    for name, elements in (("classical", 40), ("classical", None), ("range", 40), ("range", None)):
        begin = time.perf_counter()
        identify(sweeps, name, elements=elements)
        spent = time.perf_counter() - begin
        how = f"{elements} elements" if elements else "elements chosen"
        rows.append({"what": f"identify(), {name}, {how}", "samples": n, "s": spent})
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    rows.append(
        {"what": "scipy nnls on the full matrix, scaled up", "samples": n, "s": _peer(sweeps, n)}
    )
    return {"benchmark": "identification", "rows": rows, "peak_gb": peak}


def _peer(sweeps: list[Sweep], n: int) -> float:
    from scipy.optimize import nnls

    columns, heights, size = [], [], 0
    radius = np.concatenate([[0.0], equal_volts(75.0, 40)])
    for s in sweeps[10:14]:
        drive = s.drive_v[::5]
        state = np.zeros(radius.size)
        block = np.empty((drive.size, radius.size))
        for i, v in enumerate(drive):
            state = np.minimum(np.maximum(state, v - radius), v + radius)
            block[i] = state
        columns.append(block - np.append(block[:, 1:], np.zeros((drive.size, 1)), axis=1))
        heights.append(s.displacement_um[::5])
        size += drive.size
    full, y = np.concatenate(columns), np.concatenate(heights)
    begin = time.perf_counter()
    nnls(full, y)
    return (time.perf_counter() - begin) * n / size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    figures = measure()
    print("| identification | samples | s |")
    print("|---|---|---|")
    for row in figures["rows"]:
        print(f"| {row['what']} | {row['samples']} | {row['s']:.3g} |")
    print(f"\nPeak memory before the reference: {figures['peak_gb']:.2f} GB, "
          f"of which the samples themselves are {32e-9 * figures['rows'][-1]['samples']:.2f}.")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
