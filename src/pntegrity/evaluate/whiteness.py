"""Are the innovations white? A false-alarm rate is only as true as that."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import inverse_lower
from pntegrity.kernels.signatures import is_rate
from pntegrity.records import FloatArray, Update

__all__ = ["beside_others", "normalised", "whiteness"]


def normalised(updates: Sequence[Update]) -> tuple[tuple[str, ...], FloatArray]:
    """Return row keys and normalised innovations (n_updates, n_keys); nan: no row.

    A row's is ``(S^-1 nu)_i / sqrt((S^-1)_ii)``: what it says beside all other rows of the epoch, in its
    standard deviations. What the epoch's own data determine (a clock without memory) is not in it.
    """
    keys = tuple(dict.fromkeys(k for u in updates for k in u.keys))
    column = {k: i for i, k in enumerate(keys)}
    out = np.full((len(updates), len(keys)), np.nan)
    for i, u in enumerate(updates):
        if u.keys:
            out[i, [column[k] for k in u.keys]] = beside_others(u)
    return keys, out


def beside_others(update: Update) -> FloatArray:
    """Return ``(S^-1 nu)_i / sqrt((S^-1)_ii)``, shape (m,): unit normal each without a fault (Baarda's w)."""
    root = inverse_lower(update.L)
    return np.asarray((root.T @ update.white) / np.sqrt(np.einsum("ij,ij->j", root, root)))


def whiteness(updates: Iterable[Update], lags_s: Sequence[float] = (1.0, 5.0, 30.0)) -> dict[str, Any]:
    """Return how far normalised innovations are from unit white noise, for level rows and for rate rows.

    A row's autocorrelation at a lag is ``sum(a b) / sqrt(sum(a^2) sum(b^2))`` over pairs of innovations that
    far apart (about zero: the innovations of a true model have no mean). Pairs do not reach over a gap, over
    a start of the filter, nor contain the start itself. Rows are averaged with the number of their pairs as
    weight.

    Parameters
    ----------
    updates : iterable of Update
        In time order; of a repaired run the updates that were kept.
    lags_s : sequence of float
        Lags, s.

    Returns
    -------
    dict
        ``lags_s``: list of float. ``level`` and ``rate``: each ``{"autocorrelation": [float or None a lag],
        "pairs": [int a lag], "mean_square": float or None, "count": int}``; a true model has mean square 1.
    """
    kept = [u for u in updates if u.keys]
    inherits = np.array([not u.is_start for u in kept], dtype=bool)
    keys, a = normalised(kept)
    a[~inherits] = np.nan
    run = np.cumsum(~inherits)
    t_ns = np.array([u.t_ns for u in kept], dtype=np.int64)
    rate = np.array([is_rate(k) for k in keys], dtype=bool)
    parts = {"level": a[:, ~rate], "rate": a[:, rate]}
    pairs = [_pairs(t_ns, run, lag) for lag in lags_s]
    return {"lags_s": [float(lag) for lag in lags_s]} | {n: _of(part, pairs) for n, part in parts.items()}


def _pairs(
    t_ns: npt.NDArray[np.int64], run: npt.NDArray[np.intp], lag_s: float
) -> tuple[npt.NDArray[np.intp], ...]:
    """Return indices of epochs `lag_s` apart (to a tenth of the sampling interval), no start between."""
    if len(t_ns) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    lag, slack = round(lag_s * 1e9), int(np.median(np.diff(t_ns))) // 10
    later = np.searchsorted(t_ns, t_ns + (lag - slack))
    first = np.arange(len(t_ns))
    inside = later < len(t_ns)
    first, later = first[inside], later[inside]
    good = (t_ns[later] - t_ns[first] <= lag + slack) & (run[later] == run[first]) & (later > first)
    return first[good], later[good]


def _of(a: FloatArray, pairs: Sequence[tuple[npt.NDArray[np.intp], ...]]) -> dict[str, Any]:
    squares = a[np.isfinite(a)] ** 2
    found = [_autocorrelation(a[i], a[j]) for i, j in pairs]
    return {
        "autocorrelation": [r for r, _ in found],
        "pairs": [n for _, n in found],
        "mean_square": float(squares.mean()) if len(squares) else None,
        "count": len(squares),
    }


def _autocorrelation(a: FloatArray, b: FloatArray) -> tuple[float | None, int]:
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, 0.0), np.where(both, b, 0.0)
    n = both.sum(axis=0)
    power = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
    good = power > 0.0
    total = int(n[good].sum())
    if not total:
        return None, 0
    return float(((a * b).sum(axis=0)[good] / power[good] * n[good]).sum() / total), total
