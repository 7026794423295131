"""Slow actuators that share no code with the program: what the kernel is tested against.

`Sliders` is the Maxwell model as it stands in the textbooks: springs and Coulomb
sliders, moved in displacement until their forces carry the drive. `Branching`
follows branches point by point, with the laws of the thesis written out.
"""

from __future__ import annotations

from itertools import pairwise


class Sliders:
    """Parallel elasto-slide elements; the last one never slides.

    k: spring constants V/um; x: displacement at which each slides, um.
    """

    def __init__(self, k, x):
        self.k = list(k)
        self.limit = [*list(x)[:-1], float("inf")]
        self.at = [0.0] * len(self.k)  # where each slider stands
        self.x = 0.0
        self.force = 0.0

    def play(self, drive):
        """Displacement of every sample; the force at the first one is taken as zero."""
        out = []
        for v in drive:
            self._carry(v - drive[0])
            out.append(self.x)
        return out

    def _carry(self, target):
        while self.force != target:
            sign = 1.0 if target > self.force else -1.0
            room, holding, stiffness = float("inf"), [], 0.0
            for i, k in enumerate(self.k):
                # how much further this one can stretch before it slides
                left = self.limit[i] - sign * (self.x - self.at[i])
                if left > 1e-13:
                    holding.append(i)
                    stiffness += k
                    room = min(room, left)
            step = min(room, abs(target - self.force) / stiffness)
            arrives = step * stiffness >= abs(target - self.force) * (1 - 1e-15)
            self.x += sign * step
            self.force = target if arrives else self.force + sign * step * stiffness
            for i in range(len(self.k)):
                if i not in holding:
                    self.at[i] = self.x - sign * self.limit[i]


class Branching:
    """First rise and later branches from tables; the first spring follows a law.

    dx: step of displacement; k_first: springs of the first rise; k_later: springs of later
    branches, the first of them replaced by law(input range, extremum, direction).
    """

    def __init__(self, dx, k_first, k_later, law):
        self.dx, self.k_first, self.k_later, self.law = dx, list(k_first), list(k_later), law

    def _curve(self, springs, step, drive):
        """Displacement of a curve at a drive, element after element."""
        x, v = 0.0, 0.0
        for i in range(len(springs)):
            slope = sum(springs[i:])
            if i == len(springs) - 1 or v + slope * step >= drive:
                return x + (drive - v) / slope
            x, v = x + step, v + slope * step
        return x

    def first(self, drive):
        return self._curve(self.k_first, self.dx, drive)

    def later(self, k1, drive):
        return self._curve([k1, *self.k_later[1:]], 2 * self.dx, drive)

    def play(self, turns, points):
        """Displacement at `points` samples on every stretch between turning points.

        Only turning points are remembered; every stretch is one straight ride.
        """
        origin = turns[0]
        memory = []  # (drive, k1) of the turning points still remembered
        y, out = 0.0, [0.0]
        change = None
        for a, b in pairwise(turns):
            sign = 1.0 if b > a else -1.0
            if change is not None:
                memory.append((a, self.law(change, a, sign)))
            change = abs(b - a)
            grid = [a + (b - a) * j / points for j in range(1, points + 1)]
            grid[-1] = b
            here = a
            for v in grid:
                while True:
                    if not memory:
                        y += sign * (self.first(abs(v - origin)) - self.first(abs(here - origin)))
                        break
                    turn, k1 = memory[-1]
                    end = memory[-2][0] if len(memory) > 1 else 2 * origin - turn
                    stop = min(v, end) if sign > 0 else max(v, end)
                    y += sign * (
                        self.later(k1, abs(stop - turn)) - self.later(k1, abs(here - turn))
                    )
                    here = stop
                    if stop != end:
                        break
                    del memory[-2:]
                    if stop == v:
                        break
                here = v
                out.append(y)
        return out
