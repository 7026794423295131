"""Elasto-slide elements, and the curve that they draw.

An element is a spring k (V/um) and a Coulomb slider that gives way at
f = k x, x being the displacement at which it does (thesis eq. 1-3, 13). The
slope of the curve after the first i-1 elements have given way is the sum of
the springs that still hold, s_i = k_i + ... + k_n (eq. 12). A spring constant
may be negative; a slope may not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
ROW_KEYS = {"k_v_per_um", "slides_at_um", "f_v"}


@dataclass(frozen=True, eq=False)
class Elements:
    """A table of elements in the order in which they give way.

    Attributes
    ----------
    k_v_per_um : shape (n,), spring constants
    slides_at_um : shape (n,), increasing: displacement at which each gives way on a first rise
    """

    k_v_per_um: FloatArray
    slides_at_um: FloatArray

    def __len__(self) -> int:
        return int(self.k_v_per_um.size)

    @property
    def slopes(self) -> FloatArray:
        """s_i, V/um, summed from the far end, shape (n,)."""
        return np.cumsum(self.k_v_per_um[::-1])[::-1]

    @property
    def breakaway_v(self) -> FloatArray:
        """f_i, volts, shape (n,)."""
        return self.k_v_per_um * self.slides_at_um

    @property
    def knots_v(self) -> FloatArray:
        """Drive at which each element gives way on a first rise, shape (n,)."""
        return np.cumsum(self.slopes * np.diff(self.slides_at_um, prepend=0.0))

    @classmethod
    def from_slopes(cls, slopes: FloatArray, slides_at_um: FloatArray) -> Elements:
        """Springs from slopes (eq. 12 solved for k)."""
        slopes = np.asarray(slopes, dtype=float)
        return cls(-np.diff(slopes, append=0.0), np.asarray(slides_at_um, dtype=float))

    @classmethod
    def from_curve(cls, knots_v: FloatArray, compliance_um_per_v: FloatArray) -> Elements:
        """Elements of a piecewise linear first rise.

        Parameters
        ----------
        knots_v : shape (n,), the drive at the end of every piece
        compliance_um_per_v : shape (n,), um per volt on every piece, positive
        """
        compliance = np.asarray(compliance_um_per_v, dtype=float)
        slides = np.cumsum(compliance * np.diff(np.asarray(knots_v, dtype=float), prepend=0.0))
        return cls.from_slopes(1.0 / compliance, slides)

    def with_spring(self, k_v_per_um: float, slides_at_um: float) -> Elements:
        """One element more; one that gives way at the same place takes the spring in."""
        same = np.isclose(self.slides_at_um, slides_at_um, rtol=1e-9, atol=0.0)
        if np.any(same):
            return Elements(self.k_v_per_um + np.where(same, k_v_per_um, 0.0), self.slides_at_um)
        at = int(np.searchsorted(self.slides_at_um, slides_at_um))
        return Elements(
            np.insert(self.k_v_per_um, at, k_v_per_um),
            np.insert(self.slides_at_um, at, slides_at_um),
        )

    def check(self, where: str, law: bool = False) -> None:
        """Refuse slopes that are not positive, and elements out of order.

        Parameters
        ----------
        where : the stage, for the message
        law : the first spring comes from a law, so that the first slope is checked elsewhere
        """
        slopes = self.slopes
        for i in range(1 if law and len(self) > 1 else 0, len(self)):
            if not slopes[i] > 0 or not np.isfinite(slopes[i]):
                raise InputError(
                    "slope-not-positive",
                    f"{where}: the slope from element {i + 1} on is {slopes[i]:.4g} V/um",
                    "the springs that still hold there add up to zero or less: "
                    "the actuator would move without drive",
                    "fit with fewer elements, or correct the table",
                )
        steps = np.diff(self.slides_at_um, prepend=0.0)
        if not np.all(steps > 0) or not np.all(np.isfinite(steps)):
            worst = int(np.argmax(~(steps > 0)))
            raise InputError(
                "elements-out-of-order",
                f"{where}: element {worst + 1} does not give way after the one before it",
                "break-away displacements must rise from element to element",
                "sort or correct the table",
            )

    def to_rows(self) -> list[dict[str, float]]:
        """The table as plain data for a model file."""
        return [
            {"k_v_per_um": float(k), "slides_at_um": float(x), "f_v": float(k * x)}
            for k, x in zip(self.k_v_per_um, self.slides_at_um, strict=True)
        ]

    @classmethod
    def from_rows(cls, rows: Any, where: str) -> Elements:
        """The table read back; ``f_v`` may stand instead of ``slides_at_um`` (x = f/k)."""

        def broken(what: str) -> InputError:
            return InputError(
                "model-elements",
                f"{where}: {what}",
                "the element table is not one that this program wrote",
                "every element needs k_v_per_um and slides_at_um (or f_v), as numbers",
            )

        if not isinstance(rows, list) or not rows:
            raise broken("no element table")
        springs, slides = [], []
        for i, row in enumerate(rows, start=1):
            if not isinstance(row, dict) or not set(row) <= ROW_KEYS:
                raise broken(f"element {i} is not a table of {', '.join(sorted(ROW_KEYS))}")
            if not all(isinstance(x, int | float) and abs(x) < 1e300 for x in row.values()):
                raise broken(f"element {i} holds something that is not a number")
            k, x, f = row.get("k_v_per_um"), row.get("slides_at_um"), row.get("f_v")
            if k is None or (x is None and (f is None or k == 0)):
                raise broken(f"element {i} lacks k_v_per_um or slides_at_um")
            if x is None:
                x = f / k
            elif f is not None and abs(f - k * x) > 1e-6 * max(abs(f), abs(k * x)):
                raise broken(f"element {i}: f_v is {f:g}, but k_v_per_um x slides_at_um {k * x:g}")
            springs.append(float(k))
            slides.append(float(x))
        return cls(np.array(springs), np.array(slides))
