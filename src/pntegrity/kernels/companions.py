"""What goes beside a bank of subfilters where errors are not what its gains are made of.

Two things: nominal biases of rows, which the gains do not know, and a covariance of the rows' errors that
differs from the one behind the gains. With the gain ``K_i`` of a member and ``A_i = I - K_i H`` both are
linear: a bias ``b`` moves the error by ``A_i F e + K_i b``, and the errors of the filter and a member have
the joint covariance ``A_0 (F C F^T + Q) A_i^T + K_0 R_a K_i^T``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.separation import Subfilters, gains, predicted

FloatArray = npt.NDArray[np.float64]

__all__ = ["Companions", "accompany"]


@dataclass(frozen=True, eq=False)
class Companions:
    """Beside the members of a bank; shapes: M members, n states, c biased rows.

    Parameters
    ----------
    keys : tuple of str
        Rows that have or had a nominal bias.
    bias : ndarray, shape (M, n, c)
        Error that each of these biases made.
    own, shared : ndarray, shape (M, n, n)
        Covariance of each member's error, and with that of member 0.
    """

    keys: tuple[str, ...]
    bias: FloatArray
    own: FloatArray
    shared: FloatArray

    def take(self, source: npt.NDArray[np.intp], origin: int = 0) -> Companions:
        """Return them for members in another order or several times; where another member becomes member 0,
        what its error shares with the others' is taken for its own covariance, as under one model.
        """
        own = self.own[source]
        shared = self.shared[source] if origin == 0 else np.broadcast_to(self.own[origin], own.shape)
        return Companions(self.keys, self.bias[source], own, shared)

    def separation(self) -> FloatArray:
        """Return the covariance of each member's separation from member 0, shape (M, n, n)."""
        return np.asarray(self.own + self.own[:1] - self.shared - np.swapaxes(self.shared, 1, 2))

    @staticmethod
    def begin(bank: Subfilters) -> Companions:
        """Return those of a bank about which nothing else is known than its covariances."""
        shared = np.broadcast_to(bank.P[:1], bank.P.shape)
        return Companions((), np.zeros((*bank.P.shape[:2], 0)), bank.P, shared)


def accompany(
    beside: Companions | None, bank: Subfilters, F: FloatArray, Q: FloatArray, H: FloatArray, R: FloatArray,
    actual: FloatArray | None, nominal: FloatArray, keys: Sequence[str], used: npt.NDArray[np.bool_],
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
    nominal : ndarray, shape (m,)
        Largest bias of each row without a fault.
    keys : sequence of str
    used : ndarray of bool, shape (M, m)
        Rows of each member.
    """
    biased = [k for k, b in zip(keys, nominal, strict=True) if b]
    beside = _with_columns(beside or Companions.begin(bank), biased)
    K = gains(predicted(bank.P, F, Q), H, R, used)
    A = np.eye(len(Q)) - K @ H
    at = [beside.keys.index(k) if k in beside.keys else -1 for k in keys]
    unit = np.zeros((len(keys), len(beside.keys)))
    for row, column in enumerate(at):
        if column >= 0:
            unit[row, column] = nominal[row]
    noise = R if actual is None else actual
    return Companions(
        beside.keys,
        A @ (F @ beside.bias) + K @ unit,
        A @ predicted(beside.own, F, Q) @ np.swapaxes(A, 1, 2) + K @ noise @ np.swapaxes(K, 1, 2),
        A[0] @ predicted(beside.shared, F, Q) @ np.swapaxes(A, 1, 2) + K[0] @ noise @ np.swapaxes(K, 1, 2),
    )


def _with_columns(beside: Companions, keys: list[str]) -> Companions:
    """Return it with columns for rows that have a bias for the first time."""
    new = tuple(k for k in keys if k not in beside.keys)
    more = np.zeros((*beside.bias.shape[:2], len(new)))
    return Companions(
        beside.keys + new, np.concatenate([beside.bias, more], axis=2), beside.own, beside.shared
    )
