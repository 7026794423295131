"""From the tracks of identification to groups: which are repeats, and what came before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.cells import beside_corners, corners
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.errors import InputError
from piezo_rig.identification.data import Data, Track
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
FEW, ENOUGH = 20_000, 10_000  # samples that are left as they are; averages otherwise, in all
BESIDE_CORNERS = 60  # corners beside which samples are kept, in all, and of each drive
OF_EACH = 2
SAME_DRIVE = 0.01  # rms difference, of the drive's range
SHORTER = 0.05  # that a repeat may be, of its length, as one that has lost samples
LOOKED_BACK = 3  # recordings
SLOWEST, SLOW = 200.0, 450.0  # samples per second that thinning leaves at least, and always at most
OF_A_HALF_LOOP = 50.0  # samples that it leaves of a short half loop, between those rates


def group_tracks(data: Data, sweeps: Sequence[Sweep]) -> Groups:
    """Tracks of identification, repeats together.

    Raises
    ------
    InputError : sampling rates that differ
    """
    rates = {round(s.sample_rate, 6) for s in sweeps}
    if max(rates) > 1.02 * min(rates):
        raise InputError(
            "rates-disagree",
            f"sampled at {min(rates):g} and {max(rates):g} per second",
            "recordings with different settings of the digitizer",
            "diagnose them apart",
        )
    rate = float(np.median([s.sample_rate for s in sweeps]))
    found: list[list[Track]] = []
    for track in data.tracks:
        for members in found:
            if same_drive(members[0], track, sweeps):
                members.append(track)
                break
        else:
            found.append([track])
    earlier, played = _earlier(data, sweeps), _played(data, sweeps)
    begun = min(s.start_time for s in sweeps)
    groups = tuple(
        _after_others(
            replace(_group(members, sweeps, data), begun_s=begun,
                    played=np.array([played[t.sweeps] for t in members]) if played else None),
            [earlier[t.sweeps] for t in members] if earlier else [],
        )
        for members in found
    )  # fmt: skip
    offset = float(np.median([s.offset_v for s in sweeps]))
    offset = offset or max(float(g.drive_v.max()) for g in groups)
    total = sum(b - a for g in groups for a, b in g.blocks)
    factor = int(np.clip(np.ceil(total / ENOUGH), 1, max(1, rate / _slowest(groups, rate))))
    if total <= FEW or factor == 1:
        return Groups(groups, rate, 1, offset, data.noise_v)
    most = max(BESIDE_CORNERS // len(groups), OF_EACH), ENOUGH // len(groups)
    fine = tuple(_fine(g, rate, factor, most) for g in groups)
    return Groups(fine, rate, factor, offset, data.noise_v)


def _slowest(groups: Sequence[Group], rate: float) -> float:
    """Samples per second that short half loops need; most are about as short in a matrix."""
    lengths = np.concatenate([g.loops.stop - g.loops.start for g in groups])
    short_s = float(np.percentile(lengths, 10)) / rate if lengths.size else 0.0
    return float(np.clip(OF_A_HALF_LOOP / max(short_s, 1e-9), SLOWEST, SLOW))


def _fine(group: Group, rate: float, factor: int, most: tuple[int, int]) -> Group:
    """With single samples beside corners of its drive; at most so many corners and samples."""
    at, size = corners(group.drive_v, group.blocks, factor), group.drive_v.size
    return replace(group, fine=beside_corners(at, rate, most[0], size, most[1]))


def _earlier(
    data: Data, sweeps: Sequence[Sweep]
) -> dict[tuple[int, ...], tuple[FloatArray, ...]]:
    """For every track the turning points of those before it; empty where that is not known.

    It is known where all of them are said to begin virgin, each at a time of its own.
    """
    starts = [sweeps[t.sweeps[0]].start_time for t in data.tracks]
    said = all(sweeps[t.sweeps[0]].history == "virgin" for t in data.tracks)
    if not said or len(data.tracks) < 3 or len(set(starts)) < len(starts):
        return {}
    known: list[FloatArray] = []
    out = {}
    for k in np.argsort(starts):
        track = data.tracks[k]
        out[track.sweeps] = tuple(known[-LOOKED_BACK:])
        known.append(track.drive_v[np.append(track.loops.start, track.drive_v.size - 1)])
    return out


def _played(data: Data, sweeps: Sequence[Sweep]) -> dict[tuple[int, ...], float]:
    """Cycles of the session before every track; empty where nobody knows the order."""
    starts = [sweeps[t.sweeps[0]].start_time for t in data.tracks]
    if len(data.tracks) < 2 or len(set(starts)) < len(starts):
        return {}
    count, out = 0.0, {}
    for k in np.argsort(starts):
        track = data.tracks[k]
        out[track.sweeps] = count
        count += 0.5 * len(track.loops)
    return out


def _after_others(group: Group, earlier: Sequence[tuple[FloatArray, ...]]) -> Group:
    """A group with what each of its recordings was played after; the same drives together."""
    found: dict[bytes, list[tuple[FloatArray, ...]]] = {}
    after = []
    for before in earlier:
        key = b"|".join(np.round(turns, 1).tobytes() for turns in before)
        found.setdefault(key, []).append(before)
        after.append(list(found).index(key))
    shares = tuple((len(same) / len(earlier), same[0]) for same in found.values())
    return replace(group, earlier=shares, after=tuple(after))


def same_drive(a: Track, b: Track, sweeps: Sequence[Sweep]) -> bool:
    """Whether two tracks are repeats: one drive, and one history as far as that is said."""
    if len(a.sweeps) != len(b.sweeps):
        return False
    said = {sweeps[i].history for t in (a, b) for i in t.sweeps}
    if a.virgin != b.virgin and said != {"unknown"}:  # what is only inferred, damage may hide
        return False
    named = [
        (sweeps[i].condition, sweeps[j].condition) for i, j in zip(a.sweeps, b.sweeps, strict=True)
    ]
    if any(x and y and x != y for x, y in named):
        return False
    if abs(a.drive_v.size - b.drive_v.size) > SHORTER * a.drive_v.size:
        return False
    n = min(a.drive_v.size, b.drive_v.size)
    difference = a.drive_v[:n] - b.drive_v[:n]
    return bool(np.sqrt(np.mean(difference**2)) < SAME_DRIVE * np.ptp(a.drive_v))


def _group(members: list[Track], sweeps: Sequence[Sweep], data: Data) -> Group:
    first = min(members, key=lambda t: t.drive_v.size)  # a recording may lack its last samples
    n = first.drive_v.size
    virgin = sum(t.virgin for t in members) >= 0.5 * len(members)
    known = next(t for t in members if t.virgin == virgin)
    time = np.concatenate([
        sweeps[i].time_s + (sweeps[i].start_time - sweeps[first.sweeps[0]].start_time)
        for i in first.sweeps
    ])  # fmt: skip
    if np.any(np.diff(time) <= 0):  # clocks of carried sweeps that do not fit together
        time = np.arange(time.size) / sweeps[first.sweeps[0]].sample_rate
    blocks = tuple((a, min(b, n)) for a, b in known.blocks if min(b, n) - a >= 8)
    drive = np.mean([t.drive_v[:n] for t in members], axis=0)
    return Group(
        time_s=time[:n],
        drive_v=drive if len(members) > 1 else first.drive_v,
        measured_um=np.array([t.displacement_um[:n] for t in members]),
        starts_s=np.array([sweeps[t.sweeps[0]].start_time for t in members]),
        history="virgin" if virgin else "unknown",
        blocks=blocks,
        loops=first.loops,
        condition=" + ".join(data.conditions[i] for i in first.sweeps[:3]),
        sweeps=tuple(t.sweeps for t in members),
    )
