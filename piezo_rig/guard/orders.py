"""What the guard is told when it is started, and what it says when it had to act."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

BEAT_S = 0.2
"""Time between two signs of life."""
GIVE_UP_S = 600.0
"""How long the guard tries to reach a generator that does not answer."""


@dataclass(frozen=True)
class Orders:
    """Where the generator is and how the stack is brought to rest.

    Attributes
    ----------
    address, timeout_s : of the generator
    clock : ``real``, or the address of a simulated bench's clock
    rest_command_v : V; the command at which the stack sees 0 V
    slew_v_per_s : of the command
    gain, offset_v : drive = gain * command + offset_v
    report : file that the guard's report goes to; empty for none
    driver : of the generator, as the rig's config names it
    silence_s : a runner that shows no sign of life for this long is taken to hang
    """

    address: str
    timeout_s: float
    clock: str
    rest_command_v: float
    slew_v_per_s: float
    gain: float
    offset_v: float
    report: str = ""
    driver: str = "keysight_33500b"
    silence_s: float = 5.0

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Orders:
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Report:
    """What the guard did.

    Attributes
    ----------
    reason : why it took over
    step : what the runner was doing
    at_rest : the generator's settings, read back, say 0 V on the stack
    from_v, to_v : V on the stack, where at rest
    duration_s : how long that took, s
    failure : why the stack is not known to be at rest
    wall_time : ISO 8601, UTC
    """

    reason: str
    step: str
    at_rest: bool
    from_v: float = 0.0
    to_v: float = 0.0
    duration_s: float = 0.0
    failure: str = ""
    wall_time: str = ""

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Report:
        return cls(**json.loads(text))

    def sentence(self) -> str:
        """For the terminal and for error messages."""
        begun = f"{self.reason} ({self.step}): "
        if self.at_rest:
            return begun + (
                f"the guard found the stack at {self.from_v:.2f} V and brought it to "
                f"{self.to_v:.2f} V in {self.duration_s:.2f} s, read back"
            )
        return begun + (
            f"the guard could not bring the stack to rest: {self.failure}; "
            "switch the amplifier off by hand"
        )
