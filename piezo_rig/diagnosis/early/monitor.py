"""What the drive monitor says of the amplifier: read from it, before anything is inferred.

The monitor is fitted as ``a + g D(drive(t - delay))`` in its own noise, quantised and coloured as
that may be: ``D`` does nothing, or is one or several of the amplifier's laws. Offset and gain are
free, for nobody knows the monitor's divider; the delay is free, for a digitizer that starts late
makes monitor and sensor late alike. See docs/decisions/0023.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from piezo_rig.causes import CAUSES
from piezo_rig.causes.drive_clipping import NEVER_V
from piezo_rig.chain import Parameter, Stage
from piezo_rig.chain.stage import Signal
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.early.behind_a_lag import lines, stairs
from piezo_rig.diagnosis.early.corners import At, Corners, corners_of
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
LAG, SLEW, CLIP, SKEW = "amplifier-lag", "slew-limit", "drive-clipping", "time-skew"
TWICE = 2.0  # a rise and the next one share a digitizer's errors: every sample counts half
PLAIN = 40.0  # rise of the misfit without a law that is there to be seen
TURNS, SETTLED = 12, 0.1  # of refining all laws at most, and the gain that ends them
SAME = 1e-3  # of a grid's point, by which another one is no other
NOTHING = 4.0  # the same of one that is not looked at closer
INSIDE, OUTSIDE = 3.84, 15.0  # rise of the misfit: of a 95 % interval; certainly not so
LEAST = 1e-302  # chance that is told from none
FOLLOWS = 0.03  # rms misfit, of the span, above which it is no monitor of this drive
DIVIDER = 0.02  # gain's distance from 1 that is worth a word
CLOCKS, APART, CLOSE = 12, 0.2, 1e-3  # turns; samples by the end that are none, and at last
SLOWEST = 1e-3  # of the fastest change, that a limit leaves
LATE = 8  # samples, to which a delay is looked for
GRIDS: dict[str, FloatArray] = {
    LAG: np.geomspace(0.02, 100.0, 14),  # samples
    SLEW: np.array([  # below the fastest change, of that; a small one cuts off peaks alone
        0.0003, 0.001, 0.003, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.55, 0.7,
    ]),
    "upper": np.geomspace(0.0005, 0.4, 9),  # of the span, cut off
    "lower": np.geomspace(0.0005, 0.4, 9),
}
SMALLER: dict[str, FloatArray] = {  # from what hardly does anything on
    LAG: np.geomspace(5e-4, 100.0, 24),
    SLEW: np.geomspace(1e-5, 0.7, 16),
    "upper": np.geomspace(1e-5, 0.4, 16),
    "lower": np.geomspace(1e-5, 0.4, 16),
}
OF = {LAG: LAG, SLEW: SLEW, "upper": CLIP, "lower": CLIP}


@dataclass(frozen=True, eq=False)
class Told:
    """One cause that the monitor shows; ``stage`` has its interval, the chance is family-wise."""

    stage: Stage
    p_value: float


@dataclass(frozen=True, eq=False)
class Reading:
    """What the monitor says.

    Attributes
    ----------
    told : in the order in which they were found; a delay of the whole record is last
    bounds : cause that it does not show -> the smallest examples that would have shown
    settled : the delay among them, or that there is none, is the displacement's word
    left_v : rms of the monitor that nothing explains
    between : whether the drive plainly goes on between samples otherwise than straight
    """

    told: tuple[Told, ...] = ()
    bounds: dict[str, tuple[Stage, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    settled: bool = False
    left_v: float = np.inf
    between: bool = False


@dataclass(frozen=True)
class _Guess:
    """Parameter of every law that is in (in the units of `GRIDS`), the delay, and the misfit."""

    laws: dict[str, float]
    held: bool
    delay_s: float
    misfit: float


def read_monitor(
    groups: Groups, sweeps: Sequence[Sweep], level: float, count: int
) -> Reading | None:
    """What the drive monitor says; None where there is none.

    Parameters
    ----------
    level : family-wise chance of a false alarm
    count : causes that are tried in all, for the correction
    """
    corners = corners_of(groups, sweeps)
    if corners is None:
        return None
    swing = max(float(np.ptp(w.monitor_v)) for w in corners.drives)
    if swing < FOLLOWS * corners.span_v:
        return Reading(warnings=("the drive monitor stands still while the drive moves: it is not "
                                 "connected, or wrong; it is not used",))  # fmt: skip
    found = _Reader(corners).read(level, count)
    own = _Reader(replace(corners))
    own.at_one_clock(own.guess({}))
    if own.corners.runs_off:
        other = own.read(level, count)
        if _gained(found, other, corners) > PLAIN:
            return other
    if all(w.dense is None for w in corners.drives):
        finer = corners_of(groups, sweeps, between=True)
        assert finer is not None
        if any(w.dense is not None for w in finer.drives):
            other = _Reader(finer).read(level, count)
            if _gained(found, other, finer) > PLAIN:
                return replace(other, between=True)
    return found


def _gained(found: Reading, other: Reading, corners: Corners) -> float:
    """By how much another reading is likelier, log-likelihood."""
    samples = sum(b - a for w in corners.drives for a, b in w.windows)
    return float(samples * np.log(found.left_v / other.left_v) / TWICE)


@dataclass(eq=False)
class _Reader:
    corners: Corners

    def __post_init__(self) -> None:
        c = self.corners
        self.low = min(float(w.drive_v.min()) for w in c.drives)
        self.fastest = max(
            float(np.max(np.abs(np.diff(w.drive_v)))) / c.step_s for w in c.drives
        )  # fmt: skip

    def stage(self, law: str, x: float) -> Stage:
        """The stage of a law at a point of its grid."""
        kind, c = CAUSES[OF[law]], self.corners
        if law == LAG:
            return kind.of(None, tau=x * c.step_s)
        if law == SLEW:
            return kind.of(None, limit=max(1.0 - x, SLOWEST) * self.fastest)
        if law == "upper":
            return kind.of(None, lower=-NEVER_V, upper=self.low + (1.0 - x) * c.span_v)
        return kind.of(None, lower=self.low + x * c.span_v, upper=NEVER_V)

    def at(self, laws: dict[str, float], held: bool) -> list[At]:
        """Every drive behind the laws, at any instant, in samples."""
        out: list[At] = []
        for w in self.corners.drives:
            time, v = (w.time_s, w.drive_v) if held else w.played
            for law in ("upper", "lower", SLEW):
                if law in laws:
                    signal = Signal(time, v, np.zeros(v.size))
                    v = self.stage(law, laws[law]).act(signal).drive_v
            tau, places = laws.get(LAG, 0.0), None
            if w.dense is not None:
                places = (time - w.time_s[0]) / self.corners.step_s
            out.append(stairs(v, tau) if held else lines(v, tau, places))
        return out

    def guess(self, laws: dict[str, float], held: bool = False, near_s: float = 0.0) -> _Guess:
        """The delay that fits best with these laws."""
        at, step, c = self.at(laws, held), self.corners.step_s, self.corners
        straight = not held and LAG not in laws
        known: dict[float, tuple[float, FloatArray]] = {}

        def bare(samples: float) -> FloatArray:
            return c.bare(c.seen(at, samples * step))

        def look(samples: float) -> None:
            if samples not in known:
                x = bare(samples)
                known[samples] = c.fits(x)[0], x

        best = float(np.round(near_s / step)) if straight else near_s / step
        while abs(best) <= 40 * LATE:  # downhill in whole samples
            for x in (best - 1.0, best, best + 1.0):
                look(x)
            lowest = min(known, key=lambda x: known[x][0])
            if lowest == best:
                break
            best = lowest
        found = [(known[best][0], best)] if best in known else []
        for a in {float(np.floor(best)), float(np.ceil(best)) - 1.0}:
            if straight:  # between whole samples the drive moves in proportion to the delay
                look(a)
                look(a + 1.0)
                misfit, share = c.between(known[a][1], known[a + 1.0][1])
                found.append((misfit, a + share))
                continue
            r = optimize.minimize_scalar(
                lambda x: c.fits(bare(x))[0], bounds=(a, a + 1.0), method="bounded",
                options={"xatol": 1e-4},
            )  # fmt: skip
            found.append((float(r.fun), float(r.x)))
        value, x = min(found)
        return _Guess(laws, held, x * step, value)

    def best(self, here: _Guess, law: str, held: bool) -> _Guess:
        """The best of one more law."""
        step, laws, near_s = self.corners.step_s, here.laws, here.delay_s
        tried: dict[float, float] = {}
        for x in GRIDS[law]:
            own = laws | {law: float(x)}
            lag = (own[law] if law == LAG else 0.0) + 0.5 * held
            at = self.at(own, held)
            for late in {near_s, near_s - lag * step}:
                m = self.corners.explained(self.corners.seen(at, late))[0]
                tried[x] = min(tried.get(x, np.inf), m)
        order = sorted(tried, key=lambda x: tried[x])[:2]
        early = {x: ((x if law == LAG else 0.0) + 0.5 * held) * step for x in order}
        guesses = [self.guess(laws | {law: float(x)}, held, near_s - early[x]) for x in order]
        start = min(guesses, key=lambda g: g.misfit)
        plain = (here.misfit - start.misfit) / TWICE > NOTHING
        return self.refined(start, law) if plain else start

    def refined(self, start: _Guess, law: str) -> _Guess:
        """The misfit's valley over one law's parameter, from near its bottom.

        It is narrow beside a plain where a law does nothing, as a limit above every speed.
        """
        known = {np.log(start.laws[law]): start}

        def misfit(x: float) -> float:
            g = self.guess(start.laws | {law: float(np.exp(x))}, start.held, start.delay_s)
            known[x] = g
            return g.misfit

        optimize.minimize_scalar(
            misfit, bounds=tuple(np.log(_neighbours(GRIDS[law], start.laws[law]))),
            method="bounded", options={"xatol": 1e-4, "maxiter": 20},
        )  # fmt: skip
        best = min(known.values(), key=lambda g: g.misfit)
        return best

    def settled(self, here: _Guess) -> _Guess:
        """All laws refined in turn: those before the latest had made up for it, the gain too."""
        for _ in range(TURNS if len(here.laws) > 1 else 0):
            before = here.misfit
            for law in here.laws:
                here = self.refined(here, law)
            if before - here.misfit < TWICE * SETTLED:
                break
        return here

    def hear(self, g: _Guess) -> list[FloatArray]:
        """Weigh by what a guess leaves; returns that."""
        seen = self.corners.seen(self.at(g.laws, g.held), g.delay_s)
        left = self.corners.left(seen)
        self.corners.hear(left)
        return left

    def again(self, g: _Guess) -> _Guess:
        return self.guess(g.laws, g.held, g.delay_s)

    def tries(self, here: _Guess) -> list[_Guess]:
        """Every law that is not yet in, put in at its best."""
        out = []
        for law in GRIDS:
            if law in here.laws:
                continue
            out.append(self.best(here, law, here.held))
            if law == LAG and not here.laws:  # a generator holds each sample until the next
                held = self.best(here, LAG, True)
                if held.misfit < out[-1].misfit - TWICE * PLAIN:
                    out[-1] = held
        return out

    def at_one_clock(self, here: _Guess, least: float = APART) -> _Guess:
        """With the command read by the digitizer's clock, where the two run apart by so many
        samples by the end that corners are not where the command has them.
        """
        for _ in range(CLOCKS):
            at = self.at(here.laws, here.held)
            off = self.corners.further_off(self.corners.seen(at, here.delay_s))
            if abs(off) * self.corners.longest < least:
                break
            self.corners.runs_off += off
            here, least = self.again(here), CLOSE
        return here

    def rather_a_clock(self, here: _Guess, there: _Guess) -> _Guess | None:
        """With clocks that run apart by less than anybody would see in a single corner, where the
        monitor plainly says so and no other law says more.
        """
        before = self.corners.runs_off
        if before:
            return None
        found = self.at_one_clock(here, CLOSE)
        off, self.corners.runs_off = self.corners.runs_off, before
        if off == before or found.misfit >= there.misfit:
            return None
        self.corners.runs_off = off
        self.hear(found)
        found = self.again(found)
        self.corners.runs_off = before
        if (self.again(here).misfit - found.misfit) / TWICE <= PLAIN:
            return None
        self.corners.runs_off = off
        return found

    def read(self, level: float, count: int) -> Reading:
        here = self.guess({})
        self.hear(here)
        here = self.again(here)
        chances: dict[str, float] = {}
        while len(here.laws) < len(GRIDS):
            self.corners.hear(None)  # what a law leaves before it is in is no noise
            here = self.again(here)
            there = min(self.tries(here), key=lambda g: g.misfit)
            clocked = self.rather_a_clock(here, there)
            if clocked is not None:
                here = self.settled(clocked)
                continue
            self.hear(there)
            here, there = self.again(here), self.again(there)
            gained = (here.misfit - there.misfit) / TWICE
            chance = max(float(chi2_above(gained, 2)), LEAST) * count * len(GRIDS)
            if not (chance < level and gained > PLAIN):
                self.hear(here)
                here = self.again(here)
                break
            (law,) = set(there.laws) - set(here.laws)
            chances[law] = chance
            here = self.settled(self.refined(there, law))
            if self.corners.runs_off:  # as it seemed to without the law
                here = self.settled(self.at_one_clock(here, CLOSE))
        left = np.concatenate(self.hear(here))
        here = self.again(here)
        seen = self.corners.seen(self.at(here.laws, here.held), here.delay_s)
        gain = self.corners.explained(seen)[1]
        if float(np.std(left)) > FOLLOWS * self.corners.span_v or not 0.001 < gain < 1000.0:
            return Reading(warnings=(
                f"the drive monitor does not follow the drive (it is off by {np.std(left):.3g} V "
                "rms at best): another signal, or not connected; it is not used",
            ))  # fmt: skip
        told = self.told(here, chances, gain, level, count)
        return replace(told, left_v=max(float(np.std(left)), self.corners.least_v))

    def told(
        self, here: _Guess, chances: dict[str, float], gain: float, level: float, count: int
    ) -> Reading:
        notes = []
        if self.corners.runs_off:
            fast = -1e6 * self.corners.runs_off / (1.0 + self.corners.runs_off)
            notes.append(
                f"the drive monitor runs apart from the command by {fast:.3g} ppm: generator and "
                "digitizer have clocks of their own"
            )
        if abs(gain - 1.0) > DIVIDER:
            notes.append(
                f"the drive monitor reads {gain:.4g} times the drive: the amplifier's gain or the "
                "monitor's divider is not what was said"
            )
        stages = {law: self.with_interval(here, law) for law in here.laws}
        told = [Told(s, chances[law]) for law, s in stages.items()]
        if {"upper", "lower"} <= set(stages):  # one stage has both
            a, b = stages["lower"], stages["upper"]
            both = type(a)({"lower": a.parameters["lower"], "upper": b.parameters["upper"]})
            told = [t for t in told if t.stage.id != CLIP]
            told.append(Told(both, min(chances["upper"], chances["lower"])))
        late, alone = self.lateness(here), self.lag_alone(here)
        zero = self.corners.explained(self.corners.seen(self.at(here.laws, False), 0.0))[0]
        gained = (min(zero, alone) - here.misfit) / TWICE
        if gained > PLAIN:
            why = (
                "the whole record is late by that, the generator holds its samples, or the "
                "monitor's own channel is late" if late > 0.0
                else "its channel and the command's are not read at one time"
            )
            notes.append(f"{_comes(late)}: {why}")
            chance = max(float(chi2_above(gained, 1)), LEAST) * count
            half = self.delay_half_s(here)
            delay = Parameter(late, "s", (late - half, late + half))
            told.append(Told(CAUSES[SKEW]({"delay": delay}), chance))
        elif (zero - here.misfit) / TWICE > PLAIN and LAG not in here.laws:
            notes.append(
                f"{_comes(late)}; at this sampling rate it "
                "does not say whether the amplifier lags or the whole record is late"
            )
        return Reading(tuple(told), self.bounds(here), tuple(notes))

    def lateness(self, here: _Guess) -> float:
        """Seconds by which everything is late beyond the laws, the generator's holding included."""
        if not here.held:
            return here.delay_s
        step, tau = self.corners.step_s, here.laws[LAG]
        since = 1.0 - (here.delay_s / step) % 1.0  # a sample's hold has lasted so long
        behind = since + np.exp(-since / tau) / -np.expm1(-1.0 / tau)  # on a ramp, in samples
        return float(here.delay_s + step * (behind - tau))

    def delay_half_s(self, here: _Guess) -> float:
        """Half width of the delay's 95 % interval, at most twice too wide."""
        at, step = self.at(here.laws, here.held), self.corners.step_s

        def risen(late: float) -> float:
            misfit = self.corners.explained(self.corners.seen(at, here.delay_s + late))[0]
            return (misfit - here.misfit) / TWICE

        half = 1e-5 * step
        while half < step and min(risen(-half), risen(half)) < INSIDE:
            half *= 2.0
        return half

    def lag_alone(self, here: _Guess) -> float:
        """The least misfit of a lag, with the other laws, that would do without any delay."""
        tau = here.delay_s / self.corners.step_s + here.laws.get(LAG, 0.0)
        tried = [
            self.corners.explained(self.corners.seen(self.at(here.laws | {LAG: x}, False), 0.0))[0]
            for x in tau * np.linspace(0.7, 1.3, 31) if x > 0.0
        ]  # fmt: skip
        return min(tried, default=np.inf)

    def bounds(self, here: _Guess) -> dict[str, tuple[Stage, ...]]:
        """For every cause that is not shown the least that would have been, of each form."""
        shown = {OF[law] for law in here.laws}
        out: dict[str, tuple[Stage, ...]] = {}
        for cause in dict.fromkeys(OF.values()):
            found = [self.bound(here, law) for law in GRIDS if OF[law] == cause]
            known = tuple(s for s in found if s is not None)
            if cause not in shown and len(known) == len(found):
                out[cause] = known
        return out

    def with_interval(self, here: _Guess, law: str) -> Stage:
        """The stage with the interval of its parameter: where the misfit has risen."""
        best = self.again(here)
        stage = self.stage(law, best.laws[law])
        name = {LAG: "tau", SLEW: "limit"}.get(law, law)
        ends = [self.stage(law, self.edge(best, law, way, INSIDE))[name] for way in (-1.0, 1.0)]
        p = stage.parameters[name]
        own = Parameter(p.value, p.unit, (min(ends), max(ends)))
        return type(stage)(stage.parameters | {name: own})

    def edge(self, best: _Guess, law: str, way: float, rise: float) -> float:
        """How far a law's parameter may go one way until the misfit has risen."""
        x, share = best.laws[law], 1e-4

        def risen(share: float) -> float:
            laws = best.laws | {law: x * (1.0 + way * share)}
            return (self.guess(laws, best.held, best.delay_s).misfit - best.misfit) / TWICE

        while share < 0.5 and risen(share) < rise:
            share *= 2.0
        low, high = (0.0 if share == 1e-4 else share / 2.0), share
        for _ in range(4):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if risen(middle) > rise else (middle, high)
        return float(x * (1.0 + way * high))

    def bound(self, here: _Guess, law: str) -> Stage | None:
        """The smallest example of a law that would show, found from the smallest on."""
        for x in SMALLER[law]:
            laws = here.laws | {law: float(x)}
            near_s = here.delay_s - (x * self.corners.step_s if law == LAG else 0.0)
            seen = self.corners.seen(self.at(laws, here.held), near_s)
            if (self.corners.explained(seen)[0] - here.misfit) / TWICE <= OUTSIDE:
                continue  # nor at the delay that fits it best
            g = self.guess(laws, here.held, near_s)
            if (g.misfit - here.misfit) / TWICE > OUTSIDE:
                return self.stage(law, float(x))
        return None


def _neighbours(grid: FloatArray, x: float) -> tuple[float, float]:
    """The points of a grid to either side; beyond its ends, one more by the same factor."""
    ends = [grid[0] ** 2 / grid[1], *grid, grid[-1] ** 2 / grid[-2]]
    below = [g for g in ends if g < x * (1.0 - SAME)] or [x * grid[0] / grid[1]]
    above = [g for g in ends if g > x * (1.0 + SAME)] or [x * grid[-1] / grid[-2]]
    return float(max(below)), float(min(above))


def _comes(late_s: float) -> str:
    way = "after" if late_s > 0.0 else "before"
    return f"the drive monitor comes {1e3 * abs(late_s):.4g} ms {way} the command"
