"""What was flagged while the run played, beside what its samples show.

The samples come first: where they show the fault that a flag names, the flag is added to that
line. A flag that nothing else tells is a line of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from piezo_rig.run_file.guarded import one_line
from piezo_rig.run_file.verify.verdict import Verdict

_SENSOR = ("sensor_v ", "the displacement ", "the stack would move ", "differs from its repeats ")
_SHOWN_BY = {
    "beam-interruption": _SENSOR,
    "sensor-clipping": _SENSOR,
    "sensor-sensitivity": _SENSOR,
    "drive-clipping": ("the drive monitor ",),
}
"""How the lines begin that tell the same from the samples, by code of the flag."""
_PLATEAU = ("sensor_v stays ", "sensor_v stands ", "differs from its repeats ")
"""How the lines begin that a sensor at its stop explains."""


def with_flags(
    found: list[Verdict], events: Iterable[dict[str, Any]], names: Iterable[str]
) -> list[Verdict]:
    """What was ``found`` in the samples, and the flags in the run's log of the sweeps ``names``.

    A flag that leaves its sweep usable (a plateau of the sensor) names a cause that diagnosis
    knows, and so does drive-clipping: such a sweep is for `diagnose` alone.
    """
    found, known = list(found), set(names)
    told: set[tuple[str, str]] = set()
    for event in events:
        code, sweep = one_line(str(event.get("code"))), str(event.get("sweep"))
        if event["event"] != "flag" or sweep not in known or (sweep, code) in told:
            continue
        told.add((sweep, code))
        plateau = code == "sensor-clipping" and event.get("usable") is True
        same = [
            i for i, v in enumerate(found)
            if v.sweep == sweep and v.fault and v.text.startswith(_SHOWN_BY.get(code, ()))
        ]
        for i in same:
            if plateau and found[i].text.startswith(_PLATEAU):
                found[i] = replace(found[i], cause=code)
        if same:
            text = f"{found[same[0]].text} (flagged when it was played: {code})"
            found[same[0]] = replace(found[same[0]], text=text)
            continue
        found.append(Verdict(
            sweep, True, f"flagged when it was played: {code}: "
            f"{one_line(str(event.get('what', '')))}",
            code if plateau or code == "drive-clipping" else "",
        ))
    return found
