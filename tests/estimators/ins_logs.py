"""A simulated drive with an IMU and an antenna a lever arm away, and a run of the inertial filter over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from gnss_logs import NOISE, PLACE, START, navigation, options
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators._ins_solution import solution_of
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.kernels.rotations import attitude_angles
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.imu import STIM300, ImuSpec
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.noise import CITY
from pntegrity.sensors.ranges import geometry
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import motion_of_drive
from pntegrity.simulate.receiver import Receiver, epochs_of, simulate
from pntegrity.simulate.trajectory import CIRCUIT, Leg, car

SECOND = 10**9
ARM = (0.4, 0.25, -1.2)
IMU_HZ = 50.0
#: The circuit after a few seconds at rest.
DRIVE = (Leg(5.0, 0.0), *CIRCUIT)
ENU = enu_rotation(PLACE)


@dataclass(frozen=True, eq=False)
class Drive:
    """Epochs at 1 Hz, and the truth of the IMU: positions, velocities (n, 3), axes (n, 3, 3)."""

    epochs: tuple[Epoch, ...]
    position_m: np.ndarray
    velocity_mps: np.ndarray
    axes: np.ndarray

    def heading(self, k: int) -> float:
        return float(attitude_angles(enu_rotation(self.position_m[k]) @ self.axes[k])[2])


@lru_cache(maxsize=8)
def drive(
    n: int, seed: int = 1, spec: ImuSpec = STIM300, scale: float = 1.0, legs: tuple[Leg, ...] = DRIVE,
    arm: tuple[float, float, float] = ARM, late_s: int = 0,
) -> Drive:  # fmt: skip
    """Return `n` epochs; `late_s` after the drive began; `scale` multiplies the errors of the receiver."""
    rng = np.random.default_rng(seed)
    motion = motion_of_drive(car(PLACE, legs, 0.7), START - 2 * SECOND, n + late_s + 5.0)
    t_ns = START + SECOND * (late_s + np.arange(n, dtype=np.int64))

    def antenna(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        position, velocity = motion.of_point(t_ns[0] + round(t_s * 1e9), arm)
        return position[0], velocity[0]

    seconds = n + late_s + 600
    receiver = Receiver(NOISE, scale, mask_rad=float(np.deg2rad(8.0)))
    made = simulate(navigation("GE", seconds), antenna, t_ns, receiver, rng)
    felt = increments(motion, int(t_ns[0]) - SECOND, int(t_ns[-1]), IMU_HZ)
    if spec is not PERFECT:
        felt, _ = with_errors(felt, spec, rng)
    epochs = with_increments(epochs_of(made.table, navigation("GE", seconds)), felt)
    return Drive(epochs, *motion.at(t_ns))


#: A unit without errors, for a filter that takes it for a good one.
PERFECT = replace(STIM300, name="perfect")


def filter_of(log: Drive, **changes: Any) -> GnssIns:
    """Return the filter of a drive; it is given its heading unless `heading_rad` is among the changes."""
    outer = {k: changes.pop(k) for k in ("doppler", "noise", "mask_rad") if k in changes}
    known = {"lever_arm_m": ARM, "heading_rad": log.heading(0)} | changes
    outer = {"noise": CITY} | outer
    return GnssIns(options(navigation("GE"), ins=InsOptions(**known), **outer))


def updates(estimator: GnssIns, epochs: Sequence[Epoch], state: State | None = None) -> list[Update]:
    state, out = state or State.empty(epochs[0].t_ns - SECOND), []
    for epoch in epochs:
        out.append(estimator.correct(estimator.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out


def off_m(log: Drive, found: Sequence[Update], arm: tuple[float, float, float] = ARM) -> np.ndarray:
    """Return the distance of the antenna's position from the truth, nan where there is none."""
    out = np.full(len(found), np.nan)
    for k, u in enumerate(found):
        s = solution_of(u.posterior)
        if s is not None:
            out[k] = np.linalg.norm(s.position_m - log.position_m[k] - log.axes[k] @ np.array(arm))
    return out


def heading_off(log: Drive, found: Sequence[Update]) -> np.ndarray:
    """Return the error of the heading, rad, nan where there is none."""
    out = np.full(len(found), np.nan)
    for k, u in enumerate(found):
        s = solution_of(u.posterior)
        if s is not None:
            out[k] = (s.attitude_rad[2] - log.heading(k) + np.pi) % (2.0 * np.pi) - np.pi
    return out


def blind(epochs: Sequence[Epoch], first: int, last: int, keep: int = 0) -> tuple[Epoch, ...]:
    """Return epochs without rows from `first` to `last` - 1, but for those of the first `keep` satellites."""
    out = []
    for k, e in enumerate(epochs):
        if first <= k < last:
            seen = list(dict.fromkeys(key[:3] for o in e.observations for key in o.keys))[:keep]
            shown = tuple(
                o.select(np.array([key[:3] in seen for key in o.keys], bool)) for o in e.observations
            )
            e = replace(e, observations=shown)
        out.append(e)
    return tuple(out)


def still_imu(epochs: Sequence[Epoch], first: int, last: int) -> tuple[Epoch, ...]:
    """Return epochs without increments from `first` to `last` - 1."""
    return tuple(replace(e, imu=None) if first <= k < last else e for k, e in enumerate(epochs))


def shift_of(epoch: Epoch, antenna_m: np.ndarray, offset_m: np.ndarray) -> Epoch:
    """Return the epoch with the codes of a receiver elsewhere: all satellites agree on it."""
    out = []
    for o in epoch.observations:
        if o.sensor == "code":
            o = replace(o, y=o.y - geometry(antenna_m, o.aux["sv_pos_m"]).los @ offset_m)
        out.append(o)
    return replace(epoch, observations=tuple(out))
