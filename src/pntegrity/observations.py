"""What sensors said: observations and inertial increments, and all those of one instant.

Symbols as in `pntegrity.records`, which gives these names on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.states import FloatArray, freeze

__all__ = ["Epoch", "Inertial", "Observation"]


@dataclass(frozen=True, eq=False)
class Observation:
    """What one sensor said at one instant.

    Parameters
    ----------
    sensor : str
        Which model in ``sensors/`` explains the rows: ``"code"``, ``"doppler"``, ``"carrier"``, ...
    t_ns : int
        Time of reception, ns of GPS time.
    keys : tuple of str
        One name a row, ``"<group>:<signal>"``: ``"G05:C1C"``, ``"lbl:AP1"``.
    y : ndarray, shape (n,)
        Measured values, SI units of the sensor (metres, metres per second, ...).
    sigma : ndarray, shape (n,), optional
        Standard deviations that the source itself declares; None where the noise model decides.
    aux : mapping of str to ndarray
        What the sensor's model needs beside the state, first axis the row (satellite position, clock, C/N0,
        ...).
    """

    sensor: str
    t_ns: int
    keys: tuple[str, ...]
    y: FloatArray
    sigma: FloatArray | None = None
    aux: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "y")
        if self.sigma is not None:
            freeze(self, "sigma")
        object.__setattr__(self, "aux", MappingProxyType(dict(self.aux)))
        if len(self.keys) != len(self.y) or any(len(v) != len(self.y) for v in self.aux.values()):
            raise ValueError(
                f"`keys`, `y` and every `aux` of sensor {self.sensor!r} must have the same length"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.sensor, self.t_ns, self.keys, self.y, self.sigma, dict(self.aux)))

    def select(self, rows: npt.NDArray[Any]) -> Observation:
        """Return the observation with only `rows` (a mask or an index array), in that order."""
        index = np.arange(len(self.keys))[rows]
        sigma = None if self.sigma is None else self.sigma[index]
        return replace(
            self,
            keys=tuple(self.keys[i] for i in index),
            y=self.y[index],
            sigma=sigma,
            aux={name: values[index] for name, values in self.aux.items()},
        )


@dataclass(frozen=True, eq=False)
class Inertial:
    """What an inertial measurement unit felt between two instants: increments, one after the other.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        End of each increment, ns of GPS time, rising; an increment begins where the one before it ends.
    dt_s : ndarray, shape (n,)
        Duration of each.
    angle_rad : ndarray, shape (n, 3)
        Angular rate with respect to inertial space, integrated; body axes forward, right, down.
    velocity_mps : ndarray, shape (n, 3)
        Specific force, integrated; the same axes.
    reason : str
        Why the increments do not reach from one instant to the other (a gap of the file), where they do not.
    """

    t_ns: npt.NDArray[np.int64]
    dt_s: FloatArray
    angle_rad: FloatArray
    velocity_mps: FloatArray
    reason: str = ""

    def __post_init__(self) -> None:
        freeze(self, "dt_s", "angle_rad", "velocity_mps")
        t_ns = np.asarray(self.t_ns, dtype=np.int64).view()
        t_ns.flags.writeable = False
        object.__setattr__(self, "t_ns", t_ns)
        n = len(t_ns)
        if self.dt_s.shape != (n,) or self.angle_rad.shape != (n, 3) or self.velocity_mps.shape != (n, 3):
            raise ValueError("`t_ns`, `dt_s`, `angle_rad` and `velocity_mps` must have the same length")


@dataclass(frozen=True, eq=False)
class Epoch:
    """All observations of one instant, and what was dropped on the way to it (`notes`: reasons, in words).

    `imu` holds the increments since the epoch before, where there is an inertial measurement unit.
    """

    t_ns: int
    observations: tuple[Observation, ...] = ()
    notes: tuple[str, ...] = ()
    imu: Inertial | None = None

    def sensor(self, name: str) -> Observation | None:
        """Return the observation of sensor `name`, or None."""
        return next((o for o in self.observations if o.sensor == name), None)
