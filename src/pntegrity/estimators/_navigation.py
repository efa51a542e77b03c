"""What the GNSS estimators share: a wide prior around a fix, and the update with code and range-rate rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._errors import error_kinds, error_states, stationary
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._layout import columns
from pntegrity.records import Epoch, FloatArray, Layout, Prior, State, Update, group_of
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import Rows, code_rows, system_of
from pntegrity.sensors.snapshot import Fix, snapshot

#: Standard deviations of a start, far above those of the snapshot that gives the mean.
START_POS_M, START_VEL_MPS, START_CLOCK_M, START_DRIFT_MPS = 300.0, 100.0, 1000.0, 1000.0
START_VARIANCE = np.array([START_POS_M] * 3 + [START_VEL_MPS] * 3 + [START_CLOCK_M, START_DRIFT_MPS]) ** 2
ANGLES = ("el_rad", "az_rad", "cn0_dbhz")
MOTION = ("pos:x", "pos:y", "pos:z", "vel:x", "vel:y", "vel:z")


def no_prior(t_ns: int, n_old: int, events: tuple[str, ...]) -> Prior:
    """Return the empty prior of an epoch at which nothing could be started; the last event is the reason."""
    return Prior(State.empty(t_ns), np.zeros((0, n_old)), np.zeros((0, 0)), events=events)


def not_started(prior: Prior) -> Update:
    """Return the update of an empty prior: no rows, and the last event is the reason."""
    reason = prior.events[-1] if prior.events else "not started"
    return Update.of(prior, (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), reason=reason)


def fix_prior(
    epoch: Epoch, options: GnssOptions, guess_m: FloatArray, n_old: int, noise: NoiseModel,
    events: tuple[str, ...],
    exclude: frozenset[str] = frozenset(),
) -> Prior:  # fmt: skip
    """Return the wide prior around an epoch's least-squares fix without the groups in `exclude`, or an empty
    one.

    A constellation whose satellites are all left out keeps its clock state, unobserved, so that they can
    prove themselves.
    """
    fix = snapshot(epoch, options, guess_m, exclude)
    if fix.reason:
        return no_prior(epoch.t_ns, n_old, (*events, fix.reason))
    rows = code_rows(epoch, fix.position_m, options)
    unseen = sorted({system_of(k) for k in rows.keys} - set(fix.clocks_m))
    residual = rows.y - rows.predicted
    of = np.array([system_of(k) for k in rows.keys])
    guesses = {s: float(np.median(residual[of == s])) for s in unseen}
    prior = start_prior(replace(fix, clocks_m=fix.clocks_m | guesses), rows, epoch.t_ns, n_old, noise, events)
    return replace(prior, consumed=prior.consumed - len(unseen))


def start_prior(
    fix: Fix, rows: Rows, t_ns: int, n_old: int, noise: NoiseModel, events: tuple[str, ...],
    inertial: tuple[str, ...] = (),
) -> Prior:  # fmt: skip
    """Return the wide prior around a snapshot fix; the states that the data initialise are counted as
    consumed. States called `inertial` stand behind the clock's, without a variance yet.
    """
    reference = next(iter(fix.clocks_m))
    names = (
        *MOTION,
        f"clk:{reference}",
        "drift",
        *inertial,
        *(f"isb:{s}" for s in fix.clocks_m if s != reference),
    )
    layout = Layout((*names, *error_states(rows.keys, error_kinds(noise))))
    mean, sigma = np.zeros(len(layout)), np.zeros(len(layout))
    mean[:3], sigma[:3] = fix.position_m, START_POS_M
    mean[3:6] = 0.0 if fix.velocity_mps is None else fix.velocity_mps
    sigma[3:6] = START_VEL_MPS
    mean[6], sigma[6], mean[7], sigma[7] = (
        fix.clocks_m[reference],
        START_CLOCK_M,
        fix.drift_mps,
        START_DRIFT_MPS,
    )
    for i, name in enumerate(layout.names[8:], 8):
        if name.startswith("isb:"):
            mean[i], sigma[i] = fix.clocks_m[name[4:]] - fix.clocks_m[reference], START_CLOCK_M
    Q = np.diag(sigma**2)
    stationary(Q, layout, rows, noise)
    consumed = 3 + len(fix.clocks_m) + (4 if fix.velocity_mps is not None else 0)
    return Prior(State(t_ns, mean, Q, layout), np.zeros((len(layout), n_old)), Q, consumed, events, rows)


@dataclass(frozen=True, eq=False)
class Stack:
    """All rows of an epoch on a prior: names, innovations, Jacobian, variances, and angles for reports."""

    keys: tuple[str, ...]
    nu: FloatArray
    H: FloatArray
    variance: FloatArray
    angles: dict[str, FloatArray]

    def plus(self, other: Stack) -> Stack:
        """Return these rows and others behind them."""
        angles = {name: np.concatenate([values, other.angles[name]]) for name, values in self.angles.items()}
        nu, variance = np.concatenate([self.nu, other.nu]), np.concatenate([self.variance, other.variance])
        return Stack(self.keys + other.keys, nu, np.vstack([self.H, other.H]), variance, angles)

    def take(self, rows: npt.NDArray[np.bool_]) -> Stack:
        """Return only some rows."""
        if rows.all():
            return self
        keys = tuple(k for k, r in zip(self.keys, rows, strict=True) if r)
        angles = {name: values[rows] for name, values in self.angles.items()}
        return Stack(keys, self.nu[rows], self.H[rows], self.variance[rows], angles)


def stack(
    prior: Prior, code: Rows, rate: Rows, code_sigma_m: FloatArray, rate_sigma_mps: FloatArray
) -> Stack:
    """Return code and range-rate rows on a prior."""
    x, layout = prior.state.mean, prior.state.layout
    H = np.vstack([_code_jacobian(layout, code), _rate_jacobian(layout, rate)])
    nu = np.concatenate([code.y - code.predicted, rate.y - rate.predicted])
    nu -= np.concatenate([H[: len(code.keys), 6:] @ x[6:], np.full(len(rate.keys), x[7])])
    angles = {n: np.concatenate([getattr(code, n), getattr(rate, n)]) for n in ANGLES}
    variance = np.concatenate([code_sigma_m, rate_sigma_mps]) ** 2
    return Stack(code.keys + rate.keys, nu, H, variance, angles)


def use(prior: Prior, rows: Stack, used: npt.NDArray[np.bool_], **facts: Any) -> Update:
    """Return the update of a prior with the rows `used`; the others become its spare rows. `facts` are
    further fields of `Update`.
    """
    reason = "" if used.any() else "no satellite above the mask"
    some = rows.take(used)
    facts = {"aux": some.angles, "reason": reason} | facts
    update = Update.of(prior, some.keys, some.nu, some.H, np.diag(some.variance), **facts)
    if len(some.keys) == len(rows.keys):
        return update
    spare = tuple(rows.keys[i] for i in np.flatnonzero(~used))
    return update.with_spares(spare, rows.nu[~used], rows.H[~used], rows.variance[~used])


def linear_update(
    prior: Prior, code: Rows, rate: Rows, code_sigma_m: FloatArray, rate_sigma_mps: FloatArray,
    exclude: frozenset[str],
) -> Update:  # fmt: skip
    """Return the update of a prior with code and rate rows; the rows of `exclude` become the update's spare
    rows.
    """
    rows = stack(prior, code, rate, code_sigma_m, rate_sigma_mps)
    return use(prior, rows, np.array([group_of(k) not in exclude for k in rows.keys], dtype=bool))


def _code_jacobian(layout: Layout, rows: Rows) -> FloatArray:
    H = _code_template(layout, rows.keys).copy()
    H[:, :3] = -rows.los
    return H


@lru_cache(maxsize=64)
def _code_template(layout: Layout, keys: tuple[str, ...]) -> FloatArray:
    """Return the part of a code Jacobian that geometry does not change: clocks and the satellites' states."""
    H = np.zeros((len(keys), len(layout)))
    H[:, 6] = 1.0
    for prefix, names in (("isb", [system_of(k) for k in keys]), ("bias", keys), ("mp", keys)):
        i = columns(layout, tuple(f"{prefix}:{n}" for n in names))
        here = np.flatnonzero(i >= 0)
        H[here, i[here]] = 1.0
    H.flags.writeable = False
    return H


def _rate_jacobian(layout: Layout, rows: Rows) -> FloatArray:
    H = np.zeros((len(rows.keys), len(layout)))
    H[:, 3:6] = -rows.los
    H[:, 7] = 1.0
    return H
