"""From one epoch to the next with an inertial measurement unit, gaps of its file included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators._ins_solution import Aside, attitude_now, mean_of
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.sparse import sandwich
from pntegrity.kernels.strapdown import mechanise
from pntegrity.records import FloatArray, Inertial, Prior, State
from pntegrity.sensors.ranges import EARTH_RATE_RADPS

__all__ = ["Moved", "advance", "inertial_prior", "is_lost", "with_large_turns"]

#: What a vehicle may do while its IMU says nothing: white acceleration (m/s^1.5), turning about the vertical
#: and tilting (rad/sqrt(s)).
UNSEEN_ACCEL, UNSEEN_TURN, UNSEEN_TILT = 3.0, 0.3, 0.02
#: With a larger standard deviation the attitude is not worth keeping where there is a course, rad.
LOST_RAD = 0.6
#: Attitudes that are better known than this turn no force by more than their slopes say, rad.
SMALL_RAD, GRAVITY_MPS2 = 0.015, 9.81
#: Durations that differ by less than this are equal, s.
SAME_S = 1e-6


@dataclass(frozen=True, eq=False)
class Moved:
    """Where the vehicle is after a step: position and velocity of the IMU, attitude, rate with respect to
    the Earth; `F` and `Q` of the 21 errors.
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    C: FloatArray
    rate_radps: FloatArray
    F: FloatArray
    Q: FloatArray
    events: tuple[str, ...] = ()


def advance(state: State, imu: Inertial | None, dt: float, options: InsOptions) -> Moved:
    """Return the step over `dt` seconds; what the increments do not cover is bridged without them.

    Parameters
    ----------
    state : State
        A posterior of the filter.
    imu : Inertial or None
    dt : float
    options : InsOptions
    """
    errors = np.zeros(12)
    found = np.concatenate([mean_of(state, kind) for kind in ("bg", "ba", "sg", "sa")])
    errors[: len(found)] = found
    none = np.zeros((0, 3))
    spans, angles, forces = (imu.dt_s, imu.angle_rad, imu.velocity_mps) if imu else (np.zeros(0), none, none)
    step = mechanise(
        state.mean[:3], state.mean[3:6], attitude_now(state), spans, angles, forces, errors,
        options.spec.densities(),
    )  # fmt: skip
    earth = step.C.T @ np.array([0.0, 0.0, EARTH_RATE_RADPS])
    moved = Moved(
        step.position_m, step.velocity_mps, step.C, step.rate_radps - earth if len(spans) else np.zeros(3),
        step.F, step.Q,
    )  # fmt: skip
    missing = dt - float(spans.sum())
    return moved if missing < SAME_S else _bridged(moved, missing, imu.reason if imu else "")


def _bridged(moved: Moved, missing_s: float, reason: str) -> Moved:
    """Return the step with a stretch of constant velocity behind it."""
    F, Q = np.eye(21), np.zeros((21, 21))
    i = np.arange(3)
    F[i, i + 3] = missing_s
    Q[i, i] = UNSEEN_ACCEL**2 * missing_s**3 / 3.0
    Q[i, i + 3] = Q[i + 3, i] = UNSEEN_ACCEL**2 * missing_s**2 / 2.0
    Q[i + 3, i + 3] = UNSEEN_ACCEL**2 * missing_s
    up = moved.position_m / np.linalg.norm(moved.position_m)
    about_up = np.outer(up, up)
    Q[6:9, 6:9] = missing_s * (UNSEEN_TILT**2 * (np.eye(3) - about_up) + UNSEEN_TURN**2 * about_up)
    event = reason or f"no inertial data for {missing_s:.2f} s: bridged with constant velocity"
    return Moved(
        moved.position_m + missing_s * moved.velocity_mps, moved.velocity_mps, moved.C, moved.rate_radps,
        F @ moved.F, F @ moved.Q @ F.T + Q, (event,),
    )  # fmt: skip


def with_large_turns(moved: Moved, state: State, dt: float) -> Moved:
    """Return the step with what turns do that are too large for their slopes.

    A turn ``phi`` moves the specific force ``f`` by ``phi x f + (phi phi^T - |phi|^2) f / 2``. The second
    part is no state's; its second moment for a normal `phi`, at rest, goes into the noise: with a level known
    to 8 degrees 0.3 m/s^2, with one known to half a degree nothing.

    Parameters
    ----------
    moved : Moved
    state : State
        The posterior before.
    dt : float
    """
    at = state.layout.block("att")
    P = state.P[np.ix_(at, at)]
    trace = float(np.trace(P))
    if trace < SMALL_RAD**2:
        return moved
    f = GRAVITY_MPS2 * dt * moved.position_m / np.linalg.norm(moved.position_m)
    Pf = P @ f
    both = np.outer(trace * Pf + 2.0 * P @ Pf, f)
    square = trace**2 + 2.0 * float(np.sum(P * P))
    M = 0.25 * ((f @ Pf) * P + 2.0 * np.outer(Pf, Pf) - both - both.T + square * np.outer(f, f))
    Q = moved.Q.copy()
    Q[3:6, 3:6] += M
    Q[:3, :3] += 0.25 * dt**2 * M
    Q[:3, 3:6] += 0.5 * dt * M
    Q[3:6, :3] += 0.5 * dt * M
    return replace(moved, Q=Q)


def is_lost(state: State, moved: Moved) -> bool:
    """Tell whether increments were missing for so long that what is known of the attitude helps no more."""
    at = state.layout.block("att")
    return float(np.sum(state.P[at, at]) + np.trace(moved.Q[6:9, 6:9])) > LOST_RAD**2


def inertial_prior(state: State, moved: Moved, aside: Aside, t_ns: int, walks: Sequence[float] = ()) -> Prior:
    """Return the prior of a filter whose states are those of the INS, and behind them some that walk.

    Parameters
    ----------
    state : State
        The posterior before.
    moved : Moved
    aside : Aside
        What stands beside the prior.
    t_ns : int
    walks : sequence of float
        Random walks of the last states, in their units/sqrt(s).
    """
    n, k = len(state), len(state) - len(walks)
    F, Q = np.eye(n), np.zeros((n, n))
    F[:k, :k], Q[:k, :k] = moved.F[:k, :k], moved.Q[:k, :k]
    dt = (t_ns - state.t_ns) * 1e-9
    Q[range(k, n), range(k, n)] = [walk**2 * dt for walk in walks]
    mean = state.mean.copy()
    mean[:3], mean[3:6], mean[state.layout.block("att")] = moved.position_m, moved.velocity_mps, 0.0
    P = symmetric(sandwich(F, state.P) + Q)
    return Prior(State(t_ns, mean, P, state.layout, aside), F, Q, 0, moved.events)
