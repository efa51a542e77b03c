"""Tight coupling: code and range-rate rows on the inertial prior, tested one by one before they are used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._errors import error_kinds
from pntegrity.estimators._filter import clock_walk, clocks, mode, next_layout, transition
from pntegrity.estimators._gnss import GnssOptions, Rows, code_rows, rate_rows, system_of
from pntegrity.estimators._ins_motion import Moved
from pntegrity.estimators._ins_solution import Aside, antenna, antenna_of, inertial_names, with_aside
from pntegrity.estimators._ins_start import begun
from pntegrity.estimators._ins_still import standing, zero_velocity
from pntegrity.estimators._layout import columns
from pntegrity.estimators._navigation import MOTION, Stack, stack, use
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.rotations import skew
from pntegrity.kernels.row_tests import leave_out
from pntegrity.kernels.signatures import is_rate
from pntegrity.kernels.snapshot_fix import pdop_of
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import Epoch, FloatArray, Layout, Prior, Screening, State, Update, group_of

__all__ = ["correct", "predict"]

BoolArray = npt.NDArray[np.bool_]
#: A row further off than this is not used, standard deviations.
LIMIT_SIGMA = 3.3
#: Where more than half of the codes are refused for so long, and there are enough, the position is taken for
#: lost.
LOST_S, LOST_ROWS = 20.0, 6


def nav_places(layout: Layout, names: tuple[str, ...]) -> npt.NDArray[np.intp]:
    """Return where the states of the INS stand, in the order of its errors."""
    return columns(layout, (*MOTION, *names))


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
    at = nav_places(layout, names)
    F[np.ix_(at, at)], Q[np.ix_(at, at)] = moved.F[: len(at), : len(at)], moved.Q[: len(at), : len(at)]
    mean[:3], mean[3:6], mean[layout.block("att")] = moved.position_m, moved.velocity_mps, 0.0
    mean, F, Q, consumed, events = clocks(mean, F, Q, layout, state.layout, rows, mode)
    P = symmetric(sandwich(F, state.P) + Q)
    after = State(epoch.t_ns, mean, P, layout, aside)
    prior = Prior(after, F, Q, consumed, moved.events + events, rows)
    lost = aside.refused_since_ns is not None and (epoch.t_ns - aside.refused_since_ns) * 1e-9 >= LOST_S
    return (
        begun(prior, f"re-acquisition: most pseudoranges were refused for {LOST_S:.0f} s") if lost else prior
    )


def correct(prior: Prior, epoch: Epoch, options: GnssOptions, exclude: frozenset[str]) -> Update:
    """Use the rows that pass the tests, but for those of the groups in `exclude`."""
    code: Rows = prior.context
    rate, noise = rate_rows(epoch, *antenna(prior.state), options), options.noise
    rows = stack(prior, code, rate, noise.code_white_m * code.scale, noise.doppler_mps * rate.scale)
    rows = replace(rows, H=_with_arm(prior.state, rows.H, len(code.keys)))
    if standing(epoch.imu, prior.state, options.ins):
        rows = rows.plus(zero_velocity(prior.state))
    allowed = np.array([group_of(k) not in exclude for k in rows.keys], dtype=bool)
    used, screening = screened(prior, rows, allowed, code.los, options.ins.fde == "ours")
    shown = used | ~allowed  # rows of an excluded group are spare, to prove themselves
    update = use(prior, rows.take(shown), used[shown]).altered(screening=screening)
    since = _refused_since(prior, rows.keys, used & allowed, allowed)
    return with_aside(update, update.posterior.aside.with_(refused_since_ns=since))


def _with_arm(state: State, H: FloatArray, codes: int) -> FloatArray:
    """Return the Jacobian with what attitude and gyroscope bias do to the antenna."""
    aside: Aside = state.aside
    if not aside.arm_m.any():
        return H
    H = H.copy()
    arm, swing = aside.C @ aside.arm_m, aside.C @ np.cross(aside.rate_radps, aside.arm_m)
    att, bias = state.layout.block("att"), state.layout.block("bg")
    H[:codes, att] = -H[:codes, :3] @ skew(arm)
    H[codes:, att] = -H[codes:, 3:6] @ skew(swing)
    H[codes:, bias] = H[codes:, 3:6] @ aside.C @ skew(aside.arm_m)
    return H


def screened(
    prior: Prior, rows: Stack, allowed: BoolArray, los: FloatArray, test: bool
) -> tuple[BoolArray, Screening]:
    """Return which rows to use, and the story of it."""
    at = np.flatnonzero(allowed)
    codes = np.array([not is_rate(k) for k in rows.keys], dtype=bool)
    before = allowed & codes
    S = sandwich(rows.H[at], prior.state.P) + np.diag(rows.variance[at])
    limit = LIMIT_SIGMA if test else np.inf
    passes, first, last = leave_out(rows.nu[at], S, limit)
    used = allowed.copy()
    used[at[passes > 0]] = False
    dropped = sorted(
        ((rows.keys[i], int(p)) for i, p in zip(at, passes, strict=True) if p), key=lambda d: d[1]
    )
    systems = np.array([system_of(k) for k, c in zip(rows.keys, codes, strict=True) if c])
    dilution = [_pdop(los[kept[codes]], systems[kept[codes]]) for kept in (before, used)]
    return used, Screening(
        "ours" if test else "none", first=first, first_limit=limit, last=last, last_limit=limit,
        dropped=tuple(dropped), tests=1 + len(dropped),
        satellites=(int(before.sum()), int((used & codes).sum())),
        pdop=(dilution[0], dilution[1]), used=bool(used.any()),
        reason="" if used.any() else "no row passes its test" if len(at) else "no satellite above the mask",
    )  # fmt: skip


def _pdop(los: FloatArray, systems: npt.NDArray[np.str_]) -> float:
    """Return the dilution of position with a clock a constellation, inf where there is none."""
    clocks_ = systems[:, None] == np.unique(systems)
    return pdop_of(np.hstack([-los, clocks_.astype(np.float64)])) if len(los) else float("inf")


def _refused_since(prior: Prior, keys: tuple[str, ...], used: BoolArray, allowed: BoolArray) -> int | None:
    """Return since when most codes have been refused; epochs with few tell nothing."""
    codes = np.array([not is_rate(k) for k in keys], dtype=bool) & allowed
    before: int | None = prior.state.aside.refused_since_ns
    if codes.sum() < LOST_ROWS:
        return before
    if 2 * int((codes & used).sum()) > codes.sum():
        return None
    return prior.state.t_ns if before is None else before
