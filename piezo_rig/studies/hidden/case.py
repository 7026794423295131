"""A case: recordings with something hidden in them, and the sealed truth beside."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from piezo_rig.run_file.sweep import Sweep
from piezo_rig.scoring.noise import Noise
from piezo_rig.scoring.oracle import Oracle, base_columns
from piezo_rig.studies.hidden.body import Body, random_body
from piezo_rig.studies.hidden.calibration import CALIBRATION
from piezo_rig.studies.hidden.effects import EFFECTS, Effect
from piezo_rig.studies.hidden.events import EVENTS
from piezo_rig.studies.hidden.history import HISTORY
from piezo_rig.studies.hidden.locked import locked
from piezo_rig.studies.hidden.noise import noise_of
from piezo_rig.studies.hidden.protocols import Condition, conditions_of, unseen_drive
from piezo_rig.studies.hidden.session import Session
from piezo_rig.studies.hidden.sizing import sized
from piezo_rig.studies.hidden.strangers import STRANGERS

FloatArray = NDArray[np.float64]
SEVERAL = {"pair": 2, "triple": 3}  # any so many effects at once
KINDS = ("null", *EFFECTS, *HISTORY, *CALIBRATION, *EVENTS, "stranger", *STRANGERS, *SEVERAL)
SENSITIVITY = 15.48


@dataclass(frozen=True)
class Truth:
    """What was hidden.

    Attributes
    ----------
    cause : its id, ``none``, ``stranger:NAME``, or ids joined by ``+``
    causes : the same one by one, empty for ``none``
    parameters : cause -> name -> value in the catalogue's units; only what the form defines
    d_prime : of each cause off the others, by the oracle
    sizes : what scales each, in the unit of its class
    form : of each, and the body
    reached : the d' that was asked for lies within what is plausible
    """

    cause: str
    causes: tuple[str, ...] = ()
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    d_prime: tuple[float, ...] = ()
    sizes: tuple[float, ...] = ()
    form: str = ""
    reached: bool = True


@dataclass(frozen=True, eq=False)
class Unseen:
    """A drive that was never measured, without noise: um from the first sample, shape (n,)."""

    time_s: FloatArray
    drive_v: FloatArray
    with_effect_um: FloatArray
    without_um: FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """Recordings with a hidden effect; `draw` makes them."""

    sweeps: list[Sweep]
    truth: Truth
    conditions: tuple[Condition, ...]
    repeats: int
    noise: Noise
    body: Body
    effects: tuple[Effect, ...]
    seed: int

    def again(self, seed: int) -> list[Sweep]:
        """The same conditions recorded anew: fresh noise, phases and events."""
        return _recorded(self, np.random.default_rng([self.seed, 7, seed]))

    def before(self, seed: int) -> list[Sweep]:
        """The same conditions recorded before the effects came, with noise of their own."""
        rng = np.random.default_rng([self.seed, 9, seed])
        return _recorded(replace(self, effects=()), rng)

    def unseen(self, seed: int = 0) -> Unseen:
        """A drive never measured, with the drive-locked effects and without."""
        drive = unseen_drive(self.conditions, np.random.default_rng([self.seed, 8, seed]))
        time = np.arange(drive.size) / self.conditions[0].rate
        with_effect = locked(self.body, self.effects, time, drive)
        without = locked(self.body, (), time, drive)
        return Unseen(time, drive, with_effect - with_effect[0], without - without[0])

    @cached_property
    def clean_um(self) -> list[FloatArray]:
        """Drive-locked displacement of every condition."""
        return [locked(self.body, self.effects, c.time_s, c.drive_v) for c in self.conditions]

    def known_um(self) -> list[FloatArray]:
        """What the effects changed in each of ``sweeps``, um."""
        session = _session(self, self._first)
        bare = [locked(self.body, (), c.time_s, c.drive_v) for c in self.conditions]
        out = []
        for k in range(len(self.sweeps)):
            i = k % len(self.conditions)
            clean = self.clean_um[i]
            out.append(clean - bare[i] + session.added(k, self.conditions[i], clean))
        return out

    def bare(self) -> list[Sweep]:
        """``sweeps`` as they would have been without the effects, with the same noise."""
        out = []
        for sweep, known in zip(self.sweeps, self.known_um(), strict=True):
            volts = sweep.sensor_v + known / SENSITIVITY
            out.append(sweep.with_(sensor_v=volts, zero_v=float(volts[0])))
        return out

    def happened(self) -> list[tuple[int, str, int, int]]:
        """Every event in ``sweeps``: which of them, cause, index, count."""
        session = _session(self, self._first)
        return [
            (k, *place)
            for k, sweep in enumerate(self.sweeps)
            for place in session.places(k, sweep.samples)
        ]

    def best_unseen_um(self, seed: int = 0) -> FloatArray:
        """What the oracle predicts of the unseen drive: it knows the effects, not the body."""
        oracle = Oracle.of([c.drive_v for c in self.conditions], self.noise, self.repeats)
        unseen = self.unseen(seed)
        fitted = oracle.fitted([s.displacement_um for s in self.bare()])
        base = base_columns(unseen.drive_v, oracle.span_v) @ fitted
        return base + unseen.with_effect_um - unseen.without_um

    @property
    def _first(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, 6])


def _session(case: Case, rng: np.random.Generator) -> Session:
    return Session.of(case.conditions, case.repeats, case.effects, rng)


def _recorded(case: Case, rng: np.random.Generator) -> list[Sweep]:
    session = _session(case, rng)
    out = []
    for k, start in enumerate(session.starts_s):
        c = case.conditions[k % len(case.conditions)]
        x = case.clean_um[k % len(case.conditions)]
        x = x + session.added(k, c, x)
        x = x + case.noise.drawn(x.size, rng)
        volts = -x / SENSITIVITY
        out.append(Sweep(
            name=f"sweep_{k + 1:04d}", command_v=(c.drive_v - 75.0) / 7.5, sensor_v=volts,
            sample_rate=c.rate, gain=7.5, offset_v=75.0, sensitivity_um_per_v=SENSITIVITY,
            polarity=-1, zero_v=float(volts[0]), condition=c.name,
            repeat=k // len(case.conditions) + 1, history="virgin", start_time=1e3 + float(start),
            origin="IMPORTED",
        ))  # fmt: skip
    return out


def _chosen(kind: str, rng: np.random.Generator) -> list[type[Effect]]:
    every: dict[str, type[Effect]] = {
        **EFFECTS, **HISTORY, **CALIBRATION, **EVENTS, **STRANGERS
    }
    if kind == "null":
        return []
    if kind == "stranger":
        return [STRANGERS[str(rng.choice(list(STRANGERS)))]]
    if kind in SEVERAL:
        while True:
            chosen = [EFFECTS[str(n)] for n in rng.choice(list(EFFECTS), SEVERAL[kind], False)]
            places = [k.places for k in chosen if k.places]
            if len(places) == len(set(places)):
                return chosen
    names = kind.removeprefix("pair:").split("+")
    unknown = [n for n in names if n not in every]
    if unknown:
        raise ValueError(f"kind {kind!r} is not one of {', '.join(KINDS)}, or A+B")
    return [every[n] for n in names]


def draw(
    kind: str,
    seed: int,
    protocol: str = "matrix",
    noise: str = "white",
    d_prime: float = 40.0,
    repeats: int = 2,
    form: str | None = None,
) -> Case:
    """Recordings with a hidden effect.

    Parameters
    ----------
    kind : ``null``, a cause id, ``stranger`` (any) or ``stranger:NAME``, ``pair`` or ``triple``
        (any two or three effects), or ``creep+mains-hum``
    seed : the same arguments give the same case
    protocol, noise : of `PROTOCOLS`, of `NOISES`
    d_prime : of each effect, off the others; ``truth.reached`` says whether that was plausible.
        Spikes are never smaller than 30 nm: their d' may be larger
    form : one of the effect's forms; drawn if not given

    Raises
    ------
    ValueError : a name that is not known
    """
    whole = crc32(f"{kind} {seed} {protocol} {noise} {repeats}".encode())
    rng = np.random.default_rng(whole)
    kinds = _chosen(kind, rng)
    body = random_body(rng, first_element=any(k.first_element for k in kinds))
    conditions = tuple(conditions_of(protocol, rng, repeats))
    sound = noise_of(noise, conditions[0].rate)
    planned: list[Effect] = []
    for k in kinds:
        drawn = str(rng.choice(list(k.forms)))
        effect = k.drawn(rng, form if form in k.forms else drawn)
        planned.append(effect.placed(body, [c.drive_v for c in conditions] * repeats))
    effects, reached = sized(planned, d_prime, body, conditions, sound, repeats, whole)
    seconds = repeats * sum(c.drive_v.size / c.rate for c in conditions)
    causes = tuple(e.cause for e in effects)
    truth = Truth(
        cause="+".join(causes) or "none",
        causes=causes,
        parameters={e.cause: e.parameters(body, seconds) for e in effects},
        d_prime=tuple(reached),
        sizes=tuple(e.size for e in effects),
        form=", ".join([*(e.form for e in effects), body.kind]),
        reached=all(d > 0.98 * d_prime for d in reached),
    )
    empty = Case([], truth, conditions, repeats, sound, body, tuple(effects), whole)
    return _with_sweeps(empty)


def _with_sweeps(case: Case) -> Case:
    case.sweeps.extend(_recorded(case, case._first))
    return case
