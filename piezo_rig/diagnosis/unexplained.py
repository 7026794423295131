"""What is left after the last finding: whether it has structure, of which kind, how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis import dictionary
from piezo_rig.diagnosis.bands import Band
from piezo_rig.diagnosis.bursts import Bursts
from piezo_rig.diagnosis.early.lines import Line
from piezo_rig.diagnosis.levels import Levels
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import Reduced, reduce
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.ripples import AnyRipple
from piezo_rig.diagnosis.scan import LEVEL
from piezo_rig.diagnosis.scores import score_generic
from piezo_rig.diagnosis.slips import Slips
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.unsteady import Unsteady
from piezo_rig.diagnosis.warming import Drifting
from piezo_rig.diagnosis.warmth import still_warm

FloatArray = NDArray[np.float64]
WORDS = ("drive", "displacement", "direction", "range", "time_since_turn", "cycle", "clock",
         "frequency")  # fmt: skip
OF_WARMTH = ("clock", "frequency")
LINES = 0.2  # of the false alarms that a line may take, and a gain
# of the noise floor: an unsteady gain or a ripple, and a line, that are worth a word
SEEN, OF_A_LINE = 0.1, 0.02
OF_A_BAND = 2.0  # of what may be left, that may be in one band
DRIFTS = 1.0  # of the noise, by which recordings may drift apart without a word
SHARE = 0.2  # of the structured power that a tag must carry to be named
# of the noise, that structure must exceed: where it was measured between repeats, and where it was
# estimated from what is left, so that slow noise and slow structure are told apart by assumption
LEAST, LEAST_ALONE = 0.02, 0.1
FAINT = 20.0  # d' in white noise, of all samples, below which structure is not worth a word
BEYOND = 0.7  # of the noise floor, by which what repeats share may be missed
LUMPS = 1.5e-4  # of the travel: what elements that are lumps leave of a smooth actuator
AT_MOST = 3.0  # times that, what fine thresholds may take before it is more than lumps
LEFT_IN_DRIVE = 0.4  # of the noise that was taken out of the drive
NEAR_OWN = 0.03  # of a drive's frequency, within which a line is its own


@dataclass(frozen=True)
class Unexplained:
    """The verdict on the rest; sizes in nm with the noise taken out.

    ``ripple`` : the error that comes back with displacement or drive
    """

    detected: bool
    p_value: float
    rms_nm: float
    allowance_nm: float
    depends_on: list[str]
    text: str
    ripple: AnyRipple | None = None


def unexplained(
    space: Space, fitted: Fitted, noise_nm: float, of_laws_nm: float, rng: np.random.Generator,
    held_out_nm: float,
) -> Unexplained:
    """Likelihood ratio of the dictionary's scale against its null, and what carries it.

    Parameters
    ----------
    noise_nm : of one recording; the noise floor, if there is one
    of_laws_nm : rms that causes with an assumed law may have left of themselves; up to the noise
    held_out_nm : error for what was left out. If that were recordings whose repeats were not, all
        that it has beyond the noise floor is something that repeats agree on, whatever it looks
        like; what fine thresholds take in is no longer looked at otherwise
    """
    linear = space.linear(fitted.point)
    reduced = reduce(linear, every=True)
    likelihood = Likelihood(reduced)
    _, p = score_generic(likelihood, rng, LEVEL)
    scales = likelihood.best_scales()
    samples = float(linear.count.sum())
    generic, fine = _parts(reduced, scales)
    gram = _left_of(space, linear)
    bends, fines = space.counts[0], space.counts[1]
    generic_gram = gram[bends + fines :, bends + fines :]
    fine_gram = gram[bends : bends + fines, bends : bends + fines]
    rms = 1e3 * float(np.sqrt(max(float(generic @ generic_gram @ generic), 0.0) / samples))
    if np.isfinite(space.own_um):  # nothing follows the data: all that is left is what is left
        rms = min(rms, float(np.sqrt(max(held_out_nm**2 - noise_nm**2, 0.0))))
    taken = 1e3 * float(np.sqrt(max(float(fine @ fine_gram @ fine), 0.0) / samples))
    known, of_laws = _known_nm(space, noise_nm, held_out_nm), min(of_laws_nm, noise_nm)
    travel_nm = 1e3 * space.groups.travel_um
    of_drive = _of_drive_nm(space)
    mismatch = min(taken, AT_MOST * LUMPS * travel_nm)
    least = LEAST if all(g.repeats > 1 for g in space.groups.groups) else LEAST_ALONE
    least = max(least, FAINT / np.sqrt(space.groups.samples))
    allowance = float(np.linalg.norm(
        [max(mismatch, least * noise_nm, known), 3e-6 * travel_nm, of_laws, of_drive]
    ))  # fmt: skip
    missed = float(np.linalg.norm([BEYOND * noise_nm, LUMPS * travel_nm, known, of_laws, of_drive]))
    shared = _shared_nm(space, noise_nm, held_out_nm)
    named = _named(space, generic, generic_gram)
    if taken > rms:
        named.append("drive")  # fine thresholds have taken most of it
    if shared > missed:
        rms, allowance = max(rms, shared), missed
    elif not (p < LEVEL and rms > allowance):
        return Unexplained(False, p, rms, allowance, [], "")
    warm = still_warm(space, fitted)
    words = [w for w in WORDS if w in named or (warm and w in OF_WARMTH)]
    text = (f"{_two(rms)} nm rms that no known cause explains; it goes with "
            + ", ".join(w.replace("_", " ") for w in words)
            + (", as the warmth of an actuator does that was driven fast" if warm else ""))
    return Unexplained(True, p, rms, allowance, words, text)


def _two(value: float) -> str:
    """Two digits, and no power of ten."""
    return f"{float(f'{value:.2g}'):g}"


def _shared_nm(space: Space, noise_nm: float, held_out_nm: float) -> float:
    """What all repeats of every drive agree on, and the model does not follow."""
    if not all(g.repeats > 1 for g in space.groups.groups):
        return 0.0
    return float(np.sqrt(max(held_out_nm**2 - noise_nm**2, 0.0)))


def _of_drive_nm(space: Space) -> float:
    """What the model moves by noise that is left in the drive."""
    groups = space.groups
    repeats = float(np.mean([g.repeats for g in groups.groups]))
    left_v = LEFT_IN_DRIVE * groups.noise_v / np.sqrt(repeats)
    return float(1e3 * groups.travel_um / groups.span_v * left_v)


def _named(space: Space, generic: FloatArray, gram: FloatArray) -> list[str]:
    """What the dictionary's share depends on, the strongest first."""
    power: dict[str, float] = {}
    for tag in dict.fromkeys(space.tags):
        k = np.array([i for i, t in enumerate(space.tags) if t == tag])
        power[tag] = max(float(generic[k] @ gram[np.ix_(k, k)] @ generic[k]), 0.0)
    total = max(sum(power.values()), 1e-300)
    named: list[str] = []
    for tag in sorted(power, key=lambda t: -power[t]):
        if power[tag] >= SHARE * total or not named:
            named += [w for w in dictionary.depends_on(tag) if w not in named]
    return named


def _known_nm(space: Space, noise_nm: float, left_nm: float) -> float:
    """What a given model did not follow where it was identified either.

    How much of that was noise it does not say: as much as here, unless that leaves less than the
    model is off by here and it is no further off than it was.
    """
    own_nm = 1e3 * space.own_um if np.isfinite(space.own_um) else 0.0
    if left_nm <= np.hypot(noise_nm, own_nm):
        return own_nm
    return float(np.sqrt(max(own_nm**2 - noise_nm**2, 0.0)))


def with_line(
    rest: Unexplained, line: Line | None, floor_nm: float | None, own_hz: Sequence[float] = ()
) -> Unexplained:
    """The verdict with a line in clock time that no cause explains.

    ``own_hz`` : frequencies of the drives
    """
    if line is None or line.p_value > LEVEL * LINES:
        return rest
    own = any(abs(line.frequency - hz) < NEAR_OWN * hz for hz in own_hz)
    which = ", the frequency of a drive, that repeats differ by" if own else " in clock time"
    text = f"a line at {line.frequency:.1f} Hz{which}, {_two(line.rms_nm)} nm rms"
    least = OF_A_LINE * (floor_nm or 0.0)
    return _besides(rest, line.p_value, line.rms_nm, least, ("clock", "frequency"), text)


def with_ripple(
    rest: Unexplained, ripple: AnyRipple | None, noise_nm: float
) -> Unexplained:
    """The verdict with an error that comes back with displacement or drive, at a period of its own.
    """
    if ripple is None or ripple.p_value > LEVEL * LINES:
        return rest
    text = f"{ripple.text}, {_two(ripple.rms_nm)} nm rms"
    found = _besides(rest, ripple.p_value, ripple.rms_nm, SEEN * noise_nm, (ripple.over,), text)
    if found is rest:
        return rest
    # of what was there before it is a part
    rms_nm = max(rest.rms_nm, ripple.rms_nm) if rest.detected else found.rms_nm
    return replace(found, rms_nm=rms_nm, ripple=ripple)


def with_gain(
    rest: Unexplained, gain: Unsteady | None, noise_nm: float, of_ageing_nm: float = 0.0,
    what: str = "recordings",
) -> Unexplained:  # fmt: skip
    """The verdict with a gain that differs between recordings or along them.

    ``of_ageing_nm`` : rms that an ageing by an assumed law may have left of itself; ``what``
    differs
    """
    if gain is None or gain.p_value > LEVEL * LINES:
        return rest
    text = (f"{what} of the same drive differ by {100.0 * gain.share:.2g} % of the "
            f"displacement, {_two(gain.rms_nm)} nm rms: the gain of amplifier or sensor is not "
            "steady")  # fmt: skip
    least = float(np.hypot(SEEN * noise_nm, of_ageing_nm))
    return _besides(rest, gain.p_value, gain.rms_nm, least, ("clock", "displacement"), text)


def with_drifting(rest: Unexplained, found: Drifting | None) -> Unexplained:
    """The verdict with a zero that drifts otherwise from one recording to the next."""
    if found is None or found.p_value > LEVEL * LINES:
        return rest
    text = (f"recordings of one drive drift apart by {_two(found.rate_nm_s)} nm/s, "
            f"{_two(found.rms_nm)} nm rms: the zero drifts, at a rate that changes")  # fmt: skip
    return _besides(rest, found.p_value, found.rms_nm, DRIFTS * found.noise_nm, ("clock",), text)


def with_band(rest: Unexplained, band: Band | None, noise_nm: float) -> Unexplained:
    """The verdict with what all repeats share in a band of frequencies, where nothing else stands
    out.
    """
    if rest.detected or band is None or band.p_value > LEVEL * LINES:
        return rest
    text = (f"all repeats share {_two(band.rms_nm)} nm rms between {band.low_hz:.3g} and "
            f"{band.high_hz:.3g} Hz that no cause has: something rings or turns there")  # fmt: skip
    least = max(OF_A_BAND * rest.allowance_nm, SEEN * noise_nm)
    return _besides(rest, band.p_value, band.rms_nm, least, ("frequency",), text)


def with_wandering(rest: Unexplained, share: float, rms_nm: float) -> Unexplained:
    """The verdict with a gain that changes along the only recording, which is no ageing."""
    text = (f"the gain changes by {100.0 * share:.2g} % along the recording, "
            f"{_two(rms_nm)} nm rms, otherwise than with the count of its cycles")  # fmt: skip
    least = rest.allowance_nm
    return _besides(rest, rest.p_value, rms_nm, least, ("clock", "displacement"), text)


def with_slips(
    rest: Unexplained, found: Slips | None, noise_nm: float, open_nm: float = 0.0
) -> Unexplained:
    """The verdict with steps where the drive turns, where nothing else stands out.

    ``open_nm`` : of such steps, what laws leave open that turn over there
    """
    if rest.detected or found is None or found.p_value > LEVEL * LINES:
        return rest
    text = (f"the displacement steps by {_two(found.step_nm)} nm rms where the drive turns, "
            f"{_two(found.rms_nm)} nm rms in all: something slips or catches")  # fmt: skip
    least = float(np.linalg.norm([SEEN * noise_nm, rest.allowance_nm, open_nm]))
    return _besides(rest, found.p_value, found.rms_nm, least, ("time_since_turn", "cycle"), text)


def with_bursts(rest: Unexplained, bursts: Bursts | None, floor_nm: float | None) -> Unexplained:
    """The verdict with noise that is not steady.

    Without repeats it is looked for in what the model leaves, and more than the model may leave.
    """
    if bursts is None:
        return rest
    least = SEEN * floor_nm if floor_nm else rest.allowance_nm
    return _besides(rest, rest.p_value, bursts.rms_nm, least, ("clock",), bursts.text)


def with_levels(rest: Unexplained, found: Levels | None) -> Unexplained:
    """The verdict with noise that switches between two levels."""
    if found is None:
        return rest
    return _besides(rest, rest.p_value, found.rms_nm, 0.0, ("clock",), found.text)


def _besides(
    rest: Unexplained, p_value: float, rms_nm: float, least_nm: float,
    goes_with: tuple[str, ...], text: str,
) -> Unexplained:  # fmt: skip
    """The verdict with something more that no cause explains, if that is more than it may be.

    What repeats disagree by is no mismatch of the base model: it has an allowance of its own.

    ``least_nm`` : rms that it may be
    """
    if not rms_nm > least_nm:
        return rest
    words = [w for w in WORDS if w in {*rest.depends_on, *goes_with}]
    if not rest.detected:
        return Unexplained(True, min(rest.p_value, p_value), rms_nm, least_nm, words, text)
    return replace(
        rest, p_value=min(rest.p_value, p_value), rms_nm=float(np.hypot(rest.rms_nm, rms_nm)),
        depends_on=words, text=f"{rest.text}; {text}",
    )  # fmt: skip


def _parts(reduced: Reduced, scales: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Best linear prediction of the dictionary's and the fine thresholds' shares."""
    n = len(reduced.fine)
    solved = np.linalg.solve(reduced.covariance.of(scales), reduced.z[:n])
    return scales[1] * reduced.generic.T @ solved, scales[0] * reduced.fine.T @ solved


def _left_of(space: Space, linear: Linear) -> FloatArray:
    """Gram matrix of the fixed columns, unwhitened, less what the base model can follow; um^2."""
    base = fixed = cross = np.zeros(0)
    for at, piece in enumerate(space.pieces):
        weight = space.groups.groups[piece.group].repeats
        raw = space.fixed[at].raw.astype(float)
        own = np.concatenate([linear.frame.bands[at].raw, linear.rows[at].raw])
        parts = (weight * own @ own.T, weight * raw @ raw.T, weight * own @ raw.T)
        base, fixed, cross = (
            parts if at == 0 else (base + parts[0], fixed + parts[1], cross + parts[2])
        )
    if base.size == 0:
        return fixed
    size = 1.0 / np.sqrt(np.maximum(np.diag(base), 1e-300))
    ridged = base * np.outer(size, size) + 1e-8 * np.eye(size.size)
    cross = cross * size[:, None]
    return fixed - cross.T @ np.linalg.solve(ridged, cross)
