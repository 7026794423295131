"""Studies: what the program is measured against, written into ``docs`` by ``make study``."""
