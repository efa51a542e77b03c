"""Errors of a filter and its subfilters where the truth is not what the filter assumes.

Gains do not depend on data, so that all errors are linear in what really happens: noise of rows that lasts
longer than the filter believes, walks of states, faults. Their covariances follow exactly (`carry_exact`),
and many runs cost some matrix products an epoch (`carry_runs`).

Symbols: ``e`` is the error of the filter, ``d_i`` the separation of subfilter ``i`` from it, ``g`` the
lasting part of each row's error in units of its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.records import FloatArray, Update

__all__ = [
    "Exact", "RowErrors", "Runs", "carry_exact", "carry_runs", "fresh_share", "hidden",
]  # fmt: skip

NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True, eq=False)
class RowErrors:
    """What errors really are at an epoch.

    Parameters
    ----------
    white_m, lasting_m : ndarray, shape (m,)
        Standard deviations of each row's white and lasting error.
    tau_s : ndarray, shape (m,)
        Correlation time of the lasting one, a first-order Gauss-Markov process; 0: white.
    drive_m2 : ndarray, shape (n,)
        Variance of each state's step since the epoch before.
    """

    white_m: FloatArray
    lasting_m: FloatArray
    tau_s: FloatArray
    drive_m2: FloatArray


@dataclass(frozen=True, eq=False)
class Exact:
    """Covariances after an epoch; shapes: n states, m rows, M members.

    Parameters
    ----------
    t_ns : int
    keys : tuple of str, length m
    own : ndarray, shape (n + m, n + m)
        Of ``(e, g)``.
    apart : ndarray, shape (M, n, n)
        Of each ``d_i``.
    cross : ndarray, shape (M, n, n + m)
        Of each ``d_i`` with ``(e, g)``.
    """

    t_ns: int
    keys: tuple[str, ...]
    own: FloatArray
    apart: FloatArray
    cross: FloatArray


@dataclass(frozen=True, eq=False)
class Runs:
    """Many runs after an epoch: `error` (n, runs), `lasting` (m, runs), `apart` (M, n, runs)."""

    t_ns: int
    keys: tuple[str, ...]
    error: FloatArray
    lasting: FloatArray
    apart: FloatArray


def _kept_part(
    keys: tuple[str, ...], before: tuple[str, ...], errors: RowErrors, dt_s: float
) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return where each row's lasting error stood before (-1: nowhere), and what part of it is kept."""
    place = {k: i for i, k in enumerate(before)}
    at = np.array([place.get(k, -1) for k in keys], dtype=np.intp)
    lasts = (at >= 0) & (errors.tau_s > 0.0)
    return at, np.where(lasts, np.exp(-dt_s / np.where(lasts, errors.tau_s, 1.0)), 0.0)


def carry_exact(past: Exact | None, update: Update, test: CarriedTest | None, errors: RowErrors) -> Exact:
    """Return the covariances after an epoch.

    Parameters
    ----------
    past : Exact or None
        None: the filter starts.
    update : Update
        Its data are not looked at.
    test : CarriedTest or None
        Of `monitors.separation.Separation.plan`; None: only the filter is looked at.
    errors : RowErrors
    """
    n, m = len(update.prior), len(update.keys)
    T, kept = _step(past, update, errors)
    own = T @ (np.zeros((0, 0)) if past is None else past.own) @ T.T
    own += np.diag(np.concatenate([errors.drive_m2, 1.0 - kept**2]))
    G = np.hstack([-update.H, np.diag(errors.lasting_m)])
    K = np.vstack([update.K, np.zeros((m, m))])
    U, white = np.eye(n + m) + K @ G, np.diag(errors.white_m**2)
    after = U @ own @ U.T + K @ white @ K.T
    if test is None or not len(test.carry):
        return Exact(update.t_ns, update.keys, after, np.zeros((0, n, n)), np.zeros((0, n, n + m)))
    D = _differences(test, update)
    DG, DW = D @ G, D @ white
    moved, mixed = _members(past, test, T)
    spread = moved + mixed @ np.swapaxes(DG, 1, 2) + DG @ np.swapaxes(mixed, 1, 2)
    spread = spread + DG @ own @ np.swapaxes(DG, 1, 2) + DW @ np.swapaxes(D, 1, 2)
    return Exact(update.t_ns, update.keys, after, spread, (mixed + DG @ own) @ U.T + DW @ K.T)


def _step(past: Exact | None, update: Update, errors: RowErrors) -> tuple[FloatArray, FloatArray]:
    """Return the step of ``(e, g)`` into an epoch, and what part of each ``g`` is kept."""
    n, m = len(update.prior), len(update.keys)
    if past is None:
        return np.zeros((n + m, 0)), np.zeros(m)
    at, kept = _kept_part(update.keys, past.keys, errors, (update.t_ns - past.t_ns) * 1e-9)
    T = np.zeros((n + m, len(past.own)))
    before = update.F.shape[1]
    T[:n, :before] = update.F
    rows = np.flatnonzero(at >= 0)
    T[n + rows, before + at[rows]] = kept[rows]
    return T, kept


def _differences(test: CarriedTest, update: Update) -> FloatArray:
    """Return each member's gain less that of the filter, shape (M, n, m)."""
    inverse = np.linalg.solve(update.L, np.eye(len(update.L)))
    return np.asarray(test.response @ inverse)


def _members(past: Exact | None, test: CarriedTest, T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what the members' old separations make of their covariances, before the epoch's rows."""
    M, n = test.carry.shape[:2]
    if past is None or not len(past.apart):
        return np.zeros((M, n, n)), np.zeros((M, n, len(T)))
    carry = test.carry
    moved = carry @ past.apart[test.source] @ np.swapaxes(carry, 1, 2)
    return moved, carry @ past.cross[test.source] @ T.T


def carry_runs(
    past: Runs | None, update: Update, test: CarriedTest | None, errors: RowErrors, runs: int,
    rng: np.random.Generator | None, fault_m: FloatArray | None = None,
) -> Runs:  # fmt: skip
    """Return many runs after an epoch.

    Parameters
    ----------
    past, update, test, errors
        As for `carry_exact`.
    runs : int
    rng : numpy Generator or None
        None: nothing is random, only the faults move something.
    fault_m : ndarray, shape (m, runs), optional
        Added to the rows.
    """
    n, m = len(update.prior), len(update.keys)
    lasting, error = np.zeros((m, runs)), np.zeros((n, runs))
    if past is not None:
        at, kept = _kept_part(update.keys, past.keys, errors, (update.t_ns - past.t_ns) * 1e-9)
        error = update.F @ past.error
        lasting = kept[:, None] * past.lasting[at]
    else:
        kept = np.zeros(m)
    nu = np.zeros((m, runs)) if fault_m is None else fault_m.copy()
    if rng is not None:
        error = error - np.sqrt(errors.drive_m2)[:, None] * rng.standard_normal((n, runs))
        lasting = lasting + np.sqrt(1.0 - kept**2)[:, None] * rng.standard_normal((m, runs))
        nu += errors.white_m[:, None] * rng.standard_normal((m, runs)) + errors.lasting_m[:, None] * lasting
    nu -= update.H @ error
    error = error + update.K @ nu
    if test is None or not len(test.carry):
        return Runs(update.t_ns, update.keys, error, lasting, np.zeros((0, n, runs)))
    apart = past.apart if past is not None else np.zeros((0, n, runs))
    white = np.asarray(np.linalg.solve(update.L, nu), dtype=np.float64)
    return Runs(update.t_ns, update.keys, error, lasting, test.step(apart, white))


def hidden(
    level: npt.ArrayLike, threshold: npt.ArrayLike, mean: npt.ArrayLike, apart: npt.ArrayLike,
    sigma: npt.ArrayLike, sigma_ss: npt.ArrayLike, covariance: npt.ArrayLike,
) -> FloatArray:  # fmt: skip
    """Return the probability that an error exceeds a level while its separation stays within a threshold.

    Both are normal: the error with `mean` and `sigma`, the separation with mean `apart` and `sigma_ss`, and
    their `covariance`. Arrays are broadcast; the integral over the separation has 64 nodes on the part of the
    interval that matters.
    """
    arrays = (level, threshold, mean, apart, sigma, sigma_ss, covariance)
    L, T, a, b, s, ss, c = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in arrays))
    ss = np.maximum(ss, 1e-9 * np.maximum(s, 1e-12))
    low, high = np.clip(b - 10.0 * ss, -T, T), np.clip(b + 10.0 * ss, -T, T)
    x = 0.5 * (low + high)[..., None] + 0.5 * (high - low)[..., None] * NODES
    slope = c / ss**2
    rest = np.sqrt(np.maximum(s**2 - c * slope, 1e-18))[..., None]
    middle = a[..., None] + slope[..., None] * (x - b[..., None])
    beyond = special.ndtr(-(L[..., None] - middle) / rest) + special.ndtr(-(L[..., None] + middle) / rest)
    density = np.exp(-0.5 * ((x - b[..., None]) / ss[..., None]) ** 2) / (
        np.sqrt(2.0 * np.pi) * ss[..., None]
    )
    return np.asarray(0.5 * (high - low) * (WEIGHTS * beyond * density).sum(axis=-1))


def fresh_share(before: Update, update: Update, axes: FloatArray, level: float) -> FloatArray:
    """Return which share of large errors is new at an epoch, shape (d,).

    The probability that the error was within the level at the epoch before, where it is beyond it now, within
    the filter's own model. The sum over an hour is the number of independent epochs that an hour is worth for
    errors of that size.

    Parameters
    ----------
    before, update : Update
        Of two successive epochs.
    axes : ndarray, shape (d, 3)
        Directions in the frame of the position.
    level : float
        In standard deviations.
    """
    past, now = (u.posterior.layout.block("pos") for u in (before, update))
    columns = update.F @ (before.posterior.P[:, past] @ axes.T)
    columns = columns - update.K @ (update.H @ columns)
    mixed = np.einsum("dk,kd->d", axes, columns[now])
    sigma = [
        np.sqrt(np.einsum("dk,kl,dl->d", axes, u.posterior.P[np.ix_(at, at)], axes))
        for u, at in ((before, past), (update, now))
    ]
    rho = np.clip(mixed / (sigma[0] * sigma[1]), -1.0, 1.0)
    return np.asarray(hidden(level, level, 0.0, 0.0, 1.0, 1.0, rho) / (2.0 * special.ndtr(-level)))
