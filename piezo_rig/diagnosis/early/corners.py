"""The drive monitor about the turning points of its drive, and how well a drive explains it.

What an amplifier does to a drive shows within milliseconds of a turning point, and how late it all
is shows there as well. Cycles that repeat each other are looked at once: what a digitizer's steps
do to one cycle they do to all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.between import Denser, denser
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.noise import Spectrum, Whitener, spectrum_of
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
Play = Callable[[FloatArray, FloatArray], FloatArray]  # time, drive -> what is between them
At = Callable[[FloatArray], FloatArray]  # positions in samples -> volts
BEFORE, AFTER = 200, 400  # samples about a turning point
MOST = 40  # turning points
NEARLY_ALL = 0.9  # of the recordings must have a monitor
ODD = 5.0  # times the usual misfit: samples were lost in that recording
STEPS = 4.0  # least noise: a digitizer's step over this


@dataclass(frozen=True, eq=False)
class Watched:
    """One drive, its monitor averaged over the recordings that have one, and where to look.

    ``dense`` : the drive with points between samples
    """

    time_s: FloatArray
    drive_v: FloatArray
    monitor_v: FloatArray
    windows: tuple[tuple[int, int], ...]
    dense: Denser | None = None

    @property
    def played(self) -> tuple[FloatArray, FloatArray]:
        """Time and drive of all points that are known."""
        if self.dense is None:
            return self.time_s, self.drive_v
        return self.dense.time_s, self.dense.drive_v


@dataclass(eq=False)
class Corners:
    """Monitors about turning points; ``explained`` says how well a drive fits them.

    Attributes
    ----------
    drives : one per group that has a monitor
    step_s : of sampling
    runs_off : share by which the command's clock is ahead of the digitizer's
    """

    drives: tuple[Watched, ...]
    step_s: float
    runs_off: float = 0.0
    whitener: Whitener = field(init=False)
    _known: tuple[FloatArray, FloatArray] = field(init=False)  # nuisances' axes, the monitor

    def __post_init__(self) -> None:
        self.measured = [w.monitor_v[a:b] for w in self.drives for a, b in w.windows]
        steps = np.diff(np.unique(np.concatenate(self.measured)))
        steps = steps[steps > 1e-6]
        self.least_v = float(np.median(steps)) / STEPS if steps.size else 1e-6
        self.hear(None)

    @property
    def span_v(self) -> float:
        return max(float(np.ptp(w.drive_v)) for w in self.drives)

    def hear(self, left: Sequence[FloatArray] | None) -> None:
        """Weigh everything by the spectrum of what was left; equally before anything is known."""
        least = self.least_v**2 / 12.0
        spectrum = Spectrum(np.array([1e-6, 0.5]), np.log([least, least]), np.zeros(2))
        if left is not None:
            spectrum = spectrum_of(left, least=least)
        self.whitener = Whitener(spectrum)
        y = self._white(self.measured)
        q, _ = np.linalg.qr(np.column_stack([self._white(n) for n in self._nuisances()]))
        self._known = q, y - q @ (q.T @ y)

    def _nuisances(self) -> list[list[FloatArray]]:
        """Window by window: an offset of every drive, and clocks that run apart."""
        out = [
            [np.full(b - a, float(w is other)) for w in self.drives for a, b in w.windows]
            for other in self.drives
        ]
        late = []
        for w in self.drives:
            apart = np.gradient(w.drive_v) * (w.time_s - w.time_s[0])
            late += [apart[a:b] for a, b in w.windows]
        return [*out, late]

    def _white(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Windows whitened, those of one length together."""
        lengths = sorted({p.size for p in parts})
        same = [np.array([p for p in parts if p.size == n]) for n in lengths]
        return np.asarray(np.concatenate([self.whitener(s).ravel() for s in same]), float)

    def seen(self, at: Sequence[At], delay_s: float) -> list[FloatArray]:
        """What the windows would hold of drives that are known at any instant."""
        late, out = delay_s / self.step_s, list[FloatArray]()
        for f, w in zip(at, self.drives, strict=True):
            places = np.concatenate([np.arange(a, b, dtype=float) for a, b in w.windows])
            places *= 1.0 + self.runs_off
            out += np.split(f(places - late), np.cumsum([b - a for a, b in w.windows])[:-1])
        return out

    def explained(self, seen: Sequence[FloatArray]) -> tuple[float, float]:
        """Squared misfit in units of the noise, and the gain of the monitor."""
        return self.fits(self.bare(seen))

    def bare(self, seen: Sequence[FloatArray]) -> FloatArray:
        """Windows whitened, without what the nuisances explain."""
        q, _ = self._known
        x = self._white(seen)
        return np.asarray(x - q @ (q.T @ x))

    def fits(self, x: FloatArray) -> tuple[float, float]:
        """`explained` of windows that are bare."""
        _, y = self._known
        gain = float(x @ y / max(float(x @ x), 1e-300))
        return float(y @ y - gain * (x @ y)), gain

    def between(self, x: FloatArray, other: FloatArray) -> tuple[float, float]:
        """Least misfit on the straight line from one (0) to another (1) of two, and where."""
        _, y = self._known
        step = other - x
        along, more = float(x @ y), float(step @ y)
        own, both, steps = float(x @ x), float(x @ step), float(step @ step)
        at = more * both - along * steps  # of the cosine's only summit
        share = (along * both - more * own) / at if at != 0.0 else 0.0
        share = float(np.clip(share, 0.0, 1.0))
        return min((self.fits(x + s * step)[0], s) for s in {0.0, share, 1.0})

    def left(self, seen: Sequence[FloatArray]) -> list[FloatArray]:
        """What is left of every window, volts."""
        rest, _ = self._rest(seen)
        return np.split(rest, np.cumsum([m.size for m in self.measured])[:-1])

    def further_off(self, seen: Sequence[FloatArray]) -> float:
        """The share by which the clocks seem to run apart besides."""
        return self._rest(seen)[1] * self.step_s

    @property
    def longest(self) -> int:
        """Samples of the longest drive."""
        return max(w.drive_v.size for w in self.drives)

    def _rest(self, seen: Sequence[FloatArray]) -> tuple[FloatArray, float]:
        """What is left of all windows, volts, and how much of clocks apart was in it, samples/s."""
        q, _ = self._known
        columns = np.column_stack([q, self._white(seen)])
        shares, *_ = np.linalg.lstsq(columns, self._white(self.measured), rcond=None)
        gain = shares[-1]
        raw = np.column_stack([np.concatenate(n) for n in self._nuisances()])
        rest = np.concatenate(self.measured) - gain * np.concatenate(seen)
        own, *_ = np.linalg.lstsq(raw, rest, rcond=None)
        return rest - raw @ own, float(own[-1] / gain) if gain else 0.0


def corners_of(
    groups: Groups, sweeps: Sequence[Sweep], between: bool = False
) -> Corners | None:
    """None where too few recordings have a monitor.

    ``between`` : with what drives do between samples, also where it is not known that they do
    """
    having = sum(s.drive_monitor_v is not None for s in sweeps)
    if having < NEARLY_ALL * len(sweeps):
        return None
    known: set[tuple[float, ...]] = set()
    places: list[tuple[float, int, int]] = []
    monitors = [_monitor(g, sweeps) for g in groups.groups]
    for k, g in enumerate(groups.groups):
        if monitors[k] is None:
            continue
        v = g.drive_v
        turns = np.append(g.loops.start, g.loops.stop[-1])
        for i in range(turns.size - 1):
            bend = turns[max(i - 1, 0)], turns[i], turns[i + 1]
            lengths = [*np.diff(bend) // 2]  # the start of a half loop may be a sample off
            key = tuple(np.round([*v[list(bend)], *lengths], 0).tolist())
            if key not in known:
                known.add(key)
                speed = abs(v[bend[2]] - v[bend[1]]) / max(bend[2] - bend[1], 1)
                places.append((float(speed), k, int(turns[i])))
    places.sort(key=lambda p: -p[0])
    extreme = {p for p in places if groups.groups[p[1]].drive_v[p[2]] in _ends(groups)}
    chosen = {*places[:MOST], *sorted(extreme)[-MOST // 4 :]}
    watched = []
    for k, g in enumerate(groups.groups):
        monitor = monitors[k]
        windows = _joined(sorted(at for _, j, at in chosen if j == k), g.drive_v.size)
        if monitor is not None and windows:
            dense = denser(g.time_s, g.drive_v) if between else g.denser
            watched.append(Watched(g.time_s, g.drive_v, monitor, windows, dense))
    return Corners(tuple(watched), 1.0 / groups.rate) if watched else None


def _ends(groups: Groups) -> tuple[float, float]:
    low = min(float(g.drive_v.min()) for g in groups.groups)
    return low, max(float(g.drive_v.max()) for g in groups.groups)


def _joined(turns: Sequence[int], n: int) -> tuple[tuple[int, int], ...]:
    """Windows about turning points, none of them overlapping."""
    out: list[tuple[int, int]] = []
    for at in turns:
        a, b = max(at - BEFORE, 0), min(at + AFTER, n)
        if out and a < out[-1][1]:
            a = out[-1][1]
        if b - a >= 16:
            out.append((a, b))
    return tuple(out)


def _monitor(group: Group, sweeps: Sequence[Sweep]) -> FloatArray | None:
    """Mean (n,) over the recordings of a group, without those that lost samples."""
    rows = []
    for members in group.sweeps:
        parts = [sweeps[i].drive_monitor_v for i in members]
        known = [p for p in parts if p is not None]
        row = np.concatenate(known) if len(known) == len(parts) else np.empty(0)
        row = row[: group.drive_v.size]
        if row.size == group.drive_v.size and np.isfinite(row).all():
            rows.append(row)
    if not rows:
        return None
    columns = np.array([np.ones(group.drive_v.size), group.drive_v, np.gradient(group.drive_v)]).T
    off = []
    for row in rows:
        shares, *_ = np.linalg.lstsq(columns, row, rcond=None)
        off.append(float(np.std(row - columns @ shares)))
    kept = [r for r, o in zip(rows, off, strict=True) if o <= ODD * min(off) + 1e-9]
    return np.asarray(np.mean(kept, axis=0))
