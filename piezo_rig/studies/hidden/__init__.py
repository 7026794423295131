"""An independent bench: recordings with a hidden effect, to measure a diagnosis by.

`draw` is the way in. Nothing here is shared with the models that are fitted to it: ``kernels``
and ``body`` are the actuator, ``protocols`` what is played, ``noise`` what the sensor adds,
``effects`` and ``strangers`` what is hidden, ``oracle`` how visible it is to somebody who knows
it, ``case`` puts them together.
"""

from piezo_rig.studies.hidden.case import KINDS, Case, Truth, Unseen, draw
from piezo_rig.studies.hidden.noise import NOISES
from piezo_rig.studies.hidden.protocols import PROTOCOLS

__all__ = ["KINDS", "NOISES", "PROTOCOLS", "Case", "Truth", "Unseen", "draw"]
