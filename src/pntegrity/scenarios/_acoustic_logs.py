"""Real acoustic logs of the evidence campaigns: where they are, and their residuals where the vessel was."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.formats._acoustics import AcousticLog
from pntegrity.formats.acoustic_garpos import read_garpos
from pntegrity.formats.acoustic_gnatss import read_gnatss
from pntegrity.kernels.rotations import from_angles
from pntegrity.physics.frames import enu_rotations
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors.lbl import Lbl
from pntegrity.sensors.source import Pose, Track
from pntegrity.states import sensor_of

__all__ = ["LOGS", "Residuals", "lbl_of", "open_log", "poses", "residuals", "track_of"]

#: Names and folders of the logs.
LOGS = {"NCL1": "ncl1-gnssa", "SAGA": "saga-gnssa"}


@lru_cache(maxsize=4)
def open_log(name: str, data: Path) -> AcousticLog:
    """Return a log of `LOGS`; kept."""
    read = read_gnatss if name == "NCL1" else read_garpos
    return read(data / LOGS[name])


def lbl_of(log: AcousticLog, **changes: Any) -> Lbl:
    """Return the source of a log's travel times; the vehicle's position is that of the antenna."""
    usual: dict[str, Any] = {
        "name": log.source, "beacons": log.beacons, "lever_arm_m": log.lever_arm_m, "two_way": True,
        "profile": log.profile, "sea_height_m": log.sea_height_m, "sigma_s": 1e-4,
    }  # fmt: skip
    return Lbl(**(usual | changes))


def track_of(log: AcousticLog) -> Track:
    """Return where the antenna was and how the vessel stood, at transmissions and receptions."""
    a = log.attitude
    if a.attitude_rad is None:
        raise ValueError("the log has no attitudes")
    C = np.swapaxes(enu_rotations(a.position_m), 1, 2) @ from_angles(a.attitude_rad)
    return Track(a.t_ns, a.position_m, C)


def poses(log: AcousticLog) -> list[tuple[Observation, Pose]]:
    """Return each observation with the true pose at its reception, as far as that is known."""
    whole, out = track_of(log), []
    for o in log.observations:
        first = int(np.searchsorted(whole.t_ns, int(o.aux["t0_ns"].min())))
        last = int(np.searchsorted(whole.t_ns, o.t_ns))
        if last < len(whole.t_ns) and whole.t_ns[last] == o.t_ns:
            i = slice(first, last + 1)
            track = Track(whole.t_ns[i], whole.position_m[i], whole.C[i])
            speed = (track.position_m[-1] - track.position_m[0]) / max(np.ptp(track.t_ns) * 1e-9, 1e-3)
            out.append((o, Pose(o.t_ns, track.position_m[-1], speed, track.C[-1], np.zeros(3), track)))
    return out


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of travel times where the vessel was, s, and how they depend on what may be wrong.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
    beacon : ndarray of str, shape (n,)
    nu_s : ndarray, shape (n,)
    by_place : ndarray, shape (n, 3)
        Derivative of the travel time by the vessel's position, east, north, up.
    by_speed : ndarray, shape (n,)
        By the relative error of the sound speed.
    by_arm : ndarray, shape (n, 3)
        By the lever arm, forward, right, down.
    by_lag : ndarray, shape (n,)
        By how much the acoustic clock is late.
    """

    t_ns: npt.NDArray[np.int64]
    beacon: npt.NDArray[np.str_]
    nu_s: FloatArray
    by_place: FloatArray
    by_speed: FloatArray
    by_arm: FloatArray
    by_lag: FloatArray
    reasons: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """How many there are."""
        return len(self.nu_s)


def residuals(log: AcousticLog, source: Lbl) -> Residuals:
    """Return the residuals of a log where the vessel was.

    Parameters
    ----------
    log : AcousticLog
    source : Lbl
        Its `sound_scale_sigma` is not used.
    """
    source = replace(source, sound_scale_sigma=1.0, most_repeats=0)
    parts, reasons = [], []
    for o, pose in poses(log):
        found = source.rows(o, pose)
        reasons += [found.reason] if found.reason else []
        for i, key in enumerate(found.keys):
            H = found.H["pos"][i]
            # a ping is short: the attitude at its end stands for both ends
            parts.append((o.t_ns, sensor_of(key), found.nu[i], H, found.H[source.scale][i, 0], H @ pose.C,
                          H @ pose.velocity_mps))  # fmt: skip
    t_ns, beacon, nu, place, speed, arm, lag = (np.array(column) for column in zip(*parts, strict=True))
    turn = enu_rotations(log.attitude.position_m[:1])[0].T
    return Residuals(t_ns, beacon, nu, place @ turn, speed, arm, -lag, tuple(dict.fromkeys(reasons)))
