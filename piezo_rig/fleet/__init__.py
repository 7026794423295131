"""Many analyses at once: every input by itself, on this computer or on a cluster.

Knows nothing of what an analysis is. A verb hands over a function that works on one `Item` and
writes files into a folder; here it is called for all of them, in processes that may die, and what
comes back is kept as it comes: the files, a line of the journal, in the end a table and a page.
"""

from piezo_rig.fleet.item import Item, items_of
from piezo_rig.fleet.work import Outcome, Work

__all__ = ["Item", "Outcome", "Work", "items_of"]
