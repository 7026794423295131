"""All benchmarks, each in its own process, into docs/performance.md: ``make bench-figures``."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "performance.md"

HEAD = """# Speed

Measured on two shared cores of a virtual machine by `make bench-figures`; absolute times there
vary by a factor of two from day to day, so read the ratios, each taken within one run against the
reference that it names.
"""

PROSE = {
    "forward": """## Forward model

40 elements (`calibration/thesis_classical.json` and `thesis_range.json`) over the staircase of
the thesis as it was played: 725,000 samples. Reference: `np.copy` of the same array. Aim: 20 % of
its rate, 10 % with 2 mV of noise on the drive.
""",
    "identification": """## Identification

Three repeats of the matrix, 2,122,500 samples, from loaded arrays. Aim: under 0.5 s on two cores,
1000 bootstrap refits within 0.2 s more, linear in samples. `identify()` does all that the verb
does: the number of elements chosen or given, laws by Gauss-Newton, held-out scores, bands.
""",
    "diagnosis": """## Diagnosis

Two recordings of every condition, with nothing hidden in them or with one effect. Reference: one
singular value decomposition of 1000 x 1000 numbers. A study plays thousands of these.
""",
    "bench": """## Simulated bench

Through sockets and pseudo terminal, stored sweep by sweep. Aim: at least 50 times as fast as the
drive, under 1 GB; help under 0.3 s.
""",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--peer-python", default=sys.executable, metavar="PATH",
                        help="an interpreter that can import openseespy")  # fmt: skip
    options = parser.parse_args()
    parts = [HEAD]
    for name, prose in PROSE.items():
        print(f"measuring: {name}", file=sys.stderr)
        more = ["--peer-python", options.peer_python] if name == "forward" else []
        done = subprocess.run(
            [sys.executable, str(HERE / f"{name}.py"), *more],
            capture_output=True, text=True, check=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # as the program itself sets it
        )  # fmt: skip
        parts.append(f"{prose}\n{done.stdout}")
    text = "\n".join(parts)
    PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
