"""Speed of the simulated bench: the thesis's matrix through the real transports.

    python benchmarks/bench.py

The reference is the drive's own duration, without the rests between sweeps.
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def measure() -> dict[str, Any]:
    """Wall seconds of the matrix and of ``--help``, peak memory of this process."""
    from piezo_rig.commands.run import record
    from piezo_rig.config import load_rig
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.resources import find

    rig = load_rig()
    plan = build_plan(load_protocol(find("protocols", "thesis_matrix")), rig)
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        begin = time.perf_counter()
        record(plan, rig, Path(folder))
        matrix_s = time.perf_counter() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    helps = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-m", "piezo_rig", "--help"], capture_output=True)
        helps.append(time.perf_counter() - begin)
    return {
        "benchmark": "bench",
        "rows": [
            {"what": "thesis_matrix on the simulated bench", "samples": plan.samples,
             "s": matrix_s, "ratio": plan.play_s / matrix_s, "peak_gb": peak},
            {"what": "piezo-rig --help", "samples": 0, "s": min(helps), "ratio": 0, "peak_gb": 0},
        ],
    }


def main() -> None:
    figures = measure()
    print("| simulated bench | s | times faster than the drive | peak memory, GB |")
    print("|---|---|---|---|")
    for row in figures["rows"]:
        print(f"| {row['what']} | {row['s']:.3g} | "
              + (f"{row['ratio']:.0f} | {row['peak_gb']:.2f} |" if row["samples"] else "| |"))
    if "--json" in sys.argv:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
