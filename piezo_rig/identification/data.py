"""Sweeps made ready for identification: checked, joined, and cut where memory is known.

Two questions are settled here and nowhere else: what of a recording can be
trusted (or which error names what cannot), and from which sample on the state
of the actuator's memory is known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import HalfLoops, dead_band, half_loops
from piezo_rig.chain.reach import longest_branch
from piezo_rig.errors import InputError
from piezo_rig.identification.checks import (
    check_agreement,
    check_numbers,
    check_signals,
    label,
    without_spikes,
)
from piezo_rig.identification.quiet import quiet
from piezo_rig.identification.rest import begins_at_rest
from piezo_rig.run_file.sweep import Sweep

FEW = 3  # notes of one kind that are given one by one
_BEFORE = re.compile(
    r"(?P<whose>.*): history unknown, (?P<first>\d+) of (?P<of>\d+) samples (?P<what>before .*)"
)
_BEGINS = re.compile(r"(?P<whose>.*): (?P<what>(history unknown, but )?it begins at rest.*)")
FloatArray = NDArray[np.float64]
COVERED, LASTS = 0.25, 0.5  # of the drive's range, or of its samples, with a known memory
EXTREME = 0.005  # of the range: this near counts as having visited an extreme


@dataclass(frozen=True, eq=False)
class Track:
    """One stretch of drive with one memory: a sweep, or a chain of sweeps whose history carries on.

    Attributes
    ----------
    drive_v, displacement_um : shape (n,)
    sweeps : indices into the sweeps given
    edges : shape (len(sweeps) + 1,), first sample of every sweep, and n
    blocks : (first, one past last) sample of every stretch with a known memory; a
        displacement offset is free in each
    unit : for every block, the position in ``sweeps`` that it belongs to
    virgin : the memory is cleared at the first sample, or taken to be
    loops : its half loops
    noise_v : what was taken out of the drive
    """

    drive_v: FloatArray
    displacement_um: FloatArray
    sweeps: tuple[int, ...]
    edges: tuple[int, ...]
    blocks: tuple[tuple[int, int], ...]
    unit: tuple[int, ...]
    virgin: bool
    loops: HalfLoops
    noise_v: float = 0.0

    def travel_um(self, block: int) -> float:
        """Travel of the sweep that a block belongs to."""
        k = self.unit[block]
        return float(np.ptp(self.displacement_um[self.edges[k] : self.edges[k + 1]]))


    @property
    def branch_reach_v(self) -> float:
        """Largest drive change along one branch after a turning point, volts."""
        return longest_branch(self.drive_v, self.loops, self.blocks)


@dataclass(frozen=True, eq=False)
class Data:
    """Everything that a fit sees."""

    tracks: tuple[Track, ...]
    conditions: tuple[str, ...]  # of every sweep
    names: tuple[str, ...]
    left_out: list[str] = field(default_factory=list)

    @property
    def noise_v(self) -> float:
        """What was taken out of the drive, at most, volts rms."""
        return max(t.noise_v for t in self.tracks)

    @property
    def samples(self) -> int:
        return sum(t.drive_v.size for t in self.tracks)

    @property
    def has_first_rise(self) -> bool:
        return any(t.virgin for t in self.tracks)

    def one_repeat(self) -> Data:
        """The first track of every list of conditions; itself where nothing repeats."""
        first = {tuple(self.conditions[i] for i in t.sweeps): t for t in reversed(self.tracks)}
        kept = tuple(t for t in self.tracks if any(t is f for f in first.values()))
        return self if len(kept) == len(self.tracks) else replace(self, tracks=kept)

    @property
    def travel_um(self) -> float:
        """Largest travel of one block, um."""
        return max(float(np.ptp(t.displacement_um[a:b])) for t in self.tracks for a, b in t.blocks)

    @property
    def first_reach_v(self) -> float:
        """Largest |drive - first drive| of a virgin track, volts; 0 without one."""
        return max(
            (float(np.max(np.abs(t.drive_v - t.drive_v[0]))) for t in self.tracks if t.virgin),
            default=0.0,
        )

    def known_v(self, one_curve: bool) -> dict[str, float]:
        """Volts up to which data know the first rise, and a branch after a turning point."""
        first, later = self.first_reach_v, self.later_reach_v
        if one_curve:
            first, later = max(first, later / 2.0), max(2.0 * first, later)
        return {"first_rise": first or later / 2.0, "branch": later}

    @property
    def later_reach_v(self) -> float:
        """Largest drive change along one branch after a turning point, volts."""
        return max(t.branch_reach_v for t in self.tracks)


def prepare(
    sweeps: Sequence[Sweep], first_rises: bool = False, clipped: bool = False,
    not_from_rest: Mapping[str, str] | None = None,
) -> Data:
    """Check sweeps and join them into tracks.

    Parameters
    ----------
    first_rises : of sweeps with unknown history that show a first rise from rest, take it for an
        initiation curve (for models that have one of their own)
    clipped : flat tops of a sensor or a drive are said and kept, not refused
    not_from_rest : sweeps, by name, that begin with a memory, whatever they look like; what says so

    Raises
    ------
    InputError : naming the sweep, and the sample where there is one
    """
    if not sweeps:
        raise InputError("no-data", "no sweep was given", "", "name at least one recording")
    left_out: list[str] = []
    mended = []
    for sweep in sweeps:
        check_numbers(sweep)
        better, said = without_spikes(sweep)
        mended.append(better)
        left_out += said + check_signals(better, clipped)
    sweeps = mended
    check_agreement(sweeps)
    chains: list[list[int]] = []
    for i, sweep in enumerate(sweeps):
        if sweep.history == "carried" and chains:
            chains[-1].append(i)
        else:
            chains.append([i])
    tracks = []
    for chain in chains:
        rises = first_rises
        said_so = (not_from_rest or {}).get(sweeps[chain[0]].name)
        if said_so is not None:
            rises = False
            left_out.append(
                f"{label(sweeps[chain[0]])}: it begins at rest, but {said_so}: its first rise is "
                "not taken for an initiation curve"
            )
        track = _track([sweeps[i] for i in chain], chain, rises, left_out)
        if track is not None:
            tracks.append(track)
    if not tracks:
        raise InputError(
            "too-few-half-loops",
            left_out[-1] if left_out else f"{', '.join(map(label, sweeps))}: nothing left",
            "the drive never comes back over ground that it has covered",
            "record at least one full cycle",
        )
    if (noise_v := max(t.noise_v for t in tracks)) > 0.0:
        left_out.append(
            f"the drive is recorded with noise of up to {1e3 * noise_v:.2g} mV rms that the "
            "displacement does not follow: it was taken out, but for the corners"
        )
    return Data(
        tuple(tracks),
        tuple(s.condition or s.name for s in sweeps),
        tuple(s.name for s in sweeps),
        gathered(left_out),
    )


def gathered(notes: Sequence[str]) -> list[str]:
    """Notes that say the same of many recordings, but for how many samples, as one."""
    alike: dict[str, list[re.Match[str]]] = {}
    for note in notes:
        if (said := _of_one(note)) is not None:
            alike.setdefault(said["what"], []).append(said)
    out = []
    for note in notes:
        said = _of_one(note)
        every = alike[said["what"]] if said is not None else []
        if said is None or len(every) <= FEW:
            out.append(note)
        elif note == every[0].string:
            whose = f"{said['whose']} and {len(every) - 1} more"
            if said.re is _BEGINS:
                out.append(f"{whose}: {said['what']}")
                continue
            shares = [100.0 * int(m["first"]) / int(m["of"]) for m in every]
            low, high = f"{min(shares):.0f}", f"{max(shares):.0f}"
            span = high if low == high else f"{low} to {high}"
            out.append(f"{whose}: history unknown, {span} % of their samples {said['what']}")
    return out


def _of_one(note: str) -> re.Match[str] | None:
    """What a note says of one recording, if others may say the same."""
    return _BEFORE.fullmatch(note) or _BEGINS.fullmatch(note)


def _track(
    sweeps: list[Sweep], indices: list[int], first_rises: bool, left_out: list[str]
) -> Track | None:
    quieted = [quiet(s.drive_v, s.displacement_um) for s in sweeps]
    drive = np.concatenate([v for v, _ in quieted])
    displacement = np.concatenate([s.displacement_um for s in sweeps])
    edges = np.concatenate([[0], np.cumsum([s.samples for s in sweeps])]).astype(int)
    band = max(dead_band(s.drive_v) for s in sweeps)
    loops = half_loops(drive, band)
    virgin = sweeps[0].history == "virgin"
    known_from = "history unknown" if len(sweeps) == 1 else (
        f"carried through {len(sweeps)} recordings, unknown before the first"
    )  # fmt: skip
    if not virgin and first_rises and _from_rest(drive, displacement, loops, band, int(edges[1])):
        virgin = True
        left_out.append(
            f"{label(sweeps[0])}: {known_from}, but it begins at rest (its first cycle leaves "
            "behind what later ones do not): its first rise is taken for an initiation curve"
        )
    if virgin:
        known = [(0, drive.size)]
    else:
        known = _known(drive, loops, band)
        unused = drive.size - sum(b - a for a, b in known)
        why = "before the drive had visited both its extremes"
        if len(known) > 1:
            why = "before or while the drive went where it had not been"
        left_out.append(
            f"{label(sweeps[0])}: {known_from}, {unused} of {drive.size} samples {why}"
        )
    blocks, unit = [], []
    for a, b in known:
        for k in range(len(sweeps)):
            low, high = max(a, int(edges[k])), min(b, int(edges[k + 1]))
            if high - low >= 8 and np.ptp(drive[low:high]) > band:
                blocks.append((low, high))
                unit.append(k)
    covered = max((float(np.ptp(drive[a:b])) for a, b in blocks), default=0.0)
    lasts = sum(b - a for a, b in blocks)
    if covered < COVERED * float(np.ptp(drive)) and lasts < LASTS * drive.size:
        left_out.append(f"{label(sweeps[0])}: too few half loops")
        return None
    return Track(
        drive, displacement, tuple(indices), tuple(int(e) for e in edges),
        tuple(blocks), tuple(unit), virgin, loops, max(sigma for _, sigma in quieted),
    )  # fmt: skip


def _from_rest(
    drive: FloatArray, displacement: FloatArray, loops: HalfLoops, band: float, samples: int
) -> bool:
    """Whether the first sweep of a track, of so many samples, begins with a rise from rest."""
    own = drive[:samples]
    tolerance = max(band, EXTREME * float(np.ptp(own)))
    if samples < drive.size:
        loops = half_loops(own, band)
    return begins_at_rest(own, displacement[:samples], loops, tolerance)


def _known(drive: FloatArray, loops: HalfLoops, band: float) -> list[tuple[int, int]]:
    """Stretches with a known memory after an unknown first state."""
    tolerance = max(band, EXTREME * float(np.ptp(drive)))
    at_top = int(np.argmax(drive >= drive.max() - tolerance))
    at_bottom = int(np.argmax(drive <= drive.min() + tolerance))
    both = max(at_top, at_bottom)
    later = np.flatnonzero(loops.start >= both)
    # the turning point at that extreme itself
    begin = int(loops.start[later[0]]) if later.size else drive.size
    known = [(begin, drive.size)] if later.size >= 2 else []
    if (known and begin < drive.size // 2) or len(loops) < 2:
        return known
    # an amplitude that grows: known as long as the drive stays on ground covered before
    high = np.maximum.accumulate(drive)[:-1]
    low = np.minimum.accumulate(drive)[:-1]
    inside = np.concatenate([[False], (drive[1:] <= high) & (drive[1:] >= low)])
    inside[: loops.start[1]] = False
    change = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
    # each begins at the turning point just before it
    pairs = zip(change[::2], change[1::2], strict=True)
    end = begin if known else drive.size
    early = [(int(a) - 1, min(int(b), end)) for a, b in pairs]
    return [(a, b) for a, b in early if b - a > 8] + known
