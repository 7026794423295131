"""The run: one HDF5 file that holds everything that was measured."""

from piezo_rig.run_file.sweep import Sweep

__all__ = ["Sweep"]
