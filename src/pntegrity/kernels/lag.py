"""By how much the stamps of an inertial measurement unit are late: what it felt against how it was moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Felt", "Lag", "find_lag"]

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

#: Heading and tilt at the beginning of every stretch of this length are taken for unknown, s.
STRETCH_S = 20.0
#: Fewer accelerations than this in a stretch, and fewer stretches, tell nothing.
FEWEST, FEWEST_STRETCHES = 10, 3


@dataclass(frozen=True)
class Lag:
    """How late stamps are.

    Parameters
    ----------
    lag_s : float
        Stamp minus true time.
    sigma_s : float
        Its standard deviation: the jackknife over stretches.
    correlation : float
        Root of the share of the accelerations' power that is explained at that lag.
    stretches : int
        How many were compared.
    """

    lag_s: float
    sigma_s: float
    correlation: float
    stretches: int


@dataclass(frozen=True, eq=False)
class Felt:
    """What a level unit felt in its horizontal plane.

    Parameters
    ----------
    stamp_s : ndarray, shape (n,)
        Stamps, the ends of increments, rising.
    dt_s : ndarray, shape (n,)
        Durations.
    turn_rad : ndarray, shape (n,)
        Increments of the angle about the axis down.
    velocity_mps : ndarray, shape (n, 2)
        Increments of velocity forward and right.
    """

    stamp_s: FloatArray
    dt_s: FloatArray
    turn_rad: FloatArray
    velocity_mps: FloatArray


def find_lag(
    felt: Felt, t_s: FloatArray, track: FloatArray, order: int, most_s: float = 1.0, step_s: float = 0.02
) -> Lag | None:
    """Return the lag at which what was felt explains a track best, None where nothing tells.

    In every stretch the track's accelerations, as a complex number north + i east, are fitted by those that
    were felt, turned with the gyroscope, and by a constant tilt that turns along; both with a free complex
    factor, so that neither heading nor mounting matter. Turns of the gyroscope and of the course are not
    compared: a course leads the heading wherever the antenna is in front of the axis about which a vehicle
    turns, which looks like a lag of some 0.3 s.

    Parameters
    ----------
    felt : Felt
    t_s : ndarray, shape (k,)
        Times of the track, evenly spaced but for gaps, on the time scale of the stamps.
    track : ndarray, shape (k, 2)
        North and east: velocities, m/s, or positions, m.
    order : int
        How many differences make accelerations of the track: 1 of velocities, 2 of positions.
    most_s, step_s : float
        Largest lag on either side, and the grid's step.
    """
    step = float(np.median(np.diff(t_s))) if len(t_s) > order else 0.0
    if step <= 0.0 or not len(felt.stamp_s):
        return None
    at, wanted = _differences(t_s, step, order, track[:, 0] + 1j * track[:, 1])
    inside = (at - order * step - most_s >= felt.stamp_s[0]) & (at + step + most_s <= felt.stamp_s[-1])
    use = np.isfinite(wanted) & inside
    stretch = np.floor((at - t_s[0]) / STRETCH_S)
    parts = [use & (stretch == s) for s in np.unique(stretch)]
    parts = [p for p in parts if p.sum() >= FEWEST]
    if len(parts) < FEWEST_STRETCHES:
        return None
    lags = np.asarray(np.arange(-round(most_s / step_s), round(most_s / step_s) + 1) * step_s)
    curves = _summed(felt, order)
    left = np.array([_left_over(curves, lag, t_s, step, order, wanted, parts) for lag in lags])
    power = float(sum((np.abs(wanted[p]) ** 2).sum() for p in parts))
    total = left.sum(axis=1)
    best, without = _lowest(lags, total), [_lowest(lags, total - one) for one in left.T]
    m = len(parts)
    sigma = np.sqrt((m - 1) / m * np.sum((np.array(without) - np.mean(without)) ** 2))
    share = 1.0 - float(total.min()) / power if power > 0.0 else 0.0
    return Lag(best, float(sigma), float(np.sqrt(max(share, 0.0))), m)


def _differences(
    t_s: FloatArray, step: float, order: int, x: ComplexArray
) -> tuple[FloatArray, ComplexArray]:
    """Return accelerations of a track and their times, nan at gaps."""
    even = np.abs(np.diff(t_s) - step) < 0.5 * step
    if order == 1:
        return t_s[1:], np.where(even, np.diff(x) / step, np.nan)
    second = (x[2:] - 2.0 * x[1:-1] + x[:-2]) / step**2
    return t_s[1:-1], np.where(even[1:] & even[:-1], second, np.nan)


def _summed(felt: Felt, order: int) -> tuple[FloatArray, list[ComplexArray]]:
    """Return stamps, and the felt velocities and a tilt of 1 m/s^2 in axes that do not turn, summed as often
    as the track is differenced.
    """
    turned = np.cumsum(felt.turn_rad) - 0.5 * felt.turn_rad
    axis = np.exp(1j * turned)
    speed = (felt.velocity_mps[:, 0] + 1j * felt.velocity_mps[:, 1]) * axis
    out = []
    for increment in (speed, axis * felt.dt_s):
        total = np.cumsum(increment)
        out.append(total if order == 1 else np.cumsum((total - 0.5 * increment) * felt.dt_s))
    return felt.stamp_s, out


def _left_over(
    curves: tuple[FloatArray, list[ComplexArray]], lag: float, t_s: FloatArray, step: float, order: int,
    wanted: ComplexArray, parts: list[npt.NDArray[np.bool_]],
) -> list[float]:  # fmt: skip
    """Return the power of the accelerations that each stretch leaves unexplained at a lag."""
    stamp_s, series = curves
    shown = [
        np.interp(t_s + lag, stamp_s, x.real) + 1j * np.interp(t_s + lag, stamp_s, x.imag) for x in series
    ]
    A = np.stack([_differences(t_s, step, order, x)[1] for x in shown], axis=1)
    out = []
    for part in parts:
        fit = A[part] @ np.linalg.lstsq(A[part], wanted[part], rcond=None)[0]
        out.append(float((np.abs(wanted[part] - fit) ** 2).sum()))
    return out


def _lowest(lags: FloatArray, cost: FloatArray) -> float:
    """Return where the parabola through the lowest value and its neighbours is lowest."""
    k = int(np.argmin(cost))
    if not 0 < k < len(cost) - 1:
        return float(lags[k])
    a, b, c = cost[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(lags[k] + (lags[1] - lags[0]) * (0.5 * (a - c) / bend if bend > 0.0 else 0.0))
