"""What an epoch's own data initialise in a precise filter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._carrier import PreciseRows
from pntegrity.estimators._layout import columns
from pntegrity.estimators._precise import clock_name, jacobian
from pntegrity.records import FloatArray, Layout

__all__ = ["births", "middle"]

Mask = npt.NDArray[np.bool_]


def middle(values: FloatArray) -> float:
    """Return the upper median."""
    return float(np.sort(values)[len(values) // 2])


def births(
    mean: FloatArray, layout: Layout, F: FloatArray, rows: PreciseRows, exclude: frozenset[str] = frozenset()
) -> tuple[FloatArray, int, tuple[str, ...]]:
    """Return the mean with what the data initialise, how much that is, and what happened.

    A slant delay is what the codes of two frequencies differ by, or its product; what products share is the
    median of what they are longer than slant delays. The clock is the median of the code, a new
    constellation's bias that of its own code, an ambiguity what its carrier is longer than predicted.
    """
    mean, names = mean.copy(), rows.names
    new = np.asarray(~F.any(axis=1))
    kept = ~names.left_out(exclude)
    count = _slant_births(mean, layout, new, rows, kept) if len(names.slanted) else 0
    residual = rows.y - rows.predicted - jacobian(layout, rows)[:, 3:] @ mean[3:]
    isb = columns(layout, names.isb)
    fresh = {i for i in isb.tolist() if i >= 0 and new[i]}
    code = names.code
    if exclude:
        code = code & kept if (code & kept).any() else code
    known = code & ~np.isin(isb, list(fresh)) if fresh else code
    clock = middle(residual[known if known.any() else code]) if code.any() else 0.0
    mean[layout.index[clock_name(layout)]] += clock
    residual -= clock
    events = []
    for i in sorted(fresh):
        own = isb == i
        shift = middle(residual[own & code] if (own & code).any() else residual[own])
        mean[i] += shift
        residual[own] -= shift
        events.append(f"first satellites of {layout.names[i][4:]}")
    arcs = columns(layout, names.ambiguity)
    born = np.flatnonzero(names.carrier & new[arcs])
    mean[arcs[born]] += residual[born]
    return mean, int(code.any()) + len(fresh) + len(born) + count, tuple(events)


def _slant_births(mean: FloatArray, layout: Layout, new: Mask, rows: PreciseRows, kept: Mask) -> int:
    """Write the means of new slant delays and of what products share; return how many."""
    names = rows.names
    at, shared = columns(layout, names.ionosphere), columns(layout, names.offset)
    offsets = [i for i in dict.fromkeys(shared.tolist()) if i >= 0]
    born = [i for i in dict.fromkeys(at[names.slanted].tolist()) if new[i]]
    if not offsets and not born:
        return 0
    residual = rows.y - rows.predicted - jacobian(layout, rows)[:, 3:] @ mean[3:]
    later = [i for i in born if not _from_codes(mean, i, np.flatnonzero(at == i), residual, rows)]
    for i in offsets:
        own = (shared == i) & ~np.isin(at, later) if later else shared == i
        use = own & kept if (own & kept).any() else own
        shift = middle(residual[use]) if use.any() else 0.0
        mean[i] += shift
        residual[shared == i] -= shift
    for i in later:
        mean[i] += float(residual[(at == i) & (shared >= 0)].sum())
    return len(born) + len(offsets)


def _from_codes(
    mean: FloatArray, i: int, own: npt.NDArray[np.intp], residual: FloatArray, rows: PreciseRows
) -> bool:
    """Write the mean of a slant delay from the codes of its satellite, and take it from their residuals; tell
    whether there are two.
    """
    codes = own[rows.names.code[own]]
    apart = rows.iono[codes[-1]] - rows.iono[codes[0]] if len(codes) else 0.0
    if apart == 0.0:
        return False
    shift = (residual[codes[-1]] - residual[codes[0]]) / apart
    mean[i] += shift
    residual[own] -= rows.iono[own] * shift
    return True
