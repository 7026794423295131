"""Stretches that are far noisier than others: knocks, a loose lead, a pump, a mount that slips.

What repeats disagree by is taken for noise, and noise for steady; without repeats most of what the
model leaves is. A knock that comes once raises the noise of everything and shows nowhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
# thinned samples of a stretch: slow ringing is slow in a short one; and the degree of what is taken
# off each: what a model lacks varies more slowly than what rings
LOOKS = ((32, 1), (16, 1), (128, 1), (512, 1), (64, 3), (128, 9))
SPIKED = 16  # samples of a stretch, of which one may be loud: a spike, and the cell it spreads to
# percentiles, and standard deviations from the median to each
WITHIN = ((10.0, -1.2816), (25.0, -0.6745), (75.0, 0.6745))
FEW = 20  # stretches that say nothing of how much they scatter
STANDS_OUT = 6.0  # standard deviations of the logarithm of a stretch's power
MOST_TOLD = 3
NEARLY = 0.7  # of what stands out at another length
NEXT_S = 0.05


@dataclass(frozen=True)
class Bursts:
    """``count`` stretches, noisier by up to ``times``, that add ``rms_nm`` to all recordings.

    ``at`` : condition and seconds since its begin, of the noisiest; ``long_s`` : how long each is
    """

    count: int
    times: float
    rms_nm: float
    at: tuple[tuple[str, float], ...]
    long_s: float = 0.0

    def all_at(self, places: Sequence[tuple[str, float]]) -> bool:
        """Whether all of them are where something is known to have happened, or next to it.

        ``places`` : condition and seconds since its begin
        """
        return self.count <= len(self.at) and all(
            any(there == name and begin - NEXT_S < t < begin + self.long_s + NEXT_S
                for there, t in places) for name, begin in self.at
        )  # fmt: skip

    @property
    def text(self) -> str:
        places = ", ".join(f"{seconds:.3g} s into {name}" for name, seconds in self.at)
        return (
            f"the noise is not steady: at times it is up to {self.times:.2g} times as loud as "
            f"elsewhere, {self.rms_nm:.2g} nm rms more in all, for instance {places}"
        )


def bursts(groups: Groups, model: Model) -> Bursts | None:
    """What stands out of the deviations of recordings from the mean of their repeats, or of those
    that have none from the model.

    Stretches are compared by the logarithm of their power, trends (or polynomials) and the loudest
    samples taken off: a spike is no burst. Its scatter is that of three quarters of the data at
    hand, whatever the spectrum of their noise, the largest of three estimates: few stretches know
    it badly.
    Of the lengths of stretches at which something stands out the first counts at which it is
    nearly as much as at any: of a slow knock a short one holds hardly more than a trend. None where
    nothing stands out.
    """
    groups = groups.evenly()  # single samples beside corners are noisier than averages
    found = [b for look in LOOKS if (b := _of_length(groups, model, *look)) is not None]
    most = max((b.rms_nm for b in found), default=0.0)
    return next((b for b in found if b.rms_nm > NEARLY * most), None)


def _of_length(groups: Groups, model: Model, long: int, degree: int) -> Bursts | None:
    powers, places = list[tuple[float, float]](), list[tuple[str, float]]()
    for group in groups.groups:
        made, seconds = _stretches(groups, group, model, long, degree)
        powers += made
        places += [(group.condition, s) for s in seconds]
    if len(powers) < FEW:
        return None
    every, whole = np.array(powers).T
    usual = float(np.median(every))
    if not usual > 0.0:
        return None
    apart = np.log(np.maximum(every, 1e-3 * usual) / usual)
    scatter = max(float(np.percentile(apart, q)) / deviations for q, deviations in WITHIN)
    out = np.flatnonzero(apart > STANDS_OUT * max(scatter, long**-0.5))
    if not out.size:
        return None
    order = out[np.argsort(-every[out])][:MOST_TOLD]
    excess = float(np.sum(whole[out] - np.median(whole))) / every.size
    return Bursts(
        int(out.size), float(np.sqrt(every[order[0]] / usual)), 1e3 * float(np.sqrt(excess)),
        tuple(places[k] for k in sorted(order)), long * groups.factor / groups.rate,
    )  # fmt: skip


def _own(group: Group, model: Model) -> FloatArray:
    """What recordings have of their own, of the noise's size: beside their mean, or the model."""
    if group.repeats < 2:
        return np.asarray(group.measured_um - group.predicted(model))
    left = group.at_one_time(model).measured_um
    share = (group.repeats - 1.0) / group.repeats
    return np.asarray((left - left.mean(axis=0)) / np.sqrt(share))


def _stretches(
    groups: Groups, group: Group, model: Model, long: int, degree: int
) -> tuple[list[tuple[float, float]], list[float]]:
    """Variance of every stretch of a group, um^2, without its loudest samples and with them; when
    each begins.
    """
    left = groups.thinned(group, _own(group, model))
    time = groups.thinned(group, group.time_s)
    level, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, long), degree + 1))
    found, seconds = list[tuple[float, float]](), list[float]()
    for a, b in groups.edges(group):
        for begin in range(a, b - long + 1, long):
            rows = left[:, begin : begin + long]
            rows = rows - (rows @ level) @ level.T
            square = np.sort(rows**2, axis=1)
            found.append((float(square[:, : -(long // SPIKED)].mean()), float(square.mean())))
            seconds.append(float(time[begin] - group.time_s[0]))
    return found, seconds
