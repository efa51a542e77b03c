"""Products with matrices that are stored dense and are mostly zero (F, Q and H of navigation filters)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Sparse = tuple[IntArray, IntArray, FloatArray]
"""A matrix by its non-zeros (see `nonzeros`)."""


@njit(cache=True, nogil=True)
def nonzeros(A: FloatArray) -> Sparse:
    """Return the non-zeros of a matrix by row: where each row starts, their columns, their values."""
    m, n = A.shape
    start = np.zeros(m + 1, dtype=np.int64)
    column = np.empty(m * n, dtype=np.int64)
    value = np.empty(m * n)
    count = 0
    for i in range(m):
        for j in range(n):
            if A[i, j] != 0.0:
                column[count] = j
                value[count] = A[i, j]
                count += 1
        start[i + 1] = count
    return start, column[:count], value[:count]


@njit(cache=True, nogil=True)
def left(A: Sparse, B: FloatArray) -> FloatArray:
    """Return ``A @ B`` for a matrix `A` that is given by its non-zeros."""
    start, column, value = A
    m = len(start) - 1
    out = np.zeros((m, B.shape[1]))
    for i in range(m):
        row = out[i]
        for s in range(start[i], start[i + 1]):
            v, other = value[s], B[column[s]]
            for k in range(len(row)):
                row[k] += v * other[k]
    return out


@njit(cache=True, nogil=True)
def folded(A: Sparse, B: FloatArray) -> FloatArray:
    """Return ``B A^T``, exactly symmetric, for a product `B` that makes it so."""
    out = left(A, B.T.copy())
    for i in range(out.shape[0]):
        for k in range(i):
            out[k, i] = out[i, k]
    return out


@njit(cache=True, nogil=True)
def sandwich(A: FloatArray, P: FloatArray) -> FloatArray:
    """Return ``A P A^T``, exactly symmetric, for a mostly-zero `A` and a symmetric `P`."""
    parts = nonzeros(A)
    return folded(parts, left(parts, P))
