"""Pressure depth: how far a sensor is below the surface of the sea."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pntegrity.kernels.axes import local_axes
from pntegrity.records import Observation
from pntegrity.sensors._acoustic import (
    Mounted,
    Row,
    assemble,
    check_number,
    check_positive,
    depth_of,
    variances,
    vector,
)
from pntegrity.sensors.source import Nuisance, Pose, SourceRows

__all__ = ["Depth"]


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of a sensor below the sea surface: rows ``"depth:R.z"``, m, down positive.

    Parameters
    ----------
    name : str
    sigma_m : float
        Standard deviation, where the observation declares none.
    lever_arm_m : sequence of float
        From the IMU to the sensor, forward, right, down.
    sea_height_m : float
        Height of the mean sea surface above the ellipsoid (about the geoid's).
    tide_sigma_m, tide_walk_m : float
        How much higher the surface is, the sensor's offset included: standard deviation at the start (0:
        there is no such state), random walk in m/sqrt(s).

    Raises
    ------
    ValueError
        A value out of range.
    """

    fitted: ClassVar[tuple[str, ...]] = ("sigma_m",)
    name: str = "depth"
    sigma_m: float = 0.1
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sea_height_m: float = 0.0
    tide_sigma_m: float = 0.0
    tide_walk_m: float = 0.0

    def __post_init__(self) -> None:
        check_positive("`sigma_m`", self.sigma_m)
        check_positive("`tide_sigma_m`", self.tide_sigma_m, zero=True)
        check_positive("`tide_walk_m`", self.tide_walk_m, zero=True)
        vector("lever_arm_m", self.lever_arm_m)
        check_number(self.sea_height_m, "`sea_height_m`")

    @property
    def tide(self) -> str:
        """Name of the state of the tide."""
        return f"{self.name}.tide"

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return the state of the tide, where there is one."""
        return (Nuisance(self.tide, self.tide_sigma_m, self.tide_walk_m),) if self.tide_sigma_m else ()

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose."""
        here = Mounted.at(pose, pose.t_ns, np.asarray(self.lever_arm_m))
        down = -local_axes(here.position_m)[2]
        h = depth_of(here.position_m, self.sea_height_m) + float(pose.nuisance.get(self.tide, 0.0))
        H = {"pos": down, "att": down @ here.by_turn, self.tide: 1.0}
        var = variances(observation, [self.sigma_m] * len(observation.keys))
        rows, reasons = [], []
        for i, key in enumerate(observation.keys):
            if np.isfinite(observation.y[i]):
                rows.append(Row(key, float(observation.y[i]) - h, H, float(var[i])))
            else:
                reasons.append(f"{key}: no depth")
        return assemble(rows, {"pos": 3, "att": 3} | {n.name: 1 for n in self.nuisances()}, reasons)
