"""A fix from one epoch's pseudoranges, and what each of its rows would do if it were left out.

With whitened rows ``z = A x + v``, ``P = I - A (A^T A)^-1 A^T`` and residuals ``r = P z``, leaving row `i`
out turns `r` into ``r - P_i r_i / P_ii`` and `P` into ``P - P_i P_i^T / P_ii``, exactly: no further least
squares is needed for all subsets without one row. Rows with ``P_ii = 0`` are checked by no other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

__all__ = [
    "UNCHECKED", "Elimination", "Fix", "Projection", "Pseudoranges", "design", "eliminate",
    "eliminate_correlated", "fix_of", "pdop_of", "project",
]  # fmt: skip

#: Redundancy below which a row counts as checked by no other.
UNCHECKED = 1e-8
#: Smallest ratio of a pivot to its diagonal at which columns count as independent.
INDEPENDENT = 1e-9


@dataclass(frozen=True, eq=False)
class Pseudoranges:
    """One epoch's pseudoranges, linearised at a predicted position of the antenna.

    Parameters
    ----------
    keys : tuple of str
        Names of the rows.
    los : ndarray, shape (n, 3)
        Unit vectors from the antenna to the satellites, ECEF.
    clock : ndarray of int, shape (n,)
        Which receiver clock a row carries: a number a constellation.
    residual_m : ndarray, shape (n,)
        Measured minus predicted; receiver clocks not removed.
    sigma_m : ndarray, shape (n,)
        Standard deviation by the noise model.
    enu : ndarray, shape (3, 3)
        Rotation from ECEF to east, north, up.
    """

    keys: tuple[str, ...]
    los: FloatArray
    clock: IntArray
    residual_m: FloatArray
    sigma_m: FloatArray
    enu: FloatArray

    def __post_init__(self) -> None:
        n = len(self.keys)
        shapes = (self.los.shape, self.clock.shape, self.residual_m.shape, self.sigma_m.shape)
        if shapes != ((n, 3), (n,), (n,), (n,)):
            raise ValueError(f"`los`, `clock`, `residual_m` and `sigma_m` do not fit {n} keys: {shapes}")


@dataclass(frozen=True, eq=False)
class Fix:
    """A least-squares fix.

    Parameters
    ----------
    offset_m : ndarray, shape (3,)
        From the linearisation point, ECEF.
    clocks : ndarray, shape (c,)
        Receiver clocks, m, in the order of `numbers`.
    cov : ndarray, shape (3, 3)
        Covariance of `offset_m`, m^2.
    residuals : ndarray, shape (k,)
        Of the rows that were used, m.
    numbers : tuple of int
        Which clocks (`Pseudoranges.clock`).
    """

    offset_m: FloatArray
    clocks: FloatArray
    cov: FloatArray
    residuals: FloatArray
    numbers: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Projection:
    """Least squares of weighted rows, without data.

    Parameters
    ----------
    design : ndarray, shape (n, p)
        Columns of position and clocks, not weighted.
    inverse : ndarray, shape (p, p)
        Of the normal matrix.
    gain : ndarray, shape (p, n)
        From rows (not whitened) to states.
    project : ndarray, shape (n, n)
        From whitened rows to whitened residuals; symmetric.
    """

    design: FloatArray
    inverse: FloatArray
    gain: FloatArray
    project: FloatArray

    @property
    def dof(self) -> int:
        """Degrees of freedom of the residuals."""
        n, p = self.design.shape
        return int(n - p)

    @property
    def redundancy(self) -> FloatArray:
        """How much of each row's own error its residual shows: from 0 to 1, shape (n,)."""
        return np.asarray(np.diagonal(self.project))


def design(rows: Pseudoranges) -> tuple[FloatArray, tuple[int, ...]]:
    """Return the columns of position and clocks, shape (n, 3 + c), and the numbers of the clocks."""
    numbers = sorted(set(rows.clock.tolist()))
    A = np.empty((len(rows.los), 3 + len(numbers)))
    A[:, :3] = -rows.los
    A[:, 3:] = rows.clock[:, None] == np.array(numbers, dtype=np.int64)
    return A, tuple(numbers)


def project(A: FloatArray, weight_root: FloatArray) -> Projection | None:
    """Return weighted least squares of columns `A`, or None where they do not determine the states.

    Parameters
    ----------
    A : ndarray, shape (n, p)
    weight_root : ndarray, shape (n,)
        Inverse standard deviations.
    """
    determined, *parts = _least_squares(A, weight_root, INDEPENDENT)
    return Projection(A, *parts) if determined else None


def fix_of(projection: Projection, z: FloatArray, sigma_m: FloatArray, numbers: tuple[int, ...]) -> Fix:
    """Return the fix of rows `z`, m, whose least squares is `projection` and whose clocks have `numbers`.

    The covariance is that of errors with `sigma_m`, shape (n,), whatever the weights.
    """
    x = projection.gain @ z
    spread = projection.gain[:3] * sigma_m
    return Fix(x[:3], x[3:], spread @ spread.T, z - projection.design @ x, numbers)


def pdop_of(A: FloatArray) -> float:
    """Return the dilution of the position, inf where the rows do not determine one."""
    determined, inverse, _, _ = _least_squares(A, np.ones(len(A)), INDEPENDENT)
    return float(np.sqrt(inverse[0, 0] + inverse[1, 1] + inverse[2, 2])) if determined else float("inf")


@njit(cache=True, nogil=True)
def _least_squares(
    A: FloatArray, weight_root: FloatArray, independent: float
) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
    """Return whether the columns are independent, the inverse of the normal matrix, gain and projection."""
    n, p = A.shape
    white = A * weight_root.reshape(n, 1)
    inverse, gain, P = np.zeros((p, p)), np.zeros((p, n)), np.eye(n)
    root = np.zeros((p, p))
    for i in range(p):
        for j in range(i + 1):
            value = np.dot(np.ascontiguousarray(white[:, i]), np.ascontiguousarray(white[:, j]))
            size = value
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i == j:
                if not value > independent * size:
                    return False, inverse, gain, P
                root[i, i] = np.sqrt(value)
            else:
                root[i, j] = value / root[j, j]
    for c in range(p):  # inverse = L^-T L^-1, column by column
        for i in range(c, p):
            value = 1.0 if i == c else 0.0
            for k in range(c, i):
                value -= root[i, k] * inverse[c, k]
            inverse[c, i] = value / root[i, i]
    inverse = inverse @ inverse.T
    gain = inverse @ white.T
    P = P - white @ gain
    return True, inverse, gain * weight_root, P


@dataclass(frozen=True, eq=False)
class Elimination:
    """What leaving out row after row came to.

    Parameters
    ----------
    order : tuple of int
        Rows that were left out, in this order.
    first, last : float
        The statistic with all rows, and with those that remain.
    passed : bool
        Whether the rest is consistent.
    tests : int
        Subsets without one row that were tested.
    """

    order: tuple[int, ...]
    first: float
    last: float
    passed: bool
    tests: int


def eliminate(
    project: FloatArray, residual: FloatArray, ratio: FloatArray, limits: FloatArray, most: int
) -> Elimination:
    """Leave out one row after the other until the statistic of the rest is within its limit.

    Each time it is the row without which the statistic is smallest; rows that no other checks stay, and one
    degree of freedom is always left.

    Parameters
    ----------
    project : ndarray, shape (n, n)
        From whitened rows to whitened residuals (`Projection.project`).
    residual : ndarray, shape (n,)
        Whitened residuals.
    ratio : ndarray, shape (n,)
        What they are multiplied by in the statistic, which is the sum of squares.
    limits : ndarray, shape (dof + 1,)
        Of the statistic with so many degrees of freedom; the last entry goes with all rows.
    most : int
        Rows that may be left out.
    """
    order, count, first, last, passed, tests = _eliminate(
        project.copy(), residual.copy(), ratio, limits, most, UNCHECKED
    )
    return Elimination(tuple(order[:count].tolist()), float(first), float(last), bool(passed), int(tests))


def eliminate_correlated(V: FloatArray, nu: FloatArray, limits: FloatArray) -> Elimination:
    """Leave out rows as `eliminate` does, where the statistic is ``nu^T V nu``.

    Parameters
    ----------
    V : ndarray, shape (n, n)
        ``C^-1 - C^-1 A (A^T C^-1 A)^+ A^T C^-1`` of rows with covariance `C` and columns `A`.
    nu : ndarray, shape (n,)
    limits : ndarray, shape (dof + 1,)
    """
    z, V, least = V @ nu, V.copy(), UNCHECKED * np.maximum(np.diagonal(V), 1e-300)
    first = last = float(nu @ z)
    order: list[int] = []
    tests, dof = 0, len(limits) - 1
    while last > limits[dof] and dof > 1:
        pivots = np.diagonal(V)
        checked = pivots > least
        checked[order] = False
        if not checked.any():
            break
        tests += int(checked.sum())
        explained = np.where(checked, z * z / np.where(checked, pivots, 1.0), -1.0)
        i = int(np.argmax(explained))
        last, dof = max(last - float(explained[i]), 0.0), dof - 1
        z, V = z - V[i] * (z[i] / V[i, i]), V - np.outer(V[i], V[i]) / V[i, i]
        order.append(i)
    return Elimination(tuple(order), first, last, bool(last <= limits[dof]), tests)


@njit(cache=True, nogil=True)
def _square_without(P: FloatArray, r: FloatArray, ratio: FloatArray, alive: BoolArray, i: int) -> float:
    """Return the statistic without row `i`; all rows for a negative one."""
    step = 0.0 if i < 0 else r[i] / P[i, i]
    total = 0.0
    for j in range(len(r)):
        if alive[j] and j != i:
            value = r[j] * ratio[j] if i < 0 else (r[j] - P[j, i] * step) * ratio[j]
            total += value * value
    return total


@njit(cache=True, nogil=True)
def _drop(P: FloatArray, r: FloatArray, alive: BoolArray, i: int) -> None:
    """Leave row `i` out: the residuals and the projection of the rest."""
    column, pivot, value = P[:, i].copy(), P[i, i], r[i]
    for j in range(len(r)):
        r[j] -= column[j] * value / pivot
        for k in range(len(r)):
            P[j, k] -= column[j] * column[k] / pivot
    alive[i] = False


@njit(cache=True, nogil=True)
def _eliminate(
    P: FloatArray, r: FloatArray, ratio: FloatArray, limits: FloatArray, most: int, unchecked: float
) -> tuple[IntArray, int, float, float, bool, int]:
    alive = np.ones(len(r), dtype=np.bool_)
    order = np.empty(len(r), dtype=np.int64)
    first = _square_without(P, r, ratio, alive, -1)
    last, count, tests, dof = first, 0, 0, len(limits) - 1
    while last > limits[dof] and dof > 1 and count < most:
        best, smallest = -1, np.inf
        for i in range(len(r)):
            if alive[i] and P[i, i] > unchecked:
                tests += 1
                value = _square_without(P, r, ratio, alive, i)
                if value < smallest:
                    best, smallest = i, value
        if best < 0:
            break
        _drop(P, r, alive, best)
        order[count] = best
        last, count, dof = smallest, count + 1, dof - 1
    return order, count, first, last, last <= limits[dof], tests
