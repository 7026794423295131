"""The plant: what really happens between the generator's output and the digitizer's inputs.

From a command to a record, one file each: ``timeline`` (what was played),
``electrical`` (amplifier), ``actuator`` and ``kernel`` (the stack: what it is, how
it moves; ``state`` lays out the memory, ``motion`` drives it), ``strangers``
(effects that nobody expects), ``interferometer`` and ``noise`` (the sensor),
``acquisition`` (the digitizer's clock). ``config`` names every setting.
"""

from drivers.simulated.plant.config import PlantConfig, settings
from drivers.simulated.plant.plant import Plant, Record

__all__ = ["Plant", "PlantConfig", "Record", "settings"]
