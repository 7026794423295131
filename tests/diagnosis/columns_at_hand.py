"""A `Linear` from columns that a test writes down: one piece, white noise."""

import numpy as np

from piezo_rig.diagnosis.linear import Bands, Fixed, Frame, Layout, Linear


def linear_of(
    columns: np.ndarray, z: np.ndarray, bands: int, own: int, fine: int, generic: int,
    twice: int = 0, powers: int = 0, law: np.ndarray | None = None,
) -> Linear:
    """Columns (c, n) in the order bands, powers, fine, generic, other base columns, trials."""
    m = bands + powers + fine + generic
    gram, left = columns @ columns.T, columns @ z
    first, shared = slice(bands), slice(bands, m)
    base = [*range(bands), *range(m, m + own)]
    frame = Frame(
        (Bands(columns[first], columns[first], gram[first, first], gram[first, first],
               gram[first, shared]),),
        (Fixed(columns[shared], gram[shared, shared], columns[shared].astype(np.float32)),),
        (1,), (powers, fine, generic),
    )  # fmt: skip
    return Linear(
        Layout(bands + own, powers, fine, generic, len(columns) - m - own, twice), frame,
        gram[None, m:, :m], gram[None, m:, m:], np.append(left, z @ z)[None],
        gram[None, m : m + own, :bands], gram[None, m : m + own, m : m + own],
        np.append(left[base], z @ z)[None], np.array([float(z.size)]),
        np.zeros(generic) if law is None else law,
    )  # fmt: skip
