"""What an inertial filter's state holds beside its mean, and what a navigator reads from it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pntegrity.kernels.factor_set import FactorMemory
from pntegrity.kernels.rotations import attitude_angles, cross, rotation, skew
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray, State, Update
from pntegrity.states import freeze

__all__ = [
    "Aside", "InsSolution", "antenna", "antenna_of", "arm_slopes", "attitude_now", "inertial_names",
    "mean_of", "solution_of", "with_aside",
]  # fmt: skip

AXES = ("x", "y", "z")


def inertial_names(scale_factors: bool) -> tuple[str, ...]:
    """Return the names of the states of attitude and of the IMU's errors."""
    kinds = ("att", "bg", "ba", "sg", "sa") if scale_factors else ("att", "bg", "ba")
    return tuple(f"{kind}:{axis}" for kind in kinds for axis in AXES)


@dataclass(frozen=True, eq=False)
class Aside:
    """What stands beside the mean.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        Attitude (body to ECEF) about which the mean's ``att`` turns.
    rate_radps : ndarray, shape (3,)
        Angular rate of the body with respect to the Earth, body axes.
    arm_m : ndarray, shape (3,)
        From the IMU to the antenna, body axes.
    factors : FactorMemory
        Residuals that factor-set detection has seen.
    refused_since_ns : int or None
        Since when most pseudoranges have been refused.
    """

    C: FloatArray
    rate_radps: FloatArray
    arm_m: FloatArray
    factors: FactorMemory
    refused_since_ns: int | None = None

    def __post_init__(self) -> None:
        freeze(self, "C", "rate_radps", "arm_m")

    def with_(self, **changes: object) -> Aside:
        """Return the same with other fields."""
        return replace(self, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class InsSolution:
    """Position of the antenna and velocity of the IMU, ECEF, and the attitude: roll, pitch, heading with
    standard deviations.
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    attitude_rad: FloatArray
    attitude_sigma_rad: FloatArray


def antenna_of(
    position_m: FloatArray, velocity_mps: FloatArray, aside: Aside
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of the antenna, ECEF, from those of the IMU."""
    swing = aside.C @ cross(aside.rate_radps, aside.arm_m)
    return position_m + aside.C @ aside.arm_m, velocity_mps + swing


def antenna(prior: State) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of the antenna at a prior, whose attitude is that beside it."""
    return antenna_of(prior.mean[:3], prior.mean[3:6], prior.aside)


def arm_slopes(aside: Aside) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return how the lever arm moves the antenna: its position with the attitude, its velocity with attitude,
    gyroscope bias and gyroscope scale, shapes (3, 3).
    """
    C, arm, rate = aside.C, aside.arm_m, aside.rate_radps
    swing = C @ skew(arm)
    return -skew(C @ arm), -skew(C @ cross(rate, arm)), swing, swing * rate


def with_aside(update: Update, aside: Aside) -> Update:
    """Return the update with something else beside the posterior, which no gain depends on."""
    return update.altered(posterior=replace(update.posterior, aside=aside))


def attitude_now(state: State) -> FloatArray:
    """Return the attitude, body to ECEF, shape (3, 3)."""
    return np.asarray(rotation(mean_of(state, "att")) @ state.aside.C)


def mean_of(state: State, kind: str) -> FloatArray:
    """Return the mean of the states of a kind (`State.block` without their covariance)."""
    return np.asarray(state.mean[state.layout.block(kind)])


def solution_of(state: State) -> InsSolution | None:
    """Return what an inertial filter's state says; None for a state without an attitude.

    Parameters
    ----------
    state : State
        A posterior of ``gnss_ins``.
    """
    if not len(state) or not isinstance(state.aside, Aside):
        return None
    C = attitude_now(state)
    antenna = mean_of(state, "pos") + C @ state.aside.arm_m
    to_enu = enu_rotation(antenna)
    angles = attitude_angles(to_enu @ C)
    spread = to_enu @ state.block("att")[1] @ to_enu.T
    turn = _angle_jacobian(angles)
    sigma = np.sqrt(np.maximum(np.diagonal(turn @ spread @ turn.T), 0.0))
    return InsSolution(antenna, mean_of(state, "vel"), angles, sigma)


def _angle_jacobian(angles: FloatArray) -> FloatArray:
    """Return how roll, pitch and heading change with a small turn about east, north, up, shape (3, 3)."""
    _, pitch, heading = angles
    c, s = np.cos(heading), np.sin(heading)
    cp = max(float(np.cos(pitch)), 1e-6)
    t = np.tan(pitch)
    return np.array([[s / cp, c / cp, 0.0], [c, -s, 0.0], [s * t, c * t, -1.0]])
