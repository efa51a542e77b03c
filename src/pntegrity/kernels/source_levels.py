"""Protection levels of several sources: as published, from one epoch and a shared prior, and from a bank.

As published, with the square root of the threshold, the level of a combination without some sources is
``K_md sigma_c + l sqrt(T)``. The largest slope ``l`` of a fault of those sources is the standard deviation of
the separation of the two solutions over one epoch: their prior is shared, and what the fault has done to it
is not in the level. A bank of filters that never used the sources has it in.

References
----------
Chen and Zhao (2023), eqs (28)-(31).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.protection import false_alert_factor, protection_level
from pntegrity.kernels.tails import chi2_threshold

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

__all__ = ["bank_level", "published_level", "slope"]


def slope(K: FloatArray, S: FloatArray, rows: IntArray) -> float:
    """Return the largest error of a state per root of non-centrality that a fault of some rows can make.

    Parameters
    ----------
    K : ndarray, shape (m,)
        Gain of the state (or of a direction of the position).
    S : ndarray, shape (m, m)
        Innovation covariance; its inverse is the parity matrix of rows and prior.
    rows : ndarray of int

    References
    ----------
    Eq. (29).
    """
    weight = np.linalg.inv(S)[np.ix_(rows, rows)]
    return float(np.sqrt(K[rows] @ np.linalg.solve(weight, K[rows])))


def published_level(
    risk: float, sigma0: float, p: npt.ArrayLike, sigma: npt.ArrayLike, slopes: Sequence[float],
    dof: Sequence[int], p_fa: float,
) -> float:  # fmt: skip
    """Return the root of (31) in one direction, m.

    Parameters
    ----------
    risk : float
        For this direction.
    sigma0 : float
        Of the solution of all sources.
    p, sigma, slopes : sequence of float
        Of each combination: its probability, the standard deviation of its solution and its `slope`.
    dof : sequence of int
        Rows that each combination leaves out.
    p_fa : float
        Of each test.
    """
    reach = [own * np.sqrt(chi2_threshold(p_fa, n)) for own, n in zip(slopes, dof, strict=True)]
    return protection_level(risk, sigma0, 0.0, p, sigma, np.zeros(len(reach)), reach)


def bank_level(risk: float, sigma0: float, p: npt.ArrayLike, sigma: npt.ArrayLike, p_fa: float) -> float:
    """Return the separation level in one direction, m, for filters that have never used the sources.

    Parameters
    ----------
    risk, sigma0, p, sigma
        As in `published_level`.
    p_fa : float
        Of all tests of this direction together.
    """
    spread = np.sqrt(np.maximum(np.asarray(sigma) ** 2 - sigma0**2, 0.0))
    allowed = false_alert_factor(p_fa, len(spread)) * spread
    return protection_level(risk, sigma0, 0.0, p, sigma, np.zeros(len(spread)), allowed)
