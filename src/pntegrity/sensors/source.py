"""What a source of navigation must be, whatever it measures: how its rows depend on where the vehicle is.

A source type is a module of this folder that holds a class with a method ``rows``; nothing else lists it. A
row's key is ``"<source>:<kind>.<sensor>"``: ``"lbl:R.AP1"``, ``"gnss:D.G05"``, with the kind ``D`` for rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import atan2, sqrt
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.rotations import rotation
from pntegrity.records import FloatArray, Observation
from pntegrity.states import freeze

__all__ = ["Nuisance", "Pose", "Source", "SourceRows", "Track"]

#: Below this sine a turn is its sine.
SMALL = 1e-6


@dataclass(frozen=True, eq=False)
class Track:
    """Where a vehicle was lately: times (n,), positions (n, 3) ECEF and attitudes (n, 3, 3), body to ECEF."""

    t_ns: npt.NDArray[np.int64]
    position_m: FloatArray
    C: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "position_m", "C")

    def at(self, t_ns: int) -> tuple[FloatArray, FloatArray]:
        """Return position and attitude, between its times on a straight line and at a constant rate of turn;
        the ends hold beyond them.

        Parameters
        ----------
        t_ns : int
        """
        j = int(np.searchsorted(self.t_ns, t_ns))
        if j == len(self.t_ns) or j == 0 or self.t_ns[j] == t_ns:
            j = min(j, len(self.t_ns) - 1)
            return np.asarray(self.position_m[j]), np.asarray(self.C[j])
        i, start, step = j - 1, self.t_ns[j - 1], self.t_ns[j] - self.t_ns[j - 1]
        share = float((t_ns - start) / step)
        x = (1.0 - share) * self.position_m[i] + share * self.position_m[j]
        turn = _turn_of(self.C[i].T @ self.C[j])
        return x, np.asarray(self.C[i] @ rotation(share * turn))


def _turn_of(C: FloatArray) -> FloatArray:
    """Return the rotation vector of a turn of less than half a circle."""
    twice = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    sine = 0.5 * sqrt(float(twice @ twice))
    return twice * (
        0.5 if sine < SMALL else 0.5 * atan2(sine, 0.5 * (C[0, 0] + C[1, 1] + C[2, 2] - 1.0)) / sine
    )


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the vehicle is, as the filter predicts it.

    Parameters
    ----------
    t_ns : int
    position_m, velocity_mps : ndarray, shape (3,)
        Of the IMU, ECEF.
    C : ndarray, shape (3, 3)
        Body axes (forward, right, down) to ECEF.
    rate_radps : ndarray, shape (3,)
        Angular rate with respect to the Earth, body axes.
    track : Track
        The last seconds, this instant included: for signals that travel long. Its errors are those of now:
        the attitude's, and the position's less the velocity's times the age.
    nuisance : mapping of str to float
        The source's own states, by name.
    """

    t_ns: int
    position_m: FloatArray
    velocity_mps: FloatArray
    C: FloatArray
    rate_radps: FloatArray
    track: Track
    nuisance: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SourceRows:
    """Rows of one source at one instant.

    Parameters
    ----------
    keys : tuple of str
    nu : ndarray, shape (m,)
        Measured minus predicted.
    H : mapping of str to ndarray
        Jacobian by block of states: ``"pos"``, ``"vel"``, ``"att"``, ``"bg"`` (m, 3), and each of the
        source's own states (m, 1). Attitude errors are small turns in ECEF axes: ``C_true = (I + [phi x])
        C``.
    R : ndarray, shape (m, m)
    reason : str
        Why there are none, or fewer than measured.
    """

    keys: tuple[str, ...]
    nu: FloatArray
    H: Mapping[str, FloatArray]
    R: FloatArray
    reason: str = ""

    def __post_init__(self) -> None:
        freeze(self, "nu", "R")


@dataclass(frozen=True)
class Nuisance:
    """A state of a source's own: a clock, the speed of sound.

    Parameters
    ----------
    name : str
        ``"<source>.<what>"``.
    sigma : float
        Standard deviation at the start.
    walk : float
        Random walk, in its unit/sqrt(s).
    """

    name: str
    sigma: float
    walk: float = 0.0


@runtime_checkable
class Source(Protocol):
    """A source of navigation as a vehicle's description has it.

    A type may name in a class attribute ``fitted`` the fields, positive numbers, that a calibration fits.
    """

    @property
    def name(self) -> str:
        """Its name, which all its rows begin with."""
        ...

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return the states of its own."""
        ...

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose."""
        ...
