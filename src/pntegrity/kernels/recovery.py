"""When a source or a sensor that was left out may come back: tests of rows that the filter does not use.

The paper passes a source after five epochs in a row whose w-tests pass: how likely a source that is still at
fault passes depends on nothing that is said. `Trial` runs a filter with the rows over a window, beside the
one without them. Its innovations are white, a bias of given size moves them by a known mean, and so the
probability that such a fault is re-admitted is exact. Where the state follows a bias a window shows little of
it, however long it is; `ChangeTrial` then proves that the bias has gone away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.kernels.linear import inverse_definite, whiten
from pntegrity.kernels.source_test import Gains, responses
from pntegrity.kernels.tails import chi2_threshold, noncentral_tail
from pntegrity.kernels.windows import respond

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

__all__ = ["ChangeTrial", "Passes", "Trial", "w_test"]


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
        return _sigmas(self.means, white)


@dataclass(frozen=True, eq=False)
class ChangeTrial:
    """A window in whose first epochs rows are off by an unknown constant each, and no longer in the others.

    What `Trial` shows of a bias is no better than the state is known without the rows: a bearing's is that of
    the heading, which drifts the longer, the longer the bearing is left out. That a bias has changed within
    the window is known far better. The trial is passed where all innovations together are small but for the
    constants, the bias of the later epochs, as estimated, agrees with none, and differs from the one before
    by so much that a bias which has stayed as it was passes with a probability of at most `p_readmit`. Of one
    that changes and does not vanish the second of these is all that is known.

    Parameters
    ----------
    window : sequence of (F, H, L, K)
        The filter with the rows, which begins where they are first left out or later; the oldest first.
    rows : sequence of ndarray of int, each of shape (k,)
        Where the rows are in each epoch; -1: not measured then.
    before : int
        Epochs of the window in which they are off.
    size : ndarray, shape (k,)
        Biases that they had.
    p_readmit, p_fa : float
    """

    window: tuple[Gains, ...]
    rows: tuple[IntArray, ...]
    before: int
    size: FloatArray
    p_readmit: float
    p_fa: float

    def __post_init__(self) -> None:
        if not 0 < self.before < len(self.window):
            raise ValueError(f"`before` must be within the window of {len(self.window)}, not {self.before}")

    @cached_property
    def _parts(self) -> tuple[FloatArray, FloatArray]:
        """What unit biases before and after do to the whitened innovations, shapes (D, k)."""
        k, out = len(self.size), []
        E = np.zeros((self.window[0][0].shape[1], 2 * k))
        for i, ((F, H, L, K), own) in enumerate(zip(self.window, self.rows, strict=True)):
            f, there = np.zeros((len(H), 2 * k)), np.flatnonzero(own >= 0)
            f[own[there], there + (0 if i < self.before else k)] = 1.0
            g, E = respond(E, F, H, K, f)
            out.append(whiten(L, g))
        both = np.concatenate(out)
        return both[:, :k], both[:, k:]

    @cached_property
    def levels(self) -> FloatArray:
        """What a bias of each row in the later epochs does, whatever it was before; shape (D, k)."""
        early, late = self._parts
        return _outside(late, early)

    @cached_property
    def changes(self) -> FloatArray:
        """What a change of each row's bias does, whatever the bias; shape (D, k)."""
        early, late = self._parts
        return _outside(late, early + late)

    @property
    def shown(self) -> FloatArray:
        """How many standard deviations the end of a bias of each `size` moves its estimated change."""
        return np.asarray(np.linalg.norm(self.changes, axis=0) * self.size)

    @property
    def needed(self) -> float:
        """How many standard deviations each change must be."""
        return float(-special.ndtri(0.5 * self.p_readmit))

    @property
    def power(self) -> FloatArray:
        """The probability that the end of a bias of each size is seen, shape (k,)."""
        return np.asarray(special.ndtr(self.shown - self.needed))

    @property
    def readmission(self) -> FloatArray:
        """The probability at most that each row passes whose bias has stayed as it was, shape (k,)."""
        return np.full(len(self.size), self.p_readmit)

    @property
    def limit(self) -> float:
        """How many standard deviations each bias of the later epochs may be."""
        return float(np.sqrt(chi2_threshold(0.5 * self.p_fa / len(self.size), 1)))

    def estimates(self, white: FloatArray) -> FloatArray:
        """Return the size of each row's later bias in standard deviations, shape (k, runs)."""
        return _sigmas(self.levels, white)

    def passed(self, white: FloatArray) -> npt.NDArray[np.bool_]:
        """Tell which runs of whitened innovations, shape (D, runs), pass."""
        early, k = self._parts[0], len(self.size)
        left = _outside(white, early)
        total = (left * left).sum(axis=0) <= chi2_threshold(0.5 * self.p_fa, len(white) - k)
        agree = (self.estimates(white) <= self.limit).all(axis=0)
        return np.asarray(total & agree & (_sigmas(self.changes, white) >= self.needed).all(axis=0))


def _outside(columns: FloatArray, others: FloatArray) -> FloatArray:
    base = np.linalg.qr(others)[0]
    return np.asarray(columns - base @ (base.T @ columns))


def _sigmas(means: FloatArray, white: FloatArray) -> FloatArray:
    """Return the estimates of columns in standard deviations, shape (k, runs)."""
    size = np.linalg.norm(means, axis=0)[:, None]
    return np.asarray(np.abs(means.T @ white) / np.where(size > 0.0, size, 1.0))
