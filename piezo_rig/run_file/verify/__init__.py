"""Checks a run: layout, checksums, completeness, units, clocks, calibration, drive monitor.

``verify`` is the way in. Each check says for one sweep, or for the run, what is wrong; a sweep
with a fault may not be used, one with a note may. ``sweep_checks`` look at one sweep's samples,
``calibration`` at what turns them into physics, ``monitor`` at command against drive monitor,
``timeline`` at clocks and the event log, ``run_checks`` at everything but the sweeps. ``flags``
adds what was flagged when the run was played; ``superseded`` makes notes of what is wrong with
sweeps that were played again.
"""

from piezo_rig.run_file.verify.check import require_run, usable, verify
from piezo_rig.run_file.verify.verdict import Verdict

__all__ = ["Verdict", "require_run", "usable", "verify"]
