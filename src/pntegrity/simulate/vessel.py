"""A ship with INS, GNSS, long and ultra-short baseline, as a linear model of its navigation errors.

The states are true minus nominal: position and velocity (m, m/s; north, east, down), small turns of the
attitude (``C_true = (I + [phi x]) C``), gyro and accelerometer biases (body axes; true = measured - bias) and
the receiver's clock. Jacobians are those of the nominal track, so that gains need no data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pntegrity.records import FloatArray, Layout
from pntegrity.simulate.linear import LinearModel

__all__ = ["STATES", "Course", "Vessel", "vessel_model"]

DEG = np.pi / 180.0
HOUR = 3600.0
GRAVITY = 9.80665
AXES = ("n", "e", "d")
STATES = Layout(
    tuple(f"{block}:{axis}" for block in ("pos", "vel", "att") for axis in AXES)
    + tuple(f"{block}:{axis}" for block in ("bg", "ba") for axis in "xyz")
    + ("clk", "drift")
)


@dataclass(frozen=True)
class Course:
    """A track at constant speed whose heading swings: position (n, 3), acceleration (n, 3), heading (n,)."""

    t_s: FloatArray
    position_m: FloatArray
    acceleration_mps2: FloatArray
    heading_rad: FloatArray

    @staticmethod
    def of(geometry: Mapping[str, Any], t_s: FloatArray) -> Course:
        """Return the course at some times, which begin one step after its start."""
        w, speed = 2.0 * np.pi / geometry["weave_s"], geometry["speed_mps"]
        swing = geometry["weave_deg"] * DEG
        fine = np.linspace(0.0, float(t_s[-1]), 20 * len(t_s) + 1)

        def heading(t: FloatArray) -> FloatArray:
            return np.asarray(geometry["heading_deg"] * DEG + swing * np.sin(w * t))

        way = speed * np.stack([np.cos(heading(fine)), np.sin(heading(fine)), np.zeros(len(fine))], axis=1)
        steps = 0.5 * (way[1:] + way[:-1]) * np.diff(fine)[:, None]
        run = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]) + geometry["start_ned_m"]
        psi = heading(t_s)
        turn = speed * swing * w * np.cos(w * t_s)
        acceleration = turn[:, None] * np.stack([-np.sin(psi), np.cos(psi), np.zeros(len(psi))], axis=1)
        position = np.stack([np.interp(t_s, fine, run[:, i]) for i in range(3)], axis=1)
        return Course(t_s, position, acceleration, psi)


@dataclass(frozen=True)
class Vessel:
    """What is on board and how well it measures: tables as in ``scenarios/multi_level.toml``.

    Parameters
    ----------
    geometry, start, clock, ins : mapping
    noise : mapping
        One set of standard deviations; a rate of 0: no rows of rates.
    rate_hz, duration_s : float
    """

    geometry: Mapping[str, Any]
    start: Mapping[str, float]
    clock: Mapping[str, float]
    ins: Mapping[str, float]
    noise: Mapping[str, float]
    rate_hz: float = 2.0
    duration_s: float = 200.0

    @property
    def epochs(self) -> int:
        """How many there are."""
        return round(self.rate_hz * self.duration_s)

    @cached_property
    def course(self) -> Course:
        """The nominal track."""
        times = np.asarray((1.0 + np.arange(self.epochs)) / self.rate_hz, dtype=np.float64)
        return Course.of(self.geometry, times)

    @cached_property
    def transponder_m(self) -> FloatArray:
        """Where the transponder is, NED: as far from the ship at 50 s as the table says."""
        near = int(np.argmin(np.abs(self.course.t_s - 50.0)))
        return np.asarray(self.course.position_m[near] + self.geometry["transponder_from_ship_ned_m"])

    def unit(self, name: str) -> float:
        """Return what a size in ``"m"``, ``"s"`` or ``"deg"`` is multiplied by to be in units of its row."""
        return {"m": 1.0, "s": float(self.geometry["sound_mps"]), "deg": DEG}[name]


def vessel_model(vessel: Vessel) -> LinearModel:
    """Return the linear model: `F`, `Q` and `H` one an epoch, `R` constant."""
    F, Q = _steps(vessel)
    rows = [_gnss(vessel), _lbl(vessel), _usbl(vessel)]
    keys = tuple(k for own, _, _ in rows for k in own)
    H = np.concatenate([h for _, h, _ in rows], axis=1)
    R = np.diag(np.concatenate([s for _, _, s in rows]) ** 2)
    return LinearModel(F, Q, H, R, _start(vessel), keys, STATES, 1.0 / vessel.rate_hz)


def _start(vessel: Vessel) -> FloatArray:
    s, ins = vessel.start, vessel.ins
    level, heading = s["level_deg"] * DEG, s["heading_deg"] * DEG
    sigma = [s["position_m"]] * 3 + [s["velocity_mps"]] * 3 + [level, level, heading]
    sigma += [ins["gyro_bias_deg_h"] * DEG / HOUR] * 3 + [ins["accel_bias_mps2"]] * 3
    return np.diag(np.array([*sigma, s["clock_m"], s["clock_drift_mps"]]) ** 2)


def _steps(vessel: Vessel) -> tuple[FloatArray, FloatArray]:
    """Return transition and process noise into each epoch, shapes (epochs, 17, 17)."""
    course, dt, ins, clock = vessel.course, 1.0 / vessel.rate_hz, vessel.ins, vessel.clock
    density = np.zeros(17)
    density[3:6] = ins["accel_random_walk_mps_sqrt_s"] ** 2
    density[6:9] = (ins["gyro_random_walk_deg_sqrt_h"] * DEG) ** 2 / HOUR
    density[9:12] = (ins["gyro_bias_walk_deg_h_sqrt_h"] * DEG / HOUR) ** 2 / HOUR
    density[12:15] = ins["accel_bias_walk_mps2_sqrt_h"] ** 2 / HOUR
    density[15], density[16] = clock["walk_m"] ** 2, clock["drift_mps"] ** 2
    F, Q = np.empty((vessel.epochs, 17, 17)), np.empty((vessel.epochs, 17, 17))
    for k in range(vessel.epochs):
        A = _dynamics(course.heading_rad[k], course.acceleration_mps2[k])
        F[k] = np.eye(17) + A * dt + A @ A * (0.5 * dt**2)
        half = np.eye(17) + A * (0.5 * dt)
        Q[k] = (half * (density * dt)) @ half.T
        Q[k] = 0.5 * (Q[k] + Q[k].T)
    return F, Q


def _dynamics(heading: float, acceleration: FloatArray) -> FloatArray:
    C, force = _level(heading), acceleration - np.array([0.0, 0.0, GRAVITY])
    A = np.zeros((17, 17))
    A[0:3, 3:6] = np.eye(3)
    A[3:6, 6:9], A[3:6, 12:15] = -_cross(force), -C
    A[6:9, 9:12] = -C
    A[15, 16] = 1.0
    return A


def _gnss(vessel: Vessel) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return keys, Jacobian (epochs, m, 17) and sigmas of the satellites."""
    g, noise = vessel.geometry, vessel.noise
    az, el = (np.array(g[f"satellites_{name}_deg"]) * DEG for name in ("azimuth", "elevation"))
    toward = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el)], axis=1)
    n, rates = len(az), noise["pseudorange_rate_mps"] > 0.0
    H = np.zeros((2 * n if rates else n, 17))
    H[:n, :3], H[:n, 15] = -toward, 1.0
    sigma = np.full(len(H), noise["pseudorange_m"])
    if rates:
        H[n:, 3:6], H[n:, 16], sigma[n:] = -toward, 1.0, noise["pseudorange_rate_mps"]
    keys = tuple(f"gnss:{kind}.G{i + 1:02d}" for kind in ("RD" if rates else "R") for i in range(n))
    return keys, np.broadcast_to(H, (vessel.epochs, *H.shape)), sigma


def _lbl(vessel: Vessel) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return keys, Jacobian and sigmas of the one-way ranges to the beacons."""
    beacons = np.array(vessel.geometry["beacons_ned_m"])
    away = vessel.course.position_m[:, None] - beacons
    H = np.zeros((vessel.epochs, len(beacons), 17))
    H[:, :, :3] = away / np.linalg.norm(away, axis=2, keepdims=True)
    sigma = np.full(len(beacons), vessel.noise["lbl_time_s"] * vessel.unit("s"))
    return tuple(f"lbl:R.AP{i + 1}" for i in range(len(beacons))), H, sigma


def _usbl(vessel: Vessel) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return keys, Jacobian and sigmas of range, bearing and elevation of the transponder in body axes."""
    H = np.zeros((vessel.epochs, 3, 17))
    for k in range(vessel.epochs):
        d = vessel.transponder_m - vessel.course.position_m[k]
        C = _level(vessel.course.heading_rad[k])
        angles = _of_body(C.T @ d)  # range, bearing, elevation by the vector in body axes
        H[k, :, :3], H[k, :, 6:9] = -angles @ C.T, angles @ C.T @ _cross(d)
    angle = vessel.noise["usbl_angle_deg"] * DEG
    sigma = np.array([vessel.noise["usbl_time_s"] * vessel.unit("s"), angle, angle])
    return ("usbl:R.range", "usbl:A.bearing", "usbl:A.elevation"), H, sigma


def _of_body(b: FloatArray) -> FloatArray:
    """Return the derivatives of range, bearing and elevation by a vector in body axes, shape (3, 3)."""
    r, flat = float(np.linalg.norm(b)), float(np.hypot(b[0], b[1]))
    return np.array([
        b / r,
        [-b[1] / flat**2, b[0] / flat**2, 0.0],
        [-b[0] * b[2] / (r**2 * flat), -b[1] * b[2] / (r**2 * flat), flat / r**2],
    ])  # fmt: skip


def _level(heading: float) -> FloatArray:
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _cross(v: Sequence[float] | FloatArray) -> FloatArray:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
