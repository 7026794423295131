"""How sure a fit is: what conditions disagree by, carried through their Gram matrices.

Neighbouring elements are nearly interchangeable (the Gram matrix of 40 play
operators has a condition number of 1e7), so what is reported is the band of
the distribution and of the response, never one weight by itself.

Units are conditions, else sweeps, else half loops. Their
*scores* are drawn again, not the units themselves: a draw that leaves out the
only sweep to 75 V answers another question. The score of a unit is
g_u = B_u'(y_u - B_u x), and refits are x* = x + G^-1 (sum of w_u g_u + c) with
standard normal w_u (score bootstrap: Kline and Santos 2012, J. Econometric
Methods 1, 23). Two corrections make it right for few and unequal units:

- A unit pulls the fit towards itself, most of all where it alone has been, so
  that its residuals are too small there: E g_u g_u' = s2 (G_u - G_u G^-1 G_u).
  What is missing, s2 G_u G^-1 G_u, is the covariance of c. In the place of s2
  stands what the scores of single half loops vary by, times the dispersion: by
  how much units disagree more than their half loops (drift, misfit).
- The variance is itself estimated from few numbers: a band is wider by
  Student's t, with the degrees of freedom of its quantity (Satterthwaite's,
  for clusters: Bell and McCaffrey 2002, Survey Methodology 28, 169).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from piezo_rig.chain import HalfLoops
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.normal import Normal, Piece, normal_equations, pieces_of, residuals
from piezo_rig.identification.smooth import Hidden, Prior
from piezo_rig.identification.solve import UNSEEN, condition_number, steps_between, untold

FloatArray = NDArray[np.float64]
DRAWS = 1000
POINTS = 76  # of a response band
RANK = 1e-12  # of the largest eigenvalue: what lies below was never told apart
FEW_TURNS = 4  # half loops of a condition that show its design
NORMAL_975 = 1.959964
MOST_FREEDOM = 1e6


@dataclass(frozen=True, eq=False)
class Bands:
    """95 % bands of a fit.

    Attributes
    ----------
    drive_v : shape (m,), drive of a first rise, or half the drive change of a later branch
    first_um, later_um : shape (m, 2), band of the first rise, and over 2 x drive_v of the
        branch that follows the half loop ``later_loop``
    first_compliance, later_compliance : shape (n, 2), band of every compliance, um/V
    laws : parameter -> interval
    condition_number : of the equations that were solved (with the ties between elements, where
        there are any), with unit diagonal
    drawn : what was drawn again, and how often
    dispersion : variance between units over that of white noise, at least 1
    later_loop : input range, local extremum (V) and direction of the largest half loop
    """

    drive_v: FloatArray
    first_um: FloatArray
    later_um: FloatArray
    first_compliance: FloatArray
    later_compliance: FloatArray
    laws: dict[tuple[str, str], tuple[float, float]]
    condition_number: float
    drawn: str
    dispersion: float = 1.0
    later_loop: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def to_dict(self) -> dict[str, object]:
        """Plain data for a model file."""
        return {
            "drawn": self.drawn,
            "dispersion": _short(self.dispersion),
            "drive_v": _short(self.drive_v),
            "first_rise_um": _short(self.first_um),
            "later_branch": dict(
                zip(("range_v", "extremum_v", "direction"), _short(self.later_loop), strict=True)
            ),
            "later_branch_at_twice_the_drive_um": _short(self.later_um),
            "first_rise_um_per_v": _short(self.first_compliance),
            "later_branch_um_per_v": _short(self.later_compliance),
        }


@dataclass(frozen=True, eq=False)
class Spread:
    """The units of a fit, in coordinates in which its Gram matrix is the unit matrix.

    Attributes
    ----------
    root : shape (p, k), steps of the unknowns = root @ whitened steps
    gram : shape (u, k, k), whitened Gram matrices of the units; they add up to 1
    scores : shape (u, k), whitened
    noise : shape (k, k), covariance of the sum of all scores
    dispersion : see `Bands`
    variance : of a sample, um^2, times the dispersion
    """

    root: FloatArray
    gram: FloatArray
    scores: FloatArray
    noise: FloatArray
    dispersion: float
    variance: float

    def missing(self) -> FloatArray:
        """Covariance that the units' own residuals lack, shape (k, k)."""
        values, vectors = np.linalg.eigh(self.noise)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return np.asarray(root @ np.sum(self.gram @ self.gram, axis=0) @ root, float)

    def variance_along(self, rows: FloatArray) -> float:
        """Like ``variance``, but for the combinations of unknowns (q, p) that are asked for."""
        lean = rows @ self.root
        return float(np.mean(np.sum((lean @ self.noise) * lean, 1) / np.sum(lean**2, 1)))

    def draw(self, draws: int, seed: int) -> FloatArray:
        """Refits less the fit, shape (draws, p)."""
        rng = np.random.default_rng(seed)
        missing = self.missing()
        values, vectors = np.linalg.eigh(missing)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        weights = rng.standard_normal((draws, self.scores.shape[0]))
        others = rng.standard_normal((draws, values.size))
        return (weights @ self.scores + others @ root.T) @ self.root.T

    def widening(self, derivative: FloatArray) -> FloatArray:
        """Student's t over the normal quantile, shape (q,).

        ``derivative``: shape (q, p), of every quantity by the unknowns.
        """
        lean = derivative @ self.root
        pulled = lean @ self.gram  # (u, q, k)
        by_quantity = np.moveaxis(pulled, 0, 1)
        # covariance of the units' contributions under white noise
        matrix = -by_quantity @ np.swapaxes(by_quantity, 1, 2)
        index = np.arange(self.gram.shape[0])
        matrix[:, index, index] += np.sum(pulled * lean, axis=2).T
        power = np.sum(matrix**2, axis=(1, 2))
        total = np.sum(lean**2, axis=1)
        freedom = np.full(total.size, MOST_FREEDOM)
        np.divide(total**2, power, out=freedom, where=power > total**2 / MOST_FREEDOM)
        return np.asarray(stdtrit(np.maximum(freedom, 1.0), 0.975) / NORMAL_975, float)


def linearised(data: Data, curves: Curves, pieces: tuple[Piece, ...]) -> Normal:
    """Normal equations for all unknowns (break points held) about a fit."""
    normal = normal_equations(data, curves, pieces, residuals(data, curves))
    x = curves.pack(False)
    right = normal.right + normal.gram @ x
    return Normal(normal.gram, right, normal.power, normal.count, normal.pieces)


def spread(normal: Normal, x: FloatArray, owner: NDArray[np.int64]) -> Spread:
    """What the units disagree by, about the least-squares fit of the unknowns without any prior.

    Parameters
    ----------
    normal : by pieces finer than the units, where there are few of them
    x : shape (p,), where ``normal.power`` is the sum of squares
    owner : unit of every piece, shape (m,)
    """
    full = normal.gram.sum(axis=0)
    diagonal = np.diag(full)
    seen = diagonal > UNSEEN * diagonal.max()
    scale = np.zeros(diagonal.size)
    scale[seen] = 1.0 / np.sqrt(diagonal[seen])
    values, vectors = np.linalg.eigh(full * np.outer(scale, scale))
    good = values > RANK * values[-1]
    root = scale[:, None] * vectors[:, good] / np.sqrt(values[good])
    residual = normal.right - normal.gram @ x
    step = root @ (root.T @ residual.sum(axis=0))
    pulled = normal.gram @ step
    white = normal.reduced(root)
    white = replace(white, right=(residual - pulled) @ root)
    power = float(normal.power.sum() + step @ (pulled - 2.0 * residual).sum(axis=0))
    freedom = max(float(normal.count.sum()) - root.shape[1], 1.0)
    variance = max(power, 0.0) / freedom
    inner, dispersion = _noise(white, variance * np.eye(root.shape[1]))
    by_unit = white.joined(owner, normal.pieces[: int(owner.max()) + 1])
    # units may disagree more than their pieces do
    _, more = _noise(by_unit, inner)
    size = more * dispersion
    return Spread(root, by_unit.gram, by_unit.right, more * inner, size, size * variance)


def _noise(white: Normal, expected: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of the sum of all scores, and its size over what was expected of it (>= 1).

    ``expected``: shape (k, k), used in proportion to a piece's share of the Gram matrix.
    """
    square = np.sum(white.gram @ white.gram, axis=0)
    found = float(np.sum(white.right**2))
    normally = float(np.sum((np.eye(square.shape[0]) - square) * expected))
    excess = 1.0
    if normally > 1e-9 * float(np.trace(expected)):
        excess = max(1.0, found / normally)
    values, vectors = np.linalg.eigh(expected)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return white.right.T @ white.right + excess * root @ square @ root, excess


def units(data: Data, normal: Normal) -> tuple[NDArray[np.int64], str]:
    """The unit of every piece: conditions, else sweeps, else half loops."""
    kinds = (
        ("conditions", [data.conditions[p.sweep] for p in normal.pieces]),
        ("sweeps", [str(p.sweep) for p in normal.pieces]),
    )
    for what, keys in kinds:
        names = list(dict.fromkeys(keys))
        if len(names) > 1:
            return np.array([names.index(k) for k in keys]), what
    return np.arange(len(normal.pieces)), "half loops"


def bands(
    data: Data,
    curves: Curves,
    normal: Normal,
    floor: float,
    seed: int,
    draws: int = DRAWS,
    prior: Prior | None = None,
    others: tuple[Curves, ...] = (),
) -> Bands:
    """Bands of the elements, of the response and of the laws; see the module.

    Parameters
    ----------
    prior : what ties the compliances of the fit, where they are tied
    others : fits without laws that the data like as well
    """
    x = curves.pack(False)
    owner, what = units(data, normal)
    found = spread(normal, x, owner)
    reach = max(data.first_reach_v, data.later_reach_v / 2.0)
    drive = np.linspace(0.0, reach, POINTS)
    largest = _largest(data)

    def quantities(values: FloatArray, like: Curves = curves) -> FloatArray:
        c = like.unpack(values, False)
        parts = [
            _rise(c.first_knots, c.first_c, drive),
            _later(c, largest, 2.0 * drive),
            c.first_c,
            c.later_c,
            _law_values(c, c),
        ]
        return np.concatenate(parts)

    def of_any_grid(c: Curves) -> FloatArray:
        rise = _rise(c.first_knots, c.first_c, drive)
        return np.concatenate([rise, _later(c, largest, 2.0 * drive), _law_values(c, curves)])

    derivative = _derivative(quantities, x)
    centre = quantities(x)
    scatter = np.zeros((draws, centre.size))
    pulled = derivative
    if prior is not None:
        hidden = Hidden.of(prior, normal.gram.sum(axis=0))
        pulled = derivative @ hidden.shrink
        rng = np.random.default_rng([seed, 1])
        scatter = rng.standard_normal((draws, x.size)) @ (derivative @ hidden.root).T
        apart = inside(data, curves, prior, hidden)
        halved = apart.curves
        by_half = _derivative(lambda v: quantities(v, halved), halved.pack(False))
        # compliances of halves are not what is asked for
        lean = np.zeros((centre.size, x.size))
        n0, nc = curves.first_c.size, curves.later_c.size
        wide = halved.first_c.size + halved.later_c.size
        lean[: 2 * POINTS] = by_half[: 2 * POINTS] @ apart.apart
        lean[2 * POINTS + n0 + nc :] = by_half[2 * POINTS + wide :] @ apart.apart
        lean -= derivative @ apart.pulled
        scatter += (rng.standard_normal((draws, x.size)) * apart.size) @ lean.T
    scatter += found.widening(pulled) * (found.draw(draws, seed) @ pulled.T)
    if prior is not None and prior.others:
        asked = np.r_[: 2 * POINTS, 2 * POINTS + n0 + nc : centre.size]
        values = np.array([of_any_grid(c) for _, c in prior.others])
        values -= values[0].copy()
        taken = rng.choice(len(values), draws, p=[w for w, _ in prior.others])
        scatter[:, asked] += values[taken]
    gram = normal.gram.sum(axis=0)
    if prior is None:
        scatter += _never_told(gram, x, curves.runs(), draws, seed) @ derivative.T
    else:
        gram = gram + prior.penalty(x.size)
    for other in others:
        there = np.concatenate([of_any_grid(other)[: 2 * POINTS], _means(other, curves, reach)])
        size = np.random.default_rng([seed, 3]).standard_normal(draws)
        scatter += size[:, None] * (there - centre)
    low, high = np.percentile(scatter, [2.5, 97.5], axis=0)
    band = np.stack([centre + low, centre + high], axis=1)
    n0, nc = curves.first_c.size, curves.later_c.size
    first, later, first_c, later_c, laws = np.split(
        band, np.cumsum([POINTS, POINTS, n0, nc])
    )
    intervals = {
        (curves.laws[i].id, name): _pair(laws[k]) for k, (i, name) in enumerate(curves.law_names)
    }
    with_offset = [s for s in curves.laws if "offset" in s.units]
    if with_offset:
        intervals[(with_offset[0].id, "offset")] = _pair(laws[-1])
    return Bands(
        drive, first, later, np.maximum(first_c, floor), np.maximum(later_c, floor), intervals,
        condition_number(gram),
        f"scores of {found.scores.shape[0]} {what} drawn {draws} times",
        found.dispersion,
        (float(largest.range_v[0]), float(largest.extremum_v[0]), float(largest.direction[0])),
    )  # fmt: skip


def _means(other: Curves, curves: Curves, reach: float) -> FloatArray:
    """Compliances of a fit, averaged over the bands of another one."""
    out = []
    for knots, end, source, c in (
        (curves.first_knots, reach, other.first_knots, other.first_c),
        (curves.later_knots, 2.0 * reach, other.later_knots, other.later_c),
    ):
        last = max(end, 1.05 * float(knots[-1])) if knots.size else end
        edges = np.concatenate([[0.0], knots, [last]])
        out.append(np.diff(_rise(source, c, edges)) / np.diff(edges))
    return np.concatenate(out)


def _never_told(
    gram: FloatArray, x: FloatArray, runs: tuple[tuple[int, int], ...], draws: int, seed: int
) -> FloatArray:
    """Changes of a free fit that the data do not see, shape (draws, p).

    Neighbours differ by as much as those that the data do tell apart.
    """
    null = untold(gram)
    if null.shape[1] == 0:
        return np.zeros((draws, x.size))
    between = steps_between(np.diag(gram) > UNSEEN * np.diag(gram).max(), runs)
    lean, jumps = between @ null, between @ x
    step = float(np.sqrt(jumps @ jumps / max(jumps.size - null.shape[1], 1)))
    values, vectors = np.linalg.eigh(lean.T @ lean)
    root = null @ (vectors / np.sqrt(np.maximum(values, RANK * values[-1])))
    rng = np.random.default_rng([seed, 2])
    return step * rng.standard_normal((draws, null.shape[1])) @ root.T


def _law_values(curves: Curves, rest: Curves) -> FloatArray:
    """Parameters of the laws, and the first of their offsets over the slope that ``rest`` has."""
    values = [curves.laws[i][n] for i, n in curves.law_names]
    if curves.by_law:
        values.append(1.0 / curves.later_c[0] - 1.0 / rest.later_c[1])
    return np.array(values)


@dataclass(frozen=True, eq=False)
class Inside:
    """What happens inside the bands of a tied fit, as halves that differ.

    Attributes
    ----------
    curves : the fit with halved bands
    apart : shape (p', p), its unknowns by the differences between halves
    pulled : shape (p, p), what those do to the fit's own unknowns
    size : shape (p,), standard deviation of the differences
    """

    curves: Curves
    apart: FloatArray
    pulled: FloatArray
    size: FloatArray


def inside(data: Data, curves: Curves, prior: Prior, hidden: Hidden) -> Inside:
    """What the prior says of the inside of bands, and where that leads the fit.

    A Wiener process whose means over neighbouring bands differ by variance s^2 has s^2 / 2
    between the means of a band's halves. The drive is what matters, so a few half loops of every
    condition do.
    """
    halved, whole, apart = curves.halved()
    few = data.one_repeat()
    pieces = tuple(_beginning(few, piece) for piece in pieces_of(few))
    gram = normal_equations(few, halved, pieces).gram.sum(axis=0)
    own = whole.T @ gram @ whole
    share = float(np.trace(hidden.gram)) / float(np.trace(own))
    pulled = hidden.posterior @ (share * (whole.T @ gram @ apart))
    size = np.zeros(own.shape[0])
    for (a, b), step in zip(prior.runs, prior.steps, strict=True):
        size[a:b] = step / np.sqrt(2.0)
    return Inside(halved, apart, pulled, size)


def _beginning(data: Data, piece: Piece) -> Piece:
    turns = data.tracks[piece.track].loops.start
    turns = turns[(turns > piece.begin) & (turns < piece.end)]
    return replace(piece, end=int(turns[FEW_TURNS])) if turns.size > FEW_TURNS else piece


def _largest(data: Data) -> HalfLoops:
    """The largest half loop of known memory that is not a first rise."""
    best, found = -1.0, data.tracks[0].loops.only(len(data.tracks[0].loops) - 1)
    for track in data.tracks:
        loops = track.loops
        span = np.abs(track.drive_v[loops.stop] - track.drive_v[loops.start])
        known = np.any([(loops.start >= max(a, 1)) & (loops.start < b) for a, b in track.blocks], 0)
        span[~known] = -1.0
        if span.max() > best * (1 + 1e-9) + 1e-12:
            best, found = float(span.max()), loops.only(int(np.argmax(span)))
    return found


def _later(curves: Curves, loop: HalfLoops, drive: FloatArray) -> FloatArray:
    """The branch of one half loop over the drive change (m,), the law applied."""
    if not curves.by_law:
        return _rise(curves.later_knots, curves.later_c, drive)
    branches = curves.branches()
    slope = float(branches.first_slopes(loop)[0])
    knot = branches.first_break_um * slope
    compliance = np.concatenate([[1.0 / slope], curves.later_c[1:]])
    return _rise(np.concatenate([[knot], knot + branches.rest.knots_v]), compliance, drive)


def _derivative(quantities: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """By central differences, shape (q, p)."""
    columns = []
    for i in range(x.size):
        step = 1e-5 * (abs(x[i]) or 1e-3 * float(np.max(np.abs(x))))
        ahead, back = x.copy(), x.copy()
        ahead[i] += step
        back[i] -= step
        columns.append((quantities(ahead) - quantities(back)) / (2.0 * step))
    return np.stack(columns, axis=1)


def _rise(knots: FloatArray, compliance: FloatArray, drive: FloatArray) -> FloatArray:
    """A piecewise linear curve at the drives (m,)."""
    end = max(float(drive[-1]), float(knots[-1]) if knots.size else 0.0) + 1.0
    edges = np.concatenate([[0.0], knots, [end]])
    heights = np.concatenate([[0.0], np.cumsum(compliance * np.diff(edges))])
    return np.interp(drive, edges, heights)


def _short(values: ArrayLike) -> Any:
    """Numbers to seven digits."""
    given = np.asarray(values, float)
    return np.array([float(f"{v:.7g}") for v in given.ravel()]).reshape(given.shape).tolist()


def _pair(row: FloatArray) -> tuple[float, float]:
    return float(row[0]), float(row[1])
