"""One case, drawn from a seed and its number alone: what is hidden, how large, and under what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.challenge.hiding import CAUSES, QUIET, STRANGERS, Kind, Reach, Settings, body, merged
from piezo_rig.challenge.judge import Judge
from piezo_rig.challenge.noises import NOISES, PLANT, noise_of
from piezo_rig.challenge.protocols import PROTOCOLS, protocol_text
from piezo_rig.challenge.rehearsal import Rehearsal
from piezo_rig.scoring.oracle import size_for

FloatArray = NDArray[np.float64]
SCHEMA = "piezo-rig/challenge-truth/1"
# Of every eight cases, in a drawn order: two hold nothing, one a stranger, one a pair.
BLOCK = ("null", "null", "one", "one", "one", "one", "stranger", "pair")
D_PRIMES = (20.0, 40.0, 80.0)  # at 4, an oracle misses half of what is there
SEEN = 10.0  # d' that events must have, which come in one size only
IN_RANGE = 0.95  # of the sensor's range
TOGETHER = 0.8  # |cos| up to which two effects make a fair pair
DRAWS = 12  # attempts at a case in which the effect can be as large as it should


@dataclass(frozen=True)
class Truth:
    """What a case hides; the JSON beside its recordings.

    Attributes
    ----------
    case : its name
    cause : its id, ``none``, ``stranger:NAME``, or two ids joined by ``+``
    causes : the same one by one
    parameters : cause -> name -> value in the catalogue's units, where the bench's own setting
        means the same
    d_prime, sizes : of each cause
    asked : the d' that was asked for; 0 where nothing is hidden
    reached : it could be had
    form : of the actuator's body
    protocol, noise : names
    plant : the bench's settings, whole
    left_nm : held-out rms errors with any of the causes taken off, see `Judge.left_nm`
    oracle : what the oracle finds in the very recordings, as a row of `scoring.counts`
    """

    case: str
    cause: str
    causes: list[str]
    parameters: dict[str, dict[str, float]]
    d_prime: list[float]
    sizes: list[float]
    asked: float
    reached: bool
    form: str
    protocol: str
    noise: str
    plant: Settings
    left_nm: dict[str, float]
    oracle: dict[str, Any]
    schema: str = SCHEMA


@dataclass(frozen=True, eq=False)
class Case:
    """A case that is ready to be sealed and played."""

    truth: Truth
    protocol: str  # the protocol file's text
    rehearsal: Rehearsal

    def document(self) -> dict[str, Any]:
        """The truth as plain data."""
        return asdict(self.truth)

    @cached_property
    def expected_um(self) -> list[FloatArray]:
        """What a run of it has to record, rows (n,)."""
        return self.rehearsal.displacements(self.truth.plant, clean=False)


@dataclass(frozen=True, eq=False)
class _Bench:
    """An actuator in its noise under a protocol, and effects that are hidden one after another."""

    rehearsal: Rehearsal
    judge: Judge
    plant: Settings  # without any effect

    @cached_property
    def bare_um(self) -> list[FloatArray]:
        """What it would record without effects and noise, rows (n,)."""
        return self.rehearsal.displacements(self.plant)

    @property
    def reach(self) -> Reach:
        drives = self.rehearsal.drives_v
        return Reach(
            max(float(v.max()) for v in drives), max(float(x.max()) for x in self.bare_um),
            self.rehearsal.rate * max(float(np.abs(np.diff(v)).max()) for v in drives),
        )  # fmt: skip

    def change(self, effects: Sequence[Settings]) -> list[FloatArray]:
        """What effects change in every recording, um."""
        with_them = self.rehearsal.displacements(merged([self.plant, *effects]))
        return [a - b for a, b in zip(with_them, self.bare_um, strict=True)]


@dataclass(frozen=True)
class _Effect:
    kind: Kind
    more: Settings
    sign: float
    size: float
    d_prime: float
    change: list[FloatArray]

    @property
    def table(self) -> Settings:
        return self.kind.plant(self.sign * self.size, self.more)


def name_of(index: int) -> str:
    """``case_0001`` for index 0."""
    return f"case_{index + 1:04d}"


def kind_of(seed: int, index: int) -> tuple[str, int]:
    """What sort of case it is, and how many of that sort come before it."""
    block, place = divmod(index, len(BLOCK))
    order = np.random.default_rng([seed, block, 1]).permutation(len(BLOCK))
    sorts = [BLOCK[i] for i in order]
    earlier = block * BLOCK.count(sorts[place]) + sorts[:place].count(sorts[place])
    return sorts[place], earlier


def draw(seed: int, index: int) -> Case:
    """A case; the same seed and index give the same one, however many are asked for."""
    sort, earlier = kind_of(seed, index)
    rng = np.random.default_rng([seed, index, 2])
    asked = float(rng.choice(D_PRIMES)) if sort != "null" else 0.0
    best: Case | None = None
    for _ in range(DRAWS):
        kinds = _kinds(sort, seed, earlier, rng)
        noise = NOISES[earlier % len(NOISES)] if sort == "null" else str(rng.choice(NOISES))
        case = _drawn(name_of(index), kinds, noise, asked, rng)
        if case is not None:
            best = case
            if case.truth.reached:
                break
    if best is None:
        raise RuntimeError(f"{name_of(index)}: nothing visible could be drawn")
    return best


def _kinds(sort: str, seed: int, earlier: int, rng: np.random.Generator) -> list[Kind]:
    if sort == "null":
        return []
    if sort == "pair":
        smooth = [k for k in CAUSES if k.most is not None and not k.lumpy]
        return [smooth[i] for i in rng.choice(len(smooth), 2, replace=False)]
    # every one comes once before any comes again
    those = CAUSES if sort == "one" else STRANGERS
    turn, place = divmod(earlier, len(those))
    order = np.random.default_rng([seed, turn, len(those), 3]).permutation(len(those))
    return [those[order[place]]]


def _drawn(
    name: str, kinds: Sequence[Kind], noise: str, asked: float, rng: np.random.Generator
) -> Case | None:
    """One attempt; None where the effects do not show, or cannot be told from each other, or
    where the sensor's output would leave the digitizer's range.
    """
    protocol = str(rng.choice(PROTOCOLS))
    text = protocol_text(protocol, rng)
    rehearsal = Rehearsal.of(text)
    judge = Judge(rehearsal, noise_of(noise, rehearsal.rate))
    plant = merged([QUIET, body(rng), PLANT[noise], {"seed": int(rng.integers(1, 2**31))}])
    bench = _Bench(rehearsal, judge, plant)
    effects = [_sized(bench, kind, asked, rng) for kind in kinds]
    if any(e.d_prime < min(SEEN, 0.5 * asked) for e in effects):
        return None
    if len(effects) == 2:
        gram = judge.gram([e.change for e in effects])
        if abs(gram[0, 1]) > TOGETHER * np.sqrt(gram[0, 0] * gram[1, 1]):
            return None
    whole = merged([plant, *(e.table for e in effects)])
    noisy = rehearsal.displacements(whole, clean=False)
    if rehearsal.range_used(whole) > IN_RANGE:
        return None
    changes = {e.kind.cause: _share(bench, effects, i) for i, e in enumerate(effects)}
    seen = [a - b for a, b in zip(noisy, bench.bare_um, strict=True)]
    found, alternatives = judge.findings(seen, _rivals(bench, kinds, rng) | changes)
    truth = Truth(
        case=name,
        cause="+".join(e.kind.cause for e in effects) or "none",
        causes=[e.kind.cause for e in effects],
        parameters={
            e.kind.cause: {p: float(_settings(e)[s]) for p, s in e.kind.parameters.items()}
            for e in effects
        },
        d_prime=[e.d_prime for e in effects],
        sizes=[e.sign * e.size for e in effects],
        asked=asked,
        reached=all(e.d_prime > 0.98 * asked for e in effects if e.kind.most is not None),
        form="curved" if plant["stack"]["curvature"] else "straight",
        protocol=protocol,
        noise=noise,
        plant=whole,
        left_nm=judge.left_nm(noisy, changes),
        oracle={
            "findings": [
                {"cause": cause, "p": p, "alternatives": alternatives[cause]}
                for cause, p in found if not cause.startswith("stranger:")
            ],
            "unexplained": any(cause.startswith("stranger:") for cause, _ in found),
        },
    )  # fmt: skip
    return Case(truth, text, rehearsal)


def _settings(effect: _Effect) -> Settings:
    """The innermost table of an effect."""
    table = effect.table
    for name in effect.kind.table.split("."):
        table = table[name]
    return table


def _sized(bench: _Bench, kind: Kind, asked: float, rng: np.random.Generator) -> _Effect:
    """An effect as visible as was asked for, within what is plausible."""
    more = kind.drawn(rng, bench.reach)
    sign = float(rng.choice([-1.0, 1.0])) if kind.signed else 1.0

    def visible(size: float) -> float:
        return bench.judge.d_prime(bench.change([kind.plant(sign * size, more)]))

    size = kind.start
    if kind.most is not None:
        size = max(size_for(asked, visible, kind.start, kind.most)[0], kind.least)
    change = bench.change([kind.plant(sign * size, more)])
    return _Effect(kind, more, sign, size, bench.judge.d_prime(change), change)


def _share(bench: _Bench, effects: Sequence[_Effect], which: int) -> list[FloatArray]:
    """What one of the effects changes, the others being there."""
    others = [e.table for i, e in enumerate(effects) if i != which]
    if not others:
        return effects[which].change
    whole = bench.change([e.table for e in effects])
    return [a - b for a, b in zip(whole, bench.change(others), strict=True)]


def _rivals(
    bench: _Bench, hidden: Sequence[Kind], rng: np.random.Generator
) -> dict[str, list[FloatArray]]:
    """What the other causes of the catalogue would look like, where they would show at all."""
    out = {}
    for kind in CAUSES:
        if kind.lumpy or kind in hidden:
            continue
        change = bench.change([kind.plant(kind.start, kind.drawn(rng, bench.reach))])
        if any(np.ptp(row) > 1e-7 for row in change):
            out[kind.cause] = change
    return out
