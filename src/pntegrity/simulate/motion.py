"""Smooth motions of a vehicle: position, velocity and attitude at any time, from a reference or a drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, PchipInterpolator, make_smoothing_spline
from scipy.spatial.transform import Rotation, RotationSpline

from pntegrity.formats.truth import Truth
from pntegrity.kernels.rotations import from_angles
from pntegrity.physics.frames import enu_rotations
from pntegrity.records import FloatArray
from pntegrity.simulate.trajectory import Trajectory

__all__ = ["Moment", "Motion", "motion_of", "motion_of_drive", "motion_through"]

#: What a motion keeps of a reference: frequencies below this, Hz, or below this part of its sampling rate.
CUTOFF_HZ, CUTOFF_PART = 1.0, 0.4
#: Slopes of a track (the pitch of a car) are kept below this, Hz.
SLOPE_HZ = 0.1
#: A course has a meaning above this speed, m/s, a slope above the second; below the third, nothing turns.
COURSE_MPS, SLOPE_MPS, STILL_MPS = 1.0, 3.0, 0.1
#: Knots of an attitude made from a course, and samples of a drive, per second.
KNOTS_HZ = 5.0
#: Attitudes that are closer in time than this are one: the first, s.
APART_S = 0.05


class Moment(NamedTuple):
    """A motion and its derivatives at n times, ECEF; the rate is that against ECEF, in body axes.

    Parameters
    ----------
    position_m, velocity_mps, acceleration_mps2 : ndarray, shape (n, 3)
    C : ndarray, shape (n, 3, 3)
        Body axes (forward, right, down) to ECEF.
    rate_radps : ndarray, shape (n, 3)
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    acceleration_mps2: FloatArray
    C: FloatArray
    rate_radps: FloatArray


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion whose velocity, acceleration and angular rate are continuous.

    Parameters
    ----------
    span_ns : tuple of int
        First and last time, ns of GPS time.
    origin_m : ndarray, shape (3,)
        ECEF.
    track : BSpline
        Seconds from the first time to ECEF differences from `origin_m`.
    attitude : RotationSpline
        Seconds from the first time to body axes in ECEF.
    """

    span_ns: tuple[int, int]
    origin_m: FloatArray
    track: BSpline
    attitude: RotationSpline

    def at(self, t_ns: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 3), velocities (n, 3), both ECEF, and attitudes (n, 3, 3), body axes to ECEF.

        Raises
        ------
        ValueError
            A time outside of `span_ns`.
        """
        s = self.seconds(t_ns)
        return self.origin_m + self.track(s), self.track(s, 1), self.attitude(s).as_matrix()

    def of_point(self, t_ns: npt.ArrayLike, arm_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (n, 3), ECEF, of a point of the body (an antenna).

        Parameters
        ----------
        t_ns : array_like of int, shape (n,)
        arm_m : array_like, shape (3,)
            From where the motion is described to the point; forward, right, down.
        """
        position, velocity, C = self.at(t_ns)
        arm = np.asarray(arm_m, dtype=np.float64)
        turning = np.cross(self.attitude(self.seconds(t_ns), 1), arm)
        return position + C @ arm, velocity + np.einsum("nij,nj->ni", C, turning)

    def moments(self, seconds: FloatArray) -> Moment:
        """Return the motion and its derivatives at times (n,) in seconds after the first."""
        track = self.track
        turn = self.attitude(seconds).as_matrix()
        return Moment(
            self.origin_m + track(seconds), track(seconds, 1), track(seconds, 2), turn,
            self.attitude(seconds, 1),
        )  # fmt: skip

    def seconds(self, t_ns: npt.ArrayLike) -> FloatArray:
        """Return times in seconds after the first, shape (n,); ValueError outside of `span_ns`."""
        t = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        first, last = self.span_ns
        if len(t) and not first <= t.min() <= t.max() <= last:
            raise ValueError(
                f"times {t.min()} to {t.max()} ns are not within the motion, {first} to {last} ns"
            )
        return np.asarray((t - first) * 1e-9)


def motion_of(truth: Truth, lever_arm_m: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Motion:
    """Return the smooth motion behind a reference trajectory.

    A smoothing spline through its positions keeps what is slower than 1 Hz, or 0.4 of its sampling rate:
    it passes the given points at some centimetres, and stands still where they only flicker. The attitude is
    the reference's; where that has none, the nose points along the way, up and down with its slope, without
    roll. Below 1 m/s the heading then turns with the way that is made, not with time: nothing turns on the
    spot. A car that backs up would be turned round: give the attitude.

    Parameters
    ----------
    truth : Truth
        At least 5 epochs. Epochs whose time repeats are left out; gaps are bridged.
    lever_arm_m : array_like, shape (3,)
        From the point that the motion shall describe (the IMU) to that of the reference (the antenna).

    Raises
    ------
    ValueError
        Fewer than 5 epochs, or no course where one is needed.
    """
    t_ns, first = np.unique(truth.t_ns, return_index=True)
    if len(t_ns) < 5:
        raise ValueError(f"a motion needs at least 5 epochs, the reference has {len(t_ns)}")
    s, position = (t_ns - t_ns[0]) * 1e-9, truth.position_m[first]
    track = _smooth(s, position - position[0])
    attitude = None if truth.attitude_rad is None else truth.attitude_rad[first]
    if attitude is not None and np.isfinite(attitude).all():
        knots, angles = s, _smooth(s, np.unwrap(attitude, axis=0))(s)
    else:
        knots, angles = _along_way(track, position[0], s)
    place = position[0] + track(knots)
    C = np.swapaxes(enu_rotations(place), 1, 2) @ from_angles(angles)
    arm = np.asarray(lever_arm_m, dtype=np.float64)
    if arm.any():
        track = _smooth(knots, place - position[0] - C @ arm)
    span = (int(t_ns[0]), int(t_ns[-1]))
    return Motion(span, position[0].copy(), track, RotationSpline(knots, Rotation.from_matrix(C)))


def motion_of_drive(drive: Trajectory, start_ns: int, seconds: float) -> Motion:
    """Return the smooth motion of a drive (`trajectory.car`), its nose along the way.

    Parameters
    ----------
    drive : Trajectory
        Its first second is at `start_ns`.
    start_ns : int
    seconds : float
        How long.
    """
    s = np.arange(round(seconds * KNOTS_HZ) + 1) / KNOTS_HZ
    position = np.array([drive(float(at))[0] for at in s])
    return motion_of(Truth(start_ns + np.round(s * 1e9).astype(np.int64), position))


def motion_through(track: Truth, attitude: Truth) -> Motion:
    """Return a smooth motion of positions and attitudes that are known at different times.

    Positions are smoothed as in `motion_of`. Attitudes are passed where they are known (of two closer than
    0.05 s the first), and between them roll, pitch and heading go from one to the next without overshoot
    (monotone cubics): what a vessel did there nobody knows.

    Parameters
    ----------
    track : Truth
        Positions, at least 5.
    attitude : Truth
        Attitudes, at least 2; the motion lasts from the first to the last, as far as there are positions.

    Raises
    ------
    ValueError
        Fewer than that in the time that both have in common.
    """
    begin = max(int(track.t_ns[0]), int(attitude.t_ns[0]))
    end = min(int(track.t_ns[-1]), int(attitude.t_ns[-1]))
    t_ns, first = np.unique(track.t_ns, return_index=True)
    turned, at = _apart(attitude, begin, end)
    if len(t_ns) < 5 or len(at) < 2:
        raise ValueError(
            f"a motion needs 5 positions and 2 attitudes in their common time, not {len(t_ns)} and {len(at)}"
        )
    begin, end = int(turned[0]), int(turned[-1])
    position = track.position_m[first]
    origin = position[0].copy()
    whole = _smooth(np.asarray((t_ns - begin) * 1e-9, dtype=np.float64), position - origin)
    known = np.asarray((turned - begin) * 1e-9, dtype=np.float64)
    knots, course = _knots(known), PchipInterpolator(known, np.unwrap(at, axis=0))
    C = np.swapaxes(enu_rotations(origin + whole(knots)), 1, 2) @ from_angles(course(knots))
    return Motion((begin, end), origin, whole, RotationSpline(knots, Rotation.from_matrix(C)))


def _apart(attitude: Truth, begin: int, end: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return times and attitudes that are known, from begin to end, no two too close to each other."""
    if attitude.attitude_rad is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    known = np.isfinite(attitude.attitude_rad).all(axis=1)
    rows, last = [], -(2**62)
    for i in np.flatnonzero(known & (attitude.t_ns >= begin) & (attitude.t_ns <= end)).tolist():
        if attitude.t_ns[i] - last >= round(APART_S * 1e9):
            rows.append(i)
            last = int(attitude.t_ns[i])
    return attitude.t_ns[rows], attitude.attitude_rad[rows]


def _knots(s: FloatArray) -> FloatArray:
    """Return times, rising, with more between them where they are far apart."""
    grid = np.arange(s[0], s[-1], 1.0 / KNOTS_HZ)
    nearest = np.abs(s[np.searchsorted(s, grid).clip(1, len(s) - 1)] - grid)
    before = np.abs(s[(np.searchsorted(s, grid) - 1).clip(0)] - grid)
    return np.sort(np.append(s, grid[np.minimum(nearest, before) > APART_S]))


def _smooth(s: FloatArray, values: FloatArray, cutoff_hz: float = CUTOFF_HZ) -> BSpline:
    """Return the smoothing spline (cubic, natural) that halves what oscillates at a frequency."""
    step = float(np.median(np.diff(s)))
    frequency = 2.0 * np.pi * min(cutoff_hz, CUTOFF_PART / step)
    return make_smoothing_spline(s, values, lam=1.0 / (step * frequency**4))


def _along_way(track: BSpline, origin_m: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return knots (m,) and roll, pitch, heading (m, 3) of a vehicle that goes where its nose points."""
    knots = np.linspace(s[0], s[-1], max(len(s), round((s[-1] - s[0]) * KNOTS_HZ) + 1))
    place = origin_m + track(knots)
    east, north, up = np.einsum("nij,nj->in", enu_rotations(place), track(knots, 1))
    speed = np.hypot(east, north)
    fast = speed > COURSE_MPS
    if not fast.any():
        raise ValueError(f"the reference never moves faster than {COURSE_MPS} m/s: it has no course")
    way = np.cumsum(np.where(speed > STILL_MPS, speed, 0.0))
    heading = np.interp(way, way[fast], np.unwrap(np.arctan2(east, north)[fast]))
    pitch = np.interp(way, way[fast], np.where(speed > SLOPE_MPS, np.arctan2(up, speed), 0.0)[fast])
    level = np.zeros(len(knots))
    smooth = _smooth(knots, pitch, SLOPE_HZ)(knots), _smooth(knots, heading)(knots)
    return knots, np.stack([level, *smooth], axis=1)
