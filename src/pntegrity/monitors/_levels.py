"""What a bank of subfilters says of the position: separations, their thresholds, protection levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import Ism
from pntegrity.kernels.companions import Companions
from pntegrity.kernels.protection import (
    dominant_mode,
    false_alert_factor,
    least_level,
    observed_level,
    protection_level,
)
from pntegrity.monitors._members import Cast
from pntegrity.monitors._window import no_redundancy
from pntegrity.records import Bound, FloatArray, Update, join_reasons

__all__ = [
    "NO_MODES", "Spread", "beyond", "bound_of", "factors", "shares", "silence", "still_born", "why_untested",
]  # fmt: skip

Value = TypeVar("Value")
NO_MODES = "no fault mode has a probability: nothing is tested"
#: Share of a variance below which a difference of two is rounding.
ROUNDING = 1e-9
#: A separation that is expected, in its standard deviations, where levels are made of those observed. Levels
#: hold with any value; with 1 their mean is near its smallest (10 to 25 satellites: 2 is 10 % larger).
EXPECTED = 1.0
#: A position whose variance is still this share of what it was born with is not determined.
UNDETERMINED = 0.25


@dataclass(frozen=True, eq=False)
class Spread:
    """The positions of all members, in some directions; shapes (members, directions).

    Parameters
    ----------
    apart : ndarray
        Separation from the filter, m.
    variance : ndarray
        Of the member's error, m^2; inf where it does not determine that direction.
    separation : ndarray
        Variance of the separation, m^2.
    bias : ndarray
        Largest nominal bias of the member, m.
    """

    apart: FloatArray
    variance: FloatArray
    separation: FloatArray
    bias: FloatArray

    @staticmethod
    def of(
        axes: FloatArray, apart: FloatArray, P: FloatArray, born: FloatArray, bias: FloatArray,
        loose: npt.NDArray[np.bool_],
    ) -> Spread:  # fmt: skip
        """Return the spread of members in the directions of `axes`.

        Parameters
        ----------
        axes : ndarray, shape (d, k)
        apart : ndarray, shape (members, k)
            Positions less that of the filter.
        P : ndarray, shape (members, k, k)
        born : ndarray, shape (members,)
            Variance with which the position was born, where rows have not determined it since; else inf.
        bias : ndarray, shape (members, c, k)
            What each of c nominal biases made of the position: the worst signs count.
        loose : ndarray of bool, shape (members,)
            Members that are no part of the filter: of their separations only a bound is known, the largest
            that two errors of these sizes can have, whatever they share.
        """
        variance = ((axes @ P) * axes).sum(axis=2)
        variance = np.where(_undetermined(axes, P, born), inf, variance)
        whole = np.isfinite(variance[0]).all()
        separation = np.maximum(variance - variance[:1], 0.0) if whole else variance.copy()
        separation[loose] = (np.sqrt(variance[loose]) + np.sqrt(variance[0])) ** 2
        return Spread(apart @ axes.T, variance, separation, np.abs(bias @ axes.T).sum(axis=1))

    def refined(self, axes: FloatArray, beside: Companions, position: npt.NDArray[np.intp]) -> Spread:
        """Return the spread with exact separations of the first members, which these are beside."""
        few = len(beside.own)
        apart = beside.separation()[:, position[:, None], position]
        separation = self.separation.copy()
        separation[:few] = np.maximum(np.einsum("da,iab,db->id", axes, apart, axes), 0.0)
        return replace(self, separation=np.where(np.isfinite(self.variance), separation, inf))

    def testable(self, rows: slice) -> npt.NDArray[np.bool_]:
        """Return where a separation can be told from rounding."""
        return self.tells(self.separation[rows])

    def moves(self, expected: float, observed: float) -> npt.NDArray[np.bool_]:
        """Return which members are apart from the filter by more than so many of its standard deviations, as
        expected or as observed, in any direction.
        """
        sigma = np.sqrt(self.variance[0])
        apart = np.abs(self.apart) > observed * sigma if np.isfinite(observed) else False
        return np.asarray(((self.separation > (expected * sigma) ** 2) | apart).any(axis=1))

    def tells(self, variance: FloatArray) -> npt.NDArray[np.bool_]:
        """Return where the variance of a difference, shape (n, directions), is more than rounding."""
        return np.asarray(np.isfinite(variance) & (variance > ROUNDING * self.variance[0]))


def _undetermined(axes: FloatArray, P: FloatArray, born: FloatArray) -> npt.NDArray[np.bool_]:
    """Return where a direction has a part that rows do not determine, shape (members, d)."""
    out = np.zeros((len(P), len(axes)), dtype=bool)
    some = np.flatnonzero(np.isfinite(born))
    if len(some):
        values, vectors = np.linalg.eigh(P[some])
        seen = np.abs(np.einsum("dk,ikv->idv", axes, vectors)) > 1e-3
        out[some] = (seen & (values > UNDETERMINED * born[some, None])[:, None, :]).any(axis=2)
    return out


def still_born(P: FloatArray, born: FloatArray) -> FloatArray:
    """Return `born` where a position, shape (members, k, k), has a part that rows have not determined; else
    inf.
    """
    some = np.isfinite(born)
    if not some.any():
        return born
    largest = np.linalg.eigvalsh(P[some])[:, -1]
    out = born.copy()
    out[some] = np.where(largest > UNDETERMINED * born[some], born[some], inf)
    return out


def shares(split: tuple[float, float, float], directions: int) -> FloatArray:
    """Return the share of each direction; along and across the track those of east and north."""
    return np.array([*split, *split[:2]])[:directions]


def factors(ism: Ism, p_fa: float, modes: int, directions: int) -> FloatArray:
    """Return the factor of the standard deviation for the test in each direction, shape (directions,).

    Where a course is known, tests east and along share one probability, tests north and across another.
    """
    share = shares(ism.fa_split, directions)
    halved = np.where(np.arange(directions) == 2, share, 0.5 * share) if directions > 3 else share
    return np.array([false_alert_factor(p_fa * s, modes) if s > 0.0 else inf for s in halved.tolist()])


def bound_of(
    spread: Spread, cast: Cast, ism: Ism, threshold: FloatArray, since_ns: int, observed: bool = False
) -> Bound:
    """Return the protection levels.

    Parameters
    ----------
    spread : Spread
    cast : Cast
    ism : Ism
    threshold : ndarray, shape (modes, directions)
        Of the separations, m.
    since_ns : int
        Faults that began before are not covered.
    observed : bool
        Whether levels are made of the separations as they are, in place of their thresholds.
    """
    faults, few = cast.faults, slice(1, 1 + len(cast.faults.monitored))
    sigma0 = np.sqrt(spread.variance[0])
    risks = shares(ism.risks(faults.unmonitored), len(sigma0)).tolist()
    level_of = _observed if observed else _tested
    found = [level_of(risk, q, spread, cast.probability, threshold[:, q]) for q, risk in enumerate(risks)]
    levels, least = [f[0] for f in found], [f[2] for f in found[:3]]
    names = [faults.monitored[f[1]].name if f[1] >= 0 else "" for f in found[:3]]
    along, cross = levels[3:] if len(levels) > 3 else (None, None)
    determined = bool(np.isfinite(sigma0).all())
    return Bound(
        levels[0], levels[1], levels[2], _three(sigma0.tolist()), along, cross, _three(names),
        _three(least), few.stop - 1, faults.unmonitored, since_ns,
        _reason(levels[:3], names, determined, faults.reason),
    )  # fmt: skip


def _tested(
    risk: float, q: int, spread: Spread, p: FloatArray, threshold: FloatArray
) -> tuple[float, int, float]:
    """Return the level of a direction, its mode, and the smallest level possible with the test."""
    modes, sigma, bias = slice(1, 1 + len(p)), np.sqrt(spread.variance[:, q]), spread.bias[:, q]
    facts = (sigma[0], bias[0], p, sigma[modes], bias[modes], threshold)
    level = protection_level(risk, *facts)
    worst = dominant_mode(level, *facts)
    if q > 2:
        return level, worst, 0.0
    ss = np.where(np.isfinite(sigma[modes]), np.sqrt(spread.separation[modes, q]), inf)
    return level, worst, least_level(risk, sigma[0], p, ss, threshold)


def _observed(
    risk: float, q: int, spread: Spread, p: FloatArray, threshold: FloatArray
) -> tuple[float, int, float]:
    """Return the level of a direction without a test, and its mode; nothing is known of a smallest one."""
    modes, sigma, bias = slice(1, 1 + len(p)), np.sqrt(spread.variance[:, q]), spread.bias[:, q]
    expected = EXPECTED * np.sqrt(spread.separation[modes, q])
    facts = (sigma[0], bias[0], p, sigma[modes], bias[modes], expected, spread.apart[modes, q])
    return *observed_level(risk, *facts), 0.0


def _three(values: list[Value]) -> tuple[Value, Value, Value]:
    return values[0], values[1], values[2]


def _reason(levels: list[float], names: list[str], determined: bool, reason: str) -> str:
    if reason or np.isfinite(levels).all():
        return reason
    if not determined:
        return "the measurements do not determine the position"
    lost = dict.fromkeys(n for n, level in zip(names, levels, strict=True) if n and not np.isfinite(level))
    return "nothing is left to check against without " + ", ".join(lost) if lost else "the risk is used up"


def why_untested(bound: Bound, cast: Cast, update: Update) -> str:
    """Return why nothing is tested."""
    if cast.faults.monitored:
        return no_redundancy(update) if np.isfinite(bound.hpl_m + bound.vpl_m) else bound.reason
    return NO_MODES if update.keys else bound.reason


def silence(update: Update, seen_ns: int) -> str:
    """Return since when there is no row at all, in words: then levels grow with the dynamics alone."""
    if update.keys:
        return ""
    return f"no row of any source was used for {(update.t_ns - seen_ns) * 1e-9:.0f} s: levels grow"


def beyond(bound: Bound, ism: Ism) -> tuple[str, str]:
    """Return which protection level is above its alert limit, in words: alike at all epochs, and with the
    level of this one.
    """
    levels = (("horizontal", bound.hpl_m, ism.hal_m), ("vertical", bound.vpl_m, ism.val_m))
    found = [(name, level, limit) for name, level, limit in levels if level > limit]
    always = (f"{name} protection level above the alert limit of {limit:g} m" for name, _, limit in found)
    now = (
        f"the {name} protection level of {level:.3g} m is above the alert limit of {limit:g} m"
        for name, level, limit in found
    )
    return join_reasons(always), join_reasons(now)
