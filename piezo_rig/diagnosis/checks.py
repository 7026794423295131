"""Large mistakes, named before any statistics: units, another actuator, repeats that are none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from piezo_rig.chain.half_loops import noise
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import Sweep

SWITCH = 3.99  # neighbouring positions of the sensitivity switch
UNLIKE = 0.05  # of the travel: repeats differ by no more
BAD = 0.3  # of the travel
FURTHER = 1.3  # times what a given model was off by where it was identified
BEYOND = 1.1  # times the swing up to which a given model has elements
LEADS = -0.01  # area of a loop, of the drive's range times the travel
MOVES_UM_PER_V = 1e-4, 20.0  # a small stack under a volt; a lever of amplified stacks
FAR_OFF = 3.0  # times the noise, where it was identified
AT_AN_END = 8.0  # standard deviations of the noise from the last volt that a sensor shows
STANDS = 0.1  # of the drive's range that passes while it stands there


def data_warnings(groups: Groups, sweeps: Sequence[Sweep]) -> list[str]:
    """Repeats that are not repeats, and data that no stack gives."""
    out = [*_copies(sweeps), *unlike_a_stack(groups), *_at_an_end(sweeps)]
    for g in groups.groups:
        if g.repeats < 2:
            continue
        rows = g.measured_um - g.measured_um.mean(axis=1, keepdims=True)
        middle = np.median(rows, axis=0)
        travel = float(np.ptp(middle))
        for members, row in zip(g.sweeps, rows, strict=True):
            off = float(np.sqrt(np.mean((row - middle) ** 2)))
            if off > UNLIKE * travel:
                scale = float(row @ middle / (middle @ middle))
                like = f"; it is {scale:.3g} times the others" if abs(scale - 1) > 0.1 else ""
                out.append(
                    f"repeats that are not repeats: {sweeps[members[0]].name} of condition "
                    f"{g.condition} differs from the others by {off:.3g} um rms, "
                    f"{100 * off / travel:.0f} % of the travel{like}"
                )
    return out


def unlike_a_stack(groups: Groups) -> list[str]:
    """Loops that are run through the wrong way round, and a travel in other units."""
    out, moved = list[str](), groups.travel_um / max(groups.span_v, 1e-12)
    least, most = MOVES_UM_PER_V
    if not least <= moved <= most:
        out.append(
            f"the displacement moves by {moved:.3g} um per volt, which no piezo stack does: "
            "its column may be in another unit than its name says, or the sensitivity was another"
        )
    area, swept = 0.0, 0.0
    for g in groups.groups:
        mean = g.measured_um.mean(axis=0)
        for a, b in g.blocks:
            v, x = g.drive_v[a:b] - g.drive_v[a], mean[a:b] - mean[a]
            area += 0.5 * float(v[:-1] @ x[1:] - v[1:] @ x[:-1])
            swept += 0.5 * float(np.ptp(x)) * float(np.sum(np.abs(np.diff(v))))
    if area < LEADS * swept:
        out.append(
            "the displacement leads the drive, loops are run through the wrong way round: the two "
            "channels may be swapped, or the drive was recorded late"
        )
    return out


def _copies(sweeps: Sequence[Sweep]) -> list[str]:
    """Recordings that are there twice."""
    out, known = list[str](), dict[bytes, str]()
    for sweep in sweeps:
        name = f"{sweep.name} ({sweep.source})" if sweep.source else sweep.name
        samples = sweep.sensor_v.tobytes()
        if samples not in known:
            known[samples] = name
        elif np.ptp(sweep.sensor_v) > 0.0:
            out.append(
                f"{name} holds the same samples as {known[samples]}: a copy, or without noise, "
                "but no repeat; the noise that is told from repeats comes out too small"
            )
    return out


def _at_an_end(sweeps: Sequence[Sweep]) -> list[str]:
    """A voltage beyond which no recording goes, wherever it begins: the end of the sensor's output.

    Where all begin at one voltage it is a level above their zero, which is a cause to be found.
    """
    out, noise_v = list[str](), [noise(s.sensor_v) for s in sweeps]
    near = AT_AN_END * float(np.median(noise_v)) if noise_v else 0.0
    if near == 0.0:
        return out
    for side, sign in (("highest", 1.0), ("lowest", -1.0)):
        end = max((float(np.max(sign * s.sensor_v)) for s in sweeps), default=0.0)
        standing, moved = list[Sweep](), 0.0
        for s in sweeps:
            there = sign * s.sensor_v > end - near
            travel, swing = float(np.ptp(s.sensor_v)), float(np.ptp(s.drive_v))
            passed = float(np.ptp(s.drive_v[there])) if there.any() else 0.0
            if passed > max(STANDS, 4.0 * near / max(travel, near)) * swing:
                standing.append(s)
                moved = max(moved, passed)
        zeros = [s.zero_v for s in standing]
        if len(standing) > 1 and max(zeros) - min(zeros) > 2.0 * near:
            out.append(
                f"the sensor stands at {sign * end:.4g} V, its {side}, in {len(standing)} "
                f"recordings that begin at different voltages, while up to {moved:.3g} V of drive "
                "pass: its output or the digitizer's input ends there, and what was recorded there "
                "is no displacement; set a wider range, or the sensor to zero, and record again"
            )
    return out


def baseline_warnings(groups: Groups, fitted: Fitted) -> list[str]:
    """A given baseline that belongs to other data.

    Raises
    ------
    InputError : its prediction is off by a factor that no physics explains
    """
    if not fitted.point.fixed:
        return []
    scale, left, power = 0.0, 0.0, 0.0
    for g in groups.groups:
        p = g.predicted(fitted.point.model)
        y = g.measured_um.mean(axis=0)
        for a, b in g.blocks:
            dp, dy = p[a:b] - p[a:b].mean(), y[a:b] - y[a:b].mean()
            scale += float(dp @ dy)
            power += float(dp @ dp)
            left += float(dy @ dy)
    ratio = scale / max(power, 1e-300)
    shape = 1.0 - scale**2 / max(power * left, 1e-300)
    # a higher position is more um per volt: what was read at too low a one is too small
    for factor, words in (
        (1.0 / SWITCH, "the sensitivity switch stood one position higher than was said"),
        (SWITCH, "the sensitivity switch stood one position lower than was said"),
    ):
        if abs(ratio / factor - 1.0) < 0.2 and shape < 0.1:
            raise InputError(
                "sensitivity-factor",
                f"the displacement is {ratio:.3g} times what the baseline model predicts",
                "units that cannot be right, a factor near four is one step of the switch: "
                f"{words}",
                "read the recordings again with the right --sensitivity",
            )
    if not 0.5 < ratio < 2.0 or shape > BAD**2:
        return [
            f"the baseline predicts {1 / max(ratio, 1e-9):.3g} times the measured travel: it is "
            "of another actuator, the calibration differs, or a finding explains it"
        ]
    return []


def beyond_its_drives(groups: Groups, fitted: Fitted) -> list[str]:
    """What is to be said where drives swing further than a given model's elements reach."""
    model = fitted.point.model
    if not fitted.point.fixed:
        return []
    later = model.maxwell.elements
    own = [s.elements for s in model.stages if s.has_elements and s.id != "maxwell"]
    first = own[0] if own else later
    assert later is not None
    assert first is not None
    times = 0.0
    for g in groups.groups:
        swings = np.abs(g.drive_v[g.loops.stop] - g.drive_v[g.loops.start])
        if g.virgin and swings.size:
            times = max(times, float(swings[0] / first.knots_v[-1]))
            swings = swings[1:]
        # from a turning point on an element gives way after twice its threshold
        times = max(times, 0.5 * float(swings.max(initial=0.0) / later.knots_v[-1]))
    if times <= BEYOND:
        return []
    return [
        f"these drives swing {times:.3g} times as far as the given model's elements reach: "
        "beyond, its last slope goes on, and what it gets wrong there may be named as something new"
    ]


def further_off(own_nm: float, left_nm: float) -> list[str]:
    """What is to be said where a given model stays further off than it was at home."""
    if not left_nm > FURTHER * own_nm:
        return []
    return [
        f"the given model was off by {own_nm:.3g} nm rms where it was identified and is off by "
        f"{left_nm:.3g} nm here, with everything that was found: something has changed that these "
        "data do not name, or these drives ask more of it than those did"
    ]


def far_off(own_nm: float, floor_nm: float | None) -> list[str]:
    """What to say of a given model that was far off where it was identified."""
    if floor_nm is None or not np.isfinite(own_nm) or own_nm < FAR_OFF * floor_nm:
        return []
    return [
        f"the given model was off by {own_nm:.3g} nm where it was identified, at a noise of "
        f"{floor_nm:.3g} nm: it lacks causes, and what is found, or called unexplained, may be "
        "those and not news; a model by `diagnose --save-model` of those recordings has them"
    ]
