"""The oracle of one case: a generalised least-squares likelihood-ratio test that knows the truth.

It knows the noise's true covariance, the true form of what is hidden and that of every rival, and
the actuator's body up to what 50 play operators and the powers of the drive can take up, as every
model has to be fitted. What it misses, the recordings do not hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from piezo_rig.challenge.rehearsal import Rehearsal
from piezo_rig.scoring.noise import Noise
from piezo_rig.scoring.oracle import Oracle, base_columns

FloatArray = NDArray[np.float64]
Rows = Sequence[FloatArray]
LEVEL = 0.01  # chance of a false alarm, over all that it tries
APART = 4.0  # d' x sqrt(1 - cos^2) below which two causes cannot be told apart


class Judge:
    """The oracle for one protocol in one kind of noise."""

    def __init__(self, rehearsal: Rehearsal, noise: Noise) -> None:
        self.rehearsal = rehearsal
        self.repeats = rehearsal.plan.protocol.repeats
        self.oracle = Oracle.of(rehearsal.drives_v, noise, self.repeats)
        # errors are counted in nm, whatever their colour: what fits them best is plain
        plain = Noise(np.zeros(0), np.zeros(0), 1e-3)
        self.least_squares = Oracle.of(rehearsal.drives_v, plain, self.repeats)

    def d_prime(self, change: Rows) -> float:
        """How visible a change of all recordings is, rows (n,) in um."""
        return self.oracle.d_prime(change)

    def gram(self, changes: Sequence[Rows]) -> FloatArray:
        """Inner products (m, m) of m changes, in units of the noise and off the base."""
        together = [np.column_stack(rows) for rows in zip(*changes, strict=True)]
        return self.oracle.gram(together)

    def findings(
        self, seen: Rows, signatures: Mapping[str, Rows]
    ) -> tuple[list[tuple[str, float]], dict[str, list[str]]]:
        """What the oracle finds, as (cause, chance of a false alarm); and what each is taken for.

        Parameters
        ----------
        seen : recordings less the true body, um
        signatures : cause -> what it changes; of the hidden ones, what they did change

        Returns
        -------
        findings in the order of acceptance; cause -> causes that cannot be told from it
        """
        names = list(signatures)
        full = self.gram([seen, *signatures.values()])
        rest = full.copy()
        found: list[tuple[str, float]] = []
        size = np.maximum(np.diag(full)[1:], 1e-300)
        alternatives: dict[str, list[str]] = {}
        while len(found) < len(names):
            left = np.diag(rest)[1:]
            usable = left > 1e-6 * size
            ratio = np.where(usable, rest[0, 1:] ** 2 / np.where(usable, left, 1.0), 0.0)
            best = int(np.argmax(ratio))
            chance = len(names) * float(chdtrc(1, ratio[best]))  # chi-squared's tail
            if chance >= LEVEL:
                break
            d_prime = abs(rest[0, best + 1]) / np.sqrt(left[best])
            cosine = full[best + 1, 1:] / np.sqrt(full[best + 1, best + 1] * size)
            apart = d_prime * np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
            alternatives[names[best]] = [
                n for n, a in zip(names, apart, strict=True) if a < APART and n != names[best]
            ]
            found.append((names[best], min(chance, 1.0)))
            column = rest[:, best + 1].copy()
            rest = rest - np.outer(column, column) / column[best + 1]
        members = {n for n, _ in found}
        return found, {n: [a for a in alternatives[n] if a not in members] for n, _ in found}

    def left_nm(self, seen: Rows, changes: Mapping[str, Rows]) -> dict[str, float]:
        """Held-out rms errors, nm, with any of the hidden causes taken off the recordings.

        The base is fitted to one repeat by least squares and judged on the other, each in turn;
        every recording has an offset of its own. Keys are causes joined by ``+``, empty for none.
        """
        out = {}
        names = sorted(changes)
        for count in range(len(names) + 1):
            for chosen in combinations(names, count):
                rows = [
                    row - sum((changes[n][i] for n in chosen), np.zeros(row.size))
                    for i, row in enumerate(seen)
                ]
                out["+".join(chosen)] = self._held_out_nm(rows)
        return out

    def _held_out_nm(self, rows: Rows) -> float:
        per = len(self.rehearsal.drives_v)
        bases = [base_columns(v, self.oracle.span_v) for v in self.rehearsal.drives_v]
        square, count = 0.0, 0
        for repeat in range(self.repeats):
            trained = [
                self.least_squares.fitted(rows[per * r : per * (r + 1)])
                for r in range(self.repeats) if r != repeat
            ]  # fmt: skip
            fitted = np.mean(trained, axis=0)
            for base, row in zip(bases, rows[per * repeat : per * (repeat + 1)], strict=True):
                error = row - base @ fitted
                square += float(np.sum((error - error.mean()) ** 2))
                count += error.size
        return 1e3 * float(np.sqrt(square / count))
