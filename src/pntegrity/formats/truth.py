"""Reference trajectories: CSV with a header that names its columns, or RTKLIB's ``.pos`` -> `Truth`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.formats._columns import (
    check_any,
    columns_of,
    numbers,
    positions,
    read_cells,
    usable,
    velocities,
)
from pntegrity.records import FloatArray

__all__ = ["Truth", "read_truth"]

GAP_FACTOR = 1.5
"""Steps longer than this many times the usual one are gaps: nothing is interpolated across them."""

ATTITUDE = ("roll", "pitch", "heading")


@dataclass(frozen=True, eq=False)
class Truth:
    """A reference trajectory.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        GPS time, strictly rising.
    position_m : ndarray, shape (n, 3)
        ECEF.
    velocity_mps : ndarray, shape (n, 3), or None
        ECEF.
    notes : tuple of str
        What was dropped.
    attitude_rad : ndarray, shape (n, 3), or None
        Roll (right side down), pitch (nose up), heading (clockwise from north); nan where one is not known.
    """

    t_ns: npt.NDArray[np.int64]
    position_m: FloatArray
    velocity_mps: FloatArray | None = None
    notes: tuple[str, ...] = ()
    attitude_rad: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("t_ns", "position_m", "velocity_mps", "attitude_rad"):
            value = getattr(self, name)
            if value is not None:
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)

    def at(self, t_ns: npt.ArrayLike) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Return positions (n, 3) at the times `t_ns`, interpolated linearly, and which of them are valid.

        Outside the trajectory and inside its gaps (steps over 1.5 times the usual one) there is no position:
        nan.
        """
        t = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        right = np.searchsorted(self.t_ns, t, side="left").clip(0, len(self.t_ns) - 1)
        left = np.where(self.t_ns[right] == t, right, (right - 1).clip(0))
        step = self.t_ns[right] - self.t_ns[left]
        usual = np.median(np.diff(self.t_ns)) if len(self.t_ns) > 1 else 0.0
        since = t - self.t_ns[left]
        valid = (since >= 0) & (since <= step) & (step <= GAP_FACTOR * usual)
        part = np.where(step > 0, since / np.maximum(step, 1), 0.0)[:, None]
        position = (1.0 - part) * self.position_m[left] + part * self.position_m[right]
        return np.where(valid[:, None], position, np.nan), valid


def read_truth(path: Path | str) -> Truth:
    """Read a reference trajectory.

    Parameters
    ----------
    path : Path or str
        CSV, plain or gzip. Time: ``t_ns``, or ``gps_week`` and ``tow_s``, or ISO ``time_gps`` (GPS time).
        Position: ``x_m, y_m, z_m`` or ``lat_deg, lon_deg, height_m``. Velocity, optional: ``vx_mps, vy_mps,
        vz_mps`` or ``ve_mps, vn_mps, vu_mps``. Attitude, optional: ``roll_deg, pitch_deg, heading_deg``. Or
        RTKLIB's ``.pos`` in GPST, geodetic degrees or ECEF.

    Returns
    -------
    Truth
        Lines that are damaged or go back in time are dropped and noted.

    Raises
    ------
    InputError
        No such file, unknown columns, or no usable line.
    """
    path = Path(path)
    notes: list[str] = []
    cells = read_cells(path)
    column = columns_of(cells.names, path)
    table, t_ns = numbers(cells, column, path, notes)
    keep = usable(table, t_ns, column, notes)
    check_any(keep, path)
    table = table[keep]
    position = positions(table, column)
    velocity = velocities(table, column, position)
    return Truth(t_ns[keep], position, velocity, tuple(notes), _attitude(table, column))


def _attitude(table: FloatArray, column: Mapping[str, int]) -> FloatArray | None:
    if not column.keys() >= set(ATTITUDE):
        return None
    return np.radians(table[:, [column[n] for n in ATTITUDE]])
