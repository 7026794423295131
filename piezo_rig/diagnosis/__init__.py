"""Diagnosis: what a model gets wrong, which physical cause that has, and what it gains.

`diagnose` is the way in. ``groups`` prepares the data, ``spikes`` and ``hum`` look at single
recordings in clock time, ``noise`` measures the spectrum, ``fit`` and ``refit`` know the model's
tangent, ``dictionary`` what a misfit may look like, ``space`` and ``likelihood`` turn all that
into small matrices and decide, ``climb`` is the forward selection, ``held_out``, ``confusion``,
``unexplained`` and ``follow_up`` say what it is worth; ``given`` and ``since`` are for given models
that lack causes. No cause is known here by its physics.
"""

from piezo_rig.diagnosis.diagnose import diagnose
from piezo_rig.diagnosis.document import document, text
from piezo_rig.diagnosis.found import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "diagnose", "document", "text"]
