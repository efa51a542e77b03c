"""The windowed vectors of AIME and SRAIME as linear maps of whitened innovations.

The window is a run of updates after an anchor posterior. The state propagator leaves the anchor without
measurements; ``s_i`` is how far the filter's prior has moved from it: ``s_1 = 0``, ``s_{i+1} = F_{i+1} (s_i +
K_i nu_i)``. Then ``e_i = nu_i + H_i s_i`` (AIME) and ``d_i = s_i + K_i nu_i`` (SRAIME). Both papers form an
average weighted by inverse covariances; any invertible change of the average leaves the statistic alone, so
the weighted sums ``eta = sum_i W_i e_i`` (or ``W_i T d_i``) are used. The maps come from one backward
(adjoint) pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import inverse_definite
from pntegrity.kernels.sparse import right, sandwich
from pntegrity.kernels.windows import pseudo_inverses

FloatArray = npt.NDArray[np.float64]


class Step(Protocol):
    """What the kernels read of an update."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the rows."""
        ...

    @property
    def F(self) -> FloatArray:
        """Transition into the update."""
        ...

    @property
    def H(self) -> FloatArray:
        """Jacobian of the rows."""
        ...

    @property
    def S(self) -> FloatArray:
        """Innovation covariance."""
        ...

    @property
    def L(self) -> FloatArray:
        """Its lower Cholesky factor."""
        ...

    @property
    def K(self) -> FloatArray:
        """Gain."""
        ...

    @property
    def absorbed(self) -> FloatArray:
        """What the rows took from the covariance."""
        ...


def drift_covariances(window: Sequence[Step]) -> list[FloatArray]:
    """Return ``cov(s_i)``: how far the filter may have moved from the propagator before each update, shapes
    (n_i, n_i).
    """
    out = [np.zeros_like(window[0].absorbed)]
    for earlier, later in pairwise(window):
        out.append(sandwich(later.F, out[-1] + earlier.absorbed))
    return out


def innovation_maps(window: Sequence[Step]) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Return the maps ``M_j`` of AIME's weighted innovation sum and the sum of its weights (the published
    covariance).

    Rows are the union of the window's keys, so satellites may rise and set inside it.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (27)-(32); Diesel and King (1995).
    """
    union = _union([u.keys for u in window])
    rows = [_places(u.keys, union) for u in window]
    weights = [
        inverse_definite(u.S + sandwich(u.H, C) if i else u.S) for i, (u, C) in enumerate(_drifting(window))
    ]
    believed = np.zeros((len(union), len(union)))
    maps: list[FloatArray] = []
    Y = np.zeros((len(union), window[-1].K.shape[0]))
    for i in range(len(window) - 1, -1, -1):
        u, W, r = window[i], weights[i], rows[i]
        A = Y @ u.K
        A[r] += W
        maps.append(A @ u.L)
        _add_block(believed, r, W)
        if i:
            Y[r] += right(W, u.H)
            Y = right(Y, u.F)
    return tuple(reversed(maps)), believed


def _drifting(window: Sequence[Step]) -> list[tuple[Step, FloatArray]]:
    return list(zip(window, drift_covariances(window), strict=True))


def _union(keys: list[tuple[str, ...]]) -> tuple[str, ...]:
    if all(k is keys[-1] or k == keys[-1] for k in keys):
        return keys[-1]
    return tuple(dict.fromkeys(k for ks in keys for k in ks))


def _places(keys: tuple[str, ...], union: tuple[str, ...]) -> slice | npt.NDArray[np.intp]:
    """Return where rows stand in the union: everywhere (a slice, which is fast) as long as no satellite comes
    or goes.
    """
    if keys == union:
        return slice(None)
    index = {k: i for i, k in enumerate(union)}
    return np.array([index[k] for k in keys], dtype=np.intp)


def _add_block(total: FloatArray, places: slice | npt.NDArray[np.intp], block: FloatArray) -> None:
    if isinstance(places, slice):
        total += block
    else:
        total[np.ix_(places, places)] += block


def state_maps(
    window: Sequence[Step], blocks: Sequence[npt.NDArray[np.intp]]
) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Return the maps of SRAIME's weighted state-difference sum and the sum of its weights.

    Parameters
    ----------
    window : sequence of updates
    blocks : sequence of index arrays
        Where the chosen states stand in each update's layout (the same states throughout).

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (37)-(41).
    """
    moved = [
        (C + u.absorbed)[b][:, b] for C, u, b in zip(drift_covariances(window), window, blocks, strict=True)
    ]
    weights = pseudo_inverses(np.stack(moved))
    d = len(blocks[0])
    maps: list[FloatArray] = []
    Y = np.zeros((d, window[-1].K.shape[0]))
    for i in range(len(window) - 1, -1, -1):
        u, b = window[i], blocks[i]
        Y[:, b] += weights[i]
        maps.append(Y @ u.K @ u.L)
        if i:
            Y = right(Y, u.F)
    return tuple(reversed(maps)), weights.sum(axis=0)
