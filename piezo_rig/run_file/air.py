"""Refractive index of air for the interferometer's red light, by the modified Edlen equation.

Source: K. P. Birch and M. J. Downs, Metrologia 30 (1993) 155 and 31 (1994) 315, with the humidity
term of J. A. Stone and J. H. Zimmerman, NIST Engineering Metrology Toolbox, appendix A; saturation
pressure over water after IAPWS-IF97, region 4. Good to some 1e-8 between 15 and 25 degrees.
"""

from __future__ import annotations

import math

HENE_UM = 0.6328
"""Wavelength of a helium-neon laser in air, um."""


def refractive_index(
    temperature_c: float = 20.0, pressure_hpa: float = 1013.25, humidity_percent: float = 50.0,
    wavelength_um: float = HENE_UM,
) -> float:
    """n of air with 450 ppm of carbon dioxide.

    Parameters
    ----------
    temperature_c, pressure_hpa, humidity_percent : of the air
    wavelength_um : in vacuum (in air is near enough)
    """
    t, p = temperature_c, 100.0 * pressure_hpa
    s = 1.0 / wavelength_um**2
    standard = 1e-8 * (8342.54 + 2_406_147.0 / (130.0 - s) + 15_998.0 / (38.9 - s))
    density = 1.0 + 1e-8 * (0.601 - 0.00972 * t) * p
    dry = p * standard * density / (96_095.43 * (1.0 + 0.0036610 * t))
    vapour = humidity_percent / 100.0 * saturation_pa(t)
    return 1.0 + dry - 1e-10 * 292.75 / (t + 273.15) * (3.7345 - 0.0401 * s) * vapour


def saturation_pa(temperature_c: float) -> float:
    """Pressure of water vapour over water, Pa; over ice below 0 degrees it is a little less."""
    kelvin = temperature_c + 273.15
    w = kelvin - 0.23855557567849 / (kelvin - 650.17534844798)
    a = w**2 + 1167.0521452767 * w - 724213.16703206
    b = -17.073846940092 * w**2 + 12020.82470247 * w - 3232555.0322333
    c = 14.91510861353 * w**2 - 4823.2657361591 * w + 405113.40542057
    root = (2.0 * c / (-b + math.sqrt(b**2 - 4.0 * a * c))) ** 4
    return 1e6 * root


def per_kelvin(temperature_c: float, pressure_hpa: float, humidity_percent: float) -> float:
    """dn/dT at constant pressure and relative humidity, 1/K."""
    step = 0.05
    return (refractive_index(temperature_c + step, pressure_hpa, humidity_percent)
            - refractive_index(temperature_c - step, pressure_hpa, humidity_percent)) / (2 * step)


def per_hpa(temperature_c: float, pressure_hpa: float, humidity_percent: float) -> float:
    """dn/dp, 1/hPa."""
    step = 0.5
    return (refractive_index(temperature_c, pressure_hpa + step, humidity_percent)
            - refractive_index(temperature_c, pressure_hpa - step, humidity_percent)) / (2 * step)
