"""Seconds per sample of parallel ElasticPP materials in OpenSeesPy; standard library otherwise.

Run by `forward.py`, by an interpreter that has openseespy: reads k (V/um), x (um) and the
displacements (um) as JSON from stdin, prints the figure.
"""

import json
import sys
import time

import openseespy.opensees as ops


def main() -> None:
    given = json.load(sys.stdin)
    ops.wipe()
    for i, (k, x) in enumerate(zip(given["k"], given["x"]), start=1):  # noqa: B905
        ops.uniaxialMaterial("ElasticPP", i, abs(k), x)
    ops.uniaxialMaterial("Parallel", 100, *range(1, len(given["k"]) + 1))
    ops.testUniaxialMaterial(100)
    begin = time.perf_counter()
    for value in given["displacement"]:
        ops.setStrain(value)
        ops.getStress()
    print((time.perf_counter() - begin) / len(given["displacement"]))


if __name__ == "__main__":
    main()
