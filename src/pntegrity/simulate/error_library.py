"""Errors of code and range rate that a receiver really had, taken from a log whose truth is known.

What a log's measurements lack to truth is the receiver's clock, a bias between constellations, and errors.
In a city most satellites may be reflected, and reflections come late: a mean or a median would take part of
them for clock. The clock is therefore where measurements lie densest (their mode), those with a strong
signal from high up counting most, pooled over some seconds along the integrated drift.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.records import Epoch, FloatArray, group_of
from pntegrity.sensors.pseudoranges import Rows, code_rows, rate_rows
from pntegrity.sensors.ranges import C_MPS
from pntegrity.states import freeze

__all__ = ["ErrorLibrary", "Series", "library_of", "mode_of"]

#: A code error beyond this is none of a line of sight, m (root mean square over a series).
CLEAN_M = 5.0
#: Steps of a receiver's clock are whole milliseconds, m.
STEP_M = 1e-3 * C_MPS
#: Clocks are pooled over so many seconds to either side.
POOL_S = 10.0
CODE_WIDTH_M, RATE_WIDTH_MPS = 2.0, 0.2
FULL_CN0_DBHZ = 45.0


@dataclass(frozen=True, eq=False)
class Series:
    """A contiguous arc of one satellite: errors at truth, shape (n,) each, from epoch `first` on."""

    sat: str
    first: int
    code_m: FloatArray
    rate_mps: FloatArray
    cn0_dbhz: FloatArray
    el_rad: FloatArray

    @property
    def clean(self) -> bool:
        """Whether its code errors are those of a line of sight."""
        return bool(rms(self.code_m) < CLEAN_M)


@dataclass(frozen=True, eq=False)
class ErrorLibrary:
    """Errors at truth, one row an epoch and one column a satellite; nan where it was not tracked.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Time tags.
    sats : tuple of str, length m
    code_m, rate_mps : ndarray, shape (n, m)
        Measured minus predicted, without clock, drift and the bias of the constellation.
    cn0_dbhz, el_rad : ndarray, shape (n, m)
    speed_mps : ndarray, shape (n,)
        Of the vehicle: reflections vary faster where it is fast.
    clock_m, drift_mps : ndarray, shape (n,)
        What was taken off.
    isb_m : mapping of str to float
        Biases of the constellations against the first of them.
    """

    t_ns: npt.NDArray[np.int64]
    sats: tuple[str, ...]
    code_m: FloatArray
    rate_mps: FloatArray
    cn0_dbhz: FloatArray
    el_rad: FloatArray
    speed_mps: FloatArray
    clock_m: FloatArray
    drift_mps: FloatArray
    isb_m: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "code_m", "rate_mps", "cn0_dbhz", "el_rad", "speed_mps", "clock_m", "drift_mps")

    def series(self) -> tuple[Series, ...]:
        """Return the contiguous arcs of all satellites."""
        columns = (self.code_m, self.rate_mps, self.cn0_dbhz, self.el_rad)
        return tuple(
            Series(sat, i, *(c[i:j, k] for c in columns))
            for k, sat in enumerate(self.sats)
            for i, j in _runs(np.isfinite(self.code_m[:, k]))
        )


def rms(errors: FloatArray, axis: int | None = None) -> Any:
    """Return the root mean square of the finite values; inf where there is none."""
    known = np.isfinite(errors)
    total = np.where(known, errors, 0.0) ** 2
    count = known.sum(axis=axis)
    return np.sqrt(np.where(count > 0, total.sum(axis=axis) / np.maximum(count, 1), np.inf))


def library_of(
    epochs: Sequence[Epoch], position_m: FloatArray, velocity_mps: FloatArray, options: GnssOptions
) -> ErrorLibrary:
    """Return the errors of a log.

    Parameters
    ----------
    epochs : sequence of Epoch
        With code and range rates.
    position_m, velocity_mps : ndarray, shape (n, 3)
        True ones of the antenna at the epochs.
    options : GnssOptions
        Elevation mask and ionosphere.

    Raises
    ------
    ValueError
        Where the shapes do not fit, or no epoch has code.
    """
    if not len(epochs) == len(position_m) == len(velocity_mps):
        raise ValueError("`epochs`, `position_m` and `velocity_mps` must have the same length")
    code = [code_rows(e, x, options) for e, x in zip(epochs, position_m, strict=True)]
    moving = zip(epochs, position_m, velocity_mps, strict=True)
    rate = [rate_rows(e, x, v, options) for e, x, v in moving]
    sats = tuple(sorted({group_of(k) for rows in code for k in rows.keys}))
    if not sats:
        raise ValueError("no epoch has a code measurement above the mask")
    lack, lack_rate = (_panel(rows, sats, lambda r: r.y - r.predicted) for rows in (code, rate))
    cn0, el = _panel(code, sats, lambda r: r.cn0_dbhz), _panel(code, sats, lambda r: r.el_rad)
    t_ns = np.array([e.t_ns for e in epochs], dtype=np.int64)
    clock, drift, isb = _clocks(t_ns, sats, lack, lack_rate, _weights(cn0, el))
    bias = np.array([isb[s[0]] for s in sats])
    return ErrorLibrary(
        t_ns, sats, lack - bias - clock[:, None], lack_rate - drift[:, None], cn0, el,
        np.linalg.norm(velocity_mps, axis=1), clock, drift, isb,
    )  # fmt: skip


def _panel(rows: Sequence[Rows], sats: tuple[str, ...], value: Callable[[Rows], FloatArray]) -> FloatArray:
    """Return a value of all rows as a table of epochs and satellites."""
    column = {s: i for i, s in enumerate(sats)}
    out = np.full((len(rows), len(sats) + 1), np.nan)
    for k, r in enumerate(rows):
        out[k, [column.get(group_of(key), -1) for key in r.keys]] = value(r)
    return out[:, :-1]


def _weights(cn0_dbhz: FloatArray, el_rad: FloatArray) -> FloatArray:
    """Return how much each measurement says of the clock: in proportion to power and sine of elevation."""
    power = np.minimum(np.nan_to_num(cn0_dbhz, nan=20.0), FULL_CN0_DBHZ) - FULL_CN0_DBHZ
    return np.asarray(10.0 ** (power / 10.0) * np.sin(np.nan_to_num(el_rad)))


def _clocks(
    t_ns: npt.NDArray[np.int64], sats: tuple[str, ...], lack: FloatArray, rate: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """Return clock and drift (n,), and the bias of each constellation."""
    drift = _bridged(np.array([mode_of(r, v, RATE_WIDTH_MPS) for r, v in zip(rate, w, strict=True)]))
    path = _path(t_ns, lack, drift)
    level = lack - path[:, None]
    system = np.array([s[0] for s in sats])
    letters = sorted(set(system.tolist()), key=lambda s: ("GRECJ".find(s) % 99, s))
    first = _pooled(t_ns, level[:, system == letters[0]], w[:, system == letters[0]])
    isb = {letters[0]: 0.0} | {
        s: _bias((level - first[:, None])[:, system == s], w[:, system == s]) for s in letters[1:]
    }
    level = level - np.array([isb[s] for s in system.tolist()])
    return path + _pooled(t_ns, level, w), drift, isb


def _path(t_ns: npt.NDArray[np.int64], lack: FloatArray, drift: FloatArray) -> FloatArray:
    """Return the integrated drift, with the clock's steps in it."""
    moved = 0.5 * (drift[1:] + drift[:-1]) * np.diff(t_ns) * 1e-9
    seen = np.diff(_bridged(np.array([_median(row) for row in lack])))
    steps = STEP_M * np.round((seen - moved) / STEP_M)
    return np.append(0.0, np.cumsum(moved + steps))


def _median(row: FloatArray) -> float:
    known = row[np.isfinite(row)]
    return float(np.median(known)) if len(known) else float("nan")


def _bridged(values: FloatArray) -> FloatArray:
    """Return the values with those that are missing on straight lines; zeros where all are."""
    known = np.isfinite(values)
    at = np.arange(len(values))
    return np.interp(at, at[known], values[known]) if known.any() else np.zeros(len(values))


def _bias(level: FloatArray, w: FloatArray) -> float:
    """Return the mode of a constellation over the whole log: that of the epochs' modes."""
    each = np.array([mode_of(v, u, CODE_WIDTH_M) for v, u in zip(level, w, strict=True) if u.any()])
    return mode_of(each, np.ones(len(each)), CODE_WIDTH_M)


def _pooled(t_ns: npt.NDArray[np.int64], level: FloatArray, w: FloatArray) -> FloatArray:
    """Return the mode at each epoch of what is near it in time."""
    t = (t_ns - t_ns[0]) * 1e-9
    out = np.zeros(len(t))
    for k, (i, j) in enumerate(
        zip(np.searchsorted(t, t - POOL_S), np.searchsorted(t, t + POOL_S, "right"), strict=True)
    ):
        near = np.exp(-2.0 * ((t[i:j] - t[k]) / POOL_S) ** 2)
        out[k] = mode_of(level[i:j].ravel(), (near[:, None] * w[i:j]).ravel(), CODE_WIDTH_M)
    return out


def mode_of(values: FloatArray, weights: FloatArray, width: float) -> float:
    """Return where weighted values lie densest, seen through a Gaussian window; nan where there is none.

    Parameters
    ----------
    values, weights : ndarray, shape (n,)
        Values that are not finite are left out.
    width : float
        Standard deviation of the window.
    """
    known = np.isfinite(values) & (weights > 0.0)
    x, w = values[known], weights[known]
    if not len(x):
        return float("nan")
    best = float(x[np.argmax(np.exp(-0.5 * ((x[:, None] - x) / width) ** 2) @ w)])
    for _ in range(20):  # mean shift: each pass moves to the mean under the window
        near = w * np.exp(-0.5 * ((x - best) / width) ** 2)
        best = float(near @ x / near.sum())
    return best


def _runs(there: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and past-the-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    return [(int(i), int(j)) for i, j in pairwise(edges)][::2]
