"""Effects that no catalogue lists, to see whether a diagnosis admits that it has no name.

The equations are in ``strangers_kernel.py``. All are off by default.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.simulated.plant.effects import setting, switch


@dataclass(frozen=True)
class StictionBump:
    """A guide that sticks near one displacement: motion lags there, in either direction."""

    on: bool = switch(False)
    size: float = setting(0.03, "um", "lag at the worst place")
    place: float = setting(4.0, "um", "displacement of the worst place")
    width: float = setting(0.6, "um", "how far it is felt (Gaussian sigma)", low=1e-3)


@dataclass(frozen=True)
class PeriodTwo:
    """Every second cycle opens wider: a subharmonic of the drive."""

    on: bool = switch(False)
    size: float = setting(0.03, "um", "largest difference between even and odd cycles")


@dataclass(frozen=True)
class CurvatureChange:
    """After one large excursion the strain curve is bent, without memory, until recovery."""

    on: bool = switch(False)
    size: float = setting(0.05, "um", "bend half way up")
    beyond: float = setting(40.0, "V", "excursion that bends it")


@dataclass(frozen=True)
class Backlash:
    """A gap in the mount: the mirror follows the stack through a friction play."""

    on: bool = switch(False)
    gap: float = setting(0.03, "um", "full width of the gap", low=0.0)


@dataclass(frozen=True)
class SelfHeating:
    """Dissipation warms the stack, and it expands; first order in time."""

    on: bool = switch(False)
    size: float = setting(0.05, "um", "expansion after long driving at 300 V/s")
    tau: float = setting(8.0, "s", "thermal time constant", low=1e-3)


@dataclass(frozen=True)
class Strangers:
    """All of them, by name."""

    stiction_bump: StictionBump = field(default_factory=StictionBump)
    period_two: PeriodTwo = field(default_factory=PeriodTwo)
    curvature_change: CurvatureChange = field(default_factory=CurvatureChange)
    backlash: Backlash = field(default_factory=Backlash)
    self_heating: SelfHeating = field(default_factory=SelfHeating)
