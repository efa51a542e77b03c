"""A position, or a position and a velocity, as a receiver or another system gives it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pntegrity.kernels.axes import local_axes
from pntegrity.kernels.rotations import skew
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors.source import Nuisance, Pose, SourceRows

__all__ = ["Fix"]

SIGNALS = ("RX", "RY", "RZ", "DX", "DY", "DZ")


@dataclass(frozen=True)
class Fix:
    """Fixes in ECEF; ``aux["cov"]`` of an observation has the covariances of its rows with all, X to DZ.

    Parameters
    ----------
    name : str
        Of the source; rows are ``"<name>:RX"``, ... (m) and ``"<name>:DX"``, ... (m/s). They are one sensor:
        an error of a position is in any direction.
    lever_arm_m : tuple of float
        From the IMU to the point that the fix is of; forward, right, down.
    sigma_floor_m, sigma_floor_mps : float
        Added to the stated standard deviations, as a root of a sum of squares: what these do not say.
    horizontal_factor, vertical_factor, velocity_factor : float
        What the standard deviations of positions and of velocities are multiplied by then: a calibration
        finds how much larger errors are than stated.

    Raises
    ------
    ValueError
        Naming the field and what is wrong.
    """

    fitted: ClassVar[tuple[str, ...]] = ("horizontal_factor", "vertical_factor", "velocity_factor")
    name: str
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_floor_m: float = 0.0
    sigma_floor_mps: float = 0.0
    horizontal_factor: float = 1.0
    vertical_factor: float = 1.0
    velocity_factor: float = 1.0

    def __post_init__(self) -> None:
        arm = np.asarray(self.lever_arm_m, dtype=np.float64)
        if arm.shape != (3,) or not np.isfinite(arm).all():
            raise ValueError(f"source {self.name}: `lever_arm_m` {self.lever_arm_m!r} is not three numbers")
        for field in ("sigma_floor_m", "sigma_floor_mps"):
            value = getattr(self, field)
            if not value >= 0.0:
                raise ValueError(f"source {self.name}: `{field}` must be at least 0, not {value!r}")
        for field in self.fitted:
            value = getattr(self, field)
            if not 0.0 < value < np.inf:
                raise ValueError(f"source {self.name}: `{field}` must be above 0, not {value!r}")

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return no states: a fix has none of its own."""
        return ()

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of a fix; see `sensors.source`."""
        at = _places(observation)
        arm = pose.C @ np.asarray(self.lever_arm_m)
        swing = pose.C @ np.cross(pose.rate_radps, self.lever_arm_m)
        expected = np.concatenate([pose.position_m + arm, pose.velocity_mps + swing])
        nothing, one = np.zeros((3, 3)), np.eye(3)
        H: dict[str, FloatArray] = {
            "pos": np.vstack([one, nothing])[at],
            "vel": np.vstack([nothing, one])[at],
            "att": np.vstack([-skew(arm), -skew(swing)])[at],
            "bg": np.vstack([nothing, pose.C @ skew(self.lever_arm_m)])[at],
        }
        return SourceRows(
            observation.keys, observation.y - expected[at], H, self._spread(observation, at, expected[:3])
        )

    def position(self, observation: Observation) -> tuple[FloatArray, FloatArray | None, FloatArray] | None:
        """Return position, velocity where there is one, and the covariance of both; None where there is no
        position.
        """
        at = _places(observation)
        if not set(at) >= {0, 1, 2}:
            return None
        order = np.argsort(at)
        y = observation.y[order]
        cov = self._spread(observation, at, y[:3])[np.ix_(order, order)]
        return (y[:3], y[3:], cov) if len(at) == 6 else (y[:3], None, cov[:3, :3])

    def _spread(self, observation: Observation, at: list[int], place_m: FloatArray) -> FloatArray:
        floors = np.repeat([self.sigma_floor_m, self.sigma_floor_mps], 3)[at]
        spread = np.asarray(observation.aux["cov"][:, at] + np.diag(floors**2))
        wide, high, fast = (getattr(self, field) for field in self.fitted)
        if wide == high == fast == 1.0:
            return spread
        axes, grown = local_axes(place_m), fast * np.eye(6)
        grown[:3, :3] = axes.T @ (np.array([[wide], [wide], [high]]) * axes)
        grown = grown[np.ix_(at, at)]
        return np.asarray(grown @ spread @ grown.T)


def _places(observation: Observation) -> list[int]:
    """Return which signal each row is; columns of the covariance are in the order of the signals."""
    return [SIGNALS.index(key.partition(":")[2]) for key in observation.keys]
