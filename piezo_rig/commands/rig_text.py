"""Rewrites a simulated rig's config so that it points to instruments that are served elsewhere."""

from __future__ import annotations

import re

_HEADER = re.compile(r"^\s*\[+\s*([^\]\s]+)\s*\]+")
_DROPPED = re.compile(r"^\s*(simulated|clock|address)\s*=")


def served_rig(text: str, addresses: dict[str, str], clock: str) -> str:
    """The config with addresses in, and plant and faults out.

    Parameters
    ----------
    text : of the simulated rig's config
    addresses : by instrument, and the bench's ``clock``
    clock : ``real`` or ``virtual``; a virtual one is reached at its address
    """
    lines = []
    table = ""
    for line in text.splitlines():
        header = _HEADER.match(line)
        if header:
            table = header.group(1)
        if table.split(".")[0] in ("plant", "faults"):
            continue
        if table in (*addresses, "bench") and not header and _DROPPED.match(line):
            continue
        lines.append(line)
        if header and table in addresses and table != "clock":
            lines.append(f'address = "{addresses[table]}"')
        if header and table == "bench":
            where = addresses["clock"] if clock == "virtual" else "real"
            lines += ["simulated = false", f'clock = "{where}"']
    return "\n".join(lines).rstrip() + "\n"
