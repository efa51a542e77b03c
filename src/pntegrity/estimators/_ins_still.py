"""A vehicle that stands: what its IMU shows of it, and the rows of a velocity of zero."""

from __future__ import annotations

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators._ins_solution import mean_of
from pntegrity.estimators._navigation import ANGLES, Stack
from pntegrity.records import FloatArray, Inertial, State

__all__ = ["KEYS", "standing", "zero_velocity"]

KEYS = ("zupt:DX", "zupt:DY", "zupt:DZ")
#: Shaking and turning of a vehicle that stands, its engine on: per sample and in the mean.
SHAKEN_MPS2, SHAKEN_RADPS, TURNING_RADPS = 0.15, 0.02, 0.01
#: Shortest time that tells, s; white noise of samples is allowed for with so many standard deviations.
LEAST_S, ALLOWED_SIGMA = 0.08, 3.0
#: What a standing vehicle may move, m/s; the filter must not be sure of more than this and three sigma.
STILL_MPS, MOVING_MPS = 0.02, 1.0


def standing(imu: Inertial | None, prior: State, options: InsOptions) -> bool:
    """Tell whether the increments of an epoch are those of a vehicle that stands.

    Parameters
    ----------
    imu : Inertial or None
    prior : State
        Of the filter: a steady drive on a straight road shakes little too, so its velocity must be small.
    options : InsOptions
    """
    if not options.zero_velocity or imu is None or float(imu.dt_s.sum()) < LEAST_S or len(imu.dt_s) < 4:
        return False
    velocity, spread = prior.block("vel")
    speed = float(np.linalg.norm(velocity))
    if speed > MOVING_MPS + 3.0 * float(np.sqrt(np.trace(spread))):
        return False
    dt, spec = imu.dt_s[:, None], options.spec
    force, rate = imu.velocity_mps / dt, imu.angle_rad / dt - mean_of(prior, "bg")
    white = ALLOWED_SIGMA / np.sqrt(float(imu.dt_s.mean()))
    calm = force.std(axis=0).max() < SHAKEN_MPS2 + white * spec.accel_noise_mps2_rthz
    level = rate.std(axis=0).max() < SHAKEN_RADPS + white * spec.gyro_noise_radps_rthz
    return bool(calm and level and np.abs(rate.mean(axis=0)).max() < TURNING_RADPS)


def zero_velocity(prior: State) -> Stack:
    """Return the rows of a velocity of zero."""
    H = np.zeros((3, len(prior)))
    H[range(3), prior.layout.block("vel")] = 1.0
    none: dict[str, FloatArray] = {name: np.full(3, np.nan) for name in ANGLES}
    return Stack(KEYS, -mean_of(prior, "vel"), H, np.full(3, STILL_MPS**2), none)
