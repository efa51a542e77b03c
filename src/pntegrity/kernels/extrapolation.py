"""The windowed vectors of AIME and SRAIME, carried forward one epoch at a time.

The window is a run of updates after an anchor posterior. The state propagator leaves the anchor without
measurements; ``s_i`` is how far the filter's prior has moved from it: ``s_1 = 0``, ``s_{i+1} = F_{i+1} d_i``
with ``d_i = s_i + K_i nu_i``. AIME looks at ``e_i = nu_i + H_i s_i``, SRAIME at ``e_i = T d_i``. Both papers
form an average weighted by inverse covariances; any invertible change of the average leaves the statistic
alone, so the weighted sum ``eta = sum_i W_i e_i`` is used. With ``C_i = cov(s_i)``, ``X_i = cov(s_i,
eta_{i-1})`` and ``A = H`` or ``T``, white innovations give its exact covariance without a map::

    V_i = V_{i-1} + W_i + W_i A X_i + (W_i A X_i)^T,  cov(d_i, eta_i) = X_i + cov(d_i, e_i) W_i

A state that was initialised from an epoch's own data has an unknown error that innovations do not show. The
weights leave out its directions ``Z = A B`` (`B`: what such errors make of the propagator): ``W Z = 0``, so
that neither `eta` nor its rank knows of it, whatever the filter says its prior variance is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.sparse import left, nonzeros
from pntegrity.kernels.weighing import Carried, Given, step_rows, step_states
from pntegrity.kernels.windows import pivoted_root, pseudo_inverses

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Step(Protocol):
    """What the kernels read of an update."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the rows."""
        ...

    @property
    def nu(self) -> FloatArray:
        """Innovation."""
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

    @property
    def consumed(self) -> int:
        """States initialised from this epoch's data."""
        ...

    @property
    def prior(self) -> Any:
        """Belief before the rows: its covariance `P`."""
        ...

    @property
    def posterior(self) -> Any:
        """Belief after the rows."""
        ...


@dataclass(frozen=True, eq=False)
class Passage:
    """What is carried of one window: m rows of `eta`, n states, b unknown directions.

    Parameters
    ----------
    onset : int
        Counter of the window's first update.
    length : int
        Updates so far.
    names : tuple of str, length m
        What `eta` is about: keys of rows, or names of states.
    carried : tuple of ndarray
        ``cov(d)`` (n, n); ``cov(d, eta)`` (n, m); ``cov(eta)`` (m, m); the sum of the weights (m, m); roots
        of the weights' diagonal before the unknown was left out (m,), the measure of what is no variance;
        ``B`` (n, b); and the data's part, ``d`` (n,) and ``eta`` (m,).
    """

    onset: int
    length: int
    names: tuple[str, ...]
    carried: Carried

    @property
    def cov(self) -> FloatArray:
        """``V = cov(eta)``."""
        return self.carried[2]

    @property
    def weight(self) -> FloatArray:
        """Sum of the weights: its inverse is the published covariance of the average."""
        return self.carried[3]

    @property
    def eta(self) -> FloatArray:
        """The data's part."""
        return self.carried[7]

    def root(self) -> FloatArray:
        """Return a root of the exact inverse covariance of `eta`, shape (rank, m)."""
        return pivoted_root(self.cov, self.carried[4])


def given(u: Step, blind: bool = True) -> Given:
    """Return what all windows need of an update, made once.

    Not `blind`: as if no state were initialised from its data.
    """
    H = nonzeros(u.H)
    born = initialised(u) if blind else np.zeros(0, dtype=np.int64)
    HP = left(H, u.prior.P)
    S, nu, absorbed = read_only(u.S), read_only(u.nu), read_only(u.absorbed)
    return nonzeros(u.F), H, HP, S, nu, absorbed, u.K @ u.nu, born


def read_only(a: FloatArray) -> FloatArray:
    """Return a read-only view, so that one compiled kernel serves arrays before and after they were
    pickled.
    """
    out = a.view()
    out.flags.writeable = False
    return out


def initialised(u: Step) -> IntArray:
    """Return which states were initialised from the update's own data.

    An update only counts them: they are those of the states that inherit nothing which the data determined
    best, measured by how much their variance fell.
    """
    if not u.consumed:
        return np.zeros(0, dtype=np.int64)
    fresh = np.flatnonzero(~u.F.any(axis=1))
    before, after = np.diagonal(u.prior.P)[fresh], np.diagonal(u.posterior.P)[fresh]
    left_over = after / np.where(before > 0.0, before, 1.0)
    return np.asarray(np.sort(fresh[np.argsort(left_over, kind="stable")[: u.consumed]]), dtype=np.int64)


def new_passage(onset: int, names: tuple[str, ...] = ()) -> Passage:
    """Return a window without updates."""
    m = len(names)
    none, square, zero = np.zeros((0, 0)), np.zeros((m, m)), np.zeros(m)
    carried = (none, np.zeros((0, m)), square, square, zero, none, np.zeros(0), zero)
    return Passage(onset, 0, names, carried)


def look_at_rows(passage: Passage, keys: tuple[str, ...], given: Given) -> tuple[Passage, FloatArray]:
    """Return AIME's window with one more update, whose rows are `keys`, and the update's weight.

    `eta` is about the union of the window's keys, so satellites may rise and set inside it.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (27)-(32); Diesel and King (1995).
    """
    names = union(passage.names, keys)
    carried, W = step_rows(passage.carried, given, places(keys, names), len(names))
    return Passage(passage.onset, passage.length + 1, names, carried), W


def look_at_states(passage: Passage, block: IntArray, given: Given) -> tuple[Passage, FloatArray]:
    """Return SRAIME's window with one more update, and the update's weight.

    Parameters
    ----------
    passage : Passage
        Its names are those of the states.
    block : ndarray of int
        Where these states stand in the update's layout.
    given : tuple
        The update.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (37)-(41).
    """
    carried, W, regular = step_states(passage.carried, given, block, np.zeros((0, 0)))
    if not regular:
        carried, W, _ = step_states(passage.carried, given, block, pseudo_inverses(W[None])[0])
    return Passage(passage.onset, passage.length + 1, passage.names, carried), W


def union(names: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    """Return `names` with those of `more` appended that are not among them."""
    if names is more or names == more:
        return names
    return tuple(dict.fromkeys((*names, *more)))


@lru_cache(maxsize=1024)
def places(names: tuple[str, ...], among: tuple[str, ...]) -> IntArray:
    """Return where `names` stand."""
    index = {k: i for i, k in enumerate(among)}
    at = np.array([index[k] for k in names], dtype=np.int64)
    at.flags.writeable = False
    return at


def maps(
    window: Sequence[Step], weights: Sequence[FloatArray], at: Sequence[IntArray], m: int, states: bool
) -> tuple[FloatArray, ...]:
    """Return the maps ``M_j`` of ``eta = sum_j M_j n_j``, by one backward (adjoint) pass.

    Parameters
    ----------
    window : sequence of updates
    weights : sequence of ndarray
        As the window was carried forward.
    at : sequence
        Where each weight's rows stand in `eta` (AIME), or where the states stand in each layout (SRAIME).
    m : int
        Rows of `eta`.
    states : bool
        True: SRAIME.
    """
    out: list[FloatArray] = []
    Y = np.zeros((m, window[-1].K.shape[0]))
    for i in range(len(window) - 1, -1, -1):
        u, W, r = window[i], weights[i], at[i]
        if states:
            Y[:, r] += W
        A = Y @ u.K
        if not states:
            A[r] += W
            Y[r] += W @ u.H
        out.append(A @ u.L)
        if i:
            Y = Y @ u.F
    return tuple(reversed(out))
