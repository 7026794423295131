"""Protocol files and the plan that is made of them."""

from piezo_rig.protocol.build import build_plan
from piezo_rig.protocol.plan import Plan, PlannedSweep, Wave
from piezo_rig.protocol.protocol_file import Condition, Protocol, load_protocol

__all__ = [
    "Condition", "Plan", "PlannedSweep", "Protocol", "Wave", "build_plan", "load_protocol",
]
