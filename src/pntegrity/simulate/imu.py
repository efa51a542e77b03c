"""What an inertial measurement unit feels on a motion, without and with errors."""

from __future__ import annotations

import numpy as np

from pntegrity.kernels.gravity import EARTH_RATE, gravities
from pntegrity.records import FloatArray, Inertial
from pntegrity.sensors.imu import ImuSpec
from pntegrity.simulate.motion import Motion

__all__ = ["increments", "with_errors"]

#: Nodes and weights of Gauss' quadrature in an increment, on 0 to 1.
NODES, WEIGHTS = (0.5 * a for a in np.polynomial.legendre.leggauss(2))
SPIN = np.array([0.0, 0.0, EARTH_RATE])


def increments(motion: Motion, start_ns: int, end_ns: int, rate_hz: float) -> Inertial:
    """Return the increments of angle and velocity of an error-free unit on a motion.

    The angular rate with respect to inertial space and the specific force ``C^T (a + 2 w x v - g)`` are
    integrated over each increment by two Gauss points.

    Parameters
    ----------
    motion : Motion
        Of the unit.
    start_ns, end_ns : int
        Begin of the first increment, end of the last.
    rate_hz : float
        Increments a second; the last is shorter where the time is no multiple of them.

    Raises
    ------
    ValueError
        Times outside of the motion, or none between them.
    """
    if not end_ns > start_ns or not rate_hz > 0.0:
        raise ValueError(f"no increments from {start_ns} to {end_ns} ns at {rate_hz} Hz")
    count = int(np.ceil((end_ns - start_ns) * 1e-9 * rate_hz - 1e-6))
    edges = start_ns + np.round(np.arange(count + 1) * (1e9 / rate_hz)).astype(np.int64)
    edges[-1] = end_ns
    dt = np.diff(edges) * 1e-9
    at = motion.seconds(edges)
    angle, velocity = np.zeros((count, 3)), np.zeros((count, 3))
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        rate, force = _felt(motion, at[:-1] + (0.5 + node) * dt)
        angle += weight * dt[:, None] * rate
        velocity += weight * dt[:, None] * force
    return Inertial(edges[1:], dt, angle, velocity)


def _felt(motion: Motion, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return angular rate with respect to inertial space and specific force, (n, 3), body axes."""
    here = motion.moments(seconds)
    force = here.acceleration_mps2 + 2.0 * np.cross(SPIN, here.velocity_mps) - gravities(here.position_m)
    to_body = np.swapaxes(here.C, 1, 2)
    return here.rate_radps + to_body @ SPIN, (to_body @ force[:, :, None])[:, :, 0]


def with_errors(inertial: Inertial, spec: ImuSpec, rng: np.random.Generator) -> tuple[Inertial, FloatArray]:
    """Return increments as a unit of some specification would measure them, and its true errors.

    ``measured = (1 + scale) true + bias dt + noise``: white noise, biases that start at
    `ImuSpec.start_sigma` and walk with the densities of `ImuSpec.densities`, constant scale factors. An
    increment feels the mean of the biases at its two ends.

    Parameters
    ----------
    inertial : Inertial
        Without errors.
    spec : ImuSpec
    rng : numpy.random.Generator

    Returns
    -------
    Inertial
    errors : ndarray, shape (n, 12)
        Gyroscope bias, accelerometer bias, gyroscope scale, accelerometer scale at the end of each increment.
    """
    n, root_dt = len(inertial.dt_s), np.sqrt(inertial.dt_s)[:, None]
    density = np.repeat(np.sqrt(spec.densities()), 3)
    start = spec.start_sigma() * rng.standard_normal(12)
    drawn = rng.standard_normal((n, 12)) * density * root_dt
    bias = start[:6] + np.cumsum(drawn[:, 6:], axis=0)
    felt = (bias - 0.5 * drawn[:, 6:]) * inertial.dt_s[:, None] + drawn[:, :6]
    angle = inertial.angle_rad * (1.0 + start[6:9]) + felt[:, :3]
    velocity = inertial.velocity_mps * (1.0 + start[9:]) + felt[:, 3:]
    errors = np.hstack([bias, np.broadcast_to(start[6:], (n, 6))])
    return Inertial(inertial.t_ns, inertial.dt_s, angle, velocity, inertial.reason), errors
