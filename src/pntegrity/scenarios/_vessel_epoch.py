"""Figure 13 of the multi-level paper: one epoch, one prior, tests of left-out rows and of separations."""

from __future__ import annotations

import numpy as np
from scipy import special

from pntegrity.kernels.source_test import left_out, separated
from pntegrity.kernels.tails import chi2_threshold, max_threshold, noncentral_tail
from pntegrity.kernels.windows import inverse_root
from pntegrity.records import FloatArray
from pntegrity.scenarios._vessel_runs import Study
from pntegrity.states import group_of

__all__ = ["as_fixes", "first_epoch_power"]


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


def _square(value: float, dof: int, p_fa: float) -> float:
    return float(noncentral_tail(chi2_threshold(p_fa, dof), dof, value))
