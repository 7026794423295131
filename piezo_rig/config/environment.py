"""The air of the measuring beam, as far as somebody logged it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from piezo_rig.config.toml_text import Table

_UNSTATED = float("nan")


@dataclass(frozen=True)
class Environment:
    """Air and dead path; NaN where nothing was logged.

    Attributes
    ----------
    temperature_c, pressure_hpa, humidity_percent : of the air
    temperature_u_k, pressure_u_hpa : standard uncertainty of their change within a sweep
    dead_path_mm : by how much the measuring beam is longer than the reference beam at rest
    """

    temperature_c: float = _UNSTATED
    temperature_u_k: float = _UNSTATED
    pressure_hpa: float = _UNSTATED
    pressure_u_hpa: float = _UNSTATED
    humidity_percent: float = _UNSTATED
    dead_path_mm: float = _UNSTATED

    @property
    def has_dead_path(self) -> bool:
        return not math.isnan(self.dead_path_mm)


def environment_of(table: Table) -> Environment:
    """The table ``[environment]`` of a rig's config; ``InputError`` names line and key."""
    found = Environment(
        temperature_c=table.number("temperature_c", _UNSTATED, low=-40.0, high=100.0),
        temperature_u_k=table.number("temperature_u_k", _UNSTATED, low=0.0, high=100.0),
        pressure_hpa=table.number("pressure_hpa", _UNSTATED, low=100.0, high=1400.0),
        pressure_u_hpa=table.number("pressure_u_hpa", _UNSTATED, low=0.0, high=1000.0),
        humidity_percent=table.number("humidity_percent", _UNSTATED, low=0.0, high=100.0),
        dead_path_mm=table.number("dead_path_mm", _UNSTATED, low=0.0, high=1e5),
    )
    table.finish()
    return found
