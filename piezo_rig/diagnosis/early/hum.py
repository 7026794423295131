"""Mains hum: lines at 50 or 60 Hz and odd harmonics, sought in single recordings at full rate.

With repeats the lines are sought in what repeats disagree by: whatever is locked to the drive is
the same in all of them, also where a 2 Hz drive has a harmonic at 50 Hz itself. Without repeats
they are sought in the residual, against the drive's own neighbouring harmonics; and so they are in
the mean of repeats that all begin at one phase of the mains, if all drives have the same line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from piezo_rig.causes import CAUSES
from piezo_rig.causes.mains_hum import FUNDAMENTALS_HZ, ORDERS
from piezo_rig.chain import Model, Parameter, Stage
from piezo_rig.diagnosis.chances import AS_HELD, chi2_above
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.periods import period_s

FloatArray = NDArray[np.float64]
OFF_HZ = np.linspace(-0.2, 0.2, 5)
BESIDE = np.array([-4, -2, 2, 4])  # lines of a comb that are next to one
FIRST, WIDE = 3, 2.5  # of its lines; resolution cells that each takes
AROUND = np.concatenate([-np.arange(4, 14), np.arange(4, 14)])  # resolution cells of the background
INDEPENDENT = 10.8  # of the 20 cells of a Hann-windowed background
PADDED = 8
LASTING = 0.1  # of a recording
HANN = 1.5  # by which a Hann window widens the band
NEAR_HZ, NEAR_CELLS = 0.06, 0.2  # about a frequency; of the resolution of the longest recording
FINE, PARTS = 60, 32  # steps to either side, parts of a recording
FURTHER = 4  # times that the likeliest frequency is looked for further out
LONG_S = 0.3  # a recording must last this long
SUSPECTED = 0.05  # chance of a line, below which it is looked at any closer
FURTHEST_HZ = 0.35  # that mains are off their frequency
USUAL, STANDS_OUT = 0.25, 2.0  # quantile of a line's size among drives; times that
SHARED_ROUNDS = 40
AGREE = 0.9  # of the lines of all drives, that is left of them when they are added up


@dataclass(frozen=True, eq=False)
class Hum:
    """What was found, and the recordings without it."""

    groups: Groups
    p_value: float
    frequency: float
    amplitude_nm: float
    error_nm: float
    spread_hz: float

    def stage(self) -> Stage:
        half, f = (1.96 * AS_HELD * sd for sd in (self.error_nm, self.spread_hz))
        return CAUSES["mains-hum"](
            {
                "frequency": Parameter(
                    self.frequency, "Hz", (self.frequency - f, self.frequency + f)
                ),
                "amplitude": Parameter(
                    self.amplitude_nm,
                    "nm",
                    (max(self.amplitude_nm - half, 0.0), self.amplitude_nm + half),
                ),
            }
        )


@dataclass(frozen=True, eq=False)
class Row:
    """One recording: what it has of its own."""

    time_s: FloatArray  # of the shared clock
    values: FloatArray
    share: float  # of a single recording's noise power that is left in the values
    combs_hz: tuple[float, ...] = ()  # of the drive, for a good part of the recording
    always_hz: tuple[float, ...] = ()  # for all of it

    @cached_property
    def level(self) -> FloatArray:
        """Values less a straight line: an offset or a drift is in every line of a short stretch."""
        n = self.values.size
        along = np.arange(n) - 0.5 * (n - 1)
        slope = along @ self.values / max(float(along @ along), 1.0)
        return np.asarray(self.values - self.values.mean() - slope * along)

    @cached_property
    def _spectrum(self) -> tuple[float, FloatArray]:
        """Step in Hz, and squared peak amplitudes of a Hann-windowed, zero-padded transform."""
        n = self.values.size
        window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
        size = int(fft.next_fast_len(PADDED * n, real=True))
        line = 2.0 * fft.rfft(self.level * window, size) / window.sum()
        step = (n - 1) / float(self.time_s[-1] - self.time_s[0]) / size
        return step, np.abs(line) ** 2

    def is_first_line(self, f: FloatArray | float) -> NDArray[np.bool_]:
        """Whether one of the first lines of the drive is there; nothing beside is as large."""
        return np.asarray(self.near_first_line(f) & (self.share == 1.0))

    def near_first_line(self, f: FloatArray | float) -> NDArray[np.bool_]:
        """Where those are, also if repeats have been taken off: what they differ by because of the
        drive (ageing, memory) is there.
        """
        cell, f = 1.0 / float(self.time_s[-1] - self.time_s[0]), np.asarray(f)
        first = np.zeros(f.shape, bool)
        for comb in self.always_hz:
            if comb > 2.0 * cell:
                order = np.rint(f / comb)
                first |= (order >= 1) & (order <= FIRST) & (abs(f - order * comb) < WIDE * cell)
        return first

    def line(self, f: float) -> complex:
        """Amplitude and phase at a frequency, on its clock; um."""
        turned = self.level * np.exp(-2j * np.pi * f * self.time_s)
        window = np.sin(np.pi * (np.arange(turned.size) + 0.5) / turned.size) ** 2
        return complex(2.0 * turned @ window / window.sum())

    def power(self, f: FloatArray | float) -> FloatArray:
        """Squared peak amplitude at the frequencies, um^2."""
        step, power = self._spectrum
        return power[np.clip(np.rint(np.asarray(f) / step).astype(int), 0, power.size - 1)]


def find_hum(groups: Groups, model: Model) -> Hum | None:
    """The most significant line of the two mains frequencies; None without one to suspect."""
    found = [hum_of_residual(groups, model)]
    if groups.repeats > 1:
        found.insert(0, _strongest(groups, model, rows_of(groups, model)))
    return min((h for h in found if h is not None), key=lambda h: h.p_value, default=None)


def hum_of_residual(groups: Groups, model: Model) -> Hum | None:
    """The same of what a model leaves, where repeats are alike or there are none."""
    if groups.repeats == 1:
        return _strongest(groups, model, rows_of(groups, model))
    return _strongest(groups, model, means_of(groups, model), in_phase=True)


def _strongest(
    groups: Groups, model: Model, rows: list[Row], in_phase: bool = False
) -> Hum | None:
    rows = [r for r in rows if r.time_s[-1] - r.time_s[0] > LONG_S]
    nyquist = 0.45 * groups.rate
    if not rows or nyquist < min(FUNDAMENTALS_HZ):
        return None
    best: tuple[float, float] | None = None
    for fundamental in FUNDAMENTALS_HZ:
        orders = [k for k in ORDERS if k * fundamental < nyquist]
        if not orders:
            continue
        at = fundamental + np.asarray(OFF_HZ, float)
        for f, own, share in zip(at.tolist(), *_line(rows, np.outer(at, orders)), strict=True):
            lone = float(chi2_above(2.0 * own[0], 2.0 * share[0])) if share[0] else 1.0
            joint = float(chi2_above(2.0 * own.sum(), 2.0 * share.sum())) if share.any() else 1.0
            p = max(1e-300, 2.0 * min(lone, joint) * len(OFF_HZ) * len(FUNDAMENTALS_HZ))
            if best is None or p < best[0]:
                best = (p, f)
    if best is None or best[0] > SUSPECTED:
        return None
    fine = np.asarray(best[1] + np.arange(-25, 26) * 0.01, float)
    power = np.zeros(fine.size)
    for k in (1, 3):
        power += np.where(k * fine < nyquist, _line(rows, k * fine)[0], 0.0)
    frequency, spread_hz = refined(rows, float(fine[int(np.argmax(power))]), nyquist)
    if in_phase and not agreeing(rows, frequency):
        return None
    if min(abs(frequency - f) for f in FUNDAMENTALS_HZ) > FURTHEST_HZ:
        return None
    return removed(groups, model, frequency, best[0], spread_hz)


def agreeing(rows: list[Row], f: float) -> bool:
    """Whether all drives have one line, of one size and one phase from their beginnings on.

    What a drive brings about grows with its range, and comes with its neighbouring harmonics.
    """
    lines = np.array([row.line(f) for row in rows])
    return float(abs(lines.mean())) > AGREE * float(np.sqrt(np.mean(np.abs(lines) ** 2)))


def refined(rows: list[Row], near_hz: float, highest_hz: float) -> tuple[float, float]:
    """The likeliest frequency, and its standard deviation, in Hz; each recording has its phase.

    Every recording is shifted down by the frequency that is nearly right, and averaged over parts,
    in which what is left turns little. Its periodogram, against the noise beside the line, is the
    log-likelihood of a line of any phase.
    """
    longest = max(float(row.time_s[-1] - row.time_s[0]) for row in rows)
    near = max(NEAR_HZ, NEAR_CELLS / longest)
    off = np.linspace(-near, near, 2 * FINE + 1)
    for _ in range(FURTHER):
        worth = _worth(rows, near_hz, off, highest_hz)
        summit = int(np.argmax(worth))
        if 0 < summit < off.size - 1:
            break
        near_hz += float(off[summit])  # it lies further out
    best = int(np.clip(summit, 1, off.size - 2))
    step = off[1] - off[0]
    curve = (worth[best - 1] - 2.0 * worth[best] + worth[best + 1]) / step**2
    slope = (worth[best + 1] - worth[best - 1]) / (2.0 * step)
    if summit != best or curve >= 0.0:
        return near_hz, near
    return float(near_hz + off[best] - slope / curve), float(1.0 / np.sqrt(-curve))


def _worth(rows: list[Row], near_hz: float, off: FloatArray, highest_hz: float) -> FloatArray:
    """Log-likelihood (m,) of lines so far off a frequency that is nearly right."""
    worth = np.zeros(off.size)
    for row in rows:
        cell = 1.0 / float(row.time_s[-1] - row.time_s[0])
        n = row.values.size // PARTS * PARTS
        time = row.time_s[:n]
        at = time.reshape(PARTS, -1).mean(axis=1)
        for k in ORDERS:
            if k * near_hz >= highest_hz or row.is_first_line(k * near_hz):
                continue
            noise = float(np.mean(row.power(k * near_hz + AROUND * cell))) / HANN
            turned = row.level[:n] * np.exp(-2j * np.pi * k * near_hz * time)
            parts = turned.reshape(PARTS, -1).mean(axis=1)
            line = 2.0 * np.exp(-2j * np.pi * k * np.outer(off, at)) @ parts / PARTS
            worth += row.share * np.abs(line) ** 2 / max(noise, 1e-300)
    return worth


def rows_of(groups: Groups, model: Model) -> list[Row]:
    """What single recordings have of their own, and where they stand on the shared clock.

    Stretch by stretch of those where the actuator's memory is known: what it brought along differs
    from one repeat to the next, and a step at the beginning is in every line.
    """
    out = []
    repeated = groups.repeats > 1
    for g in groups.groups:
        if repeated and g.repeats < 2:
            continue
        reference = g.measured_um.mean(axis=0) if repeated else g.predicted(model)
        share = (g.repeats - 1) / g.repeats if repeated else 1.0
        often, always = _combs(g)
        for start, row in zip(g.starts_s, g.measured_um, strict=True):
            out += [Row(g.time_s[a:b] + start, (row - reference)[a:b], share, often, always)
                    for a, b in g.blocks]  # fmt: skip
    return out


def means_of(groups: Groups, model: Model) -> list[Row]:
    """What every drive has in the mean of its repeats, from its own beginning on."""
    return [
        Row(g.time_s[a:b], (g.measured_um.mean(axis=0) - g.predicted(model))[a:b], 1.0, *_combs(g))
        for g in groups.groups for a, b in g.blocks
    ]  # fmt: skip


def _combs(group: Group) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequencies at which the drive repeats itself for a good part of the recording, and those of
    them at which all of it does.
    """
    seconds = np.diff(group.time_s[group.loops.start])
    if not seconds.size:
        return (), ()
    steps = np.rint(np.log(seconds) / 0.05)
    found = []
    for step in np.unique(steps):
        here = seconds[steps == step]
        if here.sum() > LASTING * seconds.sum():
            found.append(0.5 / float(np.median(here)))
    often = tuple(found) or (0.5 / float(np.median(seconds)),)
    if np.ptp(steps) <= 1:
        return often, often
    whole = period_s(group)  # of all half loops together, as of several sines
    always = (1.0 / whole,) if whole is not None else ()
    return often + always, always


def _line(rows: list[Row], f: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fisher's sum of -log p of lines (any shape), recording by recording; as how many it counts.

    Every recording against its own background (power over background is F(2, 2 INDEPENDENT)):
    they last differently long, and a sum of powers would be that of the few shortest ones. Where
    one of the first lines of its drive is, a recording says nothing, and does not count.
    """
    score, share = np.zeros(f.shape), np.zeros(f.shape)
    for row in rows:
        cell = 1.0 / float(row.time_s[-1] - row.time_s[0])
        power, level = row.power(f), row.power(f[..., None] + AROUND * cell).mean(axis=-1)
        counts = np.where(row.is_first_line(f), 0.0, row.share)
        for comb in row.combs_hz:
            if row.share == 1.0 and comb > 2.0 * cell:
                at = np.abs(f[..., None] + BESIDE * comb)
                others = np.abs(at - f[..., None]) > comb  # mirrored at zero it may be the line
                beside = np.where(others, row.power(at), 0.0)
                level = np.maximum(level, 2.0 * beside.max(axis=-1))
        ratio = power / np.maximum(level, 1e-300)
        score += counts * INDEPENDENT * np.log1p(ratio / INDEPENDENT)
        share += counts
    return score, share


def removed(groups: Groups, model: Model, f: float, p: float, spread_hz: float) -> Hum:
    """The lines fitted and subtracted, one phase per recording.

    Hum is as large in the recordings of every drive. Where a drive has a line of its own there and
    its recordings stand out, a model that is wrong about it is what they have beside: they are
    given back what they share, and do not count for the size.

    ``spread_hz`` : standard deviation of the frequency
    """
    orders = [k for k in ORDERS if k * f < 0.45 * groups.rate]
    fitted = [_fitted(g, model, f, orders) for g in groups.groups]
    sizes = np.array([np.sqrt(np.mean(np.abs(own.lines) ** 2, axis=0)) for own in fitted])
    usual = np.quantile(sizes, USUAL, axis=0, method="lower")
    beside = (sizes > STANDS_OUT * usual) & np.array([own.driven for own in fitted])
    cleaned = []
    for g, own, spoilt in zip(groups.groups, fitted, beside, strict=True):
        lines = own.lines.copy()
        for k in np.flatnonzero(spoilt):
            lines[:, k] -= shared(lines[:, k], float(usual[k]))
        turned = np.exp(2j * np.pi * f * np.outer(orders, g.time_s))
        cleaned.append(g.with_measured(g.measured_um - (lines.conj() @ turned).real))
    counted = [own for own, spoilt in zip(fitted, beside, strict=True) if not spoilt[0]]
    powers = np.concatenate([own.powers for own in counted])
    errors = np.concatenate([own.noise for own in counted])
    size = float(np.sqrt(max(float(np.mean(powers)), 1e-18)))
    n = powers.size
    scatter = float(np.std(powers, ddof=1)) if n > 1 else 0.0
    spread = min(scatter / (2.0 * size), np.sqrt(scatter)) if n > 1 else np.sqrt(errors[0] / 2.0)
    error = max(float(spread), float(np.sqrt(np.mean(errors) / 2.0))) / np.sqrt(n)
    return Hum(groups.with_(cleaned), p, f, 1e3 * size, 1e3 * error, spread_hz)


class _Lines(NamedTuple):
    """Of a group: ``lines`` (R, k), complex, cosines real, um; of the first one the ``powers`` (R,)
    less the ``noise`` beside, um^2; and whether the drive has lines there itself, (k,).
    """

    lines: NDArray[np.complex128]
    powers: FloatArray
    noise: FloatArray
    driven: NDArray[np.bool_]


def _fitted(g: Group, model: Model, f: float, orders: list[int]) -> _Lines:
    """Lines of every recording, against the model's residual, so that what all repeats share is
    taken out as well.
    """
    predicted, mean = g.predicted(model), g.measured_um.mean(axis=0)
    reference = mean if g.repeats > 2 else predicted
    angle = 2.0 * np.pi * f * g.time_s
    columns = np.array([fn(k * angle) for k in orders for fn in (np.cos, np.sin)])
    a, b = max(g.blocks, key=lambda block: block[1] - block[0])
    cell = 1.0 / float(g.time_s[b - 1] - g.time_s[a])
    lines, noise = [], []
    for row in g.measured_um:
        both = np.vstack([columns, row - predicted])
        cut = np.concatenate([
            both[:, i:j] - both[:, i:j].mean(axis=1, keepdims=True) for i, j in g.blocks
        ], axis=1)  # fmt: skip
        shares = np.linalg.lstsq(cut[:-1].T, cut[-1], rcond=None)[0]
        lines.append(shares[::2] + 1j * shares[1::2])
        around = Row(g.time_s[a:b], (row - reference)[a:b], 1.0).power(f + AROUND * cell)
        noise.append(float(np.mean(around)) / HANN)
    at, beside = np.array(lines), np.array(noise)
    driven = np.zeros(len(orders), bool)
    for comb in _combs(g)[0]:
        wanted = np.array(orders) * f
        driven |= abs(wanted - comb * np.maximum(np.rint(wanted / comb), 1.0)) < WIDE * cell
    return _Lines(at, np.abs(at[:, 0]) ** 2 - beside, beside, driven)


def shared(lines: NDArray[np.complex128], size: float) -> complex:
    """What is the same in lines (R,) of any phase that would each be of one size without it.

    Of what does, the least.
    """
    same = 0.0 + 0.0j
    for _ in range(SHARED_ROUNDS):
        off = lines - same
        same = complex(np.mean(lines - size * off / np.maximum(np.abs(off), 1e-300)))
    return same
