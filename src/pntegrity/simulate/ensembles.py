"""Many runs of a linear model at once, through filters that leave rows out for some of the time.

The truth and the noise of all runs are drawn once; every filter, whatever it leaves out, sees the same runs.
The error of an estimate is ``e = x_hat - x``: ``e'_k = F e_{k-1} - w_k``, ``nu_k = v_k + f_k - H e'_k``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import cholesky, correct_covariance, gain, predict_covariance
from pntegrity.records import FloatArray
from pntegrity.simulate.linear import LinearModel

__all__ = ["Ensemble", "Filtered", "draw_ensemble", "filtered"]

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Noise of many runs.

    Parameters
    ----------
    start : ndarray, shape (n, runs)
        Error of the first prior.
    process : ndarray, shape (epochs, n, runs)
        Process noise of the step into each epoch; zero at the first.
    rows : ndarray, shape (epochs, m, runs)
        Noise of the rows.
    """

    start: FloatArray
    process: FloatArray
    rows: FloatArray


@dataclass(frozen=True, eq=False)
class Filtered:
    """A filter's way through runs.

    Parameters
    ----------
    first : int
        Epoch of the first entry.
    error : ndarray, shape (epochs, n, runs)
        Of the estimate.
    P : ndarray, shape (epochs, n, n)
        Its covariance as the filter believes it.
    nu : ndarray, shape (epochs, m, runs)
        Innovations of all rows, those left out too.
    """

    first: int
    error: FloatArray
    P: FloatArray
    nu: FloatArray

    def prior(self, model: LinearModel, k: int) -> FloatArray:
        """Return the covariance before the rows of an epoch, `first` itself not."""
        return predict_covariance(model.at("F", k), self.P[k - 1 - self.first], model.at("Q", k))


def draw_ensemble(model: LinearModel, epochs: int, runs: int, rng: np.random.Generator) -> Ensemble:
    """Return the noise of some runs."""
    n, m = len(model.layout), len(model.keys)
    start = _root(model.P0) @ rng.standard_normal((n, runs))
    process, rows = np.zeros((epochs, n, runs)), np.empty((epochs, m, runs))
    for k in range(epochs):
        if k:
            process[k] = _root(model.at("Q", k)) @ rng.standard_normal((n, runs))
        rows[k] = cholesky(model.at("R", k)) @ rng.standard_normal((m, runs))
    return Ensemble(start, process, rows)


def _root(cov: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def filtered(
    model: LinearModel, noise: Ensemble, faults: FloatArray, used: BoolArray, *,
    after: Filtered | None = None, first: int = 0, runs: npt.NDArray[np.intp] | None = None,
    last: int | None = None,
) -> Filtered:  # fmt: skip
    """Return the way of a filter through runs.

    Parameters
    ----------
    model : LinearModel
    noise : Ensemble
    faults : ndarray, shape (epochs, m)
        Added to the rows.
    used : ndarray of bool, shape (epochs, m)
        Which rows it uses at each epoch.
    after : Filtered, optional
        The filter of all epochs that it goes on from, at epoch `first`; it begins at the model's start where
        there is none.
    first : int
    runs : ndarray of int, optional
        Those to follow; all where not given.
    last : int, optional
        The first epoch that it does not see any more.
    """
    chosen = np.arange(noise.start.shape[1]) if runs is None else runs
    epochs, n = (len(noise.rows) if last is None else last) - first, len(model.layout)
    error, P = np.empty((epochs, n, len(chosen))), np.empty((epochs, n, n))
    nu = np.empty((epochs, len(model.keys), len(chosen)))
    begins = after is None or first == 0
    e, cov = (noise.start[:, chosen], model.P0) if begins else _state(after, first - 1, chosen)
    for i in range(epochs):
        k = first + i
        if k:
            F = model.at("F", k)
            e, cov = F @ e - noise.process[k][:, chosen], predict_covariance(F, cov, model.at("Q", k))
        H, R, rows = model.at("H", k), model.at("R", k), np.flatnonzero(used[k])
        nu[i] = noise.rows[k][:, chosen] + faults[k][:, None] - H @ e
        Hu, Ru = H[rows], R[np.ix_(rows, rows)]
        K = gain(cov, Hu, cholesky(Hu @ cov @ Hu.T + Ru))
        e, cov = e + K @ nu[i][rows], correct_covariance(cov, Hu, Ru, K)
        error[i], P[i] = e, cov
    return Filtered(first, error, P, nu)


def _state(after: Filtered | None, k: int, runs: npt.NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    assert after is not None
    return after.error[k - after.first][:, runs], after.P[k - after.first]
