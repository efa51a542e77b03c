"""Are the innovations white? A false-alarm rate is only as true as that."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import inverse_lower
from pntegrity.kernels.signatures import is_rate
from pntegrity.records import FloatArray, Update

__all__ = ["KINDS", "beside_others", "judged", "row_kinds", "usual_lags_s", "whiteness"]

#: What a row may measure: a range by code (whatever is neither of the others), by carrier, or its rate.
KINDS = ("code", "carrier", "rate")
#: A carrier whose ambiguity was less certain than this has said nothing yet: its first value became that,
#: m^2.
BORN_M2 = 100.0
#: Usual lags in sampling intervals, and where the last of them ends, s.
LAGS, LONGEST_S = (1, 5, 30), 1200.0


def row_kinds(updates: Iterable[Update]) -> dict[str, str]:
    """Return the kind of each row of some updates; a carrier is what has an ambiguity
    (``amb:<row>:<arc>``).
    """
    kinds: dict[str, str] = {}
    arcs: set[str] = set()
    for keys, spare_keys, layout in {(u.keys, u.spare_keys, u.prior.layout) for u in updates}:
        kinds |= {k: "rate" if is_rate(k) else "code" for k in (*keys, *spare_keys)}
        arcs.update(row_of(layout.names[i]) for i in layout.block("amb"))
    return kinds | {k: "carrier" for k in kinds if k in arcs}


def row_of(ambiguity: str) -> str:
    """Return the row that an ambiguity belongs to: ``G05:L1C`` of ``amb:G05:L1C:2``."""
    return ambiguity.partition(":")[2].rpartition(":")[0]


def judged(update: Update) -> FloatArray:
    """Return `beside_others`, nan for a carrier whose ambiguity is born from its own first value."""
    out = beside_others(update)
    layout, variance = update.prior.layout, np.diagonal(update.prior.P)
    born = {row_of(layout.names[i]) for i in layout.block("amb") if variance[i] > BORN_M2}
    if born:
        out[[k in born for k in update.keys]] = np.nan
    return out


def normalised(updates: Sequence[Update]) -> tuple[tuple[str, ...], FloatArray]:
    """Return row keys and what `judged` gives of each update, shape (n_updates, n_keys); nan: no row."""
    keys = tuple(dict.fromkeys(k for u in updates for k in u.keys))
    column = {k: i for i, k in enumerate(keys)}
    out = np.full((len(updates), len(keys)), np.nan)
    for i, u in enumerate(updates):
        if u.keys:
            out[i, [column[k] for k in u.keys]] = judged(u)
    return keys, out


def beside_others(update: Update) -> FloatArray:
    """Return ``(S^-1 nu)_i / sqrt((S^-1)_ii)``, shape (m,): unit normal each without a fault (Baarda's w).

    It is what a row says beside all other rows of the epoch, in its standard deviations. What the epoch's own
    data determine (a clock without memory) is not in it.
    """
    root = inverse_lower(update.L)
    return np.asarray((root.T @ update.white) / np.sqrt(np.einsum("ij,ij->j", root, root)))


def usual_lags_s(t_ns: npt.NDArray[np.int64]) -> tuple[float, ...]:
    """Return 1, 5 and 30 sampling intervals, whole seconds' worth of them where these are shorter.

    The last is 20 minutes at most where that is 10 intervals at least.
    """
    interval = float(np.median(np.diff(t_ns))) * 1e-9 if len(t_ns) > 1 else 1.0
    last = min(LAGS[2], max(round(LONGEST_S / interval), 10))
    each = max(round(1.0 / interval), 1)
    return tuple(round(n * each * interval, 6) for n in (*LAGS[:2], last))


def whiteness(
    updates: Iterable[Update],
    lags_s: Sequence[float] | None = None,
    part_of: Callable[[str], str] | None = None,
) -> dict[str, Any]:
    """Return how far normalised innovations are from unit white noise, each kind of rows for itself.

    A row's autocorrelation at a lag is ``sum(a b) / sqrt(sum(a^2) sum(b^2))`` over pairs of innovations that
    far apart (about zero: the innovations of a true model have no mean). Pairs do not reach over a gap, over
    a start of the filter, nor contain the start itself. Rows are averaged with the number of their pairs as
    weight. The first innovation of a carrier's arc does not count: its ambiguity takes it.

    Parameters
    ----------
    updates : iterable of Update
        In time order; of a repaired run the updates that were kept.
    lags_s : sequence of float, optional
        Lags, s; `usual_lags_s` where not given.
    part_of : callable, optional
        Gives the part that a row's key belongs to, where these shall be others than ``code``, ``carrier`` and
        ``rate``: its source.

    Returns
    -------
    dict
        ``lags_s``: list of float. ``code``, ``carrier``, ``rate`` and ``level`` (code and carrier together):
        each ``{"autocorrelation": [float or None a lag], "pairs": [int a lag], "mean_square": float or None,
        "count": int}``; a true model has mean square 1.
    """
    kept = [u for u in updates if u.keys]
    inherits = np.array([not u.is_start for u in kept], dtype=bool)
    keys, a = normalised(kept)
    a[~inherits] = np.nan
    run = np.cumsum(~inherits)
    t_ns = np.array([u.t_ns for u in kept], dtype=np.int64)
    lags = usual_lags_s(t_ns) if lags_s is None else lags_s
    pairs = [_pairs(t_ns, run, lag) for lag in lags]
    kinds = row_kinds(kept) if part_of is None else {k: part_of(k) for k in keys}
    names = KINDS if part_of is None else dict.fromkeys(kinds.values())
    parts = {name: _of(a[:, [kinds[k] == name for k in keys]], pairs) for name in names}
    level = _of(a[:, [kinds[k] != "rate" for k in keys]], pairs)
    return {"lags_s": [float(lag) for lag in lags], **parts, "level": level}


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
