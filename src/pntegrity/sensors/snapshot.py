"""Position and velocity of one epoch's pseudoranges and range rates, by least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pntegrity.kernels.linear import whiten
from pntegrity.records import Epoch, FloatArray
from pntegrity.sensors.pseudoranges import (
    SURFACE_M,
    Rows,
    SkyOptions,
    code_rows,
    rate_rows,
    system_of,
    without,
)

__all__ = ["Fix", "snapshot", "track", "velocity_of"]


@dataclass(frozen=True, eq=False)
class Fix:
    """A snapshot solution: position, a clock a constellation (m), and where there are range rates velocity
    with its covariance and clock drift.
    """

    position_m: FloatArray
    clocks_m: dict[str, float]
    velocity_mps: FloatArray | None
    drift_mps: float
    reason: str = ""
    velocity_cov: FloatArray | None = None


def snapshot(
    epoch: Epoch, options: SkyOptions, guess_m: FloatArray, exclude: frozenset[str] = frozenset()
) -> Fix:
    """Return the iterated weighted least-squares fix of one epoch; `reason` says why there is none.

    Parameters
    ----------
    epoch : Epoch
    options : SkyOptions
    guess_m : ndarray, shape (3,)
        Where to linearise first; the Earth's centre will do.
    exclude : frozenset of str
        Groups to leave out.
    """
    x = np.array(guess_m, dtype=np.float64)
    clocks: dict[str, float] = {}
    for _ in range(12):
        rows = without(code_rows(epoch, x, options), exclude)
        systems = tuple(sorted({system_of(k) for k in rows.keys}))
        if len(rows.keys) < 3 + len(systems):
            return _no_fix(
                x,
                f"a fix needs {3 + max(len(systems), 1)} satellites of this mix, there are {len(rows.keys)}",
            )
        step, clocks = _position_step(rows, systems, options)
        if not np.all(np.isfinite(step)):
            return _no_fix(x, "the geometry does not determine a position")
        x = x + step
        if float(step @ step) < 1e-4 and float(x @ x) > SURFACE_M**2:
            return _with_velocity(epoch, options, Fix(x, clocks, None, 0.0), exclude)
    return _no_fix(x, "the least-squares fix did not converge")


def _no_fix(x: FloatArray, reason: str) -> Fix:
    return Fix(x, {}, None, 0.0, reason)


def track(epochs: Sequence[Epoch], options: SkyOptions) -> FloatArray:
    """Return least-squares positions of code, m, ECEF, shape (n, 3), nan where there is none.

    Parameters
    ----------
    epochs : sequence of Epoch, length n
        In order of time: each begins at the position before it.
    options : SkyOptions
    """
    out, guess = np.full((len(epochs), 3), np.nan), np.zeros(3)
    for i, epoch in enumerate(epochs):
        fix = snapshot(epoch, options, guess)
        if not fix.reason:
            out[i] = guess = fix.position_m
    return out


def _position_step(
    rows: Rows, systems: tuple[str, ...], options: SkyOptions
) -> tuple[FloatArray, dict[str, float]]:
    clock = np.array([[system_of(k) == s for s in systems] for k in rows.keys], dtype=np.float64)
    weight = 1.0 / options.noise.snapshot_sigma_m(rows.scale, rows.slow)
    A = np.hstack([-rows.los, clock])
    solution, _, rank, _ = np.linalg.lstsq(
        A * weight[:, None], (rows.y - rows.predicted) * weight, rcond=None
    )
    if rank < A.shape[1]:
        return np.full(3, np.nan), {}
    return np.asarray(solution[:3], dtype=np.float64), dict(zip(systems, solution[3:].tolist(), strict=True))


def _with_velocity(epoch: Epoch, options: SkyOptions, fix: Fix, exclude: frozenset[str]) -> Fix:
    rows = without(rate_rows(epoch, fix.position_m, np.zeros(3), options), exclude)
    found = velocity_of(rows, options.noise.doppler_mps)
    if found is None:
        return fix
    velocity, drift, cov = found
    return replace(fix, velocity_mps=velocity, drift_mps=drift, velocity_cov=cov)


def velocity_of(rows: Rows, sigma_mps: float) -> tuple[FloatArray, float, FloatArray] | None:
    """Return least-squares velocity and clock drift of range rates predicted for a receiver at rest, and the
    velocity's covariance; None where they do not determine them.

    Parameters
    ----------
    rows : Rows
    sigma_mps : float
        Of a row at the zenith.
    """
    if len(rows.keys) < 4:
        return None
    weight = 1.0 / rows.scale
    A = np.hstack([-rows.los, np.ones((len(rows.keys), 1))]) * weight[:, None]
    solution, _, rank, _ = np.linalg.lstsq(A, (rows.y - rows.predicted) * weight, rcond=None)
    if rank < 4:
        return None
    _, upper = np.linalg.qr(A)
    root = whiten(upper.T, np.eye(4)[:, :3])  # root^T root is the velocity's block of (A^T A)^-1
    return np.asarray(solution[:3], dtype=np.float64), float(solution[3]), root.T @ root * sigma_mps**2
