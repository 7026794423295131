"""Speed of a diagnosis: recordings of one hidden effect, and of none.

    python benchmarks/diagnosis.py

CPU seconds, all threads together. The reference is one singular value decomposition of a fixed
matrix of 1000 x 1000 numbers, taken in the same run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw

CASES = (
    ("null", 9001, "matrix", "white"), ("null", 9002, "rates", "ar"),
    ("null", 9003, "holds", "1/f"), ("creep", 660, "matrix", "white"),
)  # fmt: skip
D_PRIME = 40.0


def cpu_s(work: Callable[[], Any], times: int = 3) -> float:
    """Least CPU time of several runs, after one that compiles."""
    work()
    taken = []
    for _ in range(times):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return min(taken)


def main() -> None:
    matrix = np.random.default_rng(0).standard_normal((1000, 1000))
    reference = cpu_s(lambda: np.linalg.svd(matrix))
    print("| diagnosis | CPU s | times the reference |\n|---|---|---|")
    print(f"| decomposition of 1000 x 1000 numbers | {reference:.3g} | 1 |")
    for kind, seed, protocol, noise in CASES:
        sweeps = draw(kind, seed, protocol, noise, D_PRIME, 2).sweeps
        seconds = cpu_s(lambda sweeps=sweeps: diagnose(sweeps, "classical"))
        print(f"| {kind}, {protocol}, {noise} | {seconds:.3g} | {seconds / reference:.3g} |")


if __name__ == "__main__":
    main()
