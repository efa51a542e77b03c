"""Positions and velocities that a receiver computed, as measurements: RTKLIB's ``.pos`` or CSV -> epochs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats import truth as tables
from pntegrity.formats._source import read_text
from pntegrity.formats.imu_table import TIMES, seconds_to_ns
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
    text = read_text(path)
    split = tables._split_pos if tables._is_pos(text) else tables._split_csv
    names, rows, first_line = split(text, path)
    names, rows = _as_known(names, rows, origin_ns, path)
    column = tables._match(names)
    tables._check_columns(column, names, path)
    at = {kind: _sigma_columns(names, kind) for kind in SIGMAS}
    _check_sigmas(at["position"], names, path)
    numbers, t_ns = tables._numbers(rows, names, column, first_line, path, told)
    stated = _positive(numbers, at["position"])
    if not stated.all():
        told.append(f"{path.name}: {int((~stated).sum())} lines dropped: no standard deviation above 0")
    good = tables._usable(numbers, t_ns, column, told) & stated
    if not good.any():
        raise InputError("no usable line", path=path, hint="Check the columns' units and order")
    numbers, track = numbers[good], tables._truth(numbers[good], t_ns[good], column, ())
    turn = enu_rotations(track.position_m)
    cov = _in_ecef(numbers, at["position"], turn, sigma_floor_m)
    if not velocity:
        told.append(f"{path.name}: velocities are not used, as asked for")
    elif track.velocity_mps is None or not at["velocity"]:
        told.append(f"{path.name}: no velocities with standard deviations: positions alone are used")
    if not velocity or track.velocity_mps is None or not at["velocity"]:
        return tuple(map(_epoch, track.t_ns.tolist(), track.position_m, cov))
    speed_cov = _in_ecef(numbers, at["velocity"], turn, sigma_floor_mps)
    speed = (
        track.velocity_mps if not velocity_lag_s else _later(track.t_ns, track.velocity_mps, velocity_lag_s)
    )
    return tuple(
        _with_velocity(*row)
        for row in zip(track.t_ns.tolist(), track.position_m, cov, speed, speed_cov, strict=True)
    )


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


def _as_known(
    names: Sequence[str], rows: Sequence[Sequence[str]], origin_ns: int | None, path: Path
) -> tuple[list[str], list[list[str]]]:
    """Return the table with bare seconds as GPS time, and velocities down as velocities up."""
    known, cells = list(names), [list(row) for row in rows]
    plain = [re.sub(r"\(.*?\)", "", n).strip().lower() for n in names]
    timed = any(n in plain for q in ("t_ns", "tow", "iso") for n in TIMES[q])
    for i, name in enumerate(plain):
        if name in TIMES["t_s"] and not timed:
            known[i] = "t_ns"
            for row in cells:
                seconds = tables._number(row[i]) if i < len(row) else np.nan
                row[i : i + 1] = [
                    str(int(seconds_to_ns(seconds, origin_ns, path))) if np.isfinite(seconds) else ""
                ]
        if name in DOWN:
            known[i] = "vu_mps"
            for row in cells:
                row[i : i + 1] = [str(-tables._number(row[i]))] if i < len(row) else []
    return known, cells


def _sigma_columns(names: Sequence[str], kind: str) -> list[int | None]:
    """Return the columns of standard deviations and covariances; empty where one of the first is missing."""
    plain = [re.sub(r"\(.*?\)", "", n).strip().lower() for n in names]
    at = [next((plain.index(v) for v in variants if v in plain), None) for variants in SIGMAS[kind]]
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
