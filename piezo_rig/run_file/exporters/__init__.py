"""A run for other programs: .csv and .tdms, one file for each sweep, or one .mat.

Volts are the truth and what is written, with the settings that make drive and displacement of
them; `piezo_rig.run_file.importers` reads them back as the same sweeps. What was
played again is left out.
"""

from piezo_rig.run_file.exporters.export import FORMATS, Exported, export_run

__all__ = ["FORMATS", "Exported", "export_run"]
