"""Receiver trajectories: functions of time (seconds from the first epoch) to position and velocity, ECEF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray

__all__ = ["CIRCUIT", "Leg", "Trajectory", "car", "static", "straight"]

Trajectory = Callable[[float], tuple[FloatArray, FloatArray]]


def static(position_m: npt.ArrayLike) -> Trajectory:
    """Return a receiver that does not move, at ECEF position (3,)."""
    place, rest = np.array(position_m, dtype=np.float64), np.zeros(3)
    return lambda _t_s: (place, rest)


def straight(position_m: npt.ArrayLike, velocity_enu_mps: npt.ArrayLike) -> Trajectory:
    """Return a constant velocity, given in east, north, up at the position where it starts."""
    place = np.array(position_m, dtype=np.float64)
    velocity = enu_rotation(place).T @ np.asarray(velocity_enu_mps, dtype=np.float64)
    return lambda t_s: (place + t_s * velocity, velocity)


@dataclass(frozen=True)
class Leg:
    """A part of a drive: the speed goes linearly to `speed_mps`, the heading turns right by `turn_rad`."""

    duration_s: float
    speed_mps: float
    turn_rad: float = 0.0


#: A calm round in a town, 150 s: four right turns, a stop at a light and a bend, never above 1 m/s^2.
CIRCUIT = (
    Leg(9.0, 8.0), Leg(14.0, 8.0), Leg(5.0, 4.0), Leg(8.0, 4.0, np.pi / 2), Leg(7.0, 9.0), Leg(8.0, 9.0),
    Leg(10.0, 0.0), Leg(9.0, 0.0), Leg(8.0, 5.0), Leg(9.0, 5.0, np.pi / 2), Leg(8.0, 9.0, -0.3),
    Leg(10.0, 9.0, 0.3), Leg(6.0, 4.0), Leg(8.0, 4.0, np.pi / 2), Leg(10.0, 8.0), Leg(6.0, 4.0),
    Leg(15.0, 0.0, np.pi / 2),
)  # fmt: skip


def car(position_m: npt.ArrayLike, legs: Sequence[Leg] = CIRCUIT, heading_rad: float = 0.0) -> Trajectory:
    """Return a drive in the horizontal plane of its start, from standstill; the legs are repeated for ever.

    Parameters
    ----------
    position_m : array_like, shape (3,)
        Start, ECEF.
    legs : sequence of Leg
    heading_rad : float
        At the start, clockwise from north.
    """
    place = np.array(position_m, dtype=np.float64)
    to_ecef = enu_rotation(place).T
    if not legs or any(leg.duration_s <= 0.0 for leg in legs):
        raise ValueError("`legs` must not be empty, and each must last longer than 0 s")
    ends = np.cumsum([leg.duration_s for leg in legs])
    lap = _lap(legs)

    def at(t_s: float) -> tuple[FloatArray, FloatArray]:
        state = np.array([0.0, 0.0, 0.0, heading_rad])  # east, north, speed, heading
        laps, rest = divmod(max(t_s, 0.0), float(ends[-1]))
        for _ in range(int(laps)):
            state = _joined(state, lap)
        for leg in legs:
            if rest <= 0.0:
                break
            state = _move(state, leg, min(rest, leg.duration_s))
            rest -= leg.duration_s
        east, north, speed, heading = state
        velocity = speed * np.array([np.sin(heading), np.cos(heading), 0.0])
        return place + to_ecef @ np.array([east, north, 0.0]), to_ecef @ velocity

    return at


def _lap(legs: Sequence[Leg]) -> FloatArray:
    if legs[-1].speed_mps != 0.0:
        raise ValueError("the last leg must end at rest, as the first begins")
    state = np.zeros(4)
    for leg in legs:
        state = _move(state, leg, leg.duration_s)
    return state


def _joined(state: FloatArray, lap: FloatArray) -> FloatArray:
    """Return the state after a whole lap, which begins and ends at rest: a turn and a shift."""
    s, c = np.sin(state[3]), np.cos(state[3])
    east, north = c * lap[0] + s * lap[1], -s * lap[0] + c * lap[1]
    return np.array([state[0] + east, state[1] + north, 0.0, state[3] + lap[3]])


def _move(state: FloatArray, leg: Leg, t: float) -> FloatArray:
    """Return east, north, speed and heading after `t` seconds of a leg, exactly."""
    east, north, speed, heading = state
    a, w = (leg.speed_mps - speed) / leg.duration_s, leg.turn_rad / leg.duration_s
    after, turned = speed + a * t, heading + w * t
    if w == 0.0:
        way = (speed + 0.5 * a * t) * t
        return np.array([east + way * np.sin(heading), north + way * np.cos(heading), after, heading])
    s0, c0, s1, c1 = np.sin(heading), np.cos(heading), np.sin(turned), np.cos(turned)
    east += (speed * c0 - after * c1) / w + a * (s1 - s0) / w**2
    north += (after * s1 - speed * s0) / w + a * (c1 - c0) / w**2
    return np.array([east, north, after, turned])
