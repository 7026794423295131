"""Speed of the forward model: 40 elements over the thesis's staircase, as played.

    python benchmarks/forward.py [--json FILE] [--peer-python PATH]

Everything is measured in one process, best of several, as a rate in million
samples per second and as a ratio to `np.copy` of the same array. Peers: a
NumPy loop over samples, and OpenSeesPy (40 parallel ElasticPP materials) where
an interpreter has it; its springs are taken without their signs.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.causes import load_model

CALIBRATION = Path(__file__).parents[1] / "calibration"
RATE = 5000.0


def staircase() -> np.ndarray:
    """0-5 .. 0-75 V, then 75-70 .. 75-5 V, ten cycles each at 2 Hz and 5 kSa/s."""

    def cycles(a: float, b: float) -> np.ndarray:
        there = np.linspace(a, b, 1250, endpoint=False)
        back = np.linspace(b, a, 1250, endpoint=False)
        return np.tile(np.concatenate([there, back]), 10)

    parts = [cycles(0.0, v) for v in np.arange(5.0, 76.0, 5.0)]
    parts.append(np.linspace(0.0, 75.0, 1250, endpoint=False))
    parts += [cycles(75.0, v) for v in np.arange(70.0, 4.0, -5.0)]
    return np.concatenate(parts)


def best(call: Callable[[], Any], times: int) -> float:
    """Shortest time of a call, seconds; the first one (compilation, caches) does not count."""
    call()
    shortest = np.inf
    for _ in range(times):
        begin = time.perf_counter()
        call()
        shortest = min(shortest, time.perf_counter() - begin)
    return float(shortest)


def naive(model: Any, drive: np.ndarray) -> np.ndarray:
    """Play operators, all at once, sample by sample."""
    table = model.maxwell.elements
    compliance = 1.0 / table.slopes
    radius = np.concatenate([[0.0], table.knots_v[:-1]])
    weight = np.diff(compliance, prepend=0.0)
    state, out = np.zeros(radius.size), np.empty(drive.size)
    for i, v in enumerate(drive):
        state = np.minimum(np.maximum(state, v - radius), v + radius)
        out[i] = weight @ state
    return out


def opensees(model: Any, drive: np.ndarray, python: str) -> float | None:
    """Seconds per sample of 40 parallel ElasticPP, driven in displacement; None if absent."""
    table = model.maxwell.elements
    x = model.simulate(np.arange(drive.size) / RATE, drive)
    given = {"k": list(table.k_v_per_um), "x": list(table.slides_at_um), "displacement": list(x)}
    try:
        done = subprocess.run(
            [python, str(Path(__file__).with_name("opensees_peer.py"))],
            input=json.dumps(given), capture_output=True, text=True,
        )  # fmt: skip
        return float(done.stdout.split()[0])
    except (OSError, ValueError, IndexError):
        return None


def measure(peer_python: str) -> dict[str, Any]:
    clean = staircase()
    noisy = clean + 0.002 * np.random.default_rng(0).standard_normal(clean.size)
    seconds = np.arange(clean.size) / RATE
    n = clean.size
    classical = load_model(CALIBRATION / "thesis_classical.json")
    by_range = load_model(CALIBRATION / "thesis_range.json")
    rows: list[tuple[str, float]] = [("np.copy", best(lambda: np.copy(clean), 60) / n)]
    for label, model in (("classical", classical), ("range", by_range)):
        for drive, words in ((clean, "as played"), (noisy, "2 mV of noise")):
            call = lambda m=model, d=drive: m.simulate(seconds, d)  # noqa: E731
            rows.append((f"{label}, 40 elements, {words}", best(call, 20) / n))
    part = clean[-60_000:]
    rows.append(("NumPy, sample by sample", best(lambda: naive(classical, part), 1) / part.size))
    peer = opensees(classical, part[:30_000], peer_python)
    if peer is not None:
        rows.append(("OpenSeesPy, 40 parallel ElasticPP", peer))
    copy = rows[0][1]
    return {
        "benchmark": "forward",
        "samples": n,
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "rows": [
            {"what": w, "msamples_per_s": 1e-6 / s, "percent_of_copy": 100.0 * copy / s}
            for w, s in rows
        ],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    parser.add_argument("--peer-python", default=sys.executable, metavar="PATH",
                        help="an interpreter that can import openseespy")  # fmt: skip
    options = parser.parse_args()
    figures = measure(options.peer_python)
    print(f"| forward model, {figures['samples']} samples | MS/s | % of np.copy |")
    print("|---|---|---|")
    for row in figures["rows"]:
        print(f"| {row['what']} | {row['msamples_per_s']:.3g} | {row['percent_of_copy']:.3g} |")
    if not any("OpenSeesPy" in row["what"] for row in figures["rows"]):
        print("\nOpenSeesPy could not be imported here (`--peer-python PATH`).")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
