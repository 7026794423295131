"""At which sample a break is, once its kind, its size and its neighbourhood are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.mended import JUMP, STEP_UM
from piezo_rig.diagnosis.early.traces import Stretch

FloatArray = NDArray[np.float64]
AROUND_S = 0.06  # half width of the neighbourhood
SURE = 3.0  # log-likelihood by which other samples must be worse
INSTANTS = 600  # that are tried at first
STILL = 0.02  # of the usual speed
BEND = 2  # of the polynomial that the model may be wrong by there


def placed(
    own: FloatArray, predicted: FloatArray, cause: str, near: int, count: int, stretch: Stretch,
    against_model: bool = False,
) -> tuple[int, int, int, float] | None:  # fmt: skip
    """(index, low, high, worth): the likeliest sample, between which it lies, log-likelihood won.

    None where a break of that size does no good anywhere near. Noise is taken for first-order
    with the correlation that is seen there.

    Parameters
    ----------
    own : shape (n,), what the recording has of its own, um
    predicted : shape (n,), um
    count : steps of lambda/8, or samples
    against_model : a model may be wrong by a kink there, and only what is worth more counts
    """
    wide = max(24, round(AROUND_S * stretch.factor * 1000.0))
    begin, end = max(near - wide, stretch.begin), min(near + wide, stretch.end)
    n = end - begin
    if n < 16:
        return None
    if cause == JUMP:
        change = np.full(n, count * STEP_UM)
    else:
        ahead = np.minimum(np.arange(begin, end) + count, stretch.end - 1)
        change = predicted[ahead] - predicted[begin:end]
    values = own[begin:end]
    x = np.linspace(-1.0, 1.0, n)
    base = x[:, None] ** np.arange(BEND + 1)
    if cause != JUMP:  # a lag that was there before
        speed = np.gradient(predicted[begin:end])
        base = np.column_stack([base, speed])
    every = max(n // INSTANTS, 1)
    tried = np.arange(1, n, every)
    off = np.diff(values) - np.median(np.diff(values))
    rho = _correlation(values, base, _begun(change, tried))
    q, _ = np.linalg.qr(_innovations(base, rho))
    y = _innovations(values[:, None], rho)
    y -= q @ (q.T @ y)

    def left_by(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns whitened and beside what is free there, and the square that each leaves."""
        s = _innovations(columns, rho)
        s -= q @ (q.T @ s)
        return s, np.sum((y - s) ** 2, axis=0)

    _, left = left_by(_begun(change, tried))
    if every > 1:  # then every sample about the likeliest
        near_to = tried[int(np.argmin(left))]
        tried = np.arange(max(near_to - 2 * every, 1), min(near_to + 2 * every + 1, n))
        _, left = left_by(_begun(change, tried))
    best = int(np.argmin(left))
    sigma = float(left[best]) / max(n - base.shape[1] - 1, 1)
    least = max(sigma, 1e-18, 1e-6 * float(off.var()))
    worth = 0.5 * (float(np.sum(y**2)) - left) / least
    won = float(worth[best])
    if against_model:
        kinks = np.maximum(np.arange(n)[:, None] - np.arange(1, n - 1, every), 0.0) / n
        k, _ = left_by(kinks)
        shares = (k.T @ y)[:, 0] ** 2 / np.maximum(np.sum(k**2, axis=0), 1e-300)
        won -= 0.5 * float(shares.max()) / least
    if won <= SURE:
        return None
    good = begin + tried[worth > worth[best] - SURE]
    return begin + int(tried[best]), int(good[0]), int(good[-1]), won


def _begun(change: FloatArray, at: NDArray[np.int64]) -> FloatArray:
    """What a break changes (n,), from each of these samples on and not before; shape (n, k)."""
    return np.where(np.arange(change.size)[:, None] >= at, change[:, None], 0.0)


def at_rest(
    predicted: FloatArray, near: int, stretch: Stretch
) -> tuple[int, int, int, float] | None:
    """As `placed`, for samples lost in a hold, which show only when it is over; None without one.

    Where in the hold they were lost makes no difference to the rest.
    """
    wide = max(24, round(AROUND_S * stretch.factor * 1000.0))
    at = near - stretch.begin
    for a, b in rests_of(predicted[stretch.begin : stretch.end]):
        if a - wide < at < b + wide and b - a > wide:
            index = stretch.begin + int(np.clip(at, a, b - 1))
            return index, index, index, 0.0
    return None


def rests_of(path: FloatArray) -> list[tuple[int, int]]:
    """Where a path (n,) stands still between moves, from one sample up to another; nowhere if it
    never moves.
    """
    speed = np.abs(np.gradient(path))
    if not speed.any():
        return []
    still = speed < STILL * float(np.percentile(speed[speed > 0.0], 95.0))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _correlation(values: FloatArray, base: FloatArray, steps: FloatArray) -> float:
    """Of neighbouring samples, beside the likeliest break for white noise."""
    q, _ = np.linalg.qr(base)
    y, s = values - q @ (q.T @ values), steps - q @ (q.T @ steps)
    left = y[:, None] - s
    rest = left[:, int(np.argmin(np.sum(left**2, axis=0)))]
    power = float(rest @ rest)
    return float(np.clip(rest[1:] @ rest[:-1] / power, 0.0, 0.98)) if power > 0 else 0.0


def _innovations(columns: FloatArray, rho: float) -> FloatArray:
    out = columns.copy()
    out[1:] -= rho * columns[:-1]
    out[0] *= np.sqrt(1.0 - rho**2)
    return out
