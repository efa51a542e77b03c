"""Doppler velocity log: the velocity over the ground, in the axes of the log."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from pntegrity.kernels.rotations import skew
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors._acoustic import Row, assemble, check_positive, matrix_of, variances, vector
from pntegrity.sensors.source import Nuisance, Pose, SourceRows
from pntegrity.states import sensor_of

__all__ = ["Dvl"]


@dataclass(frozen=True, eq=False)
class Dvl:
    """Velocity of the log over the ground: rows ``"dvl:D.X"``, ``"dvl:D.Y"``, ``"dvl:D.Z"``, m/s, forward,
    right, down in its axes.

    Parameters
    ----------
    name : str
    sigma_mps : float
        Standard deviation of each, where the observation declares none.
    lever_arm_m : sequence of float
        From the IMU to the log, forward, right, down.
    mount_deg : sequence of float
        Roll, pitch and yaw of the log in the body: ``Rz(yaw) Ry(pitch) Rx(roll)``.
    scale_sigma, scale_walk : float
        Relative error of the velocity: standard deviation at the start (0: there is no such state), random
        walk in 1/sqrt(s).

    Raises
    ------
    ValueError
        A value out of range.
    """

    fitted: ClassVar[tuple[str, ...]] = ("sigma_mps",)
    name: str = "dvl"
    sigma_mps: float = 0.02
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale_sigma: float = 0.0
    scale_walk: float = 0.0

    def __post_init__(self) -> None:
        check_positive("`sigma_mps`", self.sigma_mps)
        check_positive("`scale_sigma`", self.scale_sigma, zero=True)
        check_positive("`scale_walk`", self.scale_walk, zero=True)
        vector("lever_arm_m", self.lever_arm_m)
        matrix_of("mount_deg", self.mount_deg)

    @cached_property
    def mount(self) -> FloatArray:
        """Axes of the log to body axes."""
        return matrix_of("mount_deg", self.mount_deg)

    @property
    def scale(self) -> str:
        """Name of the state of the relative error."""
        return f"{self.name}.scale"

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return the state of the relative error, where there is one."""
        return (Nuisance(self.scale, self.scale_sigma, self.scale_walk),) if self.scale_sigma else ()

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose."""
        arm = np.asarray(self.lever_arm_m)
        turn = (pose.C @ self.mount).T
        k = 1.0 + float(pose.nuisance.get(self.scale, 0.0))
        h = turn @ pose.velocity_mps + self.mount.T @ np.cross(pose.rate_radps, arm)
        # the rate is measured minus bias, so more bias turns less
        by_bias = self.mount.T @ skew(arm)
        var = variances(observation, [self.sigma_mps] * len(observation.keys))
        rows, reasons = [], []
        for i, key in enumerate(observation.keys):
            axis = "XYZ".find(sensor_of(key))
            if axis < 0 or len(sensor_of(key)) != 1 or not np.isfinite(observation.y[i]):
                reasons.append(f"{key}: no velocity along X, Y or Z")
                continue
            H = {
                "vel": k * turn[axis], "att": k * (turn @ skew(pose.velocity_mps))[axis],
                "bg": k * by_bias[axis], self.scale: float(h[axis]),
            }  # fmt: skip
            rows.append(Row(key, float(observation.y[i] - k * h[axis]), H, float(var[i])))
        blocks = {"vel": 3, "att": 3, "bg": 3} | {n.name: 1 for n in self.nuisances()}
        return assemble(rows, blocks, reasons)
