"""Tables with a time and a position a line, as text: CSV with named columns, or RTKLIB's ``.pos``.

What their readers share.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.frames import enu_rotations, geodetic_to_ecef
from pntegrity.physics.time import SECOND_NS, from_iso, from_week_tow, to_iso
from pntegrity.records import FloatArray

__all__ = [
    "MOST_SECONDS", "NAMES", "TIMES", "Cells", "check_any", "checked", "columns_of", "first_of", "has_time",
    "matched", "number", "numbers", "plain_name", "positions", "read_cells", "second_time", "seconds_to_ns",
    "split_csv", "time_of", "usable", "velocities",
]  # fmt: skip

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
TIMES = {q: NAMES[q] for q in ("t_ns", "week", "tow", "iso")} | {
    "t_s": ("t_s", "time_s", "seconds", "elapsed_s", "t"),
}
"""Names of times, bare seconds among them."""
BARE = ("gps_week", "tow_s", "lat_deg", "lon_deg", "height_m")
"""Columns of a table of five numbers a line without a header (UrbanNav's ground truth)."""
#: Bare seconds that are more are taken for no time.
MOST_SECONDS = 1e9
ECEF, GEODETIC = ("x", "y", "z"), ("lat", "lon", "height")


@dataclass(frozen=True)
class Cells:
    """A table as text: names of its columns, its rows, and which line of the file each of them is."""

    names: list[str]
    rows: list[list[str]]
    lines: list[int]


# --- from text to cells -------------------------------------------------------------------------------------


def read_cells(path: Path) -> Cells:
    """Return the table of a file: RTKLIB's ``.pos`` where it begins with ``%``, else CSV.

    Raises
    ------
    InputError
        As `read_text`, or nothing that names the columns.
    """
    text = read_text(path)
    return _split_pos(text, path) if text.lstrip().startswith("%") else split_csv(text, path)


def _split_pos(text: str, path: Path) -> Cells:
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    heads = [line for _, line in lines if line.startswith("%")]
    names = _pos_header(heads, path).lstrip("% ").split()
    at, rows = _parted([(i, line.split()) for i, line in lines if not line.startswith("%")])
    if not rows or "/" not in rows[0][0]:
        return Cells(["gps_week", "tow_s", *names[1:]], rows, at)
    dated = [[f"{r[0].replace('/', '-')}T{r[1]}", *r[2:]] if len(r) > 1 else r for r in rows]
    return Cells(names, dated, at)


def _parted(rows: Sequence[tuple[int, list[str]]]) -> tuple[list[int], list[list[str]]]:
    return [i for i, _ in rows], [row for _, row in rows]


def _pos_header(heads: Sequence[str], path: Path) -> str:
    header = next((h for h in reversed(heads) if "latitude" in h or "x-ecef" in h), "")
    if not header:
        raise InputError(
            "this .pos file has no column line with latitude(deg) or x-ecef(m)", path=path,
            hint="Keep RTKLIB's header",
        )  # fmt: skip
    if "GPST" not in header:
        raise InputError(
            "this .pos file is not in GPS time", path=path,
            hint="Set RTKLIB's out-timesys to gpst and run it again",
        )  # fmt: skip
    return header


def split_csv(text: str, path: Path) -> Cells:
    """Return the table of a text whose cells are separated by comma, semicolon or tab.

    Raises
    ------
    InputError
        Comments alone, or no header, and not the five columns of `BARE`.
    """
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(i, line) for i, line in lines if not line.startswith("#")]
    if not lines:
        raise InputError("nothing but comments", path=path, hint="Put the columns' names and rows into it")
    mark = max(",;\t", key=lines[0][1].count)
    at, rows = _parted([(i, [cell.strip() for cell in line.split(mark)]) for i, line in lines])
    if not all(_is_number(cell) for cell in rows[0]):
        return Cells(rows[0], rows[1:], at[1:])
    if len(rows[0]) != len(BARE):
        raise InputError(
            f"this table has no header, and {len(rows[0])} columns", path=path, line=at[0],
            hint=f"Put a line with the columns' names on top, such as {','.join(BARE)}",
        )  # fmt: skip
    return Cells(list(BARE), rows, at)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


# --- which column is what -----------------------------------------------------------------------------------


def plain_name(name: str) -> str:
    """Return the name of a column without a unit in brackets, in lower case."""
    return re.sub(r"\(.*?\)", "", name).strip().lower()


def first_of(plain: Sequence[str], variants: Sequence[str]) -> int | None:
    """Return where the first of some variants of a name that is there stands; None: none is."""
    return next((plain.index(v) for v in variants if v in plain), None)


def matched(plain: Sequence[str], names: Mapping[str, Sequence[str]] = NAMES) -> dict[str, int]:
    """Return for each known quantity its column."""
    found = {q: first_of(plain, variants) for q, variants in names.items()}
    return {q: at for q, at in found.items() if at is not None}


def columns_of(names: Sequence[str], path: Path) -> dict[str, int]:
    """Return for each known quantity its column: times and positions must be there.

    Raises
    ------
    InputError
        Saying which of both lacks.
    """
    column = matched([plain_name(n).replace(" ", "_") for n in names])
    has_place = column.keys() >= set(ECEF) or column.keys() >= set(GEODETIC)
    lacks = [w for w, there in (("time", has_time(column)), ("position", has_place)) if not there]
    if lacks:
        raise InputError(
            f"no columns for {' and '.join(lacks)} among {', '.join(names)[:200]}", path=path, line=1,
            hint="Name t_ns, or gps_week and tow_s, or time_gps; and x_m, y_m, z_m or lat_deg, lon_deg, "
            "height_m",
        )  # fmt: skip
    return column


def has_time(column: Mapping[str, int]) -> bool:
    """Tell whether there are columns with GPS times, other than bare seconds."""
    return "t_ns" in column or {"week", "tow"} <= column.keys() or "iso" in column


# --- times --------------------------------------------------------------------------------------------------


def time_of(row: Sequence[str], column: Mapping[str, int]) -> int:
    """Return the time of a row, ns of GPS time (ValueError, IndexError or OverflowError: it has none)."""
    if "t_ns" in column:
        t = int(row[column["t_ns"]])
    elif "week" in column and "tow" in column:
        t = _week_time(float(row[column["week"]]), float(row[column["tow"]]))
    else:
        t = from_iso(row[column["iso"]])
    return checked(t)


def checked(t_ns: int) -> int:
    """Return a time, ns of GPS time (ValueError: before 1980, or absurd)."""
    if not 0 <= t_ns < 2**62:
        raise ValueError("time before 1980 or absurd")
    return t_ns


def _week_time(week: float, tow: float) -> int:
    if not (0.0 <= week < 10_000.0 and 0.0 <= tow < 1e6):
        raise ValueError("no GPS week and second")
    return int(from_week_tow(int(week), tow))


def _time_or_none(row: Sequence[str], column: Mapping[str, int]) -> int | None:
    try:
        return time_of(row, column)
    except (ValueError, IndexError, OverflowError):
        return None


def seconds_to_ns(seconds: npt.ArrayLike, origin_ns: int | None, path: Path) -> npt.NDArray[np.int64]:
    """Return GPS times of bare seconds.

    Raises
    ------
    InputError
        Where the time of second 0 is not known.
    """
    if origin_ns is None:
        raise InputError(
            "times are bare seconds, from an unknown time on", path=path,
            hint="Say with --imu-start when second 0 was, in GPS time: --imu-start 2025-07-08T19:34:00",
        )  # fmt: skip
    return origin_ns + np.rint(np.asarray(seconds, dtype=np.float64) * SECOND_NS).astype(np.int64)


def second_time(cell: str, origin_ns: int | None, path: Path) -> int:
    """Return the GPS time of a cell with bare seconds (ValueError: it is none)."""
    seconds = float(cell)
    if not abs(seconds) < MOST_SECONDS:
        raise ValueError(f"{cell!r} is no number of seconds")
    return checked(int(seconds_to_ns(seconds, origin_ns, path)))


# --- numbers ------------------------------------------------------------------------------------------------


def number(cell: str) -> float:
    """Return the number of a cell; nan where it is none."""
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def numbers(
    cells: Cells, column: Mapping[str, int], path: Path, notes: list[str]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return all cells as numbers (nan: none), and the times, ns; rows without a time are dropped and noted.

    Raises
    ------
    InputError
        No row has a time.
    """
    times = [_time_or_none(row, column) for row in cells.rows]
    bad = [line for line, t in zip(cells.lines, times, strict=True) if t is None]
    if bad:
        notes.append(f"{len(bad)} lines without a readable time dropped, first line {bad[0]}")
    if len(bad) == len(times):
        raise InputError(
            "no line with a time", path=path, line=cells.lines[0] if times else None,
            hint="Times are numbers, or ISO as 2019-01-14T06:15:00",
        )  # fmt: skip
    n = len(cells.names)
    kept = [_numbers_of(row, n) for row, t in zip(cells.rows, times, strict=True) if t is not None]
    return np.array(kept, dtype=np.float64), np.array([t for t in times if t is not None], dtype=np.int64)


def _numbers_of(row: Sequence[str], n: int) -> list[float]:
    return [number(row[k]) if k < len(row) else np.nan for k in range(n)]


def usable(
    table: FloatArray, t_ns: npt.NDArray[np.int64], column: Mapping[str, int], notes: list[str]
) -> npt.NDArray[np.bool_]:
    """Return which rows have a position and come later than those before them; the others are noted."""
    finite = _placed(table, column)
    before = np.maximum.accumulate(np.where(finite, t_ns, -1))
    rising = np.append(True, t_ns[1:] > before[:-1])
    if not finite.all():
        notes.append(f"{int((~finite).sum())} lines dropped: their position is no number or no place")
    late = finite & ~rising
    if late.any():
        first = to_iso(int(t_ns[late][0]))
        notes.append(f"{int(late.sum())} lines dropped: time repeats or goes back, first at {first}")
    return np.asarray(finite & rising)


def _placed(table: FloatArray, column: Mapping[str, int]) -> npt.NDArray[np.bool_]:
    """Return which rows have a position that can be one."""
    if column.keys() >= set(ECEF):
        return np.asarray(np.isfinite(_picked(table, column, ECEF)).all(axis=1))
    llh = _picked(table, column, GEODETIC)
    on_earth = (np.abs(llh[:, 0]) <= 90.0) & (np.abs(llh[:, 1]) <= 360.0)
    return np.asarray(np.isfinite(llh).all(axis=1) & on_earth)


def check_any(kept: npt.NDArray[np.bool_], path: Path) -> None:
    """Check that there is a row to go on with.

    Raises
    ------
    InputError
        None is left.
    """
    if not kept.any():
        raise InputError("no usable line", path=path, hint="Check the columns' units and order")


# --- what the numbers say -----------------------------------------------------------------------------------


def _picked(table: FloatArray, column: Mapping[str, int], names: Sequence[str]) -> FloatArray:
    return table[:, [column[n] for n in names]]


def positions(table: FloatArray, column: Mapping[str, int]) -> FloatArray:
    """Return positions of all rows, ECEF, m, shape (n, 3)."""
    if column.keys() >= set(ECEF):
        return _picked(table, column, ECEF)
    llh = _picked(table, column, GEODETIC)
    return geodetic_to_ecef(np.radians(llh[:, 0]), np.radians(llh[:, 1]), llh[:, 2])


def velocities(table: FloatArray, column: Mapping[str, int], position_m: FloatArray) -> FloatArray | None:
    """Return velocities of all rows, ECEF, m/s, shape (n, 3); None where there are no columns for them."""
    if {"vx", "vy", "vz"} <= column.keys():
        return _picked(table, column, ("vx", "vy", "vz"))
    if {"ve", "vn", "vu"} <= column.keys():
        enu = _picked(table, column, ("ve", "vn", "vu"))
        return np.asarray(np.einsum("nij,ni->nj", enu_rotations(position_m), enu))
    return None
