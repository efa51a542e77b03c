"""Coarse alignment: level from what is felt of gravity, heading from the course or as given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.kernels.rotations import attitude_angles, cross, from_angles, rotation
from pntegrity.records import FloatArray, Inertial
from pntegrity.states import freeze

__all__ = ["Aligned", "Alignment", "aligned", "felt"]

GRAVITY_MPS2 = 9.81
EARTH_RATE_RADPS = 7.3e-5
#: Below this speed and this mean rate of turn a vehicle is taken to stand.
STILL_MPS, STILL_RADPS = 0.5, 0.03
#: A course tells the heading above this speed, where the velocity is known this many times better.
COURSE_MPS, COURSE_SIGMA = 1.0, 8.0
#: Heading against course (side slip, mounting), heading as given, level at best: standard deviations, rad.
SLIP_RAD, GIVEN_RAD, LEVEL_RAD = np.deg2rad([5.0, 2.0, 0.2]).tolist()
#: Level is never thought better known than this after an acceleration of unknown direction, rad.
WORST_LEVEL_RAD = float(np.deg2rad(8.0))


@dataclass(frozen=True, eq=False)
class Alignment:
    """What is known of the attitude before a filter can start.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        Body to a level frame: z up, y wherever the body pointed when it was levelled last.
    force_mps : ndarray, shape (3,)
        Specific force in that frame, integrated since.
    time_s : float
        For how long.
    turned_rad : ndarray, shape (3,)
        Angular rate integrated while standing, body axes, over `still_s`.
    """

    C: FloatArray = field(default_factory=lambda: np.eye(3))
    force_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    time_s: float = 0.0
    turned_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    still_s: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "C", "force_mps", "turned_rad")


@dataclass(frozen=True, eq=False)
class Aligned:
    """Attitude, body to east-north-up, its standard deviations east, north, up (rad), and the gyroscope bias
    with its own.
    """

    C: FloatArray
    sigma_rad: FloatArray
    gyro_bias_radps: FloatArray
    gyro_sigma_radps: float


def felt(known: Alignment | None, imu: Inertial, speed_mps: float) -> Alignment:
    """Return the alignment after increments, during which the vehicle went at a speed (nan: unknown)."""
    span = float(imu.dt_s.sum())
    turned, force = imu.angle_rad.sum(axis=0), imu.velocity_mps.sum(axis=0)
    still = speed_mps < STILL_MPS and float(np.linalg.norm(turned)) < STILL_RADPS * span
    if known is None or still:
        before, C = known or Alignment(), _level(force)
        if not still:
            return Alignment(C, C @ force, span)
        return Alignment(C, C @ force, span, before.turned_rad + turned, before.still_s + span)
    C, total = known.C, known.force_mps
    bias = known.turned_rad / known.still_s if known.still_s > 0.0 else np.zeros(3)
    for dt, angle, velocity in zip(imu.dt_s, imu.angle_rad, imu.velocity_mps, strict=True):
        total = total + C @ velocity
        C = C @ rotation(angle - bias * dt)
    return replace(known, C=C, force_mps=total, time_s=known.time_s + span)


def aligned(
    known: Alignment, options: InsOptions, velocity_enu_mps: FloatArray | None, sigma_mps: float
) -> Aligned | str:
    """Return the attitude, or why there is none yet.

    Parameters
    ----------
    known : Alignment
    options : InsOptions
    velocity_enu_mps : ndarray, shape (3,), or None
        Of the receiver, with a standard deviation of `sigma_mps`.
    """
    speed = 0.0 if velocity_enu_mps is None else float(np.hypot(*velocity_enu_mps[:2]))
    if options.heading_rad is not None:
        heading, sigma = options.heading_rad, GIVEN_RAD
    elif velocity_enu_mps is not None and speed > max(COURSE_MPS, COURSE_SIGMA * sigma_mps):
        heading = float(np.arctan2(velocity_enu_mps[0], velocity_enu_mps[1]))
        sigma = float(np.hypot(SLIP_RAD, sigma_mps / speed))
    else:
        return "waiting for a course of the GNSS velocity to tell the heading (or give one)"
    C = _tilted_back(known.force_mps) @ known.C
    turn = heading - float(attitude_angles(C)[2])
    C = rotation(np.array([0.0, 0.0, -turn])) @ C
    spec = options.spec
    tilt = float(spec.start_sigma()[3]) / GRAVITY_MPS2
    moved = min(speed / max(known.time_s, 1e-3) / GRAVITY_MPS2, WORST_LEVEL_RAD)
    level = float(np.sqrt(tilt**2 + moved**2 + LEVEL_RAD**2))
    return Aligned(C, np.array([level, level, sigma]), *_gyro_bias(known, options))


def _gyro_bias(known: Alignment, options: InsOptions) -> tuple[FloatArray, float]:
    """Return the bias that a standstill showed, where it tells more than the specification."""
    stated = float(options.spec.start_sigma()[0])
    if known.still_s <= 0.0:
        return np.zeros(3), stated
    seen = float(np.hypot(EARTH_RATE_RADPS, options.spec.gyro_noise_radps_rthz / np.sqrt(known.still_s)))
    seen = float(np.hypot(seen, options.spec.gyro_bias_radps))
    return (known.turned_rad / known.still_s, seen) if seen < stated else (np.zeros(3), stated)


def _level(force: FloatArray) -> FloatArray:
    """Return the rotation, body to a level frame with the body's heading, in which a force points up."""
    roll = float(np.arctan2(-force[1], -force[2]))
    pitch = float(np.arctan2(force[0], np.hypot(force[1], force[2])))
    return from_angles([roll, pitch, 0.0])


def _tilted_back(force: FloatArray) -> FloatArray:
    """Return the smallest rotation that turns a force upwards."""
    unit = force / max(float(np.linalg.norm(force)), 1e-9)
    up = np.array([0.0, 0.0, 1.0])
    axis = cross(unit, up)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3)
    return np.asarray(rotation(axis / sine * float(np.arctan2(sine, unit @ up))))
