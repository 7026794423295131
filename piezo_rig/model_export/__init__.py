"""A model for other programs: a step function in C, or its tables for MATLAB and spreadsheets."""

from piezo_rig.model_export.c_source import CSource, c_source
from piezo_rig.model_export.c_text import identifier
from piezo_rig.model_export.tables import write_csv_tables, write_mat_tables

__all__ = ["CSource", "c_source", "identifier", "write_csv_tables", "write_mat_tables"]
