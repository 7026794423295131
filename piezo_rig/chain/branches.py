"""The two curves of an actuator and the law of its first spring, ready for the kernel.

The initiation curve is followed beyond the largest past drive, the later
branch from every turning point on. On a later branch an element gives way
after twice its break-away displacement. The first element's spring may follow
a law; its break-away displacement stays (thesis eq. 8 and 10), so the drive at
which it gives way moves, and all others with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.elements import Elements
from piezo_rig.chain.half_loops import HalfLoops, half_loops
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
Law = Callable[[FloatArray, HalfLoops], FloatArray]
"""First slopes (m,) V/um before the law, and the half loops -> first slopes (m,) after it."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Piecewise linear: ``compliance_um_per_v`` (n,) on the pieces between ``knots_v`` (n-1,)."""

    knots_v: FloatArray
    compliance_um_per_v: FloatArray

    @classmethod
    def of(cls, elements: Elements) -> Curve:
        """The first rise of a set of elements; past the last break point its slope goes on."""
        return cls(elements.knots_v[:-1], 1.0 / elements.slopes)


@dataclass(frozen=True, eq=False)
class Walk:
    """A drive cut into segments; columns as `kernels` says."""

    ints: NDArray[np.int64]
    floats: FloatArray


@dataclass(frozen=True, eq=False)
class Branches:
    """What the kernel needs to know of an actuator.

    Attributes
    ----------
    initiation : the first rise, over |drive - first drive|
    first_slope_v_per_um : first slope of a later branch before any law
    first_break_um : displacement after a turning point at which the first element gives way
    rest : the later branch after that, over the volts since
    laws : applied to the first slope in this order
    """

    initiation: Curve
    first_slope_v_per_um: float
    first_break_um: float
    rest: Curve
    laws: tuple[Law, ...] = field(default=())

    @classmethod
    def of(cls, later: Elements, initiation: Elements | None = None) -> Branches:
        """Branches of constant elements, with an own set for the first rise if given."""
        slopes = later.slopes
        steps = 2.0 * np.diff(later.slides_at_um)
        return cls(
            initiation=Curve.of(initiation if initiation is not None else later),
            first_slope_v_per_um=float(slopes[0]),
            first_break_um=2.0 * float(later.slides_at_um[0]) if len(later) > 1 else np.inf,
            rest=Curve(np.cumsum(slopes[1:] * steps)[:-1], 1.0 / slopes[1:]),
        )

    def first_slopes(self, loops: HalfLoops) -> FloatArray:
        """First slope of the branches of every half loop, V/um, shape (m,)."""
        slopes = np.full(len(loops), self.first_slope_v_per_um)
        for law in self.laws:
            slopes = law(slopes, loops)
        bad = ~(slopes > 0)
        if np.any(bad):
            i = int(np.argmax(bad))
            raise InputError(
                "slope-not-positive",
                f"the first slope of half loop {i + 1} (sample {loops.start[i]}) is "
                f"{slopes[i]:.4g} V/um: it begins at {loops.extremum_v[i]:.4g} V after a change "
                f"of {loops.range_v[i]:.4g} V",
                "the law of the first spring does not hold for this drive",
                "use the model inside the range that it was identified on",
            )
        return slopes

    def walk(self, drive_v: FloatArray, loops: HalfLoops | None = None) -> Walk:
        """Cut a drive (n,) into segments; the memory is virgin at its first sample."""
        from piezo_rig.chain import kernels

        if self.laws:
            loops = half_loops(drive_v) if loops is None else loops
            start, slopes = loops.start, self.first_slopes(loops)
        else:
            start, slopes = np.zeros(1, np.int64), np.array([self.first_slope_v_per_um])
        ints, floats = kernels.walk(
            drive_v,
            float(drive_v[0]),
            self.initiation.knots_v,
            self.first_break_um,
            self.rest.knots_v,
            start,
            slopes,
        )
        return Walk(ints, floats)

    def displacement(self, drive_v: FloatArray, walked: Walk | None = None) -> FloatArray:
        """Displacement of a drive (n,), um, 0 at the first sample."""
        from piezo_rig.chain import kernels

        walked = self.walk(drive_v) if walked is None else walked
        # numpy asks for large pages, the compiled code would not
        out = np.empty(drive_v.size)
        kernels.fill(
            drive_v,
            walked.ints,
            walked.floats,
            self.initiation.compliance_um_per_v.size,
            self.initiation.compliance_um_per_v,
            self.rest.compliance_um_per_v,
            out,
        )
        return out
