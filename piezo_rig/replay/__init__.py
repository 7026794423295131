"""Runs the drivers against a run's wire transcript, without any instrument.

``replay`` is the way in. ``tape`` is the transport: bytes out are compared with those recorded,
bytes in are taken from the record. ``past_bench`` builds again what the run was played with, and
``compare`` plays it and says where the drivers now differ.
"""

from piezo_rig.replay.compare import Outcome, replay

__all__ = ["Outcome", "replay"]
