"""By how much the stamps of an inertial unit are late, from the motion that it and the antenna felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.formats.fixes import POSITION_KEYS, VELOCITY_KEYS
from pntegrity.kernels.lag import Felt, Lag, find_lag
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import Epoch, FloatArray, Inertial
from pntegrity.sensors.snapshot import snapshot

__all__ = ["MOST_LAG_S", "Track", "estimate_lag", "tracks", "without_lag"]

#: A lag is believed where this much of the accelerations is explained, and its standard deviation is at most
#: this, s; lags are looked for up to `MOST_LAG_S`.
LEAST_CORRELATION, MOST_SIGMA_S, MOST_LAG_S = 0.6, 0.1, 1.0
#: Positions tell the lag where the accelerations that they give are better than this, m/s^2: a receiver's
#: velocities may be late themselves.
POSITIONS_MPS2 = 1.0

Motion = tuple[FloatArray, FloatArray, float]
#: What `tracks` returns.
Track = tuple[FloatArray, FloatArray, float]


def without_lag(whole: Inertial, lag: Lag | None, path: Path, notes: list[str]) -> Inertial:
    """Return the increments with the stamps put right.

    Parameters
    ----------
    whole : Inertial
    lag : Lag or None
        As `estimate_lag` gives it.
    path : Path
        Of the table, for messages.
    notes : list of str
        Gets the lag.

    Raises
    ------
    InputError
        No lag, one that explains too little, or one at the end of the search.
    """
    good = lag is not None and lag.correlation >= LEAST_CORRELATION and lag.sigma_s <= MOST_SIGMA_S
    if lag is None or not good or abs(lag.lag_s) > MOST_LAG_S - MOST_SIGMA_S:
        found = ""
        if lag is not None:
            best = f"the best is {lag.lag_s:.2f} s +- {lag.sigma_s:.2f} s"
            found = f": {best}, which explains {lag.correlation:.2f} of what moves"
        raise InputError(
            f"the lag of its stamps cannot be told from the motion{found}", path=path,
            hint="Give it with --imu-lag-s SECONDS; see whether units and axes (--imu-axes) are right",
        )  # fmt: skip
    notes.append(
        f"{path.name}: stamps are {lag.lag_s:.3f} s late (+- {lag.sigma_s:.3f} s; correlation "
        f"{lag.correlation:.2f}), by comparison with the motion of the antenna"
    )
    return replace(whole, t_ns=whole.t_ns - round(lag.lag_s * SECOND_NS))


def estimate_lag(
    whole: Inertial, epochs: Sequence[Epoch], track: Track, notes: list[str] | None = None
) -> Lag | None:
    """Return by how much the stamps of an IMU are late, None where the motion does not tell.

    What the unit felt is compared with the accelerations of the antenna: from fixes' positions, where these
    are good enough (centimetres), or else from velocities; see `kernels.lag.find_lag`.

    Parameters
    ----------
    whole : Inertial
        As `read_imu` gives it without a lag.
    epochs : sequence of Epoch
    track : tuple
        Of `tracks`, of the same epochs.
    notes : list of str, optional
        Gets a word on velocities of fixes that are late against their positions.
    """
    if not epochs or not len(whole.t_ns):
        return None
    first = epochs[0].t_ns
    felt = Felt(
        np.asarray((whole.t_ns - first) * 1e-9), whole.dt_s, whole.angle_rad[:, 2], whole.velocity_mps[:, :2]
    )
    positions, speeds, noise = track
    by_speed = _lag_of(felt, epochs, speeds, 1)
    step = np.median(np.diff([e.t_ns for e in epochs])) * 1e-9 if len(epochs) > 1 else 1.0
    if not noise * np.sqrt(6.0) / step**2 <= POSITIONS_MPS2:
        return by_speed
    by_place = _lag_of(felt, epochs, positions, 2)
    if by_place and by_speed and notes is not None:
        late = by_place.lag_s - by_speed.lag_s
        if abs(late) > 3.0 * np.hypot(by_place.sigma_s, by_speed.sigma_s):
            notes.append(
                f"velocities of the fixes are {late:.2f} s late against their positions: take that times the "
                "usual acceleration for their smallest sigma (--fix-floor-mps)"
            )
    return by_place or by_speed


def _lag_of(felt: Felt, epochs: Sequence[Epoch], track: FloatArray, order: int) -> Lag | None:
    there = np.isfinite(track).all(axis=1)
    t_s = np.array([e.t_ns - epochs[0].t_ns for e in epochs])[there] * 1e-9
    return find_lag(felt, np.asarray(t_s), track[there], order, MOST_LAG_S)


def tracks(epochs: Sequence[Epoch], options: GnssOptions) -> Track:
    """Return how the antenna moved.

    Parameters
    ----------
    epochs : sequence of Epoch
        With fixes, sources that tell a position, or code and range rates.
    options : GnssOptions
        For snapshots from code and range rates.

    Returns
    -------
    tuple
        Positions, m, and velocities, m/s, north and east, shapes (n, 2), nan where there are none; and the
        standard deviation that fixes state for their positions, m, inf for snapshots.
    """
    both = [_from_fix(e) or _from_sources(e, options) or _from_snapshot(e, options) for e in epochs]
    place = np.array([p for p, _, _ in both])
    known = place[np.isfinite(place).all(axis=1)]
    if not len(known):
        return np.full((len(both), 2), np.nan), np.full((len(both), 2), np.nan), np.inf
    north_east = enu_rotation(known[0])[[1, 0]]
    speed = np.array([v for _, v, _ in both])
    noise = float(np.median([s for _, _, s in both]))
    return (place - known[0]) @ north_east.T, speed @ north_east.T, noise


def _from_fix(epoch: Epoch) -> Motion | None:
    fix = epoch.sensor("fix")
    if fix is None or fix.sigma is None:
        return None
    row = dict(zip(fix.keys, fix.y.tolist(), strict=True))
    place = np.array([row.get(k, np.nan) for k in POSITION_KEYS])
    return place, np.array([row.get(k, np.nan) for k in VELOCITY_KEYS]), float(fix.sigma[:3].max())


def _from_sources(epoch: Epoch, options: GnssOptions) -> Motion | None:
    """Return what the first source that tells a position says of it."""
    for source in options.sources:
        said, told = epoch.sensor(source.name), getattr(source, "position", None)
        found = told(said) if said is not None and len(said.keys) and told is not None else None
        if found is not None:
            place, speed, cov = found
            sigma = float(np.sqrt(np.diag(cov)[:3].max()))
            return place, np.full(3, np.nan) if speed is None else speed, sigma
    return None


def _from_snapshot(epoch: Epoch, options: GnssOptions) -> Motion:
    nothing = np.full(3, np.nan)
    if epoch.sensor("code") is None or epoch.sensor("doppler") is None:
        return nothing, nothing, np.inf
    fix = snapshot(epoch, options, np.zeros(3))
    speed = nothing if fix.reason or fix.velocity_mps is None else fix.velocity_mps
    return (nothing if fix.reason else fix.position_m), speed, np.inf
