"""A process that brings the stack to rest when the runner cannot.

It holds the generator's line from before the first volt; the runner's bytes go
through it. When the runner is gone or has been silent for too long, the guard
waits for a burst that plays, ramps to rest, reads back, reports and ends.

    frames   what the two say to each other
    orders   what the guard needs to know, and how it tells what it did
    keeper   the runner's side: starts the guard, shows signs of life, says when it is over
    relay    the runner's side: a line to the generator by way of the guard
    lock     one program at a time holds a generator
    watch    the guard's side: passes bytes on and listens for signs of life
    rest     the guard's side: brings the stack to rest

See docs/decisions/0010.
"""

from piezo_rig.guard.keeper import Keeper, Unguarded
from piezo_rig.guard.orders import Orders

__all__ = ["Keeper", "Orders", "Unguarded"]
