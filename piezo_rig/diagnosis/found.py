"""What a diagnosis says, as data."""

from __future__ import annotations

from dataclasses import dataclass, field

from piezo_rig.causes.input_bend import InputBend
from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.chain import Model, Parameter
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.events import Event
from piezo_rig.diagnosis.follow_up import FollowUp
from piezo_rig.diagnosis.isolability import Workings
from piezo_rig.diagnosis.unexplained import Unexplained

EVENTS = ("outliers", "fringe-jump", "dropped-samples")  # nothing foretells them: no gain
REFITTED = "refitted"  # the rung from which on a given model follows the data
RIPPLE = "ripple"  # the rung from which on one is set aside
NO_FINDINGS = {
    **dict.fromkeys((Bend.id, InputBend.id, OutputBend.id), "part of the base model"),
    REFITTED: "follows the data from here on",
    RIPPLE: "an error with a period of its own, set aside",
}


@dataclass(frozen=True, eq=False)
class Finding:
    """One accepted cause; fields as in the diagnosis JSON."""

    cause: str
    place: str
    p_value: float
    gain_percent: float | None
    gain_ci95: list[float] | None
    parameters: dict[str, Parameter]
    alternatives: list[str]
    d_prime: float | None = None
    events: tuple[Event, ...] = ()  # one by one, where the cause is events


@dataclass(frozen=True, eq=False)
class Rung:
    """One step of the ladder: what was added, and the errors with it, held out."""

    added: str
    rms_nm: float
    max_percent: float
    finding: int | None = None  # which finding it is; none for the baseline and `NO_FINDINGS`


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a diagnosis says."""

    sweeps: int
    samples: int
    repeats: int
    held_out: str
    recordings: list[tuple[str, float]]
    baseline: str
    rungs: list[Rung]
    noise_floor_nm: float | None
    findings: list[Finding]
    unexplained: Unexplained
    follow_up: FollowUp | None
    model: Model
    rung_models: list[Model]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    workings: Workings | None = None  # for a report
    assumed: list[str] = field(default_factory=list)  # of recordings, as they were read
    tried_in_vain: bool = False  # much, on what is left
    at_home_nm: float | None = None  # error of a given model where it was identified, if less

    def rung_of(self, finding: int) -> int:
        """Which rung a finding is, by its place among them; 0 for none."""
        return next((i for i, r in enumerate(self.rungs) if r.finding == finding), 0)


def said_all(found: Diagnosis, baseline: str) -> str:
    """What says all there is where nothing was found: a baseline, and what was added to its base.

    ``baseline`` : what it is called
    """
    bends = NO_FINDINGS.keys() - {REFITTED, RIPPLE}
    bent = any(r.added in bends for r in found.rungs[1:])
    return f"{baseline}, with a memoryless bend," if bent else baseline
