"""Strapdown mechanisation in the Earth frame, with its composed linear step.

Symbols: `C` turns body axes (forward, right, down) into ECEF; ``theta`` and ``u`` are the increments of angle
and velocity with the errors of the sensors taken out. The 21 errors are of position, velocity (both ECEF),
attitude (small turn phi in ECEF axes, ``C_true = (I + [phi x]) C``), biases of gyroscopes and
accelerometers, their scale factors: ``true = (measured - bias) / (1 + scale)``.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.gravity import EARTH_RATE, gravity, gravity_gradient

FloatArray = npt.NDArray[np.float64]

__all__ = ["Step", "mechanise"]

#: Rate and force are means over the last increments that last together at least this long, s.
MEAN_S = 0.1
#: States in all, and those that noise reaches: the scale factors are constant.
N, NOISY = 21, 15


class Step(NamedTuple):
    """Where the mechanisation came, and how errors came there.

    Parameters
    ----------
    position_m, velocity_mps : ndarray, shape (3,)
        ECEF.
    C : ndarray, shape (3, 3)
        Body axes to ECEF.
    F, Q : ndarray, shape (21, 21)
        Transition of the errors over all increments, and their new covariance.
    rate_radps : ndarray, shape (3,)
        Mean angular rate with respect to inertial space of the last 0.1 s or more, body axes, corrected; 0
        where there were no increments.
    force_mps2 : ndarray, shape (3,)
        Specific force, likewise.
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    C: FloatArray
    F: FloatArray
    Q: FloatArray
    rate_radps: FloatArray
    force_mps2: FloatArray


def mechanise(
    position_m: FloatArray,
    velocity_mps: FloatArray,
    C: FloatArray,
    dt_s: FloatArray,
    angle_rad: FloatArray,
    velocity_inc_mps: FloatArray,
    errors: FloatArray,
    densities: FloatArray,
) -> Step:
    """Integrate increments of an inertial measurement unit.

    Attitude by exact rotation vectors with the coning term, velocity with those of rotation and sculling from
    pairs of increments (Savage 1998), gravity and Coriolis at the middle of each increment, position by the
    trapezoid.

    Parameters
    ----------
    position_m, velocity_mps : ndarray, shape (3,)
        ECEF, of the unit, at the start.
    C : ndarray, shape (3, 3)
        Body axes to ECEF at the start.
    dt_s : ndarray, shape (n,)
        Durations of the increments, which follow one another.
    angle_rad, velocity_inc_mps : ndarray, shape (n, 3)
        As measured, body axes.
    errors : ndarray, shape (12,)
        Gyroscope bias (rad/s), accelerometer bias (m/s^2), gyroscope scale, accelerometer scale.
    densities : ndarray, shape (4,)
        Spectral densities of the white noise of gyroscopes and accelerometers, and of their biases' walks.

    Returns
    -------
    Step
    """
    x = np.concatenate([position_m, velocity_mps])
    turn = np.array(C, dtype=np.float64)
    n = len(dt_s)
    dt = np.array(dt_s, dtype=np.float64)
    theta, u = _corrected(dt, angle_rad, velocity_inc_mps, errors)
    F, Q, mean = np.eye(N), np.zeros((N, N)), np.zeros((2, 3))
    if n:
        gain = 1.0 / (1.0 + np.array(errors[6:], dtype=np.float64))
        _integrate(x, turn, dt, theta, u, gain, np.array(densities, dtype=np.float64), F, Q)
        first = n - 1 - int(np.searchsorted(np.cumsum(dt[::-1]), MEAN_S * (1.0 - 1e-6)).clip(0, n - 1))
        mean = np.array([theta[first:].sum(axis=0), u[first:].sum(axis=0)]) / dt[first:].sum()
    return Step(x[:3], x[3:], turn, F, Q, mean[0], mean[1])


def _corrected(
    dt: FloatArray, angle_rad: FloatArray, velocity_mps: FloatArray, errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the increments without biases and scale factors."""
    theta = (angle_rad - dt[:, None] * errors[:3]) / (1.0 + errors[6:9])
    return theta, (velocity_mps - dt[:, None] * errors[3:6]) / (1.0 + errors[9:])


@njit(cache=True, nogil=True)
def _integrate(
    x: FloatArray,
    C: FloatArray,
    dt: FloatArray,
    theta: FloatArray,
    u: FloatArray,
    gain: FloatArray,
    densities: FloatArray,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    """Move position and velocity `x`, attitude `C`, `F` and `Q`, in place, over all increments."""
    G = gravity_gradient(x[0], x[1], x[2])
    turn, mean, nu = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    P, V = np.zeros((3, N)), np.zeros((3, N))
    q, other = np.zeros((NOISY, NOISY)), np.empty((NOISY, NOISY))
    pushed = np.empty((2, 3, NOISY))
    rv, s, a = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(dt)):
        _pair(dt, theta, u, k, rv, s)
        _times_half_turn(C, rv, mean)
        for i in range(3):
            a[i] = C[i, 0] * s[0] + C[i, 1] * s[1] + C[i, 2] * s[2]
            for j in range(3):
                P[i, 9 + j] = -mean[i, j] * gain[j] * dt[k]
                P[i, 15 + j] = -mean[i, j] * gain[j] * theta[k, j]
                V[i, 12 + j] = -mean[i, j] * gain[3 + j] * dt[k]
                V[i, 18 + j] = -mean[i, j] * gain[3 + j] * u[k, j]
        _carry(F, P, V, a, G, dt[k])
        _carry_noise(q, other, pushed, P, V, a, G, dt[k], densities)
        _move(x, a, dt[k])
        _turn(C, rv, dt[k], turn, nu)
    _orthonormalise(C)
    Q[:NOISY, :NOISY] = q


@njit(cache=True, nogil=True)
def _pair(dt: FloatArray, theta: FloatArray, u: FloatArray, k: int, rv: FloatArray, s: FloatArray) -> None:
    """Put the rotation vector of increment `k` into `rv` and its change of velocity, in the axes of its
    start, into `s`.

    Rate and force are taken as linear over the increment and its neighbour: the one before, or after the
    first. Coning is ``theta' x theta / 12``, sculling ``(theta' x u + u' x theta) / 12`` for equal durations.
    """
    t0, t1, t2 = theta[k]
    u0, u1, u2 = u[k]
    rv[0], rv[1], rv[2] = t0, t1, t2
    s[0] = u0 + 0.5 * (t1 * u2 - t2 * u1)
    s[1] = u1 + 0.5 * (t2 * u0 - t0 * u2)
    s[2] = u2 + 0.5 * (t0 * u1 - t1 * u0)
    j = k - 1 if k > 0 else 1
    if j >= len(dt):
        return
    w = dt[k] * dt[k] / (6.0 * dt[j] * (dt[j] + dt[k])) * (1.0 if j < k else -1.0)
    p0, p1, p2 = theta[j]
    v0, v1, v2 = u[j]
    rv[0] += w * (p1 * t2 - p2 * t1)
    rv[1] += w * (p2 * t0 - p0 * t2)
    rv[2] += w * (p0 * t1 - p1 * t0)
    s[0] += w * (p1 * u2 - p2 * u1 + v1 * t2 - v2 * t1)
    s[1] += w * (p2 * u0 - p0 * u2 + v2 * t0 - v0 * t2)
    s[2] += w * (p0 * u1 - p1 * u0 + v0 * t1 - v1 * t0)


@njit(cache=True, nogil=True)
def _move(x: FloatArray, a: FloatArray, dt: float) -> None:
    """Move position and velocity by the change of velocity `a` (ECEF, axes of the start) and gravity."""
    h, w = 0.5 * dt, EARTH_RATE * dt
    g = gravity(x[0] + h * x[3], x[1] + h * x[4], x[2] + h * x[5])
    # The axes turn under the change by half the Earth's turn.
    d0, d1, d2 = a[0] + 0.5 * w * a[1] + dt * g[0], a[1] - 0.5 * w * a[0] + dt * g[1], a[2] + dt * g[2]
    m0, m1 = x[3] + 0.5 * d0 + w * x[4], x[4] + 0.5 * d1 - w * x[3]
    v0, v1, v2 = x[3] + d0 + 2.0 * w * m1, x[4] + d1 - 2.0 * w * m0, x[5] + d2
    x[0] += h * (x[3] + v0)
    x[1] += h * (x[4] + v1)
    x[2] += h * (x[5] + v2)
    x[3], x[4], x[5] = v0, v1, v2


@njit(cache=True, nogil=True)
def _turn(C: FloatArray, rv: FloatArray, dt: float, turn: FloatArray, nu: FloatArray) -> None:
    """Turn the attitude by a rotation vector in body axes, and back by what the Earth turned."""
    _rotate(rv, turn)
    c, s = cos(EARTH_RATE * dt), sin(EARTH_RATE * dt)
    for i in range(3):
        for j in range(3):
            nu[i, j] = C[i, 0] * turn[0, j] + C[i, 1] * turn[1, j] + C[i, 2] * turn[2, j]
    for j in range(3):
        C[0, j] = c * nu[0, j] + s * nu[1, j]
        C[1, j] = c * nu[1, j] - s * nu[0, j]
        C[2, j] = nu[2, j]


@njit(cache=True, nogil=True)
def _rotate(v: FloatArray, out: FloatArray) -> None:
    """Put the rotation about `v` into `out`."""
    x, y, z = v
    square = x * x + y * y + z * z
    if square > 1e-8:
        angle = sqrt(square)
        f, h = sin(angle) / angle, sin(0.5 * angle) / angle
        g = 2.0 * h * h
    else:
        f, g = 1.0 - square / 6.0, 0.5 - square / 24.0
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - g * (y * y + z * z), g * x * y - f * z, g * x * z + f * y
    out[1, 0], out[1, 1], out[1, 2] = g * x * y + f * z, 1.0 - g * (x * x + z * z), g * y * z - f * x
    out[2, 0], out[2, 1], out[2, 2] = g * x * z - f * y, g * y * z + f * x, 1.0 - g * (x * x + y * y)


@njit(cache=True, nogil=True)
def _times_half_turn(C: FloatArray, rv: FloatArray, out: FloatArray) -> None:
    """Put ``C (I + [rv x] / 2)`` into `out`: the mean attitude of an increment."""
    x, y, z = 0.5 * rv[0], 0.5 * rv[1], 0.5 * rv[2]
    for i in range(3):
        c0, c1, c2 = C[i]
        out[i, 0] = c0 + c1 * z - c2 * y
        out[i, 1] = c1 + c2 * x - c0 * z
        out[i, 2] = c2 + c0 * y - c1 * x


@njit(cache=True, nogil=True)
def _carry(M: FloatArray, P: FloatArray, V: FloatArray, a: FloatArray, G: FloatArray, dt: float) -> None:
    """Carry columns of errors of position, velocity and attitude (the first 9 rows of `M`) over an increment.

    Parameters
    ----------
    M : ndarray, shape (9 or more, n)
        Changed in place.
    P, V : ndarray, shape (3, n)
        Errors of the increment's angle and change of velocity, ECEF axes.
    a : ndarray, shape (3,)
        The change of velocity, ECEF.
    G : ndarray, shape (3, 3)
        Gradient of gravity.
    dt : float
    """
    h, w = 0.5 * dt, EARTH_RATE * dt
    a0, a1, a2 = a[0], a[1], a[2]
    G0, G1, G2 = dt * G[0], dt * G[1], dt * G[2]
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = (
        G0[0], G0[1], G0[2], G1[0], G1[1], G1[2], G2[0], G2[1], G2[2]
    )  # fmt: skip
    for j in range(M.shape[1]):
        v0, v1, v2 = M[3, j], M[4, j], M[5, j]
        r0, r1, r2 = M[0, j] + h * v0, M[1, j] + h * v1, M[2, j] + h * v2
        f0, f1, f2 = M[6, j] + 0.5 * P[0, j], M[7, j] + 0.5 * P[1, j], M[8, j] + 0.5 * P[2, j]
        d0 = g00 * r0 + g01 * r1 + g02 * r2 - (a1 * f2 - a2 * f1) + V[0, j]
        d1 = g10 * r0 + g11 * r1 + g12 * r2 - (a2 * f0 - a0 * f2) + V[1, j]
        d2 = g20 * r0 + g21 * r1 + g22 * r2 - (a0 * f1 - a1 * f0) + V[2, j]
        n0, n1 = v0 + d0 + 2.0 * w * (v1 + 0.5 * d1), v1 + d1 - 2.0 * w * (v0 + 0.5 * d0)
        M[0, j] += h * (v0 + n0)
        M[1, j] += h * (v1 + n1)
        M[2, j] += h * (v2 + v2 + d2)
        M[3, j], M[4, j], M[5, j] = n0, n1, v2 + d2
        p0, p1 = M[6, j], M[7, j]
        M[6, j] = p0 + w * p1 + P[0, j]
        M[7, j] = p1 - w * p0 + P[1, j]
        M[8, j] += P[2, j]


@njit(cache=True, nogil=True)
def _carry_noise(
    q: FloatArray,
    other: FloatArray,
    pushed: FloatArray,
    P: FloatArray,
    V: FloatArray,
    a: FloatArray,
    G: FloatArray,
    dt: float,
    densities: FloatArray,
) -> None:
    """Carry the covariance `q` over an increment, half of whose noise comes before it and half after it."""
    _add_noise(q, 0.5 * dt, densities)
    _push(q, pushed, P, V)
    _carry(q, pushed[0], pushed[1], a, G, dt)
    for i in range(NOISY):
        for j in range(NOISY):
            other[j, i] = q[i, j]
    _push(other, pushed, P, V)
    _carry(other, pushed[0], pushed[1], a, G, dt)
    for i in range(NOISY):
        for j in range(NOISY):
            q[i, j] = 0.5 * (other[i, j] + other[j, i])
    _add_noise(q, 0.5 * dt, densities)


@njit(cache=True, nogil=True)
def _add_noise(q: FloatArray, dt: float, densities: FloatArray) -> None:
    for i in range(3):
        q[3 + i, 3 + i] += dt * densities[1]
        q[6 + i, 6 + i] += dt * densities[0]
        q[9 + i, 9 + i] += dt * densities[2]
        q[12 + i, 12 + i] += dt * densities[3]


@njit(cache=True, nogil=True)
def _push(q: FloatArray, pushed: FloatArray, P: FloatArray, V: FloatArray) -> None:
    """Put what columns of bias errors do to an increment into `pushed` (angle, velocity)."""
    for i in range(3):
        for j in range(NOISY):
            pushed[0, i, j] = P[i, 9] * q[9, j] + P[i, 10] * q[10, j] + P[i, 11] * q[11, j]
            pushed[1, i, j] = V[i, 12] * q[12, j] + V[i, 13] * q[13, j] + V[i, 14] * q[14, j]


@njit(cache=True, nogil=True)
def _orthonormalise(C: FloatArray) -> None:
    """Take one Newton step towards the nearest rotation, in place."""
    S = 1.5 * np.eye(3) - 0.5 * (C.T.copy() @ C)
    C[:] = C @ S
