"""What the technician writes about a rig, read and checked."""

from piezo_rig.config.rig import DEFAULT_RIG, Limits, Rig, load_rig

__all__ = ["DEFAULT_RIG", "Limits", "Rig", "load_rig"]
