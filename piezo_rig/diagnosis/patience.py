"""How much is tried before what is left is called unexplained.

Effects of the catalogue, two or three or six at once, are found within some twenty refits of
causes. What no cause explains is tried on all of them, one after the other, in pairs and around
each other, and every one that does a little of it asks for all others anew.
"""

from __future__ import annotations

from dataclasses import dataclass

WAYS_ROUND, AT_ALL = 30, 60  # refits of causes in a climb


@dataclass(eq=False)
class Patience:
    """``tried`` : causes that were refitted by now, in all climbs of a diagnosis; ``before`` :
    those before the latest climb. One that begins anew on better data needs as many as the first.
    """

    tried: int = 0
    before: int = 0

    def begin(self) -> None:
        """A climb begins."""
        self.before = self.tried

    def spend(self, causes: int) -> None:
        self.tried += causes

    @property
    def lost(self) -> bool:
        """Whether nothing is tried any more but what a look at every cause asks for."""
        return self.tried - self.before >= WAYS_ROUND or self.tried >= AT_ALL

    @property
    def at_an_end(self) -> bool:
        """Whether it is time to say what was found."""
        return self.tried - self.before >= AT_ALL

    @property
    def note(self) -> str | None:
        """What is to be said of it."""
        if not self.lost:
            return None
        return (
            f"{self.tried} refits of causes were tried, and something is left that they do not "
            "explain: no further ways round were looked for, and what is named may stand in for it"
        )
