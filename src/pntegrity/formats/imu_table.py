"""Tables of an inertial measurement unit: CSV, plain or gzip, with units in the columns' names -> `Inertial`.

A sample is a rate valid over the interval that ends at its stamp, or the increment of that interval.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial.transform import Rotation

from pntegrity.errors import InputError
from pntegrity.formats._columns import MOST_SECONDS, TIMES, matched, seconds_to_ns
from pntegrity.formats._imu_checks import check_gravity, without_hung
from pntegrity.formats._source import read_text
from pntegrity.physics.time import SECOND_NS, from_iso, from_week_tow, to_iso
from pntegrity.records import FloatArray, Inertial

__all__ = ["GAP_FACTOR", "mounting", "read_imu"]

#: A step longer than this many times the usual one is a gap.
GAP_FACTOR = 5.0
#: Where a larger share of the stamps goes back, their order means nothing.
MOST_UNSORTED = 0.1
#: Latest time that is taken for one, ns.
LATEST_NS = 2**62
DEG = np.pi / 180.0

KINDS: dict[str, tuple[str, ...]] = {
    "rate": ("gyr", "gyro", "gyros", "gyroscope", "g", "w", "omega", "rate", "angular_rate", "ang_rate",
             "angular_velocity", "ang_vel"),
    "force": ("acc", "accel", "accelerometer", "a", "f", "specific_force", "linear_acceleration"),
    "angle": ("dtheta", "d_theta", "delta_theta", "dth", "dang", "dangle", "delta_angle"),
    "speed": ("dv", "d_v", "dvel", "delta_v", "delta_vel", "delta_velocity"),
}  # fmt: skip
UNITS: dict[str, dict[str, float]] = {
    "rate": {"rps": 1.0, "radps": 1.0, "rad/s": 1.0, "rad_s": 1.0, "rad_per_s": 1.0, "dps": DEG,
             "degps": DEG, "deg/s": DEG, "deg_s": DEG, "deg_per_s": DEG, "deg/h": DEG / 3600.0,
             "degph": DEG / 3600.0, "deg_h": DEG / 3600.0},
    "force": {"mps2": 1.0, "m/s2": 1.0, "m/s^2": 1.0, "m/s/s": 1.0, "m_s2": 1.0, "ms2": 1.0, "g": 9.80665,
              "mg": 9.80665e-3},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": DEG, "arcsec": DEG / 3600.0},
    "speed": {"mps": 1.0, "m/s": 1.0, "m_s": 1.0, "mmps": 1e-3, "mm/s": 1e-3, "cmps": 1e-2, "cm/s": 1e-2},
}  # fmt: skip
AXES = {"frd": "x,y,z", "flu": "x,-y,-z", "rfu": "y,x,-z"}
"""Words for axes in use: what the file's x, y and z are, forward, right, down, left, up."""
NAMES_HINT = (
    "Name t_ns, gps_week and tow_s, time_gps or t_s; and gyro_x_rps, gyro_y_rps, gyro_z_rps, acc_x_mps2, "
    "acc_y_mps2, acc_z_mps2, with their units, or dtheta_x_rad, dv_x_mps, ..."
)


@dataclass(frozen=True)
class _Column:
    """What a column holds: a kind of `KINDS`, the axis 0 to 2, and the factor to SI."""

    at: int
    kind: str
    axis: int
    factor: float


def read_imu(
    path: Path | str, *, lag_s: float = 0.0, axes: str = "x,y,z",
    mount_deg: Sequence[float] = (0.0, 0.0, 0.0), origin_ns: int | None = None, level: bool = True,
    notes: list[str] | None = None,
) -> Inertial:  # fmt: skip
    """Read the table of an inertial measurement unit.

    Parameters
    ----------
    path : Path or str
        CSV, plain or gzip, with a header. Time: ``gps_week`` and ``tow_s``, ``t_ns``, ISO ``time_gps`` (GPS
        time), or bare seconds ``t_s``. Angular rate and specific force, or their increments, with units in
        the names or in brackets: ``gyro_x_rps``, ``gx_dps``, ``acc_x_mps2``, ``az (g)``, ``dtheta_x_rad``,
        ``dv_x_mps``.
    lag_s : float
        By how much stamps are late.
    axes, mount_deg
        How the unit is mounted: see `mounting`.
    origin_ns : int, optional
        GPS time of second 0 of bare seconds.
    level : bool
        Whether the body stands about level, so that gravity must be felt upwards.
    notes : list of str, optional
        Gets what was dropped, sorted or missing, in words.

    Returns
    -------
    Inertial
        Increments of the body axes forward, right, down. A step over `GAP_FACTOR` times the usual one leaves
        a gap before its increment; `reason` counts the gaps.

    Raises
    ------
    InputError
        No such file, unknown columns, columns without units, no usable line, unsorted stamps that cannot be
        sorted, or a specific force at rest that is not that of gravity.
    """
    path, told = Path(path), [] if notes is None else notes
    turn = mounting(axes, mount_deg)
    names, cells = _cells(read_text(path), path)
    columns = _columns(names, path)
    t_ns = _times(names, cells, origin_ns, path)
    values = {
        k: _values(cells, [c for c in columns if c.kind == k]) for k in dict.fromkeys(c.kind for c in columns)
    }
    t_ns, values = without_hung(*_in_order(t_ns, values, path, told), path, told)
    dt, reason = _steps(t_ns, told)
    angle, speed = _increments(values, dt, turn)
    whole = Inertial(t_ns - round(lag_s * SECOND_NS), dt, angle, speed, reason)
    check_gravity(whole, path, level, turn)
    return whole


def mounting(axes: str = "x,y,z", mount_deg: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return the matrix (3, 3) that turns vectors in the file's axes into body axes forward, right, down.

    Parameters
    ----------
    axes : str
        Which axes of the file point forward, right and down, each with its sign: ``"-x,y,-z"``; or one of the
        words of `AXES` (``"flu"``: x forward, y left, z up).
    mount_deg : sequence of float
        Roll, pitch and yaw of the unit, so named, in the body: turned about its nose by the roll, then nose
        up by the pitch, then clockwise seen from above by the yaw: ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Raises
    ------
    InputError
        Not three different axes, a left-handed set, or not three angles.
    """
    words = AXES.get(axes.strip().lower(), axes).lower().replace(" ", "").split(",")
    rows = [np.eye(3)["xyz".index(w[-1])] * (-1.0 if w[0] == "-" else 1.0) for w in words if _is_axis(w)]
    M = np.array(rows)
    if M.shape != (3, 3) or len(words) != 3 or not np.abs(M).sum(axis=0).all():
        raise InputError(
            f"axes {axes!r} are not three of x, y and z",
            hint="Name the file's axes that point forward, right, down: x,y,z or -x,y,-z; or frd, flu, rfu",
        )
    if np.linalg.det(M) < 0.0:
        raise InputError(
            f"axes {axes!r} are a mirror image, no unit can be mounted so", hint="Turn the sign of one axis"
        )
    angles = np.asarray(mount_deg, dtype=np.float64)
    if angles.shape != (3,) or not np.isfinite(angles).all():
        raise InputError(f"mounting {mount_deg!r} is not roll, pitch and yaw in degrees")
    return np.asarray(Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix() @ M)


def _is_axis(word: str) -> bool:
    return re.fullmatch(r"[+-]?[xyz]", word) is not None


# --- the table --------------------------------------------------------------------------------------------


def _cells(text: str, path: Path) -> tuple[list[str], pl.DataFrame]:
    """Return the names of the columns and all cells as text."""
    lines = io.StringIO(text)
    head = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    names = [cell.strip() for cell in re.split("[,;\t]", head)]
    if len(names) < 7 or all(re.fullmatch(r"[-+.\deE]+", n) for n in names):
        raise InputError(
            "the first line does not name the columns of an IMU table", path=path, line=1, hint=NAMES_HINT
        )
    mark = max(",;\t", key=head.count)
    try:
        cells = pl.read_csv(
            io.StringIO(text), separator=mark, comment_prefix="#", infer_schema=False, quote_char=None,
            truncate_ragged_lines=True, new_columns=[str(i) for i in range(len(names))],
        )  # fmt: skip
    except pl.exceptions.PolarsError as error:
        raise InputError(f"is no table ({str(error)[:80]})", path=path, hint=NAMES_HINT) from None
    return names, cells


def _column(cells: pl.DataFrame, at: int, kind: type[pl.DataType] = pl.Float64) -> pl.Series:
    return cells.to_series(at).str.strip_chars().cast(kind, strict=False)


def _plain(name: str) -> str:
    return re.sub(r"[(\[].*?[)\]]", "", name).strip().lower().replace(" ", "_").replace(".", "_")


def _columns(names: Sequence[str], path: Path) -> list[_Column]:
    """Return the six columns of rates or increments.

    Raises
    ------
    InputError
        Columns are missing, twice there, or have no unit that is known.
    """
    found = [_recognised(i, name, path) for i, name in enumerate(names)]
    columns = [c for c in found if c is not None]
    for pair in (("rate", "angle"), ("force", "speed")):
        there = sorted((c.kind, c.axis) for c in columns if c.kind in pair)
        if there not in ([(kind, axis) for axis in range(3)] for kind in pair):
            what = "angular rates" if pair[0] == "rate" else "specific forces"
            raise InputError(
                f"not one column of {what} (or their increments) for each of x, y and z among "
                f"{', '.join(names)[:200]}",
                path=path, line=1, hint=NAMES_HINT,
            )  # fmt: skip
    return columns


def _recognised(at: int, name: str, path: Path) -> _Column | None:
    """Return what a column holds, None where it holds something else."""
    plain = _plain(name)
    bracket = re.search(r"[(\[](.*?)[)\]]", name)
    for kind, words in KINDS.items():
        stem = "|".join(sorted(map(re.escape, words), key=len, reverse=True))
        match = re.fullmatch(rf"(?:imu_)?(?:{stem})_?([xyz])(?:_(.+))?", plain)
        if match is None:
            continue
        unit = bracket[1].strip().lower() if bracket else match[2] or ""
        if unit not in UNITS[kind]:
            said = f"the unit {unit!r}, which is not known" if unit else "no unit"
            stem_only = plain.removesuffix(f"_{unit}") if unit else plain
            raise InputError(
                f"column {name!r} has {said}", path=path, line=1,
                hint=f"Write it in the name, {stem_only}_{next(iter(UNITS[kind]))}, or in brackets; known "
                f"are {', '.join(UNITS[kind])}",
            )  # fmt: skip
        return _Column(at, kind, "xyz".index(match[1]), UNITS[kind][unit])
    return None


def _times(
    names: Sequence[str], cells: pl.DataFrame, origin_ns: int | None, path: Path
) -> npt.NDArray[np.int64]:
    """Return the stamps, ns of GPS time; -1 where there is none."""
    plain = [_plain(n) for n in names]
    at = matched(plain, TIMES)
    if "t_ns" in at:
        return _column(cells, at["t_ns"], pl.Int64).fill_null(-1).to_numpy()
    if {"week", "tow"} <= at.keys():
        return _week_times(*(_column(cells, at[q]).to_numpy() for q in ("week", "tow")))
    if "t_s" in at:
        return _second_times(_column(cells, at["t_s"]).to_numpy(), origin_ns, path)
    if "iso" in at:
        return np.array([_iso(text) for text in cells.to_series(at["iso"])], dtype=np.int64)
    raise InputError(
        f"no columns for time among {', '.join(names)[:200]}", path=path, line=1, hint=NAMES_HINT
    )


def _week_times(week: FloatArray, tow: FloatArray) -> npt.NDArray[np.int64]:
    good = (week >= 0.0) & (week < 10_000.0) & (tow >= 0.0) & (tow < 1e6)
    return np.where(good, from_week_tow(np.where(good, week, 0), np.where(good, tow, 0.0)), -1)


def _second_times(seconds: FloatArray, origin_ns: int | None, path: Path) -> npt.NDArray[np.int64]:
    good = np.isfinite(seconds) & (np.abs(seconds) < MOST_SECONDS)
    return np.where(good, seconds_to_ns(np.where(good, seconds, 0.0), origin_ns, path), -1)


def _iso(text: str | None) -> int:
    try:
        return from_iso(text or "")
    except ValueError:
        return -1


def _values(cells: pl.DataFrame, columns: Sequence[_Column]) -> FloatArray:
    """Return three columns of one kind in SI units, shape (n, 3); nan where a cell is no number."""
    ordered = sorted(columns, key=lambda c: c.axis)
    return np.stack([_column(cells, c.at).to_numpy() * c.factor for c in ordered], axis=1)


# --- stamps and increments --------------------------------------------------------------------------------


def _in_order(
    t_ns: npt.NDArray[np.int64], values: Mapping[str, FloatArray], path: Path, notes: list[str]
) -> tuple[npt.NDArray[np.int64], dict[str, FloatArray]]:
    """Return the samples that can be used, rising in time.

    Raises
    ------
    InputError
        Fewer than two, or stamps in no order at all.
    """
    good = (t_ns >= 0) & (t_ns < LATEST_NS)
    for v in values.values():
        good &= np.isfinite(v).all(axis=1)
    if not good.all():
        notes.append(f"{path.name}: {int((~good).sum())} lines dropped: no time or no number")
    rows = _without_repeats(t_ns, _sorted(t_ns, np.flatnonzero(good), path, notes), path, notes)
    if len(rows) < 2:
        raise InputError("fewer than two usable lines", path=path, hint=NAMES_HINT)
    return t_ns[rows], {k: v[rows] for k, v in values.items()}


def _sorted(
    t_ns: npt.NDArray[np.int64], rows: npt.NDArray[np.intp], path: Path, notes: list[str]
) -> npt.NDArray[np.intp]:
    """Return `rows` by time, where only some go back (InputError: too many)."""
    back = np.flatnonzero(np.diff(t_ns[rows]) < 0) + 1
    if not len(back):
        return rows
    first = to_iso(int(t_ns[rows[back[0]]]))
    if len(back) > MOST_UNSORTED * len(rows):
        raise InputError(
            f"{len(back)} of {len(rows)} stamps are before the one above them", path=path, epoch=first,
            hint="Sort the table by time, and see whether the time column is the right one",
        )  # fmt: skip
    notes.append(f"{path.name}: {len(back)} stamps go back, first at {first}: sorted")
    return rows[np.argsort(t_ns[rows], kind="stable")]


def _without_repeats(
    t_ns: npt.NDArray[np.int64], rows: npt.NDArray[np.intp], path: Path, notes: list[str]
) -> npt.NDArray[np.intp]:
    new = np.append(True, np.diff(t_ns[rows]) > 0)[: len(rows)]
    if not new.all():
        first = to_iso(int(t_ns[rows[~new][0]]))
        notes.append(f"{path.name}: {int((~new).sum())} lines dropped: their stamp repeats, first at {first}")
    return np.asarray(rows[new])


def _steps(t_ns: npt.NDArray[np.int64], notes: list[str]) -> tuple[FloatArray, str]:
    """Return how long each sample is valid, and in words which gaps there are."""
    step = np.diff(t_ns) * 1e-9
    usual = float(np.median(step))
    late = step > GAP_FACTOR * usual
    dt = np.append(usual, np.where(late, usual, step))
    if not late.any():
        return dt, ""
    longest, n = int(np.argmax(step)), int(late.sum())
    reason = (
        f"the IMU has {n} gap{'s' if n > 1 else ''} (steps over {GAP_FACTOR * usual * 1e3:.0f} ms), the "
        f"longest of {step[longest] - usual:.2f} s from {to_iso(int(t_ns[longest]))}"
    )
    notes.append(reason)
    return dt, reason


def _increments(
    values: Mapping[str, FloatArray], dt: FloatArray, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    angle = values["angle"] if "angle" in values else values["rate"] * dt[:, None]
    speed = values["speed"] if "speed" in values else values["force"] * dt[:, None]
    return angle @ turn.T, speed @ turn.T
