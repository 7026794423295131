"""A model for other programs: a step function in C, or its tables for MATLAB and spreadsheets."""

from piezo_rig.model_export.c_source import CSource, c_source

__all__ = ["CSource", "c_source"]
