"""The catalogue of causes: one file each, found by file.

Adding a cause is adding one file with one subclass of `Stage` in it. A named
model is a list of causes on the Maxwell kernel.
"""

from piezo_rig.causes.catalogue import CAUSES, NAMED_MODELS, STAGES, load_model, named_model

__all__ = ["CAUSES", "NAMED_MODELS", "STAGES", "load_model", "named_model"]
