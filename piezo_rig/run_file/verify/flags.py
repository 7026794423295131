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
_DIAGNOSED = ("drive-clipping",)


def with_flags(
    found: list[Verdict], events: Iterable[dict[str, Any]], names: Iterable[str]
) -> list[Verdict]:
    """What was ``found`` in the samples, and the flags in the run's log of the sweeps ``names``."""
    found, known = list(found), set(names)
    told: set[tuple[str, str]] = set()
    for event in events:
        code, sweep = str(event.get("code")), str(event.get("sweep"))
        if event["event"] != "flag" or sweep not in known or (sweep, code) in told:
            continue
        told.add((sweep, code))
        code = one_line(code)
        same = next((
            i for i, v in enumerate(found)
            if v.sweep == sweep and v.fault and v.text.startswith(_SHOWN_BY.get(code, ()))
        ), None)
        if same is not None:
            text = f"{found[same].text} (flagged when it was played: {code})"
            found[same] = replace(found[same], text=text)
            continue
        good = event.get("usable") is True
        found.append(Verdict(
            sweep, not good, f"flagged when it was played: {code}: "
            f"{one_line(str(event.get('what', '')))}" + ("; it may be used" if good else ""),
            code if code in _DIAGNOSED and not good else "",
        ))
    return found
