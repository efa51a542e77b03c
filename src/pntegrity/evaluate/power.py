"""What a monitor would see: the power of its own tests against a fault, without noise and without simulation.

A fault ``f`` on the rows moves the mean of the innovations by ``g`` (`kernels.windows.respond`), whatever the
data. Fed with the whitened ``g``, a quadratic test gives its non-centrality: its statistic is a non-central
chi-square, or, where its covariance is not the true one (published variants), a weighted sum of them. A bank
gives the mean of each hypothesis; that the best one alone exceeds the threshold is a lower bound of its
power.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Protocol

import numpy as np
from scipy import special

from pntegrity.evaluate.montecarlo import Planned, Test
from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.kernels.linear import whiten
from pntegrity.kernels.quadratic_tail import quadratic_tail
from pntegrity.kernels.tails import noncentral_tail, noncentrality_for, two_sided_tail
from pntegrity.kernels.windows import QuadraticTest, respond
from pntegrity.records import FloatArray, Update

__all__ = ["Probe", "Reach", "Shape", "detection", "spectrum"]


@dataclass(frozen=True)
class Shape:
    """A fault of unit size on one row since an onset: ``"bias"``, or ``"ramp"`` that is 0 at the onset."""

    key: str
    kind: str

    def at(self, tau_s: float) -> float:
        """Return its value `tau_s` seconds after the onset."""
        return tau_s if self.kind == "ramp" else 1.0


class Reach(Protocol):
    """What one test sees of unit faults; c of them."""

    @property
    def score(self) -> FloatArray:
        """How well each is seen, shape (c,); 0: not at all."""
        ...

    def power(self, i: int, size: float) -> float:
        """Return the probability that the test alarms on fault `i` of that size."""
        ...

    def size(self, i: int, power: float) -> float:
        """Return the smallest size of fault `i` seen with that probability, inf where there is none."""
        ...


@dataclass(frozen=True, eq=False)
class _ChiSquare:
    """A quadratic test with the true covariance: `noncentrality`, shape (c,), of unit faults."""

    threshold: float
    dof: int
    noncentrality: FloatArray

    @property
    def score(self) -> FloatArray:
        return self.noncentrality / self.threshold

    def power(self, i: int, size: float) -> float:
        return float(noncentral_tail(self.threshold, self.dof, self.noncentrality[i] * size**2))

    def size(self, i: int, power: float) -> float:
        seen = float(self.noncentrality[i])
        return float(np.sqrt(_needed(power, self.threshold, self.dof) / seen)) if seen > 0.0 else float("inf")


@dataclass(frozen=True, eq=False)
class _Weighted:
    """A quadratic test with another covariance: true variances (r,), means `shift` (r, c) in sigmas."""

    threshold: float
    weights: FloatArray
    shift: FloatArray

    @property
    def score(self) -> FloatArray:
        return np.asarray(self.weights @ (self.shift * self.shift)) / self.threshold

    def power(self, i: int, size: float) -> float:
        return quadratic_tail(self.threshold, self.weights, size * self.shift[:, i])

    def size(self, i: int, power: float) -> float:
        from scipy.optimize import brentq

        if self.score[i] <= 0.0:
            return float("inf")
        if self.power(i, 0.0) >= power:
            return 0.0
        wanted = float(special.ndtri(power))

        @cache
        def above(size: float) -> float:  # nearly a straight line
            return float(special.ndtri(np.clip(self.power(i, size), 1e-300, 1.0 - 1e-16))) - wanted

        low = high = self._guess(i, power)
        while above(low) > 0.0:
            low *= 0.95
        while above(high) < 0.0:
            high *= 1.05
        return low if low == high else float(brentq(above, low, high, rtol=1e-5))

    def _guess(self, i: int, power: float) -> float:
        """Return the size at which a normal of the statistic's mean and variance has that power."""
        w, d2 = self.weights, self.shift[:, i] ** 2
        size, z = 1.0 / np.sqrt(self.score[i]), float(special.ndtri(power))
        for _ in range(20):
            spread = np.sqrt(float((2.0 * w**2 * (1.0 + 2.0 * size**2 * d2)).sum()))
            wanted = self.threshold + z * spread - float(w.sum())
            size = np.sqrt(max(wanted, 1e-3 * self.threshold) / float(w @ d2))
        return float(size)


@dataclass(frozen=True, eq=False)
class _Largest:
    """A bank: mean of its best test for unit faults, and the threshold on that one's size, shapes (c,)."""

    threshold: FloatArray
    score: FloatArray

    def power(self, i: int, size: float) -> float:
        mean = abs(size) * float(self.score[i])
        return float(special.ndtr(mean - self.threshold[i]) + special.ndtr(-mean - self.threshold[i]))

    def size(self, i: int, power: float) -> float:
        needed = float(self.threshold[i] + special.ndtri(power))
        if two_sided_tail(self.threshold[i]) >= power:
            return 0.0
        return needed / float(self.score[i]) if self.score[i] > 0.0 else float("inf")


@lru_cache(maxsize=1024)
def _needed(power: float, threshold: float, dof: int) -> float:
    return noncentrality_for(power, threshold, dof)


def spectrum(test: QuadraticTest) -> tuple[FloatArray, FloatArray] | None:
    """Return the true variances of a test's vector and their directions (columns); None where all are 1."""
    if test.form is None:
        return None
    cov = test.form.covariance()
    values, vectors = np.linalg.eigh(cov)
    if np.abs(values - 1.0).max(initial=0.0) < 1e-7:
        return None
    keep = values > 1e-12 * values[-1]
    return values[keep], vectors[:, keep]


class Probe:
    """Unit faults on their way through a record since an onset; `take` the updates one after another.

    Parameters
    ----------
    shapes : sequence of Shape
        The faults, c of them.
    first : Update
        The update at which they begin.

    Attributes
    ----------
    white : list of ndarray, shapes (m_k, c)
        Means of the whitened innovations so far.
    left : ndarray, shape (c,)
        What part of the last fault is left in the innovations (norms, whitened).
    """

    def __init__(self, shapes: Sequence[Shape], first: Update) -> None:
        self.shapes, self.onset_ns = tuple(shapes), first.t_ns
        self.E: FloatArray = np.zeros((first.F.shape[1], len(self.shapes)))
        self.num: FloatArray | None = None
        self.apart: FloatArray = np.zeros((0, 0, len(self.shapes)))
        self.white: list[FloatArray] = []
        self.left: FloatArray = np.ones(len(self.shapes))

    def take(self, planned: Planned) -> Reach | None:
        """Return what the test of this epoch sees of the faults, None where there is no test."""
        u = planned.update
        f = self._faults(u)
        g, self.E = respond(self.E, u.F, u.H, u.K, f)
        white, whole = whiten(u.L, g), whiten(u.L, f)
        size = np.linalg.norm(whole, axis=0)
        self.left = np.linalg.norm(white, axis=0) / np.where(size > 0.0, size, 1.0)
        self.white.append(white)
        reach = self._seen(planned.test, white)
        return None if planned.reason else reach

    def _faults(self, u: Update) -> FloatArray:
        row = {k: i for i, k in enumerate(u.keys)}
        tau = (u.t_ns - self.onset_ns) * 1e-9
        f = np.zeros((len(u.keys), len(self.shapes)))
        for c, shape in enumerate(self.shapes):
            if shape.key in row:
                f[row[shape.key], c] = shape.at(tau)
        return f

    def _seen(self, test: Test, white: FloatArray) -> Reach | None:
        if isinstance(test, MaximumTest):
            return self._bank(test, white)
        if isinstance(test, CarriedTest):
            return self._subfilters(test, white)
        if test.form is None:
            return None
        window = np.concatenate(self.white[-len(test.form.maps) :])
        # a window that reaches back before the onset has nothing of the fault there
        mean = test.form.stacked()[:, -len(window) :] @ window
        return _reach(test, mean)

    def _bank(self, test: MaximumTest, white: FloatArray) -> Reach:
        if self.num is None:  # before the onset all sums are zero
            self.num = np.zeros((int(test.source.max(initial=-1)) + 1, len(self.shapes)))
        self.num = test.carry(self.num, white)
        best = np.abs(self.num * np.sqrt(test.inverse)[:, None]).max(axis=0, initial=0.0)
        return _Largest(np.full(len(best), np.sqrt(test.threshold)), best)

    def _subfilters(self, test: CarriedTest, white: FloatArray) -> Reach | None:
        if not test.inverse.size:
            return None
        if not len(self.apart):  # before the onset all are where the filter is
            self.apart = np.zeros((int(test.source.max()) + 1, test.carry.shape[2], len(self.shapes)))
        self.apart = test.step(self.apart, white)
        ratios = test.ratios(self.apart)
        best = ratios.reshape(-1, ratios.shape[2])
        at = best.argmax(axis=0)
        allowed = np.tile(test.deviations, len(ratios))[at]
        return _Largest(allowed, np.take_along_axis(best, at[None], axis=0)[0] * allowed)


def _reach(test: QuadraticTest, mean: FloatArray) -> Reach:
    found = spectrum(test)
    if found is None:
        return _ChiSquare(test.threshold, mean.shape[0], np.asarray(np.sum(mean * mean, axis=0)))
    values, vectors = found
    return _Weighted(test.threshold, values, (vectors.T @ mean) / np.sqrt(values)[:, None])


def detection(planned: Iterable[Planned], shape: Shape, size: float) -> Iterator[float | None]:
    """Yield the probability of an alarm at each epoch of a fault since the first; None without a test.

    Exact for quadratic monitors, a lower bound for a bank.
    """
    probe: Probe | None = None
    for p in planned:
        probe = probe or Probe((shape,), p.update)
        reach = probe.take(p)
        yield None if reach is None else reach.power(0, size)
