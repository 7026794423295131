"""What is wrong with measured points, before and after a line is drawn through them.

An error stops the calibration (exit 2); a warning is a sentence that is printed and kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_rig.calibrate.line import Line, bend, fit_line, student, worst_point
from piezo_rig.calibrate.points import COLUMNS, Points
from piezo_rig.errors import InputError

FEWEST = 3
SIGNIFICANT = 0.01
BENT = 0.01
"""Of the span of y: beyond it a bend is an error."""
SLIGHTLY_BENT = 2e-4
"""Of the span of y: beyond it a bend that is significant is worth a warning."""
LOOSE = 0.02
"""95 % uncertainty of the slope, relative, that is worth a warning."""
ALIKE = 0.1
"""Within this a slope is what was expected."""
MOST = 10_000
"""Points; more than anybody reads off a voltmeter."""


@dataclass(frozen=True)
class Expected:
    """What an instrument should show: um/V at positions 0..6, or V/V and V."""

    slopes: tuple[float, ...]
    switch: int | None = None
    offset_v: float = 0.0


def fitted(points: Points, common: float = 0.0) -> tuple[Line, list[str]]:
    """The line through the points, and what there is to say against it.

    Parameters
    ----------
    common : relative standard uncertainty of the reference's scale

    Raises
    ------
    InputError : too few points, no span, no slope, an outlier, a bend
    """
    _check_span(points)
    line = fit_line(points.x, points.y, points.u, common)
    _check_scatter(points)
    scatter_u = math.sqrt(max(0.0, line.slope_u**2 - (common * line.slope) ** 2))
    if abs(line.slope) <= student(0.99, line.dof) * scatter_u:
        x, y = points.names
        raise _wrong(
            "slope", points, f"{y} does not follow {x}: the slope is {line.slope:.4g} with a "
            f"standard uncertainty of {scatter_u:.2g}",
            "the points scatter more than they change, or lie too close together",
            "measure over the whole range, and wait for the reading to settle",
        )
    return line, _warnings(points, line)


def _check_span(points: Points) -> None:
    n, (x, y) = points.x.size, points.names
    if n < FEWEST:
        raise _wrong(
            "few", points, f"{n} point{'s' * (n != 1)} of {x} and {y}; a line with its uncertainty "
            f"needs at least {FEWEST}", "too few points", "measure five or more over the range",
        )
    if n > MOST:
        raise _wrong("many", points, f"{n} points", "this is a recording, not a table of points",
                     "import it with 'piezo-rig import', or give averages of stretches at rest")
    largest = float(np.abs(points.x).max())
    if np.ptp(points.x) <= 1e-6 * max(largest, 1e-6):
        raise _wrong("span", points, f"all points lie at {x} = {points.x[0]:g} V",
                     "only one level was measured", "measure over the whole range")


def _check_scatter(points: Points) -> None:
    """One point or a bend: whichever explains more of the scatter."""
    span = float(np.ptp(points.y))
    point = worst_point(points.x, points.y, points.u)
    bent = bend(points.x, points.y, points.u)
    significant = bent is not None and bent.p_value < SIGNIFICANT and bent.size > BENT * span
    if point is not None and point.p_value < SIGNIFICANT and abs(point.distance) > 1e-4 * span and (
        bent is None or point.rest < bent.rest or bent.p_value >= SIGNIFICANT
    ):
        x, y = points.names
        raise _wrong(
            "outlier", points, f"line {points.lines[point.index]}: {y} = "
            f"{points.y[point.index]:g} {points.unit} at {x} = {points.x[point.index]:g} V is "
            f"{abs(point.distance):.3g} {points.unit} off the line through the other points",
            "a slip of the pen, another range of the meter, or a reading that had not settled",
            "measure that point again, or take its line out",
        )
    if significant and bent is not None:
        raise _wrong(
            "bent", points, f"the points do not lie on a straight line: they bend by "
            f"{bent.size:.3g} {points.unit}, {100 * bent.size / span:.1f} % of the span",
            "the amplifier or the sensor saturates at an end, or the stack's own hysteresis was "
            "measured instead of a reference",
            "leave out the points near the limits, or use a linear reference",
        )


def _warnings(points: Points, line: Line) -> list[str]:
    span, unit = float(np.ptp(points.y)), points.unit
    found = []
    if points.u is None and line.residual < 1e-7 * span:
        found.append("the points scatter less than any meter reads: what the reference itself is "
                     f"uncertain by is not in it; state {COLUMNS[points.instrument][2]} or "
                     "--reference-percent")
    relative = line.coverage * line.slope_u / abs(line.slope)
    if relative > LOOSE:
        found.append(f"the slope is known to {100 * relative:.1f} % only (95 %): "
                     "take more points, over a wider range")
    if line.dof < 3 and points.u is None:
        found.append(f"{points.x.size} points: the uncertainty itself is uncertain, "
                     f"95 % is {line.coverage:.1f} standard uncertainties")
    if np.unique(points.x).size < 3:
        found.append("two levels only: nothing says that the line is straight")
    bent = bend(points.x, points.y, points.u)
    if bent is not None and bent.p_value < SIGNIFICANT and bent.size > SLIGHTLY_BENT * span:
        found.append(f"a bend of {bent.size:.2g} {unit} is left in the points; "
                     "it is counted as scatter")
    if line.birge > 1.0 and _is_too_large(line):
        found.append(f"the points scatter {line.birge:.1f} times as much as their stated "
                     "uncertainties allow; the result's are enlarged by that")
    return found


def _is_too_large(line: Line) -> bool:
    from scipy.special import chdtrc

    return float(chdtrc(line.dof, line.birge**2 * line.dof)) < SIGNIFICANT


def check_amplifier(points: Points, line: Line, expected: Expected) -> list[str]:
    """Signs and units of an amplifier's points against what is expected.

    Raises
    ------
    InputError : the leads are exchanged, or a unit or the columns are
    """
    (gain,) = expected.slopes
    if line.slope < 0:
        raise _wrong("sign", points, f"the drive falls as the command rises ({line.slope:.4g} V/V)",
                     "the voltmeter's leads are exchanged", "turn the sign of drive_v")
    slips = {
        "command_v is in mV": gain / 1e3, "drive_v is in mV": gain * 1e3,
        "the columns are exchanged": 1.0 / gain,
    }
    _check_slips(points, line.slope, gain, slips, f"{line.slope:.4g} V/V")
    warnings = []
    if abs(line.slope / gain - 1.0) > ALIKE:
        warnings.append(f"the gain is {line.slope:.4g} V/V; {gain:g} V/V was expected")
    if abs(line.intercept - expected.offset_v) > 5.0:
        warnings.append(f"the offset is {line.intercept:.4g} V; {expected.offset_v:g} V was "
                        "expected: look at the amplifier's set voltage")
    return warnings


def check_interferometer(
    points: Points, line: Line, expected: Expected
) -> tuple[int, list[str]]:
    """The switch that the points are for, and what is odd about them.

    Raises
    ------
    InputError : another switch, another unit, or exchanged columns
    """
    found, table = abs(line.slope), expected.slopes
    away = [abs(math.log(found / s)) for s in table]
    nearest = int(np.argmin(away))
    said = f"{found:.4g} um/V"
    if expected.switch is None:
        if away[nearest] > math.log(2.0):
            raise _wrong(
                "units", points, f"{said} is no sensitivity of this instrument "
                f"({table[0]:g} to {table[-1]:g} um/V)",
                "sensor_v is in mV, displacement_um in nm, or the columns are exchanged",
                "convert to volts and micrometres; if the value is right, name its switch "
                "with --sensitivity",
            )
        note = f"taken to be at switch {nearest} ({table[nearest]:g} um/V)"
        if abs(found / table[nearest] - 1.0) > 0.05:
            note += f", though {said} was measured: name the switch with --sensitivity"
        return nearest, [note]
    switch = expected.switch
    slips = {
        "sensor_v is in mV": table[switch] / 1e3, "displacement_um is in nm": table[switch] * 1e3,
        "the columns are exchanged": 1.0 / table[switch],
    } | {f"the switch stood at {k}": s for k, s in enumerate(table) if k != switch}
    _check_slips(points, found, table[switch], slips, said)
    if abs(found / table[switch] - 1.0) > ALIKE:
        return switch, [f"the sensitivity is {said}; {table[switch]:g} um/V was expected at "
                        f"switch {switch}"]
    return switch, []


def _check_slips(
    points: Points, found: float, expected: float, slips: dict[str, float], said: str
) -> None:
    """Refuse a slope that one slip explains; the nearest slip is named."""
    if abs(found / expected - 1.0) <= ALIKE:
        return
    cause = min(slips, key=lambda slip: abs(math.log(found / slips[slip])))
    if abs(found / slips[cause] - 1.0) <= ALIKE:
        raise _wrong(
            "units", points, f"{said} where about {expected:.4g} is expected", cause,
            "mend the file, or the option that names the switch; if the value is right, say what "
            "is expected with --update FILE",
        )


def _wrong(code: str, points: Points, what: str, cause: str, remedy: str) -> InputError:
    return InputError(f"calibration-{code}", f"{points.path}: {what}", cause, remedy)


def words(line: Line, names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Slope and intercept as a certificate states them."""
    rows = ((names[0], line.slope, line.slope_u, units[0]),
            (names[1], line.intercept, line.intercept_u, units[1]))
    return [
        f"{name:<12} {abs(value) if name == 'sensitivity' else value:.6g} {unit}, standard "
        f"uncertainty {u:.2g}; 95 %: +-{line.coverage * u:.2g}"
        for name, value, u, unit in rows if name
    ]
