"""After how long a drive comes back: triangles, sines, sums of sines with a common period."""

from __future__ import annotations

import numpy as np
from scipy import fft

from piezo_rig.diagnosis.groups import Group

FEWEST, SAME = 3, 0.02  # periods in half of a recording; of its size, that they may differ by


def period_s(group: Group) -> float | None:
    """After how long the whole drive comes back, if it does so a few times once it is under way."""
    drive = group.drive_v[group.drive_v.size // 2 :]
    drive, n = drive - drive.mean(), drive.size
    size = int(fft.next_fast_len(2 * n, real=True))
    along = fft.irfft(np.abs(fft.rfft(drive, size)) ** 2, size)[:n]
    below = np.concatenate([[0.0], np.cumsum(drive**2)])
    # squared distance of the drive from itself so much later, where both are recorded
    square = below[n - np.arange(n)] + below[n] - below[np.arange(n)]
    apart = ((square - 2.0 * along) / np.arange(n, 0, -1))[: n // FEWEST + 1]
    left = np.flatnonzero(apart > np.var(drive))
    if not left.size:
        return None
    back = left[0] + np.flatnonzero(apart[left[0] :] < SAME**2 * np.var(drive))
    if not back.size:
        return None
    near = back[back < back[0] + max(back[0] // 10, 2)]
    best = near[int(np.argmin(apart[near]))]
    return float(group.time_s[best] - group.time_s[0])
