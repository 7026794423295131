"""Recordings that this program never made, .lvm, .tdms and .csv, read into sweeps.

So are the .csv, .tdms and .mat that it exported; ``said`` knows what those state of themselves.

``read_recordings`` is the way in. Readers (``lvm``, ``tdms``, ``csv_text``) know a
format each and nothing else; ``channels`` decides which column is what, ``timing``
when samples were taken, ``damage`` what looks broken, ``assemble`` the rest. No file
makes this package raise anything but ``InputError``, and nothing in a file is run.
"""

from piezo_rig.run_file.importers.assemble import read_recordings
from piezo_rig.run_file.importers.file_name import NameSays, distinct_names, parse_name
from piezo_rig.run_file.importers.options import (
    DISPLACEMENT,
    DRIVE,
    SWITCH_UM_PER_V,
    Imported,
    ImportOptions,
    parse_sensitivity,
)

__all__ = [
    "DISPLACEMENT",
    "DRIVE",
    "SWITCH_UM_PER_V",
    "ImportOptions",
    "Imported",
    "NameSays",
    "distinct_names",
    "parse_name",
    "parse_sensitivity",
    "read_recordings",
]
