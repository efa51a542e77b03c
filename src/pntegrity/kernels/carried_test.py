"""A test of differences that a bank carries from epoch to epoch, without data: what becomes of them, and when
they alarm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

__all__ = ["CarriedTest"]


@dataclass(frozen=True, eq=False)
class CarriedTest:
    """One epoch of a bank of subfilters; shapes: M members, n states, m rows, d directions.

    Parameters
    ----------
    source : ndarray of int, shape (M,)
        Where each member stood in the epoch before.
    carry : ndarray, shape (M, n, n_before)
        How a member's difference from the filter goes on.
    response : ndarray, shape (M, n, m)
        What the whitened innovation adds to it.
    axes : ndarray, shape (d, n)
        Directions that are tested.
    inverse : ndarray, shape (M, d)
        One over what is allowed, 0 where nothing is tested.
    deviations : ndarray, shape (d,)
        How many standard deviations are allowed.
    threshold, p_fa : float
        Of the largest, and the false-alarm probability that it stands for.
    overlap : int
        Epochs since the bank began.
    reason : str
        Why no test is possible, where none is.
    """

    source: npt.NDArray[np.intp]
    carry: FloatArray
    response: FloatArray
    axes: FloatArray
    inverse: FloatArray
    deviations: FloatArray
    threshold: float = float("inf")
    p_fa: float = 0.0
    overlap: int = 1
    reason: str = ""

    @staticmethod
    def impossible(reason: str) -> CarriedTest:
        """Return the test of an epoch without rows."""
        none, nobody = np.zeros((0, 0)), np.zeros((0, 0, 0))
        return CarriedTest(np.zeros(0, np.intp), nobody, nobody, none, none, np.zeros(0), reason=reason)

    @property
    def nbytes(self) -> int:
        """Size of the matrices."""
        return self.carry.nbytes + self.response.nbytes

    def step(self, apart: FloatArray, white: FloatArray) -> FloatArray:
        """Return the differences after the epoch, shape (M, n, runs), from those before and the whitened rows
        (m, runs).
        """
        before = apart[self.source] if len(apart) else np.zeros((*self.carry.shape[::2], white.shape[1]))
        return np.asarray(self.carry @ before + self.response @ white)

    def statistic(self, apart: FloatArray) -> FloatArray:
        """Return the largest difference over what is allowed, shape (runs,)."""
        return np.asarray(self.ratios(apart).max(axis=(0, 1)))

    def ratios(self, apart: FloatArray) -> FloatArray:
        """Return each difference over what is allowed, shape (M, d, runs)."""
        return np.asarray(np.abs(self.axes @ apart) * self.inverse[:, :, None])
