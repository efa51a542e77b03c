"""How an inertial filter starts: aligned, around a fix; and how it starts anew without losing its
attitude.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._errors import KINDS, stationary
from pntegrity.estimators._filter import mode
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_alignment import Aligned, Alignment, Velocity, aligned, felt, heading_of
from pntegrity.estimators._ins_solution import Aside, inertial_names
from pntegrity.estimators._navigation import MOTION, start_prior
from pntegrity.kernels.factor_set import FactorMemory
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.rotations import cross
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, FloatArray, Inertial, Layout, Prior, State
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import Rows, code_rows, system_of
from pntegrity.sensors.snapshot import Fix, snapshot

__all__ = ["align", "begun", "found_anew"]

#: Standard deviations of a start and of a re-acquisition: position, velocity, clock and its drift.
START_M, START_MPS, CLOCK_M, DRIFT_MPS = 100.0, 10.0, 1000.0, 100.0
#: The same of a velocity that nothing tells, m/s.
ANY_MPS = 30.0
#: Without range rates the course is that between fixes: how far off one may be, m; how long between them, s;
#: how far the vehicle may have turned meanwhile, rad.
FIX_M, TRAVEL_S, RENEW_S, TURNED_RAD = 5.0, 4.0, 8.0, 0.2
NO_IMU = "no inertial data at this epoch"


def align(state: State, epoch: Epoch, options: GnssOptions, events: tuple[str, ...], n_old: int = 0) -> Prior:
    """Return the prior of a filter that starts, or an empty one that remembers what was felt and says why.

    Parameters
    ----------
    state : State
        An empty one; what was felt before stands beside it.
    epoch : Epoch
    options : GnssOptions
    events : tuple of str
        What happened already.
    n_old : int
        States before.
    """
    known = state.aside if isinstance(state.aside, Alignment) else Alignment()
    if epoch.imu is None or not len(epoch.imu.dt_s):
        return _waiting(epoch, known, n_old, (*events, NO_IMU))
    fix = _fix(epoch, options)
    velocity = _velocity(fix)
    known = felt(known, epoch.imu, velocity, options.ins.spec)
    if fix.reason:
        return _waiting(epoch, known, n_old, (*events, fix.reason))
    if velocity is None:
        velocity, known = _travel(fix, known, epoch.t_ns)
    found = aligned(known, options.ins, velocity)
    if isinstance(found, str):
        return _waiting(epoch, known, n_old, (*events, found))
    if velocity is not None and fix.velocity_mps is None:
        fix = replace(fix, velocity_mps=enu_rotation(fix.position_m).T @ velocity.enu_mps)
    return _started(fix, found, epoch, options, n_old, (*events, "start"))


def _velocity(fix: Fix) -> Velocity | None:
    if fix.velocity_mps is None or fix.velocity_cov is None:
        return None
    sigma = float(np.sqrt(np.trace(fix.velocity_cov) / 3.0))
    return Velocity(enu_rotation(fix.position_m) @ fix.velocity_mps, sigma)


def _travel(fix: Fix, known: Alignment, t_ns: int) -> tuple[Velocity | None, Alignment]:
    """Return the mean velocity since a fix some seconds ago, where the vehicle went straight on."""
    heading = heading_of(known)
    anew = replace(known, anchor=(t_ns, fix.position_m, heading))
    if known.anchor is None:
        return None, anew
    since_ns, place, before = known.anchor
    dt = (t_ns - since_ns) * 1e-9
    turned = abs((heading - before + np.pi) % (2.0 * np.pi) - np.pi)
    if dt < TRAVEL_S and turned < TURNED_RAD:
        return None, known
    travel = enu_rotation(fix.position_m) @ (fix.position_m - place) / dt
    velocity = Velocity(travel, np.sqrt(2.0) * FIX_M / dt, turned)
    return velocity if turned < TURNED_RAD else None, known if turned < TURNED_RAD and dt < RENEW_S else anew


def _waiting(epoch: Epoch, known: Alignment, n_old: int, events: tuple[str, ...]) -> Prior:
    state = replace(State.empty(epoch.t_ns), aside=known)
    return Prior(state, np.zeros((0, n_old)), np.zeros((0, 0)), events=events)


def _fix(epoch: Epoch, options: GnssOptions) -> Fix:
    """Return the receiver's own fix where it gives one, else that of its pseudoranges."""
    own = epoch.sensor("fix")
    if own is None:
        return snapshot(epoch, options, np.zeros(3))
    cov = own.aux["cov"]
    if len(own.keys) < 3:
        return Fix(np.zeros(3), {}, None, 0.0, "waiting for a position: of a fix, or of satellites")
    velocity = (own.y[3:6], cov[3:6, 3:6]) if len(own.keys) == 6 else (None, None)
    return Fix(own.y[:3], {}, velocity[0], 0.0, "", velocity[1])


def _started(
    fix: Fix, found: Aligned, epoch: Epoch, options: GnssOptions, n_old: int, events: tuple[str, ...]
) -> Prior:
    names = inertial_names(options.ins.scale_factors)
    if options.ins.coupling == "tight":
        rows = code_rows(epoch, fix.position_m, options)
        prior = start_prior(_by_mode(fix, rows), rows, epoch.t_ns, n_old, options.noise, events, names)
    else:
        n = len(MOTION) + len(names)
        state = State(epoch.t_ns, np.zeros(n), np.zeros((n, n)), Layout((*MOTION, *names)))
        consumed = 3 if fix.velocity_cov is None else 6
        prior = Prior(state, np.zeros((n, n_old)), np.zeros((n, n)), consumed, events)
    return _with_attitude(prior, fix, found, epoch.imu, options)


def _by_mode(fix: Fix, rows: Rows) -> Fix:
    """Return the fix with each clock where most of its satellites agree: reflected ones do not."""
    residual = rows.y - rows.predicted
    of = np.array([system_of(k) for k in rows.keys])
    return replace(fix, clocks_m={s: mode(residual[of == s]) for s in fix.clocks_m})


def _with_attitude(
    prior: Prior, fix: Fix, found: Aligned, imu: Inertial | None, options: GnssOptions
) -> Prior:
    """Return the start with position, velocity, attitude and the IMU's errors in it."""
    assert imu is not None
    to_ecef = enu_rotation(fix.position_m).T
    C = to_ecef @ found.C
    rate = imu.angle_rad.sum(axis=0) / imu.dt_s.sum() - found.gyro_bias_radps
    arm = np.asarray(options.ins.lever_arm_m)
    velocity = np.zeros(3) if fix.velocity_mps is None else fix.velocity_mps - C @ cross(rate, arm)
    mean, P, layout = prior.state.mean.copy(), prior.state.P.copy(), prior.state.layout
    mean[:3], mean[3:6], mean[layout.block("bg")] = fix.position_m - C @ arm, velocity, found.gyro_bias_radps
    P[:6, :6] = np.diag(np.repeat([START_M, ANY_MPS if fix.velocity_cov is None else START_MPS], 3) ** 2)
    at = layout.block("att")
    P[np.ix_(at, at)] = symmetric(to_ecef @ np.diag(found.sigma_rad**2) @ to_ecef.T)
    sigma = options.ins.spec.start_sigma()
    sigma[:3] = found.gyro_sigma_radps
    for k, kind in enumerate(("bg", "ba", "sg", "sa")):
        block = layout.block(kind)
        P[block, block] = sigma[3 * k : 3 * k + len(block)] ** 2
    aside = Aside(C, rate, arm, FactorMemory())
    return replace(prior, state=State(prior.state.t_ns, mean, P, layout, aside), Q=P)


def begun(prior: Prior, event: str) -> Prior:
    """Return the prior with position, velocity and clock born anew where they are; all else stays known."""
    sigma = {"pos": START_M, "vel": START_MPS, "clk": CLOCK_M, "drift": DRIFT_MPS}
    at = np.concatenate([prior.state.layout.block(kind) for kind in sigma])
    variance = np.concatenate([np.full(len(prior.state.layout.block(k)), s**2) for k, s in sigma.items()])
    variance = np.maximum(variance, prior.state.P[at, at])
    return _born(prior, prior.state.mean, at, np.diag(variance), event)


def found_anew(prior: Prior, noise: NoiseModel, event: str) -> Prior:
    """Return the prior of a filter that lost its position: all that it learnt from GNSS is born anew, but for
    attitude and the IMU's errors.

    Inter-system biases and the errors of satellites fitted the wrong position: they would hold it.
    """
    prior = begun(prior, event)
    layout, rows, mean = prior.state.layout, prior.context, prior.state.mean.copy()
    lasting = np.zeros((len(layout), len(layout)))
    stationary(lasting, layout, rows, noise)
    isb = layout.block("isb")
    lasting[isb, isb] = CLOCK_M**2
    at = np.concatenate([isb, *(layout.block(kind) for kind in KINDS)])
    mean[at] = 0.0
    residual = rows.y - rows.predicted
    of = np.array([f"isb:{system_of(k)}" for k in rows.keys])
    own = ~np.isin(of, [layout.names[i] for i in isb])
    mean[6] = mode(residual[own]) if own.any() else mean[6]
    for i in isb.tolist():
        here = of == layout.names[i]
        mean[i] = mode(residual[here]) - mean[6] if here.any() else prior.state.mean[i]
    return _born(prior, mean, at, lasting[np.ix_(at, at)], "")


def _born(
    prior: Prior, mean: FloatArray, at: npt.NDArray[np.intp], variance: FloatArray, event: str
) -> Prior:
    """Return the prior with some states that inherit nothing."""
    F, Q, P = prior.F.copy(), prior.Q.copy(), prior.state.P.copy()
    for matrix in (Q, P):
        matrix[at], matrix[:, at] = 0.0, 0.0
        matrix[np.ix_(at, at)] = variance
    F[at] = 0.0
    state = replace(prior.state, mean=mean, P=P, aside=prior.state.aside.with_(refused_since_ns=None))
    fresh = [i for i in at.tolist() if not prior.state.layout.names[i].startswith(KINDS)]
    events = (*prior.events, event) if event else prior.events
    return replace(prior, state=state, F=F, Q=Q, consumed=prior.consumed + len(fresh), events=events)
