"""Ultra-short baseline: range or travel time, and direction, to a transponder with known coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pntegrity.kernels.rotations import skew
from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors._acoustic import (
    Beacon,
    Mounted,
    Row,
    Water,
    assemble,
    beacon_of,
    check_flag,
    check_positive,
    matrix_of,
    received_ns,
    travel,
    variances,
    vector,
)
from pntegrity.sensors.source import Nuisance, Pose, SourceRows
from pntegrity.states import sensor_of

__all__ = ["Usbl"]

#: An angle larger than this is none in radians.
LARGEST_ANGLE_RAD = 2.0 * np.pi
#: Nearer to the transducer's axis than this sine, a bearing has no meaning.
LEAST_SINE = 1e-3


@dataclass(frozen=True, eq=False)
class Usbl:
    """Range, travel time, bearing and elevation of one transponder, in the axes of the transducer.

    Rows: ``"usbl:R.range"`` (m, the straight way), ``"usbl:R.time"`` (s), ``"usbl:A.bearing"`` (rad,
    clockwise from the transducer's forward axis, seen from above), ``"usbl:A.elevation"`` (rad, up from the
    plane of forward and right: a transponder below has a negative one). Angles are those from which sound
    arrives; with a profile that is not where the transponder is. Times there and back are treated as those of
    `Lbl`.

    Parameters
    ----------
    name : str
    transponder : mapping
        Coordinates, and ``delay_s``: as a beacon of `Lbl`.
    sigma_range_m, sigma_s, sigma_angle_deg : float
        Standard deviations where the observation declares none.
    lever_arm_m : sequence of float
        From the IMU to the transducer, forward, right, down.
    mount_deg : sequence of float
        Roll, pitch and yaw of the transducer in the body: ``Rz(yaw) Ry(pitch) Rx(roll)``.
    two_way : bool
        Of times.
    sound_speed_mps, profile, sea_height_m
        As `Lbl`.

    Raises
    ------
    ValueError
        A transponder without coordinates, a profile that does not reach it, a value out of range.
    """

    fitted: ClassVar[tuple[str, ...]] = ("sigma_range_m", "sigma_s", "sigma_angle_deg")
    name: str = "usbl"
    transponder: Mapping[str, Any] = field(default_factory=dict)
    sigma_range_m: float = 1.0
    sigma_s: float = 1e-4
    sigma_angle_deg: float = 0.4
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    two_way: bool = False
    sound_speed_mps: float = 1500.0
    profile: SoundSpeed | Mapping[str, Any] | None = None
    sea_height_m: float | None = None

    def __post_init__(self) -> None:
        for name in ("sigma_range_m", "sigma_s", "sigma_angle_deg"):
            check_positive(f"`{name}`", getattr(self, name))
        check_flag("`two_way`", self.two_way)
        vector("lever_arm_m", self.lever_arm_m)
        matrix_of("mount_deg", self.mount_deg)
        self.water.check(self.beacon, "transponder")

    @cached_property
    def beacon(self) -> Beacon:
        """The transponder."""
        return beacon_of("transponder", self.transponder, "transponder")

    @cached_property
    def water(self) -> Water:
        """How sound travels."""
        return Water(self.sound_speed_mps, self.profile, self.sea_height_m)

    @cached_property
    def mount(self) -> FloatArray:
        """Transducer axes to body axes."""
        return matrix_of("mount_deg", self.mount_deg)

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return no state: there is none of its own."""
        return ()

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose.

        Parameters
        ----------
        observation : Observation
            Keys as above; `aux` as for `Lbl`.
        pose : Pose
            At the observation's time.
        """
        angle = float(np.radians(self.sigma_angle_deg))
        sigma = {"range": self.sigma_range_m, "time": self.sigma_s}
        var = variances(observation, [sigma.get(sensor_of(k), angle) for k in observation.keys])
        rows, reasons = [], []
        for i, key in enumerate(observation.keys):
            try:
                rows.append(self._row(observation, i, pose, float(var[i])))
            except ValueError as error:
                reasons.append(f"{key}: {error}")
        return assemble(rows, {"pos": 3, "vel": 3, "att": 3}, reasons)

    def _row(self, o: Observation, i: int, pose: Pose, var: float) -> Row:
        what, y = sensor_of(o.keys[i]), float(o.y[i])
        if what not in ("range", "time", "bearing", "elevation"):
            raise ValueError("known are range, time, bearing and elevation")
        if not np.isfinite(y):
            raise ValueError(f"{y:g} is no measurement")
        here = Mounted.at(pose, received_ns(o, i), np.asarray(self.lever_arm_m))
        if what == "range":
            h, H = self._range(here)
        elif what == "time":
            h, H = self._time(o, i, pose)
        else:
            return self._angle(o.keys[i], what, y, here, var)
        if y <= 0.0:
            raise ValueError(f"{y:g} is no distance")
        return Row(o.keys[i], y - h, H, var)

    def _range(self, here: Mounted) -> tuple[float, dict[str, FloatArray]]:
        way = here.position_m - self.beacon.position_m
        length = float(np.linalg.norm(way))
        return length, {"pos": way / length, "att": way / length @ here.by_turn}

    def _time(self, o: Observation, i: int, pose: Pose) -> tuple[float, dict[str, FloatArray]]:
        arm = np.asarray(self.lever_arm_m)
        found = travel(self.water, o, i, pose, arm, self.beacon, self.two_way)
        return found.time_s + found.delay_s, found.slopes

    def _angle(self, key: str, what: str, y: float, here: Mounted, var: float) -> Row:
        if abs(y) > LARGEST_ANGLE_RAD:
            raise ValueError(f"{y:g} is no angle in rad: the file must declare degrees (`{what}_deg`)")
        arrival = self.water.arrival(here.position_m, self.beacon.position_m)
        turn = (here.C @ self.mount).T
        u = turn @ arrival.direction
        # C_true = (I + [phi x]) C: the direction in transducer axes turns the other way
        by_place = turn @ arrival.by_place
        by_turn = turn @ skew(arrival.direction) + by_place @ here.by_turn
        flat = float(np.hypot(u[0], u[1]))
        if flat < LEAST_SINE:
            raise ValueError("the transponder is on the axis of the transducer: there is no bearing")
        if what == "bearing":
            h, g = float(np.arctan2(u[1], u[0])), np.array([-u[1], u[0], 0.0]) / flat**2
        else:
            h = float(np.arctan2(-u[2], flat))
            g = np.array([u[0] * u[2] / flat, u[1] * u[2] / flat, -flat])
        nu = float(np.mod(y - h + np.pi, 2.0 * np.pi) - np.pi)
        return Row(key, nu, {"pos": g @ by_place, "att": g @ by_turn}, var)
