"""Products with matrices that are stored dense and are mostly zero (F, Q and H of navigation filters)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]


@njit(cache=True, nogil=True)
def nonzeros(A: FloatArray) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], FloatArray]:
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
def right(B: FloatArray, A: FloatArray) -> FloatArray:
    """Return ``B @ A`` for a mostly-zero `A`."""
    rows, cols = np.nonzero(A)
    out = np.zeros((B.shape[0], A.shape[1]))
    for i in range(B.shape[0]):
        for k in range(len(rows)):
            out[i, cols[k]] += B[i, rows[k]] * A[rows[k], cols[k]]
    return out


@njit(cache=True, nogil=True)
def sandwich(A: FloatArray, P: FloatArray) -> FloatArray:
    """Return ``A P A^T``, exactly symmetric, for a mostly-zero `A` and a symmetric `P`."""
    m, n = A.shape
    start, column, value = nonzeros(A)
    row = np.empty(n)
    out = np.empty((m, m))
    for i in range(m):
        row[:] = 0.0
        for s in range(start[i], start[i + 1]):
            for k in range(n):
                row[k] += value[s] * P[column[s], k]
        for k in range(i, m):
            total = 0.0
            for s in range(start[k], start[k + 1]):
                total += value[s] * row[column[s]]
            out[i, k] = total
            out[k, i] = total
    return out
