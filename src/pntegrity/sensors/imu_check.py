"""Whether the angles of an inertial measurement unit are in the unit that its table says: gravity and a track
tell a factor of 57.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.kernels.mean_force import WINDOW_S, mean_force
from pntegrity.records import FloatArray, Inertial

__all__ = ["check_level", "check_turns"]

ComplexArray = npt.NDArray[np.complex128]

DEG = np.pi / 180.0
#: The mean specific force of a window, in axes that do not turn, is not below this, m/s^2, where angles are
#: right (`kernels.mean_force`), and within these bounds where the body hardly tilts.
TOO_LOW_MPS2, LEAST_MPS2, MOST_MPS2 = 7.8, 9.3, 10.5
#: Angles are refused where this share of the windows, in the first and in the second half of the log, is too
#: low, and no fewer than this many.
SHARE, FEWEST_WINDOWS = 0.25, 3
#: A track's directions are compared from place to place, so far apart, m, and so many of its sigmas; where no
#: sigma is known, m; places that are longer apart than this, s, are not compared.
APART_M, APART_SIGMAS, APART_UNKNOWN_M, APART_S = 5.0, 10.0, 30.0, 60.0
#: A turn is more than this, rad. With fewer than this, factors fit by chance a vehicle that moves sideways as
#: much as it turns: 6 in 1000 of four turns, none in 20,000 of eight.
TURN_RAD, FEWEST_TURNS = 15.0 * DEG, 8
#: What another unit leaves of the turns is at most this share of what the unit that is told leaves, and of
#: what is left where the gyroscopes are not asked; without the worst of the turns, this share. What the right
#: unit leaves of the real logs at hand is 0.003 to 0.15 of the turns.
LEFT, WORST = 0.25, 0.1
#: What each factor to the angles would mean.
LOOKS = {
    DEG: "degrees that are named radians: name the columns gyro_x_dps, or dtheta_x_deg for increments",
    1.0 / DEG: "radians that are named degrees: name the columns gyro_x_rps, or dtheta_x_rad for increments",
    1e-3: "mrad that are named rad: name the columns dtheta_x_mrad",
    1e3: "rad that are named mrad: name the columns dtheta_x_rad",
    1.0 / 3600.0: "deg/h that are named deg/s: name the columns gyro_x_deg_h",
    3600.0: "deg/s that are named deg/h: name the columns gyro_x_dps",
}
RATES = "rates that are named increments: name the columns gyro_x_rps or gyro_x_dps"
INCREMENTS = "increments that are named rates: name the columns dtheta_x_rad or dtheta_x_deg"
#: Factors nearer to 1 than this are none.
NEAR_ONE = 5.0


def check_level(whole: Inertial, path: Path) -> None:
    """Check that the mean specific force, in axes that the gyroscopes keep from turning, is that of gravity.

    Parameters
    ----------
    whole : Inertial
        All increments of the log.
    path : Path
        The table, for the message.

    Raises
    ------
    InputError
        Angles are so much too large that gravity comes from everywhere. Angles that are too small are not
        seen: a mean that is not turned back is still about gravity.
    """
    increments = (whole.dt_s, whole.angle_rad, whole.velocity_mps)
    told = mean_force(*increments)
    low = told < TOO_LOW_MPS2
    halves = np.array_split(low, 2)
    if low.sum() < FEWEST_WINDOWS or min(half.mean() for half in halves) < SHARE:
        return
    small = float(np.median(mean_force(*increments, DEG)[low]))
    if not LEAST_MPS2 <= small <= MOST_MPS2:
        return
    raise InputError(
        f"angular rates are too large: turned by them, the specific force has a mean of "
        f"{float(np.median(told[low])):.1f} m/s2 in {int(low.sum())} of {len(low)} windows of "
        f"{WINDOW_S:g} s, where gravity is 9.8; divided by 57.3, degrees to radians, it has {small:.1f}",
        path=path, hint=f"They look like {LOOKS[DEG]}; or like {RATES}",
    )  # fmt: skip


def check_turns(
    whole: Inertial, t_ns: npt.NDArray[np.int64], track: FloatArray, sigma_m: float, path: Path
) -> None:
    """Check that a vehicle turned as much as its gyroscopes say.

    Parameters
    ----------
    whole : Inertial
        All increments of the log.
    t_ns : ndarray of int64, shape (k,)
        Times of the track.
    track : ndarray, shape (k, 2)
        Positions north and east, m; nan where there are none.
    sigma_m : float
        Their standard deviation; inf where it is not known.
    path : Path
        The table, for the message.

    Raises
    ------
    InputError
        The turns of the track are those of the gyroscopes times a factor that a wrong unit makes. Nothing is
        said of a vehicle that does not turn, or moves without regard of where it points.
    """
    first, last = whole.t_ns[0], whole.t_ns[-1]
    there = np.isfinite(track).all(axis=1) & (t_ns >= first) & (t_ns <= last)
    t_ns, track = t_ns[there], track[there]
    at = _apart(track, sigma_m)
    t_s = np.asarray((t_ns[at] - first) * 1e-9)
    seen = _turns(t_s, track[at] @ np.array([1.0, 1.0j]))
    turns = int((np.abs(seen) > TURN_RAD).sum())
    if turns < FEWEST_TURNS:
        return
    looks = _looks(float(np.median(whole.dt_s)))
    left = {k: _left(seen - _felt(whole, k, t_s)) for k in (0.0, 1.0, *looks)}
    factor = min(looks, key=lambda k: left[k])
    if left[factor] > LEFT * min(left[0.0], left[1.0]):
        return
    size = f"{max(factor, 1.0 / factor):.4g} times too {'large' if factor < 1.0 else 'small'}"
    raise InputError(
        f"angular rates are {size}: the track of the vehicle turns as they say only then, in {turns} turns",
        path=path, hint=f"They look like {looks[factor]}",
    )  # fmt: skip


def _left(turns: FloatArray) -> float:
    """Return what is left of turns, 1 - cos each, without the worst."""
    left = np.sort(1.0 - np.cos(turns[np.isfinite(turns)]))
    return float(left[: round(len(left) * (1.0 - WORST))].sum())


def _looks(dt_s: float) -> dict[float, str]:
    """Return what factors to the angles would mean in a table whose increments are so long."""
    both = LOOKS | {dt_s: RATES, 1.0 / dt_s: INCREMENTS}
    return {k: words for k, words in both.items() if max(k, 1.0 / k) > NEAR_ONE}


def _apart(track: FloatArray, sigma_m: float) -> list[int]:
    """Return which places of a track are far enough from the one before."""
    least = max(APART_M, APART_SIGMAS * sigma_m) if np.isfinite(sigma_m) else APART_UNKNOWN_M
    at: list[int] = []
    for i, place in enumerate(track):
        if not at or np.hypot(*(place - track[at[-1]])) >= least:
            at.append(i)
    return at


def _turns(t_s: FloatArray, place: ComplexArray) -> FloatArray:
    """Return by how much the way turns at each place but the ends, rad; nan where it took too long."""
    way = np.diff(place)
    quick = np.diff(t_s) < APART_S
    return np.where(quick[1:] & quick[:-1], np.angle(way[1:] * np.conj(way[:-1])), np.nan)


def _felt(whole: Inertial, factor: float, t_s: FloatArray) -> FloatArray:
    """Return the turns at the places of a way of even speed that points where gyroscopes say, rad."""
    up = whole.velocity_mps.sum(axis=0)
    heading = -factor * np.cumsum(whole.angle_rad @ (up / np.linalg.norm(up)))
    stamp_s = (whole.t_ns - whole.t_ns[0]) * 1e-9
    way = np.append(0.0, np.cumsum(np.exp(1j * heading[1:]) * np.diff(stamp_s)))
    place = np.interp(t_s, stamp_s, way.real) + 1j * np.interp(t_s, stamp_s, way.imag)
    return np.asarray(_turns(t_s, place))
