"""A first spring that keeps its force, against springs and sliders that are solved one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.chain.held_force import Springs, held_v
from tests.more import first_of

FloatArray = NDArray[np.float64]
STEPS = 300  # samples of a half loop
FAR_UM = 1e3
TURNS_V = [0.0, 60.0, 10.0, 75.0, 0.0, 30.0, 20.0, 75.0, 5.0, 50.0, 40.0, 45.0, 0.0]
K, SLIDES, LAST = np.array([0.5, 0.3, 0.4, 0.2]), np.array([0.2, 0.9, 2.1, 4.0]), 6.0


def drive_of(turns_v: Sequence[float]) -> FloatArray:
    pieces = [np.linspace(a, b, STEPS + 1)[1:] for a, b in pairwise(turns_v)]
    return np.concatenate([[turns_v[0]], *pieces])


@dataclass
class Solved:
    """The table's elements, one more that follows a law, and less a plain one like it: where all
    forces are in balance, sample after sample, by a search for the root.
    """

    stiffness: Callable[[int], float]
    plain: float
    reach_um: float
    at_force: bool
    from_rest: bool
    x: float = 0.0
    own: float = 0.0
    less: float = 0.0
    forces: FloatArray = field(default_factory=lambda: np.zeros(K.size))

    def along(self, turns_v: Sequence[float]) -> FloatArray:
        drive = drive_of(turns_v)
        moved = np.zeros(drive.size)
        for i in range(1, drive.size):
            loop = (i - 1) // STEPS
            k = self.stiffness(loop) if loop or self.from_rest else self.plain
            way = float(np.sign(drive[i] - drive[i - 1]))
            step = float(brentq(self._off, -1.0, 1.0, (k, way, drive[i]), xtol=1e-13))
            self.forces, self.own, self.less = self._after(step, k, way)
            self.x += step
            moved[i] = self.x
        return moved

    def _after(self, step: float, k: float, way: float) -> tuple[FloatArray, float, float]:
        half = 0.5 * self.reach_um
        most = (self.plain if self.at_force else k) * half
        table = np.clip(self.forces + K * step, -K * SLIDES, K * SLIDES)
        own, less = self.own, way * min(way * (self.less + self.plain * step), self.plain * half)
        if own * way < most:
            own = way * min(way * (own + k * step), most)
        return table, own, less

    def _off(self, step: float, k: float, way: float, drive_v: float) -> float:
        table, own, less = self._after(step, k, way)
        return float(table.sum() + LAST * (self.x + step) + own - less - drive_v)


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x * x)))


def model_of(id: str, **values: float) -> Model:
    table = Elements(np.append(K, LAST), np.append(SLIDES, FAR_UM))
    law = CAUSES[id].of(None, **{"closing": 0.0, "taper": 0.0, "carries": 1.0} | values)
    return Model((Maxwell.of(table),)).with_stage(law)


def simulated(turns_v: Sequence[float], id: str, **values: float) -> FloatArray:
    drive = drive_of(turns_v)
    return model_of(id, **values).simulate(np.arange(drive.size) / 5000.0, drive)


def history(id: str, turns_v: Sequence[float]) -> Callable[[int], float]:
    """Volts that a law follows on half loop after half loop."""
    if id == "extremum-dependence":
        return lambda loop: turns_v[loop]
    return lambda loop: abs(turns_v[loop] - turns_v[loop - 1]) if loop else 0.0


@pytest.mark.parametrize(("slope", "offset", "plain", "reach_um"), first_of(2, [
    (0.003, 0.3, 0.45, 0.5), (0.008, 0.02, 0.3, 0.4), (-0.004, 0.5, 0.4, 0.6),
]))
@pytest.mark.parametrize(("id", "at_force", "from_rest"), first_of(3, [
    ("range-dependence", False, False), ("extremum-dependence", False, True),
    ("extremum-dependence", True, False), ("range-dependence", True, True),
    ("range-dependence", True, False), ("extremum-dependence", True, True),
    ("range-dependence", False, True), ("extremum-dependence", False, False),
]))
def test_it_is_where_all_forces_balance(
    id: str, at_force: bool, from_rest: bool, slope: float, offset: float, plain: float,
    reach_um: float,
) -> None:  # fmt: skip
    follows = history(id, TURNS_V)
    wanted = Solved(
        lambda loop: max(slope * follows(loop) + offset, 1e-3 * plain), plain, reach_um, at_force,
        from_rest,
    ).along(TURNS_V)  # fmt: skip
    without = Solved(lambda loop: plain, plain, reach_um, False, True).along(TURNS_V)
    found = simulated(
        TURNS_V, id, slope=slope, offset=offset, reach=reach_um, spring=plain,
        at_force=float(at_force), from_rest=float(from_rest),
    )  # fmt: skip
    assert rms(found - wanted) < 0.02 * rms(wanted - without)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(0.0, 75.0), min_size=2, max_size=8),
    st.floats(0.1, 1.0), st.floats(0.1, 1.0),
)  # fmt: skip
def test_a_law_that_changes_nothing_does_nothing(
    turns_v: list[float], spring: float, reach_um: float
) -> None:
    """A spring that stays as stiff as the one in whose place it stands is that one."""
    turns = [0.0, *turns_v]
    table = Elements(np.append(K, LAST), np.append(SLIDES, FAR_UM))
    drive = drive_of(turns)
    bare = Model((Maxwell.of(table),)).simulate(np.arange(drive.size) / 5000.0, drive)
    found = simulated(turns, "extremum-dependence", slope=0.0, offset=spring, reach=reach_um,
                      spring=spring, at_force=0.0, from_rest=1.0)  # fmt: skip
    np.testing.assert_allclose(found, bare, atol=1e-9)


def test_how_far_it_is_hangs_on_the_stiffness_before() -> None:
    """From a spring of 0.2 V/um to one of 0.6 it is (0.2 + 0.6) dx / 0.6, and on the way back
    (0.6 + 0.2) dx / 0.2; in between the force is where it was.
    """
    half_um, fine = 0.5, 20000
    x = np.concatenate([np.linspace(a, b, fine + 1)[1:] for a, b in pairwise([0.0, 5.0, 0.0, 5.0])])
    k = np.array([0.2, 0.6, 0.2])
    springs = Springs(fine * np.arange(3), k, k * half_um, 1e-9, 1e-9)
    held = held_v(springs, np.zeros(1, np.int64), 1e6 * x, x)  # springs that do not give
    for loop, far_um in ((0, 0.5), (1, 0.8 * half_um / 0.6), (2, 0.8 * half_um / 0.2)):
        part = held[loop * fine : (loop + 1) * fine]
        moved = np.abs(x[loop * fine : (loop + 1) * fine] - [0.0, 5.0, 0.0][loop])
        end = (-1.0) ** loop * k[loop] * half_um
        begin = [0.0, 0.1, -0.3][loop]
        wanted = np.interp(moved, [0.0, far_um], [begin, end])
        np.testing.assert_allclose(part, wanted, atol=1e-3)


def test_several_drives_at_once_know_nothing_of_each_other() -> None:
    from piezo_rig.chain.drives import Drives

    model = model_of("range-dependence", slope=0.004, offset=0.2, reach=0.5, spring=0.4,
                     at_force=0.0, from_rest=0.0)  # fmt: skip
    drives = [drive_of(TURNS_V), drive_of([0.0, 40.0, 10.0, 30.0])]
    times = [np.arange(d.size) / 5000.0 for d in drives]
    both = Drives.of([(t, d, "virgin") for t, d in zip(times, drives, strict=True)])
    wanted = [model.simulate(t, d) for t, d in zip(times, drives, strict=True)]
    np.testing.assert_allclose(model.simulate_each(both), np.concatenate(wanted), atol=1e-12)
