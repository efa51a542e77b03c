"""The values that flow from a sensor to a verdict.

Everything here is immutable: frozen dataclasses whose arrays are made read-only when they are built. SI units
and radians throughout; time is int nanoseconds of GPS time (``t_ns``), counted from the GPS epoch 1980-01-06.

Symbols (the same everywhere): ``x'`` prior state, ``x`` posterior, ``P'``/``P`` their covariances, ``F``
transition from the previous posterior to this prior (rectangular: states are born and die), ``Q`` process
noise, ``H`` Jacobian of the rows, ``R`` their covariance, ``nu = z - h(x')`` the innovation, ``S = H P' H^T +
R`` its covariance, ``K`` the gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import cholesky, correct_covariance, gain, whiten
from pntegrity.kernels.sparse import sandwich
from pntegrity.kernels.tails import deviation_of, joint_square
from pntegrity.observations import Epoch, Inertial, Observation
from pntegrity.states import FloatArray, Layout, Prior, State, freeze, frozen, group_of
from pntegrity.verdicts import Bound, Screening, Status, Suspect, Verdict, join_reasons

__all__ = [
    "Bound", "Epoch", "FloatArray", "Inertial", "Layout", "Observation", "Prior", "Screening", "State",
    "Status", "Suspect", "Update", "Verdict", "group_of", "join_reasons",
]  # fmt: skip


#: What an `Update` keeps beside its fields, as long as it is in use.
GAINS = ("S", "L", "K", "absorbed")


@dataclass(frozen=True, eq=False)
class Update:
    """One epoch of any linear(ised) filter: all that a monitor may see.

    Parameters
    ----------
    t_ns : int
        Time, ns of GPS time.
    keys : tuple of str, length m
        Names of the rows that were used.
    nu : ndarray, shape (m,)
        Innovation ``z - h(x')``.
    H, R : ndarray, shapes (m, n) and (m, m)
        Jacobian and covariance of the rows.
    F, Q : ndarray, shapes (n, n_previous) and (n, n)
        The step from the previous posterior to `prior`.
    prior, posterior : State
        Before and after the rows were used.
    excluded : tuple of str
        Groups whose rows were left out.
    consumed : int
        States initialised from this epoch's data.
    switched : tuple of str
        Groups that this epoch's prior, and all before it, never knew: the filter goes on from the subfilter
        without them, and `F` leads from that one's posterior.
    R_accuracy : ndarray, shape (m, m), optional
        Covariance that the rows' errors are believed to have, where `R` bounds it from above.
    events : tuple of str
        What happened, in words.
    reason : str
        Why there are no rows, where there are none.
    spare_keys, spare_nu, spare_var, spare_cov
        Rows that were left out: names, residuals against `posterior`, their variances, and with each other
        their covariance, shape (k, k); None where only variances are known.
    aux : mapping of str to ndarray
        Elevation, azimuth (rad) and C/N0 a row: for reports, and for faults that come from one direction.
    screening : Screening, optional
        What the estimator's own fault detection did with the rows before it used them.
    """

    t_ns: int
    keys: tuple[str, ...]
    nu: FloatArray
    H: FloatArray
    R: FloatArray
    F: FloatArray
    Q: FloatArray
    prior: State
    posterior: State
    excluded: tuple[str, ...] = ()
    consumed: int = 0
    events: tuple[str, ...] = ()
    reason: str = ""
    spare_keys: tuple[str, ...] = ()
    spare_nu: FloatArray = field(default_factory=lambda: np.zeros(0))
    spare_var: FloatArray = field(default_factory=lambda: np.zeros(0))
    spare_cov: FloatArray | None = None
    switched: tuple[str, ...] = ()
    R_accuracy: FloatArray | None = None
    aux: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    screening: Screening | None = None

    def __post_init__(self) -> None:
        freeze(self, "nu", "H", "R", "F", "Q", "spare_nu", "spare_var")
        for name in ("R_accuracy", "spare_cov"):
            if getattr(self, name) is not None:
                freeze(self, name)

    @staticmethod
    def of(
        prior: Prior,
        keys: tuple[str, ...],
        nu: npt.ArrayLike,
        H: npt.ArrayLike,
        R: npt.ArrayLike,
        **facts: Any,
    ) -> Update:
        """Use rows on a prior: the measurement update of a Kalman filter.

        Parameters
        ----------
        prior : Prior
            The predicted state and the step that made it.
        keys, nu, H, R
            The rows; see `Update`.
        **facts
            Further fields of `Update`: `excluded`, `reason`, `aux`.

        Raises
        ------
        numpy.linalg.LinAlgError
            Where the innovation covariance is not positive definite.
        """
        nu, H, R = frozen(nu), frozen(H), frozen(R)
        P = prior.state.P
        S = sandwich(H, P) + R
        L = cholesky(S)
        K = gain(P, H, L)
        after = correct_covariance(P, H, R, K) if len(keys) else P
        posterior = replace(prior.state, mean=prior.state.mean + K @ nu, P=after)
        update = Update(
            prior.state.t_ns, keys, nu, H, R, prior.F, prior.Q, prior.state, posterior,
            consumed=prior.consumed, events=prior.events, **facts,
        )  # fmt: skip
        update.__dict__.update(S=frozen(S), L=frozen(L), K=frozen(K))
        return update

    @staticmethod
    def from_filter(
        t_ns: int,
        *,
        F: npt.ArrayLike,
        Q: npt.ArrayLike,
        H: npt.ArrayLike,
        R: npt.ArrayLike,
        P_prior: npt.ArrayLike,
        nu: npt.ArrayLike,
        keys: tuple[str, ...] = (),
        states: tuple[str, ...] = (),
    ) -> Update:
        """Wrap one epoch of a filter that you already have, for any monitor.

        Parameters
        ----------
        t_ns : int
            Time in nanoseconds; only differences matter.
        F, Q : array_like, shapes (n, n) and (n, n)
            Transition and process noise of the step into this epoch.
        H, R : array_like, shapes (m, n) and (m, m)
            Jacobian and covariance of the measurements.
        P_prior : array_like, shape (n, n)
            Covariance before the measurements were used.
        nu : array_like, shape (m,)
            Innovation, measured minus predicted.
        keys : tuple of str, optional
            Names of the rows, ``"<what fails together>:<signal>"``; ``"z0:L"``, ``"z1:L"``, ... where not
            given.
        states : tuple of str, optional
            Names of the states; ``"pos:0"``, ``"pos:1"``, ... where not given.

        Raises
        ------
        ValueError
            Where shapes do not fit, with the shapes.
        """
        nu_, P, F_, Q_ = (np.asarray(a, dtype=np.float64) for a in (nu, P_prior, F, Q))
        nu_, H_, R_ = nu_.reshape(-1), *(np.atleast_2d(np.asarray(a, dtype=np.float64)) for a in (H, R))
        m, n = len(nu_), len(P)
        if H_.shape != (m, n) or R_.shape != (m, m):
            raise ValueError(f"`H` {H_.shape} and `R` {R_.shape} do not fit {m} rows and {n} states")
        if F_.ndim != 2 or len(F_) != n or Q_.shape != (n, n):
            raise ValueError(f"`F` {F_.shape} and `Q` {Q_.shape} do not fit {n} states")
        if keys and len(set(keys)) != m:
            raise ValueError(f"`keys` must be {m} different names, one a row, not {keys}")
        names = Layout(states or tuple(f"pos:{i}" for i in range(n)))
        state = State(t_ns, np.zeros(n), P, names)
        return Update.of(Prior(state, F_, Q_), keys or tuple(f"z{i}:L" for i in range(m)), nu_, H_, R_)

    @cached_property
    def S(self) -> FloatArray:
        """Innovation covariance, shape (m, m)."""
        return frozen(sandwich(self.H, self.prior.P) + self.R)

    @cached_property
    def L(self) -> FloatArray:
        """Lower Cholesky factor of `S`."""
        return frozen(cholesky(self.S))

    @cached_property
    def K(self) -> FloatArray:
        """Gain ``P' H^T S^-1``, shape (n, m)."""
        return frozen(gain(self.prior.P, self.H, self.L))

    @cached_property
    def absorbed(self) -> FloatArray:
        """What the rows took from the covariance, ``P' - P = K S K^T``: the covariance of ``K nu``."""
        return frozen(self.prior.P - self.posterior.P)

    @cached_property
    def white(self) -> FloatArray:
        """Whitened innovation ``L^-1 nu``: independent unit normals under the null hypothesis, shape (m,)."""
        return frozen(whiten(self.L, self.nu))

    @property
    def is_start(self) -> bool:
        """Whether nothing was inherited from an earlier epoch (a filter's start, any snapshot)."""
        return not self.F.any()

    def altered(self, **changes: Any) -> Update:
        """Return the update with other fields and the same gains: not for `H`, `R`, `prior` or
        `posterior`.
        """
        out = replace(self, **changes)
        out.__dict__.update({n: self.__dict__[n] for n in GAINS if n in self.__dict__})
        return out

    def release(self) -> None:
        """Forget what can be computed again; a long run keeps all its updates."""
        for name in ("white", *GAINS):
            self.__dict__.pop(name, None)

    def with_spares(
        self, keys: tuple[str, ...], nu: FloatArray, H: FloatArray, R: FloatArray,
        names: tuple[str, ...] | None = None, cross: FloatArray | None = None,
    ) -> Update:  # fmt: skip
        """Return the update with rows left out: residuals against the posterior, and their covariance.

        With errors that rows left out share with used ones (a clock that is no state) these are residuals
        against all that the used rows tell, ``nu_o - S_oc S^-1 nu``.

        Parameters
        ----------
        keys : tuple of str
        nu, H : ndarray, shapes (k,) and (k, n)
            Innovations against the prior and Jacobian of the rows left out.
        R : ndarray, shape (k,) or (k, k)
            Measurement variances, or covariance.
        names : tuple of str, optional
            Who is left out; the groups of the rows, where that is not told.
        cross : ndarray, shape (k, m), optional
            Covariance of their errors with those of the used rows; none where it is not told.
        """
        known = H @ (self.posterior.mean - self.prior.mean)
        spread = sandwich(H, self.posterior.P) + (np.diag(R) if R.ndim == 1 else R)
        if cross is not None and cross.any():
            told = whiten(self.L, self.H @ self.prior.P @ H.T + cross.T)
            known, spread = told.T @ self.white, sandwich(H, self.prior.P) + R - told.T @ told
        out = tuple(dict.fromkeys(map(group_of, keys))) if names is None else names
        return self.altered(
            spare_keys=keys, spare_nu=nu - known, spare_var=np.diagonal(spread), spare_cov=spread,
            excluded=out,
        )  # fmt: skip

    def misfit(self, rows: npt.NDArray[np.intp]) -> float:
        """Return how far rows left out are off, together or the worst of them alone, in standard deviations
        of a normal as improbable.

        Parameters
        ----------
        rows : ndarray of int
            Which of `spare_keys`.
        """
        alone = float(np.max(np.abs(self.spare_nu[rows]) / np.sqrt(self.spare_var[rows]), initial=0.0))
        return max(alone, deviation_of(self.misfit_square(rows), len(rows)))

    def misfit_square(self, rows: npt.NDArray[np.intp], expected: FloatArray | float = 0.0) -> float:
        """Return the sum of squares of residuals of rows left out, less what was expected, whitened
        together.
        """
        cov = np.diag(self.spare_var) if self.spare_cov is None else self.spare_cov
        return joint_square(np.asarray(self.spare_nu[rows] - expected), cov[np.ix_(rows, rows)])

    def groups(self) -> dict[str, npt.NDArray[np.intp]]:
        """Return the rows of each group, in order of first appearance."""
        rows: dict[str, list[int]] = {}
        for i, key in enumerate(self.keys):
            rows.setdefault(group_of(key), []).append(i)
        return {g: np.array(i, dtype=np.intp) for g, i in rows.items()}
