"""Plays a Plan on a Bench into a run.

    play     from the first volt to the closed run
    safe     the way out: rest first, then the file
    stop     what signals do
    headers  what a run says about itself
    resume   what a broken run still lacks, and whether this bench may go on with it
    wire     bytes on their way into the run
"""

from piezo_rig.runner.play import new_run_path, play
from piezo_rig.runner.wire import Wire

__all__ = ["Wire", "new_run_path", "play"]
