"""When a source or a sensor that was left out may come back: tests of rows that the filter does not use.

The paper passes a source after five epochs in a row whose w-tests pass: how likely a source that is still at
fault passes depends on nothing that is said. `Trial` runs a filter with the rows over a window, beside the
one without them. Its innovations are white, a bias of given size moves them by a known mean, and so the
probability that such a fault is re-admitted is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.kernels.linear import inverse_definite
from pntegrity.kernels.source_test import Gains, responses
from pntegrity.kernels.tails import chi2_threshold, noncentral_tail

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

__all__ = ["Passes", "Trial", "sensor_verification", "w_test"]


def w_test(nu: FloatArray, cov: FloatArray, p_fa: float) -> tuple[FloatArray, float]:
    """Return the w-statistics of rows left out, shape (k,) or (k, runs), and what each may be.

    Parameters
    ----------
    nu : ndarray, shape (k,) or (k, runs)
        Residuals of the rows against the filter that does not use them.
    cov : ndarray, shape (k, k)
        Their covariance.
    p_fa : float
        Probability that a healthy row fails.

    References
    ----------
    Chen and Zhao (2023), eqs (5)-(7), where `V` is the weight and the residual stands for `Y`.
    """
    weight = inverse_definite(np.ascontiguousarray(cov))
    scale = np.sqrt(np.diagonal(weight))
    return np.abs((weight @ nu).T / scale).T, float(-special.ndtri(0.5 * p_fa))


@dataclass(frozen=True)
class Passes:
    """How many tests in a row have passed; `needed`: then the source is back."""

    count: int = 0
    needed: int = 5

    def after(self, passed: bool) -> Passes:
        """Return what it is after another test."""
        return Passes(self.count + 1 if passed else 0, self.needed)

    @property
    def recovered(self) -> bool:
        """Whether it is back."""
        return self.count >= self.needed


def sensor_verification(white: FloatArray, p_fa: float) -> tuple[FloatArray, float]:
    """Return the sum of squares over a verification period, and what it may be.

    Parameters
    ----------
    white : ndarray, shape (epochs * k,) or (epochs * k, runs)
        Whitened innovations of the sensor in the verification subfilter.
    p_fa : float

    References
    ----------
    Eqs (16)-(19); of innovations before the rows are used, since residuals after it have another covariance.
    """
    return np.asarray((white * white).sum(axis=0)), chi2_threshold(p_fa, len(white))


@dataclass(frozen=True, eq=False)
class Trial:
    """A window of the filter that uses the rows to be proved, which begins from the filter without them.

    It is passed where all innovations together are small, and each row's bias, as estimated, too. What small
    means is so chosen that a row which is still off by its `size` passes with a probability of at most
    `p_readmit`: a non-central chi-square of one degree of freedom. Where the window shows more than needed, a
    healthy source fails with `p_fa` at most; where it shows less, it must try more often.

    Parameters
    ----------
    window : sequence of (F, H, L, K)
        The filter with the rows, the oldest first.
    rows : sequence of ndarray of int, each of shape (k,)
        Where the rows to be proved are in each epoch; -1: not measured then.
    size : ndarray, shape (k,)
        Biases that must not pass.
    p_readmit, p_fa : float
    least : float
        Each estimated bias may be at least so many standard deviations, whatever the probability of
        re-admission then is: for a trial that cannot be longer.
    """

    window: tuple[Gains, ...]
    rows: tuple[IntArray, ...]
    size: FloatArray
    p_readmit: float
    p_fa: float
    least: float = -np.inf

    def __post_init__(self) -> None:
        if {len(own) for own in self.rows} != {len(self.size)}:
            raise ValueError("`rows` must be as many as `size` in each epoch of a trial")

    @cached_property
    def means(self) -> FloatArray:
        """What a bias of each row makes of the whitened innovations, shape (D, k)."""
        A, _ = responses(self.window)
        ends = np.cumsum([0] + [len(H) for _, H, _, _ in self.window])
        at = np.stack(
            [np.where(own < 0, -1, first + own) for first, own in zip(ends, self.rows, strict=False)]
        )
        return np.stack([A[:, i[i >= 0]].sum(axis=1) for i in at.T], axis=1)

    @property
    def shown(self) -> FloatArray:
        """How many standard deviations a bias of each `size` moves its estimate, shape (k,)."""
        return np.asarray(np.linalg.norm(self.means, axis=0) * self.size)

    @property
    def limits(self) -> FloatArray:
        """How many standard deviations each estimated bias may be, shape (k,); negative: nothing passes."""
        usual = np.sqrt(chi2_threshold(0.5 * self.p_fa / len(self.size), 1))
        proved = self.shown + special.ndtri(self.p_readmit)
        return np.asarray(np.minimum(usual, np.maximum(proved, self.least)))

    @property
    def readmission(self) -> FloatArray:
        """The probability that each row's estimate passes where it is off by its size, shape (k,): an upper
        bound for the whole source.
        """
        t = np.maximum(self.limits, 0.0)
        return np.array(
            [1.0 - float(noncentral_tail(a * a, 1, b * b)) for a, b in zip(t, self.shown, strict=True)]
        )

    def passed(self, white: FloatArray) -> npt.NDArray[np.bool_]:
        """Tell which runs of whitened innovations, shape (D, runs), pass."""
        total = np.asarray((white * white).sum(axis=0)) <= chi2_threshold(0.5 * self.p_fa, len(white))
        return np.asarray(total & (self.estimates(white) <= self.limits[:, None]).all(axis=0))

    def estimates(self, white: FloatArray) -> FloatArray:
        """Return the size of each row's estimated bias in standard deviations, shape (k, runs)."""
        size = np.linalg.norm(self.means, axis=0)[:, None]
        return np.asarray(np.abs(self.means.T @ white) / np.where(size > 0.0, size, 1.0))
