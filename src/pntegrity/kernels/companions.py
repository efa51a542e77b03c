"""What goes beside a bank of subfilters where errors are not what its gains are made of: covariances.

With the gain ``K_i`` of a member and ``A_i = I - K_i H``, the errors of the filter and a member have the
joint covariance ``A_0 (F C F^T + Q) A_i^T + K_0 R_a K_i^T``, where ``R_a`` is that of the rows' errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.separation import Subfilters, gains, predicted

FloatArray = npt.NDArray[np.float64]

__all__ = ["Companions", "accompany"]


@dataclass(frozen=True, eq=False)
class Companions:
    """Beside the members of a bank; shapes: M members, n states.

    Parameters
    ----------
    own, shared : ndarray, shape (M, n, n)
        Covariance of each member's error, and with that of member 0.
    """

    own: FloatArray
    shared: FloatArray

    def take(self, source: npt.NDArray[np.intp], origin: int = 0) -> Companions:
        """Return them for members in another order or several times; where another member becomes member 0,
        what its error shares with the others' is taken for its own covariance, as under one model.
        """
        own = self.own[source]
        shared = self.shared[source] if origin == 0 else np.broadcast_to(self.own[origin], own.shape)
        return Companions(own, shared)

    def separation(self) -> FloatArray:
        """Return the covariance of each member's separation from member 0, shape (M, n, n)."""
        return np.asarray(self.own + self.own[:1] - self.shared - np.swapaxes(self.shared, 1, 2))

    @staticmethod
    def begin(bank: Subfilters) -> Companions:
        """Return those of a bank about which nothing else is known than its covariances."""
        return Companions(bank.P, np.broadcast_to(bank.P[:1], bank.P.shape))


def accompany(
    beside: Companions | None, bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray,
    actual: FloatArray | None, used: npt.NDArray[np.bool_],
) -> Companions:  # fmt: skip
    """Return what goes beside the members of a bank after an epoch.

    Parameters
    ----------
    beside : Companions or None
        None: it begins.
    bank : Subfilters
        Before the epoch.
    F, Q, H, R : ndarray
        As for `separation.advance`.
    actual : ndarray, shape (m, m), optional
        Covariance of the rows' errors where it is not `R`.
    used : ndarray of bool, shape (M, m)
        Rows of each member.
    """
    beside = beside or Companions.begin(bank)
    K = gains(predicted(bank.P, F, Q), H, R, used)
    A = np.eye(len(Q)) - K @ H
    noise = R if actual is None else actual
    after, back = np.swapaxes(A, 1, 2), np.swapaxes(K, 1, 2)
    return Companions(
        A @ predicted(beside.own, F, Q) @ after + K @ noise @ back,
        A[0] @ predicted(beside.shared, F, Q) @ after + K[0] @ noise @ back,
    )
