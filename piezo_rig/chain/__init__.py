"""The signal chain: stages, their composition, and one Maxwell kernel."""

from piezo_rig.chain.branches import Branches, Curve
from piezo_rig.chain.elements import Elements
from piezo_rig.chain.half_loops import HalfLoops, dead_band, half_loops
from piezo_rig.chain.maxwell import Maxwell
from piezo_rig.chain.memo import Memo
from piezo_rig.chain.model import Model
from piezo_rig.chain.model_file import read_model, save_model
from piezo_rig.chain.stage import Parameter, Reads, Signal, Stage

__all__ = [
    "Branches",
    "Curve",
    "Elements",
    "HalfLoops",
    "Maxwell",
    "Memo",
    "Model",
    "Parameter",
    "Reads",
    "Signal",
    "Stage",
    "dead_band",
    "half_loops",
    "read_model",
    "save_model",
]
