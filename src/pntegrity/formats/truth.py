"""Reference trajectories: CSV with a header that names its columns, or RTKLIB's ``.pos`` -> `Truth`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.frames import ecef_to_geodetic, geodetic_to_ecef
from pntegrity.physics.time import from_iso, from_week_tow, to_iso
from pntegrity.records import FloatArray

__all__ = ["Truth", "read_truth"]

GAP_FACTOR = 1.5
"""Steps longer than this many times the usual one are gaps: nothing is interpolated across them."""

# Names as found in the wild, lower case without units in brackets, blanks as "_".
NAMES: dict[str, tuple[str, ...]] = {
    "t_ns": ("t_ns", "time_ns", "gps_time_ns"),
    "week": ("gps_week", "week", "gpst_week", "wn"),
    "tow": ("tow_s", "gps_tow", "gps_tow_s", "tow", "sow", "gps_sow", "gpst_tow", "time_of_week_s"),
    "iso": ("time_gps", "gpst", "time", "datetime", "time_gpst"),
    "x": ("x_m", "ecef_x_m", "ecef_x", "x-ecef", "x", "pos_x_m"),
    "y": ("y_m", "ecef_y_m", "ecef_y", "y-ecef", "y", "pos_y_m"),
    "z": ("z_m", "ecef_z_m", "ecef_z", "z-ecef", "z", "pos_z_m"),
    "lat": ("lat_deg", "latitude_deg", "latitude", "lat"),
    "lon": ("lon_deg", "longitude_deg", "longitude", "lon"),
    "height": ("height_m", "ellipsoid_height", "ellipsoidal_height", "h_ell_m", "height", "alt_m", "hgt"),
    "vx": ("vx_mps", "vel_ecef_x", "ecef_vx_mps", "vx"),
    "vy": ("vy_mps", "vel_ecef_y", "ecef_vy_mps", "vy"),
    "vz": ("vz_mps", "vel_ecef_z", "ecef_vz_mps", "vz"),
    "ve": ("ve_mps", "east_velocity", "ve"),
    "vn": ("vn_mps", "north_velocity", "vn"),
    "vu": ("vu_mps", "up_velocity", "vu"),
    "roll": ("roll_deg", "roll", "att2_deg"),
    "pitch": ("pitch_deg", "pitch", "att1_deg"),
    "heading": ("heading_deg", "heading", "yaw_deg", "azimuth_deg"),
}
"""The attitude of GINav's tables is pitch, roll, heading: ``att1_deg`` is pitch."""
ATTITUDE = {"roll", "pitch", "heading"}
BARE = ("gps_week", "tow_s", "lat_deg", "lon_deg", "height_m")
"""Columns of a table of five numbers a line without a header (UrbanNav's ground truth)."""


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
    text = read_text(path)
    names, rows, first_line = _split_pos(text, path) if _is_pos(text) else _split_csv(text, path)
    column = _match(names)
    _check_columns(column, names, path)
    notes: list[str] = []
    table, t_ns = _numbers(rows, names, column, first_line, path, notes)
    keep = _usable(table, t_ns, column, notes)
    if not keep.any():
        raise InputError("no usable line", path=path, hint="Check the columns' units and order")
    return _truth(table[keep], t_ns[keep], column, tuple(notes))


def _is_pos(text: str) -> bool:
    return text.lstrip().startswith("%")


def _split_pos(text: str, path: Path) -> tuple[list[str], list[list[str]], int]:
    lines = text.splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("%")]
    header = next((lines[i] for i in reversed(heads) if "latitude" in lines[i] or "x-ecef" in lines[i]), "")
    if not header:
        raise InputError(
            "this .pos file has no column line with latitude(deg) or x-ecef(m)",
            path=path,
            hint="Keep RTKLIB's header",
        )
    if "GPST" not in header:
        raise InputError(
            "this .pos file is not in GPS time",
            path=path,
            hint="Set RTKLIB's out-timesys to gpst and run it again",
        )
    names = header.lstrip("% ").split()
    rows = [line.split() for line in lines if line.strip() and not line.startswith("%")]
    as_date = bool(rows) and "/" in rows[0][0]
    rows = [[f"{r[0].replace('/', '-')}T{r[1]}", *r[2:]] if as_date and len(r) > 1 else r for r in rows]
    names = names if as_date else ["gps_week", "tow_s", *names[1:]]
    return names, rows, len(heads) + 1


def _split_csv(text: str, path: Path) -> tuple[list[str], list[list[str]], int]:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    mark = max(",;\t", key=lines[0].count) if lines else ","
    rows = [[cell.strip() for cell in line.split(mark)] for line in lines]
    if rows and all(_is_number(cell) for cell in rows[0]):
        if len(rows[0]) != len(BARE):
            raise InputError(
                f"this table has no header, and {len(rows[0])} columns",
                path=path,
                line=1,
                hint=f"Put a line with the columns' names on top, such as {','.join(BARE)}",
            )
        return list(BARE), rows, 1
    return rows[0], rows[1:], 2


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _match(names: Sequence[str]) -> dict[str, int]:
    """Return for each known quantity its column: names without units in brackets, case and blanks apart."""
    plain = [re.sub(r"\(.*?\)", "", n).strip().lower().replace(" ", "_") for n in names]
    return {q: plain.index(v) for q, variants in NAMES.items() for v in variants[::-1] if v in plain}


def _check_columns(column: Mapping[str, int], names: Sequence[str], path: Path) -> None:
    has_time = "t_ns" in column or {"week", "tow"} <= column.keys() or "iso" in column
    has_place = {"x", "y", "z"} <= column.keys() or {"lat", "lon", "height"} <= column.keys()
    if has_time and has_place:
        return
    lacks = " and ".join(w for w, there in (("time", has_time), ("position", has_place)) if not there)
    raise InputError(
        f"no columns for {lacks} among {', '.join(names)[:200]}",
        path=path,
        line=1,
        hint="Name t_ns, or gps_week and tow_s, or time_gps; and x_m, y_m, z_m or lat_deg, lon_deg, height_m",
    )


def _numbers(
    rows: Sequence[Sequence[str]],
    names: Sequence[str],
    column: Mapping[str, int],
    first_line: int,
    path: Path,
    notes: list[str],
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return all cells as floats (nan: no number) and the times; lines without a time are dropped."""
    width = len(names)
    kept: list[Sequence[float]] = []
    times: list[int] = []
    bad: list[int] = []
    for i, row in enumerate(rows):
        try:
            t = _time(row, column)
            kept.append([_number(row[k]) if k < len(row) else np.nan for k in range(width)])
            times.append(t)
        except (ValueError, IndexError, OverflowError):
            bad.append(first_line + i)
    if bad:
        notes.append(f"{len(bad)} lines without a readable time dropped, first line {bad[0]}")
    if not kept:
        raise InputError(
            "no line with a time",
            path=path,
            line=first_line,
            hint="Times are numbers, or ISO as 2019-01-14T06:15:00",
        )
    return np.array(kept, dtype=np.float64), np.array(times, dtype=np.int64)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _time(row: Sequence[str], column: Mapping[str, int]) -> int:
    if "t_ns" in column:
        t = int(row[column["t_ns"]])
    elif "week" in column and "tow" in column:
        week, tow = float(row[column["week"]]), float(row[column["tow"]])
        if not (0.0 <= week < 10_000.0 and 0.0 <= tow < 1e6):
            raise ValueError("no GPS week and second")
        t = int(from_week_tow(int(week), tow))
    else:
        t = from_iso(row[column["iso"]])
    if not 0 <= t < 2**62:
        raise ValueError("time before 1980 or absurd")
    return t


def _usable(
    table: FloatArray, t_ns: npt.NDArray[np.int64], column: Mapping[str, int], notes: list[str]
) -> npt.NDArray[np.bool_]:
    place = [
        column[k] for k in (("x", "y", "z") if {"x", "y", "z"} <= column.keys() else ("lat", "lon", "height"))
    ]
    finite = np.isfinite(table[:, place]).all(axis=1)
    if not {"x", "y", "z"} <= column.keys():
        finite &= (np.abs(table[:, place[0]]) <= 90.0) & (np.abs(table[:, place[1]]) <= 360.0)
    before = np.maximum.accumulate(np.where(finite, t_ns, -1))
    rising = np.append(True, t_ns[1:] > before[:-1])
    if not finite.all():
        notes.append(f"{int((~finite).sum())} lines dropped: their position is no number or no place")
    if not rising[finite].all():
        first = to_iso(int(t_ns[np.flatnonzero(finite & ~rising)[0]]))
        notes.append(
            f"{int((finite & ~rising).sum())} lines dropped: time repeats or goes back, first at {first}"
        )
    return finite & rising


def _truth(
    table: FloatArray, t_ns: npt.NDArray[np.int64], column: Mapping[str, int], notes: tuple[str, ...]
) -> Truth:
    def of(*names: str) -> FloatArray:
        return table[:, [column[n] for n in names]]

    if {"x", "y", "z"} <= column.keys():
        position = of("x", "y", "z")
    else:
        llh = of("lat", "lon", "height")
        position = geodetic_to_ecef(np.radians(llh[:, 0]), np.radians(llh[:, 1]), llh[:, 2])
    velocity = None
    if {"vx", "vy", "vz"} <= column.keys():
        velocity = of("vx", "vy", "vz")
    elif {"ve", "vn", "vu"} <= column.keys():
        velocity = _from_enu(position, of("ve", "vn", "vu"))
    attitude = np.radians(of("roll", "pitch", "heading")) if column.keys() >= ATTITUDE else None
    return Truth(t_ns, position, velocity, notes, attitude)


def _from_enu(position_m: FloatArray, enu: FloatArray) -> FloatArray:
    """Return ECEF vectors (n, 3) of east, north, up ones, each turned at its own position."""
    lat, lon, _ = ecef_to_geodetic(position_m).T
    (sp, cp), (sl, cl) = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon))
    e, n, u = enu.T
    radial = cp * u - sp * n
    return np.stack([radial * cl - e * sl, radial * sl + e * cl, cp * n + sp * u], axis=1)
