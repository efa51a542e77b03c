"""Tight coupling: code and range-rate rows on the inertial prior, tested one by one before they are used."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._errors import error_kinds
from pntegrity.estimators._filter import clock_walk, clocks, mode, next_layout, transition
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_motion import Moved
from pntegrity.estimators._ins_solution import antenna, antenna_of, arm_slopes, inertial_names, with_aside
from pntegrity.estimators._ins_start import found_anew
from pntegrity.estimators._ins_still import standing, zero_velocity
from pntegrity.estimators._layout import columns
from pntegrity.estimators._navigation import MOTION, Stack, stack, use
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.row_tests import leave_out
from pntegrity.kernels.signatures import is_rate
from pntegrity.kernels.snapshot_fix import pdop_of
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import Epoch, FloatArray, Layout, Prior, Screening, State, Update, group_of
from pntegrity.sensors.pseudoranges import Rows, code_rows, rate_rows, system_of

__all__ = ["correct", "predict"]

BoolArray = npt.NDArray[np.bool_]
IndexArray = npt.NDArray[np.intp]
#: Epochs with fewer pseudoranges do not tell whether the position is lost.
LOST_ROWS = 6


@lru_cache(maxsize=512)
def _nav_places(layout: Layout, names: tuple[str, ...]) -> tuple[IndexArray, IndexArray]:
    """Return where the states of the INS stand, in the order of its errors, as rows and as columns."""
    at = columns(layout, (*MOTION, *names))
    return at[:, None], at[None, :]


def predict(state: State, moved: Moved, epoch: Epoch, dt: float, options: GnssOptions) -> Prior:
    """Return the prior after a step of the INS."""
    aside = state.aside.with_(C=moved.C, rate_radps=moved.rate_radps)
    place, _ = antenna_of(moved.position_m, moved.velocity_mps, aside)
    rows = code_rows(epoch, place, options)
    names = inertial_names(options.ins.scale_factors)
    layout = next_layout(state.layout, rows.keys, error_kinds(options.noise), names)
    F, Q = transition(state.layout, layout, dt, options.noise, rows)
    clock_walk(F, Q, dt, options.noise)
    mean = F @ state.mean
    at, n = _nav_places(layout, names), len(MOTION) + len(names)
    F[at], Q[at] = moved.F[:n, :n], moved.Q[:n, :n]
    mean[:3], mean[3:6], mean[layout.block("att")] = moved.position_m, moved.velocity_mps, 0.0
    mean, F, Q, consumed, events = clocks(mean, F, Q, layout, state.layout, rows, mode)
    P = symmetric(sandwich(F, state.P) + Q)
    prior = Prior(State(epoch.t_ns, mean, P, layout, aside), F, Q, consumed, moved.events + events, rows)
    return _found_again(prior, options)


def _found_again(prior: Prior, options: GnssOptions) -> Prior:
    """Return the prior with all that GNSS told born anew, where most codes have been refused so long."""
    since, lost_s = prior.state.aside.refused_since_ns, options.ins.lost_s
    if since is None or (prior.state.t_ns - since) * 1e-9 < lost_s:
        return prior
    return found_anew(
        prior, options.noise, f"re-acquisition: most pseudoranges were refused for {lost_s:.0f} s"
    )


def correct(prior: Prior, epoch: Epoch, options: GnssOptions, exclude: frozenset[str]) -> Update:
    """Use the rows that pass the tests, but for those of the groups in `exclude`."""
    rows = _rows(prior, epoch, options)
    allowed = np.ones(len(rows.keys), dtype=bool)
    if exclude:
        allowed = np.array([group_of(k) not in exclude for k in rows.keys], dtype=bool)
    limit = options.ins.limit_sigma if options.ins.fde == "ours" else np.inf
    used, screening = screened(prior, rows, allowed, limit)
    shown = used | ~allowed  # rows of an excluded group are spare, to prove themselves
    update = use(prior, rows.take(shown), (used & allowed)[shown], screening=screening)
    since = _refused_since(prior, rows.keys, used & allowed, allowed)
    if since == prior.state.aside.refused_since_ns:
        return update
    return with_aside(update, update.posterior.aside.with_(refused_since_ns=since))


def _rows(prior: Prior, epoch: Epoch, options: GnssOptions) -> Stack:
    """Return code and range-rate rows at the antenna, and behind them those of a standstill."""
    code: Rows = prior.context
    rate, noise = rate_rows(epoch, *antenna(prior.state), options), options.noise
    rows = stack(prior, code, rate, noise.code_white_m * code.scale, noise.doppler_mps * rate.scale)
    _write_arm(prior.state, rows.H, len(code.keys))
    return rows.plus(zero_velocity(prior.state)) if standing(epoch.imu, prior.state, options.ins) else rows


def _write_arm(state: State, H: FloatArray, codes: int) -> None:
    """Write into a Jacobian what attitude and the gyroscopes' errors do to the antenna."""
    if not state.aside.arm_m.any():
        return
    block, place, speed = state.layout.block, H[:codes, :3], H[codes:, 3:6]
    slopes = arm_slopes(state.aside)
    H[:codes, block("att")] = place @ slopes[0]
    for kind, slope in zip(("att", "bg", "sg"), slopes[1:], strict=True):
        if len(at := block(kind)):
            H[codes:, at] = speed @ slope


def screened(
    prior: Prior, rows: Stack, allowed: BoolArray, limit_sigma: float
) -> tuple[BoolArray, Screening]:
    """Return which of the rows that are `allowed` to use, and the story of it."""
    at = np.flatnonzero(allowed)
    codes, clocks_ = _codes(rows.keys)
    H = rows.H[at]
    S = sandwich(H, prior.state.P) + np.diag(rows.variance[at])
    passes, first, last = leave_out(rows.nu[at], S, limit_sigma)
    used = allowed.copy()
    used[at[passes > 0]] = False
    dropped = sorted(((rows.keys[at[i]], int(passes[i])) for i in np.flatnonzero(passes)), key=lambda d: d[1])
    both = ((allowed & codes)[: len(clocks_)], (used & codes)[: len(clocks_)])
    los = -rows.H[: len(clocks_), :3]
    none = "no row passes its test" if len(at) else "no satellite above the mask"
    return used, Screening(
        "ours" if np.isfinite(limit_sigma) else "none", first=first, first_limit=limit_sigma, last=last,
        last_limit=limit_sigma, dropped=tuple(dropped), tests=1 + len(dropped),
        satellites=(int(both[0].sum()), int(both[1].sum())),
        pdop=(_pdop(los, clocks_, both[0]), _pdop(los, clocks_, both[1])), used=bool(used.any()),
        reason="" if used.any() else none,
    )  # fmt: skip


@lru_cache(maxsize=512)
def _codes(keys: tuple[str, ...]) -> tuple[BoolArray, FloatArray]:
    """Return which rows are codes (the first ones), and which clock each of these reads."""
    codes = np.array([not is_rate(k) for k in keys], dtype=bool)
    systems = np.array([system_of(k) for k, c in zip(keys, codes, strict=True) if c], dtype="U1")
    return codes, (systems[:, None] == np.unique(systems)).astype(np.float64)


def _pdop(los: FloatArray, clocks_: FloatArray, kept: BoolArray) -> float:
    """Return the dilution of position with a clock a constellation, inf where there is none."""
    if not kept.any():
        return float("inf")
    reads = clocks_[kept]
    return pdop_of(np.hstack([-los[kept], reads[:, reads.any(axis=0)]]))


def _refused_since(prior: Prior, keys: tuple[str, ...], used: BoolArray, allowed: BoolArray) -> int | None:
    """Return since when most codes have been refused; epochs with few tell nothing."""
    codes = _codes(keys)[0] & allowed
    before: int | None = prior.state.aside.refused_since_ns
    if codes.sum() < LOST_ROWS:
        return before
    if 2 * int((codes & used).sum()) > codes.sum():
        return None
    return prior.state.t_ns if before is None else before
