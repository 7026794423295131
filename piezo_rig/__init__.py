"""piezo-rig: measures, models, and says what its model gets wrong and why."""

__version__ = "0.1.0"
