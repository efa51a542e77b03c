"""Figure 13 of the multi-level paper: tests of left-out rows and of separations for one epoch and one prior.

Beside them are those that gather: filters that have not used a row for some time, and a window's likelihood
ratio.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.kernels.linear import cholesky, correct_covariance, gain, predict_covariance
from pntegrity.kernels.source_test import left_out, responses, separated
from pntegrity.kernels.tails import chi2_threshold, max_threshold, noncentral_tail
from pntegrity.kernels.windows import inverse_root, respond
from pntegrity.records import FloatArray
from pntegrity.scenarios._vessel_runs import Study
from pntegrity.states import group_of

__all__ = ["EPOCHS", "as_fixes", "first_epoch_power", "later_power"]

IntArray = npt.NDArray[np.intp]
#: Epochs of a fault after which its power is told.
EPOCHS = (1, 5, 20)
#: Filters that do without a row have done so for as many epochs when the fault begins.
EARLIER = 20


def as_fixes(
    H: FloatArray, R: FloatArray, nu: FloatArray, groups: list[str]
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return the rows of each source reduced to what its own least squares can say, of unit variance: the
    form in which the paper fuses (positions of each source).

    Returns
    -------
    H, nu : ndarray, shapes (k, n) and (k,)
    groups : list of str
        The source of each row.
    """
    parts, values, names = [], [], []
    for source in dict.fromkeys(groups):
        own = np.array([g == source for g in groups])
        W = np.linalg.inv(R[np.ix_(own, own)])
        N = H[own].T @ W @ H[own]
        e, V = np.linalg.eigh(N)
        keep = e > 1e-10 * e[-1]
        root = np.sqrt(e[keep])
        parts.append(root[:, None] * V[:, keep].T)
        values.append(V[:, keep].T @ (H[own].T @ (W @ nu[own])) / root)
        names += [source] * int(keep.sum())
    return np.concatenate(parts), np.concatenate(values), names


def first_epoch_power(study: Study, at_s: float, size_m: float, p_fa: float) -> dict[str, float]:
    """Return the probability that each test sees a bias of one satellite at its first epoch, the mean over
    the satellites.
    """
    k = int(np.searchsorted(study.t_s, at_s))
    u = study.updates[k]
    names = [group_of(key) for key in u.keys]
    found: dict[str, list[float]] = {}
    for row in [i for i, name in enumerate(names) if name == "gnss"]:
        f = np.zeros(len(names))
        f[row] = size_m
        for test, power in _powers(study, k, f, names, p_fa).items():
            found.setdefault(test, []).append(power)
    return {test: float(np.mean(powers)) for test, powers in found.items()}


def _powers(study: Study, k: int, f: FloatArray, names: list[str], p_fa: float) -> dict[str, float]:
    u, out = study.updates[k], np.array([i for i, name in enumerate(names) if name == "gnss"])
    rows = left_out(f, u.S, out)
    H, nu, groups = as_fixes(u.H, u.R, f, names)
    fix = np.array([i for i, name in enumerate(groups) if name == "gnss"])
    unit = np.eye(len(nu))
    reduced = left_out(nu, H @ u.prior.P @ H.T + unit, fix)
    apart, cov = separated(nu, H, unit, u.prior.P, fix)
    whole = inverse_root(cov) @ apart
    sigma = np.sqrt(np.diagonal(cov)[:3])
    limit = float(-special.ndtri(0.5 * p_fa / 3.0))
    axes = special.ndtr(np.abs(apart[:3]) / sigma - limit)
    largest = max_threshold(np.zeros(2 * len(f)), p_fa)
    best = float(np.max(np.abs(np.linalg.solve(u.S, f)) / np.sqrt(np.diagonal(np.linalg.inv(u.S)))))
    return {
        "left-out rows": _square(rows.square, len(rows.residual), p_fa),
        "left-out fix": _square(reduced.square, len(fix), p_fa),
        "full separation": _square(float(whole @ whole), len(whole), p_fa),
        "separation by axes": float(1.0 - np.prod(1.0 - axes)),
        "largest of all rows (GLR)": float(special.ndtr(best - largest)),
    }


def later_power(study: Study, at_s: float, size_m: float, p_fa: float) -> dict[str, list[float]]:
    """Return the probability that each test sees a bias of one satellite in its epochs `EPOCHS`, the mean
    over the satellites.

    Left-out rows use the prior that the fault has reached. Recursive separations compare positions with a
    filter that has not used some rows since before: those of all satellites, or of one, each of which has
    `p_fa` over their number. The likelihood ratio is of a bias of any row since any epoch of the fault's
    time; its power is that of the true one.
    """
    first = int(np.searchsorted(study.t_s, at_s))
    sats = np.array([i for i, key in enumerate(study.model.keys) if group_of(key) == "gnss"])
    f = np.zeros((len(study.model.keys), len(sats)))
    f[sats, np.arange(len(sats))] = size_m
    wanted = [first + n - 1 for n in EPOCHS]
    source = _position_without(study, sats, first - EARLIER, wanted)
    single = [_position_without(study, sats[[s]], first - EARLIER, wanted) for s in range(len(sats))]
    E = np.zeros((len(study.model.layout), len(sats)))
    out: dict[str, list[float]] = {name: [] for name in _LATER}
    for k in range(first, wanted[-1] + 1):
        u = study.updates[k]
        g, E = respond(E, u.F, u.H, u.K, f)
        if k not in wanted:
            continue
        P0, each = u.posterior.P[:3, :3], range(len(sats))
        rows = [left_out(g[:, s], u.S, sats).square for s in each]
        powers = (
            [_square(value, len(sats), p_fa) for value in rows],
            [_separation(E[:3, s], source[k] - P0, p_fa) for s in each],
            [_separation(E[:3, s], single[s][k] - P0, p_fa / len(sats)) for s in each],
            _largest(study, first, k, sats, size_m, p_fa),
        )
        for name, values in zip(_LATER, powers, strict=True):
            out[name].append(float(np.mean(values)))
    return out


_LATER = ("left-out rows", "recursive separation of GNSS", "recursive separation of each", "window's GLR")


def _position_without(study: Study, out: IntArray, first: int, wanted: list[int]) -> dict[int, FloatArray]:
    """Return position covariances of a filter that does not use some rows from an epoch on."""
    P, found, model = study.updates[first - 1].posterior.P, {}, study.model
    rest = np.setdiff1d(np.arange(len(model.keys)), out)
    for k in range(first, wanted[-1] + 1):
        H, R = model.at("H", k)[rest], model.at("R", k)[np.ix_(rest, rest)]
        P = predict_covariance(model.at("F", k), P, model.at("Q", k))
        P = correct_covariance(P, H, R, gain(P, H, cholesky(H @ P @ H.T + R)))
        if k in wanted:
            found[k] = P[:3, :3]
    return found


def _separation(apart: FloatArray, cov: FloatArray, p_fa: float) -> float:
    whole = inverse_root(cov) @ apart
    return _square(float(whole @ whole), len(whole), p_fa)


def _largest(study: Study, first: int, last: int, sats: IntArray, size: float, p_fa: float) -> list[float]:
    """Return the power against biases of each satellite of the largest of all biases since any epoch."""
    window = study.updates[first : last + 1]
    A, _ = responses([(u.F, u.H, u.L, u.K) for u in window])
    m = len(study.model.keys)
    each = A.reshape(len(A), len(window), m)
    means = np.cumsum(each[:, ::-1], axis=1)[:, ::-1].transpose(0, 2, 1)  # (D, rows, onsets)
    size_of = np.linalg.norm(means, axis=0)
    unit = means / size_of
    near = np.abs(np.einsum("drk,drk->rk", unit[:, :, 1:], unit[:, :, :-1]))
    rho = np.concatenate([np.zeros((m, 1)), np.minimum(near, 1.0)], axis=1)
    limit = max_threshold(rho.ravel(), p_fa)
    return [float(special.ndtr(size * size_of[i, 0] - limit)) for i in sats]


def _square(value: float, dof: int, p_fa: float) -> float:
    return float(noncentral_tail(chi2_threshold(p_fa, dof), dof, value))
