"""A diagnosis of a short run takes a few seconds: none of them is for what it does not need."""

from __future__ import annotations

import subprocess
import sys


def test_libraries_that_take_seconds_to_load_are_not_loaded():
    code = (
        "import sys, piezo_rig.diagnosis;"
        "heavy = {'scipy.signal', 'scipy.stats', 'matplotlib', 'pandas'} & set(sys.modules);"
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""
    assert done.returncode == 0
