"""By how much a unit normal must grow to bound innovations: singly, and in means over several epochs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.special import ndtri

from pntegrity.evaluate.whiteness import judged
from pntegrity.records import FloatArray, Update

__all__ = ["bound", "excess", "lasting", "series_of"]

#: Lengths of the means over which a row's innovations are compared with white ones, epochs, and how many
#: such means there must be.
SPANS, MEANS = (1, 5, 10, 20), 5


def series_of(updates: Iterable[Update]) -> dict[str, FloatArray]:
    """Return the unit innovations of each row, by its key."""
    series: dict[str, list[float]] = {}
    for u in updates:
        for key, value in zip(u.keys, judged(u), strict=True):
            if np.isfinite(value):
                series.setdefault(key, []).append(float(value))
    return {key: np.array(x) for key, x in series.items()}


def excess(x: FloatArray) -> float:
    """Return how much larger than unit white noise a series is, 0.7 to 6.

    Means of white unit innovations over ``L`` epochs have variance ``1 / L``; the largest ratio to that over
    several `L` also counts errors that are small but last.
    """
    ratios = [np.sqrt(np.mean(_means(x, n) ** 2)) for n in SPANS if len(x) >= MEANS * n]
    return float(np.clip(max(ratios), 0.7, 6.0))


def bound(series: Sequence[FloatArray]) -> float:
    """Return the least factor of a unit normal that bounds what is beyond one sigma, singly and in means.

    The outermost values, where a normal sample of that size is beyond 3 sigma, are left to the threshold
    factors: a single one would decide.
    """
    worst = 1.0
    for n in SPANS:
        found = np.sort(np.abs(_pooled(series, n)))[::-1]
        normal = ndtri(1.0 - (np.arange(len(found)) + 0.5) / (2.0 * max(len(found), 1)))
        inner = (normal > 1.0) & (normal < 3.0)
        worst = max(worst, float((found / normal)[inner].max(initial=1.0)))
    return worst


def lasting(series: Sequence[FloatArray]) -> float:
    """Return how much larger than those of unit white noise the means over several epochs surely are, at
    least 1.

    It is the largest root mean square of such means, less twice what it may be off by chance: of white noise
    it is 1, even where there are few means.
    """
    worst = 1.0
    for n in SPANS[1:]:
        pooled = _pooled(series, n)
        if len(pooled):
            sure = 1.0 - 2.0 / np.sqrt(2.0 * len(pooled))
            worst = max(worst, sure * float(np.sqrt(np.mean(pooled**2))))
    return worst


def _pooled(series: Sequence[FloatArray], n: int) -> FloatArray:
    """Return the means over so many epochs of all series that are long enough."""
    return np.concatenate([np.zeros(0), *(_means(x, n) for x in series if len(x) >= MEANS * n)])


def _means(x: FloatArray, n: int) -> FloatArray:
    """Return the means of each `n` values, scaled so that those of unit white noise are such again."""
    return np.asarray(np.sqrt(n) * x[: len(x) // n * n].reshape(-1, n).mean(axis=1))
