"""Work that misbehaves, for processes of their own."""

from __future__ import annotations

import os
import signal
import threading

from piezo_rig.fleet import Item, Outcome


def odd(item: Item) -> Outcome:
    if item.name == "exits":
        os._exit(9)
    if item.name == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if item.name == "hangs":
        threading.Event().wait()
    return Outcome(item.name, {"rms_nm": 1.0})


def half(item: Item, place) -> dict[str, object]:
    """The analysis of a text file that holds a number."""
    from pathlib import Path

    print("assumed: it is a number")
    value = float(Path(item.files[0]).read_text()) / 2
    (place / f"{item.name}.json").write_text(str(value))
    return {"rms_nm": value, "max_percent": 1.0, "origin": "IMPORTED"}
