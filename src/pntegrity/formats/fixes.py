"""Positions and velocities that a receiver computed, as measurements: RTKLIB's ``.pos`` or CSV -> epochs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._columns import (
    TIMES,
    Cells,
    check_any,
    columns_of,
    first_of,
    number,
    numbers,
    plain_name,
    positions,
    read_cells,
    second_time,
    usable,
    velocities,
)  # fmt: skip
from pntegrity.physics.frames import enu_rotations
from pntegrity.records import Epoch, FloatArray, Observation

__all__ = ["POSITION_KEYS", "VELOCITY_KEYS", "read_fixes"]

POSITION_KEYS = ("fix:X", "fix:Y", "fix:Z")
VELOCITY_KEYS = ("fix:DX", "fix:DY", "fix:DZ")
#: Standard deviations east, north, up, of positions and of velocities, then what RTKLIB has for covariances:
#: the root of east-north, north-up and up-east, with its sign.
SIGMAS: dict[str, tuple[tuple[str, ...], ...]] = {
    "position": (
        ("sde", "sde_m", "pos_std_e_m", "std_e_m", "sigma_e_m"),
        ("sdn", "sdn_m", "pos_std_n_m", "std_n_m", "sigma_n_m"),
        ("sdu", "sdu_m", "pos_std_u_m", "pos_std_d_m", "std_u_m", "std_d_m", "sigma_u_m"),
        ("sdne",),
        ("sdun",),
        ("sdeu",),
    ),
    "velocity": (
        ("sdve", "vel_std_e_mps", "std_ve_mps", "sigma_ve_mps"),
        ("sdvn", "vel_std_n_mps", "std_vn_mps", "sigma_vn_mps"),
        ("sdvu", "vel_std_u_mps", "vel_std_d_mps", "std_vu_mps", "std_vd_mps", "sigma_vu_mps"),
        ("sdvne",),
        ("sdvun",),
        ("sdveu",),
    ),
}
DOWN = ("vd_mps", "vd", "down_velocity")


def read_fixes(
    path: Path | str, *, origin_ns: int | None = None, sigma_floor_m: float = 0.0,
    sigma_floor_mps: float = 0.0, velocity: bool = True, velocity_lag_s: float = 0.0,
    notes: list[str] | None = None,
) -> tuple[Epoch, ...]:  # fmt: skip
    """Read the fixes of a receiver.

    Parameters
    ----------
    path : Path or str
        RTKLIB's ``.pos`` in GPST, or CSV, plain or gzip, with the times and positions of `read_truth` and
        ``vn_mps, ve_mps`` and ``vu_mps`` or ``vd_mps``; standard deviations as RTKLIB names them (``sdn``,
        ``sdvn``) or ``pos_std_n_m``, ``vel_std_n_mps``, ... Times may be bare seconds ``t_s``.
    origin_ns : int, optional
        GPS time of second 0 of bare seconds.
    sigma_floor_m, sigma_floor_mps : float
        Smaller standard deviations of positions and velocities, east, north or up, are raised to these.
    velocity : bool
        False: velocities of the file are not used.
    velocity_lag_s : float
        By how much velocities are late against their positions: a fix gets that of so much later, between the
        two fixes around it, and none where these are more than twice the usual step apart.
    notes : list of str, optional
        Gets what was dropped, in words.

    Returns
    -------
    tuple of Epoch
        Each with the observation ``"fix"``: rows ``"fix:X"``, ``"fix:Y"``, ``"fix:Z"`` (ECEF, m) and, where
        there are velocities with their standard deviations, ``"fix:DX"``, ... (m/s). ``aux["cov"]`` (n, n) is
        their covariance, `sigma` the root of its diagonal.

    Raises
    ------
    InputError
        As `read_truth`, and where positions have no standard deviations.
    """
    path, told = Path(path), [] if notes is None else notes
    cells = _as_known(read_cells(path), origin_ns, path)
    column = columns_of(cells.names, path)
    at = {kind: _sigma_columns(cells.names, kind) for kind in SIGMAS}
    _check_sigmas(at["position"], cells.names, path)
    table, t_ns = _good_rows(cells, column, at["position"], path, told)
    position = positions(table, column)
    turn = enu_rotations(position)
    rows = (t_ns.tolist(), position, _in_ecef(table, at["position"], turn, sigma_floor_m))
    speed = velocities(table, column, position) if at["velocity"] else None
    if not velocity:
        told.append(f"{path.name}: velocities are not used, as asked for")
    elif speed is None:
        told.append(f"{path.name}: no velocities with standard deviations: positions alone are used")
    if not velocity or speed is None:
        return tuple(map(_epoch, *rows))
    speed = _later(t_ns, speed, velocity_lag_s) if velocity_lag_s else speed
    speed_cov = _in_ecef(table, at["velocity"], turn, sigma_floor_mps)
    return tuple(_with_velocity(*row) for row in zip(*rows, speed, speed_cov, strict=True))


def _good_rows(
    cells: Cells, column: Mapping[str, int], at: Sequence[int | None], path: Path, notes: list[str]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return the numbers and times of the rows that are a fix with standard deviations."""
    table, t_ns = numbers(cells, column, path, notes)
    stated = _positive(table, at)
    if not stated.all():
        notes.append(f"{path.name}: {int((~stated).sum())} lines dropped: no standard deviation above 0")
    good = usable(table, t_ns, column, notes) & stated
    check_any(good, path)
    return table[good], t_ns[good]


def _later(t_ns: npt.NDArray[np.int64], velocity: FloatArray, lag_s: float) -> FloatArray:
    """Return the velocities that are stamped `lag_s` later, nan where no two fixes are around that time."""
    at_s = (t_ns - t_ns[0]) * 1e-9
    if len(at_s) < 2:
        return np.full_like(velocity, np.nan)
    wanted = at_s + lag_s
    i = np.searchsorted(at_s, wanted).clip(1, len(at_s) - 1)
    apart = at_s[i] - at_s[i - 1]
    known = (wanted >= at_s[0]) & (wanted <= at_s[-1]) & (apart <= 2.0 * np.median(np.diff(at_s)))
    share = ((wanted - at_s[i - 1]) / apart)[:, None]
    return np.where(known[:, None], velocity[i - 1] + share * (velocity[i] - velocity[i - 1]), np.nan)


def _as_known(cells: Cells, origin_ns: int | None, path: Path) -> Cells:
    """Return the table with bare seconds as GPS time, and velocities down as velocities up."""
    names, rows = list(cells.names), [list(row) for row in cells.rows]
    plain = [plain_name(n) for n in names]
    timed = any(n in plain for q in ("t_ns", "tow", "iso") for n in TIMES[q])

    def since(cell: str) -> str:
        try:
            return str(second_time(cell, origin_ns, path))
        except InputError:
            raise
        except ValueError:
            return ""

    for i, name in enumerate(plain):
        if name in TIMES["t_s"] and not timed:
            names[i] = "t_ns"
            _change(rows, i, since)
        if name in DOWN:
            names[i] = "vu_mps"
            _change(rows, i, lambda cell: str(-number(cell)))
    return Cells(names, rows, cells.lines)


def _change(rows: Sequence[list[str]], at: int, change: Callable[[str], str]) -> None:
    for row in rows:
        row[at : at + 1] = [change(cell) for cell in row[at : at + 1]]


def _sigma_columns(names: Sequence[str], kind: str) -> list[int | None]:
    """Return the columns of standard deviations and covariances; empty where one of the first is missing."""
    plain = [plain_name(n) for n in names]
    at = [first_of(plain, variants) for variants in SIGMAS[kind]]
    return [] if None in at[:3] else at


def _check_sigmas(at: Sequence[int | None], names: Sequence[str], path: Path) -> None:
    if not at:
        raise InputError(
            f"no columns for the standard deviations of positions among {', '.join(names)[:200]}",
            path=path, line=1, hint="Name sdn, sde, sdu, or pos_std_n_m, pos_std_e_m, pos_std_d_m",
        )  # fmt: skip


def _positive(numbers: FloatArray, at: Sequence[int | None]) -> npt.NDArray[np.bool_]:
    sigma = numbers[:, [i for i in at[:3] if i is not None]]
    return np.asarray((np.isfinite(sigma) & (sigma > 0.0)).all(axis=1))


def _in_ecef(
    numbers: FloatArray, at: Sequence[int | None], turn: FloatArray, floor: float = 0.0
) -> FloatArray:
    """Return covariances (n, 3, 3) in ECEF, of standard deviations east, north, up and RTKLIB's products."""
    e, n, u, en, nu, ue = (np.zeros(len(numbers)) if i is None else numbers[:, i] for i in at)
    C = np.zeros((len(numbers), 3, 3))
    for k, sigma in enumerate((e, n, u)):
        C[:, k, k] = np.maximum(sigma, floor) ** 2
    for (i, j), root in zip(((0, 1), (1, 2), (2, 0)), (en, nu, ue), strict=True):
        C[:, i, j] = C[:, j, i] = np.nan_to_num(np.sign(root) * root**2)
    return np.asarray(np.einsum("nji,njk,nkl->nil", turn, C, turn))


def _epoch(t_ns: int, y: FloatArray, cov: FloatArray, keys: tuple[str, ...] = POSITION_KEYS) -> Epoch:
    fix = Observation("fix", t_ns, keys, y, np.sqrt(np.diagonal(cov)), {"cov": cov})
    return Epoch(t_ns, (fix,))


def _with_velocity(
    t_ns: int, position: FloatArray, cov: FloatArray, velocity: FloatArray, speed_cov: FloatArray
) -> Epoch:
    if not (np.isfinite(velocity).all() and np.isfinite(speed_cov).all() and speed_cov.trace() > 0.0):
        return _epoch(t_ns, position, cov)
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = cov, speed_cov
    return _epoch(t_ns, np.append(position, velocity), whole, POSITION_KEYS + VELOCITY_KEYS)
