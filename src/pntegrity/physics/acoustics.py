"""Sound in water: profiles of its speed, and how long it travels from one place to another.

Depths are in metres, down positive, from the sea surface, whose height above the ellipsoid is given (about
the geoid's, and the tide). Places are Earth-fixed; the profile is laid about the vertical halfway between
both, so that a constant speed gives the straight line exactly, and both ends have their own depths. What is
left of the Earth's curvature, water in between that stands up to h^2/8R higher, is under 1e-7 of the time at
a horizontal distance h of 1 km and under 1e-5 at 10 km.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.axes import local_axes
from pntegrity.kernels.rays import trace_ray, trace_rays
from pntegrity.physics.frames import geodetic_of
from pntegrity.records import FloatArray
from pntegrity.states import freeze

__all__ = [
    "FASTEST_MPS", "SLOWEST_MPS", "Arrival", "Path", "Rays", "SoundSpeed", "arrival_at", "effective_speed",
    "path_between", "rays",
]  # fmt: skip

#: Speeds of sound in water, m/s.
SLOWEST_MPS, FASTEST_MPS = 1300.0, 1800.0
#: Above its first depth a profile holds that far, and above the mean surface, in waves: upper water is mixed.
TOP_GAP_M = 25.0
#: The last gradient is that over this much of the depth.
LAST_GRADIENT_M = 100.0


@dataclass(frozen=True, eq=False)
class SoundSpeed:
    """The speed of sound against depth.

    Parameters
    ----------
    depth_m : ndarray, shape (n,)
        Rising, down positive, from the sea surface.
    speed_mps : ndarray, shape (n,)
        In between it is linear.

    Raises
    ------
    ValueError
        Not two rows at least, depths that do not rise, or speeds that are not those of water.
    """

    depth_m: FloatArray
    speed_mps: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "depth_m", "speed_mps")
        z, c = self.depth_m, self.speed_mps
        if z.ndim != 1 or z.shape != c.shape or len(z) < 2:
            raise ValueError("`depth_m` and `speed_mps` must be two lists of the same length, two or more")
        if not np.isfinite(z).all() or not (np.diff(z) > 0.0).all():
            raise ValueError("`depth_m` must rise from row to row: depths in metres, down positive")
        odd = np.flatnonzero(~((c >= SLOWEST_MPS) & (c <= FASTEST_MPS)))
        if len(odd):
            raise ValueError(
                f"`speed_mps` must lie between {SLOWEST_MPS:g} and {FASTEST_MPS:g} m/s, not "
                f"{c[odd[0]]:g} at a depth of {z[odd[0]]:g} m"
            )

    @staticmethod
    def constant(speed_mps: float) -> SoundSpeed:
        """Return water in which sound is equally fast everywhere."""
        return SoundSpeed(np.array([0.0, 12_000.0]), np.array([speed_mps, speed_mps]))

    @cached_property
    def is_constant(self) -> bool:
        """Whether sound is equally fast everywhere."""
        return bool(self.speed_mps.min() == self.speed_mps.max())

    def check(self, depth_m: float, what: str = "a place") -> None:
        """Check that the profile reaches a depth.

        Raises
        ------
        ValueError
            Where it ends above, or begins more than `TOP_GAP_M` below; both depths are named.
        """
        if depth_m > self.depth_m[-1]:
            raise ValueError(
                f"the sound-speed profile ends at {self.depth_m[-1]:.1f} m, {what} is {depth_m:.1f} m deep: "
                "give a deeper profile, or add a row at that depth"
            )
        if depth_m < self.depth_m[0] - TOP_GAP_M or depth_m < -TOP_GAP_M:
            raise ValueError(
                f"the sound-speed profile begins at {self.depth_m[0]:.1f} m, {what} is {depth_m:.1f} m deep: "
                "give one from the surface on, depths positive down; see whether `sea_height_m`, the height "
                "of the sea surface above the ellipsoid, is right"
            )

    def extended(self, depth_m: float) -> SoundSpeed:
        """Return the profile down to a depth, with the gradient of its last `LAST_GRADIENT_M` metres."""
        z, c = self.depth_m, self.speed_mps
        if depth_m <= z[-1]:
            return self
        first = min(int(np.searchsorted(z, z[-1] - LAST_GRADIENT_M)), len(z) - 2)
        g = (c[-1] - c[first]) / (z[-1] - z[first])
        return SoundSpeed(np.append(z, depth_m), np.append(c, c[-1] + g * (depth_m - z[-1])))

    def at(self, depth_m: npt.ArrayLike) -> FloatArray:
        """Return the speed at depths; beyond the ends theirs holds."""
        return np.asarray(np.interp(np.asarray(depth_m, dtype=np.float64), self.depth_m, self.speed_mps))

    def gradient(self, depth_m: float) -> float:
        """Return the change of the speed with depth, 1/s, below a depth; beyond the ends there is none."""
        z, c = self.depth_m, self.speed_mps
        i = int(np.searchsorted(z, depth_m, side="right"))
        return float((c[i] - c[i - 1]) / (z[i] - z[i - 1])) if 0 < i < len(z) else 0.0


class Rays(NamedTuple):
    """Direct rays between pairs of points, in the plane of depth and horizontal distance.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Travel time one way; nan where no ray arrives without turning.
    p_spm : ndarray, shape (n,)
        Ray parameter: the derivative of the time by the horizontal distance, s/m.
    dt_dz1, dt_dz2 : ndarray, shape (n,)
        Derivatives of the time by the depths of the ends, s/m.
    dp_dx, dp_dz1 : ndarray, shape (n,)
        Derivatives of the ray parameter by the distance and the first depth, s/m^2: how the direction at an
        end turns.
    """

    time_s: FloatArray
    p_spm: FloatArray
    dt_dz1: FloatArray
    dt_dz2: FloatArray
    dp_dx: FloatArray
    dp_dz1: FloatArray


def rays(sound: SoundSpeed, z1_m: npt.ArrayLike, z2_m: npt.ArrayLike, x_m: npt.ArrayLike) -> Rays:
    """Return the direct rays between pairs of points.

    Parameters
    ----------
    sound : SoundSpeed
    z1_m, z2_m : array_like, shape (n,)
        Depths of the ends.
    x_m : array_like, shape (n,)
        Horizontal distance.

    Notes
    -----
    Each layer is an exact circular arc. A pair that only a ray with a turning point joins (nearly horizontal
    ways, equal depths) gets nan.
    """
    z1, z2, x = (
        np.ascontiguousarray(a, dtype=np.float64)
        for a in np.broadcast_arrays(*(np.atleast_1d(np.asarray(a)) for a in (z1_m, z2_m, x_m)))
    )
    t, p, w1, w2, spread = trace_rays(z1, z2, np.abs(x), sound.depth_m, sound.speed_mps).T
    c1, c2 = sound.at(z1), sound.at(z2)
    down = np.where(z2 >= z1, 1.0, -1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        # tan(angle)/spread, with spread infinite where a ray is horizontal
        turn = np.where(w1 > 0.0, down * p * c1 / (w1 * spread), 0.0)
        return Rays(t, p, -down * w1 / c1, down * w2 / c2, 1.0 / spread, turn)


class Path(NamedTuple):
    """The direct ray between two places.

    Parameters
    ----------
    time_s : float
        Travel time one way; nan where no ray arrives without turning.
    slowness_spm : ndarray, shape (3,)
        Derivative of the time by the first place, ECEF, s/m; it points away from where the sound comes from.
    """

    time_s: float
    slowness_spm: FloatArray


class Arrival(NamedTuple):
    """From where the sound of another place comes.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Unit vector, ECEF, at the first place; nan where no ray arrives without turning.
    by_place : ndarray, shape (3, 3)
        Its derivative by the first place, 1/m.
    """

    direction: FloatArray
    by_place: FloatArray


def path_between(
    sound: SoundSpeed, here_m: FloatArray, there_m: FloatArray, sea_height_m: float = 0.0
) -> Path:
    """Return the direct ray from one place to another.

    Parameters
    ----------
    sound : SoundSpeed
    here_m, there_m : ndarray, shape (3,)
        ECEF.
    sea_height_m : float
        Height of the sea surface above the ellipsoid.

    Raises
    ------
    ValueError
        Where the profile does not reach one of the depths.
    """
    if sound.is_constant:
        way = there_m - here_m
        length, c = float(np.linalg.norm(way)), float(sound.speed_mps[0])
        return Path(length / c, -way / (length * c) if length else np.zeros(3))
    plane = _plane(sound, here_m, there_m, sea_height_m)
    time, p, w, *_ = trace_ray(plane.z1, plane.z2, plane.x, sound.depth_m, sound.speed_mps)
    rise = w / float(sound.at(plane.z1)) * plane.down
    # as the place moves along, the distance falls; as it moves up, its depth falls
    return Path(time, rise * plane.up - p * plane.along)


def arrival_at(
    sound: SoundSpeed, here_m: FloatArray, there_m: FloatArray, sea_height_m: float = 0.0
) -> Arrival:
    """Return from where the sound of another place comes; parameters and errors of `path_between`."""
    if sound.is_constant:
        way = there_m - here_m
        length = float(np.linalg.norm(way))
        u = way / length if length else way
        return Arrival(u, (_square(u) - np.eye(3)) / length if length else np.zeros((3, 3)))
    plane = _plane(sound, here_m, there_m, sea_height_m)
    _, p, dt_dz1, _, dp_dx, dp_dz1 = (float(v[0]) for v in rays(sound, plane.z1, plane.z2, plane.x))
    c, up, along = float(sound.at(plane.z1)), plane.up, plane.along
    sine, cosine = p * c, -dt_dz1 * c
    by_place = -c * dp_dx * along - (c * dp_dz1 + p * sound.gradient(plane.z1)) * up
    turning = _turning(sine, cosine, by_place, along, up)
    turning -= (sine / plane.x if plane.x > 0.0 else c * dp_dx) * _square(np.cross(up, along))
    return Arrival(sine * along - cosine * up, turning)


class _Plane(NamedTuple):
    """Two places in the plane of depth and horizontal distance, and where that lies; `down` is 1 where the
    second is deeper, else -1.
    """

    z1: float
    z2: float
    x: float
    down: float
    up: FloatArray
    along: FloatArray


def _plane(sound: SoundSpeed, here_m: FloatArray, there_m: FloatArray, sea_height_m: float) -> _Plane:
    up, way = _up(0.5 * (here_m + there_m)), there_m - here_m
    rise = float(up @ way)
    z1 = sea_height_m - geodetic_of(*here_m.tolist())[2]
    for z in (z1, z1 - rise):
        sound.check(z)
    side = way - rise * up
    x = float(np.linalg.norm(side))
    along = side / x if x > 0.0 else _any_normal(up)
    return _Plane(z1, z1 - rise, x, 1.0 if rise <= 0.0 else -1.0, up, along)


def _turning(
    sine: float, cosine: float, by_place: FloatArray, along: FloatArray, up: FloatArray
) -> FloatArray:
    """Return how a direction ``sine along - cosine up`` turns in its plane, of the derivative of the sine."""
    if cosine == 0.0:
        return np.outer(along, by_place)
    return np.outer(along, by_place) + np.outer(up, sine / cosine * by_place)


def _square(v: FloatArray) -> FloatArray:
    return np.outer(v, v)


def _up(place_m: FloatArray) -> FloatArray:
    return np.asarray(local_axes(place_m)[2])


def _any_normal(up: FloatArray) -> FloatArray:
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    side = np.cross(up, other)
    return np.asarray(side / np.linalg.norm(side))


def effective_speed(
    sound: SoundSpeed, z1_m: npt.ArrayLike, z2_m: npt.ArrayLike, x_m: npt.ArrayLike
) -> FloatArray:
    """Return the straight distance over the travel time, m/s, of the pairs of points of `rays`."""
    length = np.hypot(np.asarray(z2_m) - np.asarray(z1_m), x_m)
    return np.asarray(length / rays(sound, z1_m, z2_m, x_m).time_s)
