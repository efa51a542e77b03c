"""Which of a source's redundant sensors is at fault: subfilters without some, and windows of innovations.

Subfilter ``j`` never uses the sensors of its set; each sensor's innovations against it are squared, whitened
and summed over a window, ``d[j, i]``. A faulty sensor spoils every subfilter that uses it: the one without
the faulty sensors is the only one all of whose tests pass.

References
----------
Chen and Zhao (2023), eqs (8)-(15), read with ``P`` and not its inverse in (10), and (15) as the mean of the
parents' windows, epoch by epoch. Jurado et al. (2020), Residual-based multi-filter methodology for all source
fault detection, exclusion, and performance monitoring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.tails import chi2_threshold

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Sets = tuple[tuple[int, ...], ...]

__all__ = ["Outcome", "SensorTests", "expanded", "sets_of", "squares", "used_rows"]


def sets_of(sensors: int, faults: int) -> Sets:
    """Return which sensors each subfilter does without, eq. (8)."""
    return tuple(combinations(range(sensors), faults))


def used_rows(sets: Sets, sensor: npt.NDArray[np.intp]) -> BoolArray:
    """Return which rows each subfilter uses, shape (J, m).

    Parameters
    ----------
    sets : tuple of tuple of int
    sensor : ndarray of int, shape (m,)
        The sensor of each row, -1 for rows of other sources.
    """
    return np.stack([~np.isin(sensor, own) for own in sets])


def squares(nu: FloatArray, H: FloatArray, R: FloatArray, P: FloatArray) -> FloatArray:
    """Return ``r^T (R + H P H^T)^-1 r`` of one sensor's rows against each subfilter, shape (J,).

    Parameters
    ----------
    nu : ndarray, shape (J, k)
        Innovations of the rows.
    H, R : ndarray, shapes (k, n) and (k, k)
    P : ndarray, shape (J, n, n)
        Priors.

    References
    ----------
    Eqs (9)-(11).
    """
    S = R + H @ P @ H.T
    return np.asarray((nu * np.linalg.solve(S, nu[:, :, None])[:, :, 0]).sum(axis=1))


def expanded(window: FloatArray, old: Sets, new: Sets) -> FloatArray:
    """Return the window with which larger sets begin: the mean of those of their parents.

    Parameters
    ----------
    window : ndarray, shape (epochs, J_old, sensors)
    old, new : tuple of tuple of int
        Sets before, and those with one sensor more.

    References
    ----------
    Eqs (14)-(15).
    """
    out = np.empty((len(window), len(new), window.shape[2]))
    for j, own in enumerate(new):
        parents = [i for i, before in enumerate(old) if set(before) < set(own)]
        out[:, j] = window[:, parents].mean(axis=1)
    return out


@dataclass(frozen=True)
class Outcome:
    """What the tests say: nobody is at fault (`clear`), these sensors are (`faulty`), more sensors must be
    assumed to be (`grow`), or it cannot be told yet.
    """

    clear: bool = False
    faulty: tuple[int, ...] = ()
    grow: bool = False


@dataclass(frozen=True, eq=False)
class SensorTests:
    """The tests of one epoch.

    Parameters
    ----------
    sets : tuple of tuple of int
    ratio : ndarray, shape (J, sensors)
        Each statistic over its threshold; 0 for the sensors that a subfilter does without.
    """

    sets: Sets
    ratio: FloatArray

    @staticmethod
    def of(sets: Sets, window: FloatArray, rows: Sequence[int], p_fa: float) -> SensorTests:
        """Return the tests of windows, shape (epochs, J, sensors); `rows`: how many each sensor has."""
        allowed = np.array([chi2_threshold(p_fa, len(window) * k) for k in rows])
        ratio = window.sum(axis=0) / allowed
        for j, own in enumerate(sets):
            ratio[j, list(own)] = 0.0
        return SensorTests(sets, ratio)

    @property
    def matrix(self) -> BoolArray:
        """Which tests fail, eq. (12)."""
        return np.asarray(self.ratio > 1.0)

    @property
    def scores(self) -> npt.NDArray[np.int64]:
        """How many tests of each subfilter fail, eq. (13)."""
        return np.asarray(self.matrix.sum(axis=1))

    @property
    def outcome(self) -> Outcome:
        """What follows from the scores."""
        passing = np.flatnonzero(self.scores == 0)
        if len(passing) == len(self.scores):
            return Outcome(clear=True)
        if len(passing) == 1:
            return Outcome(faulty=self.sets[int(passing[0])])
        return Outcome(grow=not len(passing))
