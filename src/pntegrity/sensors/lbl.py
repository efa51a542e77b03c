"""Long baseline: travel times of sound to beacons with known coordinates, one way or there and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors._acoustic import (
    Beacon,
    Row,
    Water,
    assemble,
    beacon_of,
    check_flag,
    check_positive,
    travel,
    variances,
    vector,
)
from pntegrity.sensors.source import Nuisance, Pose, SourceRows
from pntegrity.states import sensor_of

__all__ = ["Lbl"]


@dataclass(frozen=True, eq=False)
class Lbl:
    """Travel times between a transducer on the vehicle and beacons.

    A row ``"lbl:R.AP1"`` is a time in seconds. There and back, with the turn-around delay inside, the sound
    leaves where the vehicle was at `aux` ``"t0_ns"`` (without it: the travel time earlier) and returns at
    ``"received_ns"`` (without it: the observation's time). `aux` ``"ways"``, 1 or 2, goes before `two_way`;
    ``"repeated"`` counts how often a value came unchanged.

    Parameters
    ----------
    name : str
    beacons : mapping of str to mapping
        ``x_m``, ``y_m``, ``z_m`` (ECEF), or ``lat_deg``, ``lon_deg``, ``height_m`` above the ellipsoid; and
        ``delay_s``, the wait before the reply, 0 where the times are without it.
    sigma_s : float
        Standard deviation of a travel time, where the observation declares none.
    lever_arm_m : sequence of float
        From the IMU to the transducer, forward, right, down.
    two_way : bool
    sound_speed_mps : float
        Everywhere, where there is no profile.
    profile : SoundSpeed or mapping, optional
        Sound speed against depth: ``depth_m`` and ``speed_mps``.
    sea_height_m : float, optional
        Height of the sea surface above the ellipsoid; needed with a profile.
    sound_scale_sigma : float
        Standard deviation at the start of a common relative error of the sound speed; 0: there is no such
        state.
    sound_scale_walk : float
        Its random walk, 1/sqrt(s).
    most_repeats : int
        A value that came unchanged this many times is left out; 0: never.

    Raises
    ------
    ValueError
        A beacon without coordinates, a profile that does not reach a beacon, a value out of range.
    """

    fitted: ClassVar[tuple[str, ...]] = ("sigma_s",)
    name: str = "lbl"
    beacons: Mapping[str, Any] = field(default_factory=dict)
    sigma_s: float = 1e-3
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    two_way: bool = False
    sound_speed_mps: float = 1500.0
    profile: SoundSpeed | Mapping[str, Any] | None = None
    sea_height_m: float | None = None
    sound_scale_sigma: float = 0.0
    sound_scale_walk: float = 0.0
    most_repeats: int = 5

    def __post_init__(self) -> None:
        if not self.beacons:
            raise ValueError("`beacons` must name one beacon at least, each with its coordinates")
        check_positive("`sigma_s`", self.sigma_s)
        check_positive("`sound_scale_sigma`", self.sound_scale_sigma, zero=True)
        check_positive("`sound_scale_walk`", self.sound_scale_walk, zero=True)
        check_positive("`most_repeats`", self.most_repeats, zero=True)
        check_flag("`two_way`", self.two_way)
        vector("lever_arm_m", self.lever_arm_m)
        for name, beacon in self.places.items():
            self.water.check(beacon, name)

    @cached_property
    def places(self) -> dict[str, Beacon]:
        """The beacons by name."""
        return {name: beacon_of(name, table) for name, table in self.beacons.items()}

    @cached_property
    def water(self) -> Water:
        """How sound travels."""
        return Water(self.sound_speed_mps, self.profile, self.sea_height_m)

    @property
    def scale(self) -> str:
        """Name of the state of the sound speed's relative error."""
        return f"{self.name}.sound_speed"

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return the state of the sound speed, where there is one."""
        if not self.sound_scale_sigma:
            return ()
        return (Nuisance(self.scale, self.sound_scale_sigma, self.sound_scale_walk),)

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose.

        Parameters
        ----------
        observation : Observation
            Travel times, s.
        pose : Pose
            At the observation's time; its track must reach back to the transmission.
        """
        var = variances(observation, [self.sigma_s] * len(observation.keys))
        rows, reasons = [], []
        for i in range(len(observation.keys)):
            try:
                rows.append(self._row(observation, i, pose, float(var[i])))
            except ValueError as error:
                reasons.append(f"{observation.keys[i]}: {error}")
        blocks = {"pos": 3, "vel": 3, "att": 3} | {n.name: 1 for n in self.nuisances()}
        return assemble(rows, blocks, reasons)

    def _row(self, o: Observation, i: int, pose: Pose, var: float) -> Row:
        name, y = sensor_of(o.keys[i]), float(o.y[i])
        beacon = self._beacon(name)
        if not (np.isfinite(y) and y > 0.0):
            raise ValueError(f"{y:g} s is no travel time")
        repeated = int(o.aux["repeated"][i]) if "repeated" in o.aux else 0
        if self.most_repeats and repeated >= self.most_repeats:
            raise ValueError(f"its value came {repeated} times unchanged")
        arm = np.asarray(self.lever_arm_m)
        found = travel(self.water, o, i, pose, arm, beacon, self.two_way)
        k = 1.0 / (1.0 + float(pose.nuisance.get(self.scale, 0.0)))
        H: dict[str, FloatArray | float] = {name: k * slope for name, slope in found.slopes.items()}
        H[self.scale] = -k * k * found.time_s
        return Row(o.keys[i], y - found.delay_s - k * found.time_s, H, var)

    def _beacon(self, name: str) -> Beacon:
        beacon = self.places.get(name)
        if beacon is None:
            raise ValueError(
                f"beacon {name!r} has no coordinates; there are those of {', '.join(self.places)}"
            )
        return beacon
