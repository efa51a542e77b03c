"""Coarse alignment: level from what is felt of gravity, heading from the course or as given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.kernels.rotations import attitude_angles, cross, from_angles, rotation
from pntegrity.records import FloatArray, Inertial
from pntegrity.sensors.imu import ImuSpec
from pntegrity.states import freeze

__all__ = ["Aligned", "Alignment", "Velocity", "aligned", "felt", "heading_of"]

GRAVITY_MPS2 = 9.81
EARTH_RATE_RADPS = 7.3e-5
#: Below this speed and this mean rate of turn, and what the gyroscopes may show beside it (standard
#: deviations), a vehicle is taken to stand.
STILL_MPS, STILL_RADPS, STILL_SIGMA = 0.5, 0.005, 4.0
#: A course tells the heading above this speed, where the velocity is known this many times better.
COURSE_MPS, COURSE_SIGMA = 1.0, 8.0
#: Heading against course (side slip, mounting), heading as given, level at best: standard deviations, rad.
SLIP_RAD, GIVEN_RAD, LEVEL_RAD = np.deg2rad([5.0, 2.0, 0.2]).tolist()
#: Level is never thought better known than this after an acceleration of unknown direction, rad.
WORST_LEVEL_RAD = float(np.deg2rad(8.0))
#: What was felt before the velocity became known is forgotten where it is no more than this, s.
SHORT_S = 2.0


@dataclass(frozen=True, eq=False)
class Velocity:
    """Velocity of the receiver, east, north, up, and its standard deviation, m/s; how far the heading may be
    from its course beside side slip.
    """

    enu_mps: FloatArray
    sigma_mps: float
    turned_rad: float = 0.0

    @property
    def speed_mps(self) -> float:
        """Horizontal."""
        return float(np.hypot(self.enu_mps[0], self.enu_mps[1]))


@dataclass(frozen=True, eq=False)
class Alignment:
    """What is known of the attitude before a filter can start.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        Body to a level frame: z up, y where the body pointed at the first epoch.
    is_level : bool
        Whether there is such a frame yet.
    force_mps : ndarray, shape (3,)
        Specific force in that frame, integrated since it was levelled.
    time_s : float
        For how long.
    from_mps : ndarray, shape (3,), or None
        Velocity at the beginning of that time, east, north, up.
    turned_rad : ndarray, shape (3,)
        Angular rate integrated while standing, body axes, over `still_s`.
    carried_s : float
        For how long only gyroscopes have carried the heading since the first epoch.
    is_late : bool
        Whether a heading that was given for the first epoch says nothing any more.
    anchor : tuple, or None
        A fix some seconds ago: time (ns), ECEF position, heading in the level frame.
    """

    C: FloatArray = field(default_factory=lambda: np.eye(3))
    is_level: bool = False
    force_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    time_s: float = 0.0
    from_mps: FloatArray | None = None
    turned_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    still_s: float = 0.0
    carried_s: float = 0.0
    is_late: bool = False
    anchor: tuple[int, FloatArray, float] | None = None

    def __post_init__(self) -> None:
        freeze(self, "C", "force_mps", "turned_rad")
        if self.from_mps is not None:
            freeze(self, "from_mps")


@dataclass(frozen=True, eq=False)
class Aligned:
    """Attitude, body to east-north-up, its standard deviations east, north, up (rad), and the gyroscope bias
    with its own.
    """

    C: FloatArray
    sigma_rad: FloatArray
    gyro_bias_radps: FloatArray
    gyro_sigma_radps: float


def heading_of(known: Alignment) -> float:
    """Return how far the body has turned clockwise since the first epoch."""
    return float(attitude_angles(known.C)[2]) if known.is_level else 0.0


def felt(known: Alignment, imu: Inertial, velocity: Velocity | None, spec: ImuSpec) -> Alignment:
    """Return the alignment after the increments of an epoch, at whose end the velocity is as given."""
    span = float(imu.dt_s.sum())
    turned, force = imu.angle_rad.sum(axis=0), imu.velocity_mps.sum(axis=0)
    limit = STILL_RADPS + STILL_SIGMA * float(spec.start_sigma()[0])
    slow = velocity is not None and float(np.linalg.norm(velocity.enu_mps)) < STILL_MPS
    if slow and float(np.linalg.norm(turned)) < limit * span:
        C = _level(force, heading_of(known))
        known = replace(known, turned_rad=known.turned_rad + turned, still_s=known.still_s + span)
        return replace(known, C=C, is_level=True, force_mps=C @ force, time_s=span, from_mps=np.zeros(3))
    if not known.is_level:
        C = _level(force, 0.0)
        known = replace(known, C=C, is_level=True, force_mps=C @ force, time_s=span)
    else:
        known = _carried(known, imu, span)
    if known.from_mps is None and velocity is not None and known.time_s <= SHORT_S:
        return replace(known, force_mps=np.zeros(3), time_s=0.0, from_mps=velocity.enu_mps)
    return known


def _carried(known: Alignment, imu: Inertial, span_s: float) -> Alignment:
    """Return the alignment after increments of a vehicle that moves."""
    C, total = known.C, known.force_mps
    bias = known.turned_rad / known.still_s if known.still_s > 0.0 else np.zeros(3)
    for dt, angle, velocity in zip(imu.dt_s, imu.angle_rad, imu.velocity_mps, strict=True):
        total = total + C @ velocity
        C = C @ rotation(angle - bias * dt)
    return replace(
        known, C=C, force_mps=total, time_s=known.time_s + span_s, carried_s=known.carried_s + span_s
    )


def aligned(known: Alignment, options: InsOptions, velocity: Velocity | None) -> Aligned | str:
    """Return the attitude, or why there is none yet.

    Parameters
    ----------
    known : Alignment
        Levelled.
    options : InsOptions
    velocity : Velocity or None
    """
    bias, gyro_sigma = _gyro_bias(known, options.spec)
    found = _heading(known, options, velocity, gyro_sigma)
    if found is None:
        return "waiting for a course of the GNSS velocity to tell the heading (or give one)"
    turn, sigma = found
    yaw = rotation(np.array([0.0, 0.0, -turn]))
    C, level = yaw @ known.C, WORST_LEVEL_RAD
    if known.time_s > 0.0:
        change, unknown = _speeding(known, velocity, sigma)
        up = np.array([0.0, 0.0, GRAVITY_MPS2 * known.time_s])
        tilt = float(options.spec.start_sigma()[3]) / GRAVITY_MPS2
        drift = 0.5 * gyro_sigma * known.time_s
        moved = unknown / (known.time_s * GRAVITY_MPS2)
        if moved > WORST_LEVEL_RAD:  # so short a time that velocities tell nothing of accelerations
            change, moved = np.zeros(3), WORST_LEVEL_RAD
        C = _turning(yaw @ known.force_mps, up + change) @ C
        level = float(np.linalg.norm([tilt, drift, moved, LEVEL_RAD]))
    return Aligned(np.asarray(C), np.array([level, level, sigma]), bias, gyro_sigma)


def _heading(
    known: Alignment, options: InsOptions, velocity: Velocity | None, gyro_sigma: float
) -> tuple[float, float] | None:
    """Return by how much to turn the level frame clockwise, and its standard deviation; None: not known."""
    if options.heading_rad is not None and not known.is_late:
        return options.heading_rad, float(np.hypot(GIVEN_RAD, gyro_sigma * known.carried_s))
    if velocity is None or velocity.speed_mps <= max(COURSE_MPS, COURSE_SIGMA * velocity.sigma_mps):
        return None
    course = float(np.arctan2(velocity.enu_mps[0], velocity.enu_mps[1]))
    up = np.array([0.0, 0.0, 1.0])
    C = known.C if known.time_s == 0.0 else _turning(known.force_mps, up) @ known.C
    sigma = [SLIP_RAD, velocity.sigma_mps / velocity.speed_mps, velocity.turned_rad]
    return course - float(attitude_angles(C)[2]), float(np.linalg.norm(sigma))


def _speeding(known: Alignment, velocity: Velocity | None, heading_sigma: float) -> tuple[FloatArray, float]:
    """Return the change of velocity since the level frame was level, and how much of it is unknown."""
    if velocity is None:
        return np.zeros(3), np.inf
    if known.from_mps is None:
        return np.zeros(3), velocity.speed_mps
    change = np.asarray(velocity.enu_mps - known.from_mps)
    return change, float(np.hypot(np.sqrt(2.0) * velocity.sigma_mps, heading_sigma * np.hypot(*change[:2])))


def _gyro_bias(known: Alignment, spec: ImuSpec) -> tuple[FloatArray, float]:
    """Return the bias that a standstill showed, where it tells more than the specification."""
    stated = float(spec.start_sigma()[0])
    if known.still_s <= 0.0:
        return np.zeros(3), stated
    white = spec.gyro_noise_radps_rthz / np.sqrt(known.still_s)
    seen = float(np.linalg.norm([EARTH_RATE_RADPS, white, spec.gyro_bias_radps]))
    return (known.turned_rad / known.still_s, seen) if seen < stated else (np.zeros(3), stated)


def _level(force: FloatArray, heading_rad: float) -> FloatArray:
    """Return the rotation, body to a level frame with some heading, in which a force points up."""
    roll = float(np.arctan2(-force[1], -force[2]))
    pitch = float(np.arctan2(force[0], np.hypot(force[1], force[2])))
    return from_angles([roll, pitch, heading_rad])


def _turning(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the smallest rotation that turns one direction into another."""
    axis, along = cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine <= 1e-12 * float(np.linalg.norm(a) * np.linalg.norm(b)):
        return np.eye(3)
    return np.asarray(rotation(axis / sine * float(np.arctan2(sine, along))))
