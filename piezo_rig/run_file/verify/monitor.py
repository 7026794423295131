"""The command against the drive monitor: what was asked of the stack, and what it got.

Where they differ, the difference may follow a law of the bench: another gain or offset, an
amplifier that saturates or is too slow, samples that are missing. Then the file is whole, and
diagnosis can name the cause. A difference that follows none, or that other sweeps of the same
run contradict, is damage.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_rig.run_file.reader import LARGEST, decimate
from piezo_rig.run_file.verify.sweep_checks import Channels
from piezo_rig.run_file.verify.verdict import Verdict

# The monitor sees the stack, the command says what it should be: gain and offset of the
# amplifier (0.5 %), the digitizer's range, and the amplifier's lag at the highest slew.
MONITOR_TOLERANCE_V = 0.75
GAIN_TOLERANCE = 0.01
_NARROW_V = 10.0  # sweeps of less tell no gain
_MOST_LOST = 500  # samples
_OVER = 50  # samples that a speed is taken over


@dataclass(frozen=True)
class Followed:
    """How the monitor of one sweep follows its command.

    Attributes
    ----------
    top_v, bottom_v, slew : of the drive, volts and V per sample
    gain, offset_v : monitor = gain * drive + offset_v, least squares
    law : ``""`` agrees, ``gain``, ``upper``, ``lower``, ``slew``, ``lost``, or ``none`` of these
    text : what differs
    """

    top_v: float
    bottom_v: float
    slew: float
    gain: float
    offset_v: float
    law: str
    limit: float
    text: str


_CAUSES = {
    "upper": "drive-clipping", "lower": "drive-clipping", "slew": "slew-limit",
    "lost": "dropped-samples",
}  # fmt: skip


def followed(a: dict[str, Any], c: Channels) -> Followed:
    """Compare one sweep's command with its monitor."""
    assert c.monitor_v is not None
    raw = c.monitor_v
    if raw.size != c.command_v.size * a["oversampling"] or raw.size < 2 or not (
        (np.abs(raw) <= LARGEST).all() and (np.abs(c.command_v) <= LARGEST).all()
    ):
        return Followed(0.0, 0.0, 0.0, 1.0, 0.0, "", 0.0, "")  # said elsewhere
    drive = float(a["gain"]) * c.command_v + float(a["offset_v"])
    monitor = decimate(raw, a["oversampling"])
    slew = np.abs(np.gradient(drive))
    gain, offset = 1.0, 0.0
    if np.ptp(drive) >= _NARROW_V:
        gain, offset = (float(v) for v in np.polyfit(drive, monitor, 1))
    law, limit, text = _law(drive, monitor, slew, gain, offset)
    return Followed(
        float(drive.max()), float(drive.min()), float(slew.max()), gain, offset, law, limit, text
    )


def _fits(predicted: np.ndarray, monitor: np.ndarray, slew: np.ndarray) -> bool:
    # The amplifier's lag and a sample of delay are not faults; a wrong level is.
    return bool((np.abs(monitor - predicted) - 2.0 * slew).max() <= 0.5 * MONITOR_TOLERANCE_V)


def _law(
    drive: np.ndarray, monitor: np.ndarray, slew: np.ndarray, gain: float, offset: float
) -> tuple[str, float, str]:
    """The law of the difference, its parameter, and the difference in words."""
    worst = np.abs(monitor - drive) - 2.0 * slew
    index = int(worst.argmax())
    agrees = worst[index] <= MONITOR_TOLERANCE_V
    if agrees and abs(gain - 1) <= GAIN_TOLERANCE:
        return "", 0.0, ""
    text = (f"the drive monitor reads {monitor[index]:.2f} V where the command asks for "
            f"{drive[index]:.2f} V (sample {index})")
    if abs(gain - 1) < 0.2 and abs(offset) < 20 and _fits(gain * drive + offset, monitor, slew):
        return "gain", 0.0, f"{text}: it follows {gain:.4f} x drive {offset:+.2f} V"
    high, low = float(np.quantile(monitor, 0.999)), float(np.quantile(monitor, 0.001))
    if drive.max() > high + MONITOR_TOLERANCE_V and _fits(np.minimum(drive, high), monitor, slew):
        return "upper", high, f"{text}: it stops at {high:.2f} V"
    if drive.min() < low - MONITOR_TOLERANCE_V and _fits(np.maximum(drive, low), monitor, slew):
        return "lower", low, f"{text}: it stops at {low:.2f} V"
    limit = _fastest(monitor)
    if 0 < limit < 0.9 * slew.max() and _fits(_limited(drive, limit, monitor[0]), monitor, slew):
        return "slew", limit, f"{text}: it changes by no more than {limit:.3g} V per sample"
    first = int(np.argmax(worst > min(worst[index], MONITOR_TOLERANCE_V) - 1e-12))
    if lost := _lost(drive, monitor, slew, first):
        return "lost", float(lost), f"{text}: {lost} samples or so are missing before it"
    return "none", 0.0, text


def _fastest(monitor: np.ndarray) -> float:
    """Volts per sample that the monitor changes by where it is fastest.

    Over many samples: the noise and the steps of single ones would add up over a half loop.
    """
    over = min(_OVER, monitor.size // 4)
    if over < 1:
        return 0.0
    return float(np.quantile(np.abs(monitor[over:] - monitor[:-over]), 0.98)) / over


def _limited(drive: np.ndarray, limit: float, start: float) -> np.ndarray:
    """The drive behind a slew limit, volts per sample."""
    out, now = np.empty_like(drive), float(start)
    for i, v in enumerate(drive.tolist()):
        now += min(limit, max(-limit, v - now))
        out[i] = now
    return out


def _lost(drive: np.ndarray, monitor: np.ndarray, slew: np.ndarray, first: int) -> int:
    """By how many samples the monitor runs ahead of the command from ``first`` on; 0 for none."""
    begin = first + 20
    best, least = 0, np.inf
    for count in range(1, min(_MOST_LOST, drive.size - begin - 100) + 1):
        end = min(begin + 5000, drive.size - count)
        ahead, steep = drive[begin + count : end + count], slew[begin + count : end + count]
        off = float(np.abs(monitor[begin:end] - ahead).max())
        if off < least and np.ptp(ahead) > 5.0 and _fits(ahead, monitor[begin:end], steep):
            best, least = count, off
    return best


def judge(monitors: dict[str, Followed]) -> list[Verdict]:
    """What the monitors of all sweeps say together; by name."""
    found: list[Verdict] = []
    by_gain: list[str] = []
    for name, m in monitors.items():
        if not m.law:
            continue
        others = [o for n, o in monitors.items() if n != name]
        if m.law == "none" or _contradicted(m, others):
            found.append(Verdict(name, True, m.text))
        elif m.law == "gain":
            by_gain.append(name)
        else:
            found.append(Verdict(name, True, m.text, _CAUSES[m.law]))
    if by_gain:
        found.append(Verdict(
            "", True, f"in {len(by_gain)} of {len(monitors)} sweeps {monitors[by_gain[0]].text}: "
            "the amplifier's gain or offset is not the calibrated one (drive-gain), or the "
            "monitor's is not; the sweeps may be used, their drive is the commanded one",
        ))
    return found


def _contradicted(m: Followed, others: list[Followed]) -> bool:
    """Whether more sweeps of the run deny a law than share it."""
    share = deny = 0
    for o in others:
        if o.law == m.law:
            if m.law != "gain" or (
                abs(o.gain - m.gain) < GAIN_TOLERANCE and abs(o.offset_v - m.offset_v) < 1.0
            ):
                share += 1
        elif o.law == "" and (
            (m.law == "gain" and o.top_v - o.bottom_v >= _NARROW_V
             and (abs(o.gain - m.gain) > GAIN_TOLERANCE / 2 or abs(o.offset_v - m.offset_v) > 0.5))
            or (m.law == "upper" and o.top_v > m.limit + 2 * MONITOR_TOLERANCE_V)
            or (m.law == "lower" and o.bottom_v < m.limit - 2 * MONITOR_TOLERANCE_V)
            or (m.law == "slew" and o.slew > 1.5 * m.limit)
        ):
            deny += 1
    return deny > share
