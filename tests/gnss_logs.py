"""Logs that several test folders share: simulated GNSS epochs and a linear filter, with and without
faults.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.kernels.gravity import gravity
from pntegrity.kernels.rotations import from_angles
from pntegrity.physics.frames import enu_rotation, geodetic_to_ecef
from pntegrity.physics.tables import Navigation
from pntegrity.physics.time import from_iso
from pntegrity.protocols import Estimator, Monitor
from pntegrity.records import Epoch, Inertial, Observation, Prior, State, Update, group_of
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.ranges import EARTH_RATE_RADPS
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.linear import LinearModel
from pntegrity.simulate.receiver import Receiver, Simulated, epochs_of, simulate
from pntegrity.simulate.trajectory import static

SECOND = 10**9
START = from_iso("2024-06-01T09:30:00")
PLACE = geodetic_to_ecef(np.deg2rad(50.85), np.deg2rad(4.35), 60.0)
#: What the simulated receivers suffer from: the estimators' own model, biases small.
NOISE = NoiseModel(code_bias_m=0.3)


@lru_cache(maxsize=8)
def navigation(systems: str = "GE", seconds: int = 600) -> Navigation:
    return nominal_navigation(START, START + seconds * SECOND, systems)


def options(nav: Navigation, **changes: Any) -> GnssOptions:
    return replace(GnssOptions(noise=NOISE, klobuchar=nav.klobuchar["G"]), **changes)


STILL = static(PLACE)


@lru_cache(maxsize=16)
def simulated(
    n: int, systems: str = "GE", seed: int = 1, scale: float = 1.0, clock_m: float = 2000.0
) -> Simulated:
    t_ns = START + SECOND * np.arange(n, dtype=np.int64)
    receiver = Receiver(NOISE, scale, mask_rad=float(np.deg2rad(8.0)), clock_m=clock_m)
    return simulate(navigation(systems), static(PLACE), t_ns, receiver, np.random.default_rng(seed))


@lru_cache(maxsize=16)
def _clean(n: int, systems: str, seed: int, scale: float) -> tuple[Epoch, ...]:
    return tuple(epochs_of(simulated(n, systems, seed, scale).table, navigation(systems)))


def log(n: int, *faults: str, systems: str = "GE", seed: int = 1, scale: float = 1.0) -> list[Epoch]:
    """Return `n` epochs at 1 Hz of a receiver at `PLACE`, with faults in the grammar of `simulate.faults`."""
    return apply_faults(_clean(n, systems, seed, scale), [parse_fault(f) for f in faults])


def without(epoch: Epoch, groups: Iterable[str]) -> Epoch:
    """Return the epoch as if some groups were not there."""
    gone = frozenset(groups)
    return replace(
        epoch,
        observations=tuple(_kept(o, [group_of(k) not in gone for k in o.keys]) for o in epoch.observations),
    )


def only(epoch: Epoch, groups: Iterable[str]) -> Epoch:
    """Return the epoch with some groups alone."""
    seen = frozenset(groups)
    return replace(
        epoch, observations=tuple(_kept(o, [group_of(k) in seen for k in o.keys]) for o in epoch.observations)
    )


def _kept(o: Observation, rows: list[bool]) -> Observation:
    return o.select(np.array(rows, dtype=bool))


@lru_cache(maxsize=4)
def _felt(n: int) -> Inertial:
    """Return what an IMU feels that stands level at `PLACE`, its heading 0.3 rad: 20 increments a second."""
    C = enu_rotation(PLACE).T @ from_angles([0.0, 0.0, 0.3])
    dt = np.full(20 * n, 0.05)
    ends = START - SECOND + np.cumsum(np.full(20 * n, SECOND // 20))
    earth, up = C.T @ np.array([0.0, 0.0, EARTH_RATE_RADPS]), -C.T @ np.array(gravity(*PLACE))
    return Inertial(ends, dt, dt[:, None] * earth, dt[:, None] * up)


def with_imu(epochs: Sequence[Epoch]) -> tuple[Epoch, ...]:
    """Return epochs of `log` with what an IMU feels beside a receiver that does not move."""
    seconds = (epochs[-1].t_ns - START) // SECOND + 2
    return with_increments(epochs, _felt(int(seconds)))


def shuffled(epoch: Epoch, rng: np.random.Generator) -> Epoch:
    """Return the epoch with its rows and sensors in another order."""
    mixed = [o.select(rng.permutation(len(o.keys))) for o in epoch.observations]
    return replace(epoch, observations=tuple(mixed[::-1]))


def groups(epoch: Epoch) -> list[str]:
    code = epoch.sensor("code") or epoch.observations[0]
    return list(dict.fromkeys(map(group_of, code.keys)))


def shifted(epoch: Epoch, metres: float, sensor: str = "code") -> Epoch:
    """Return the epoch with all rows of a sensor moved."""
    moved = tuple(replace(o, y=o.y + metres) if o.sensor == sensor else o for o in epoch.observations)
    return replace(epoch, observations=moved)


@dataclass(frozen=True)
class LinearFilter:
    """The textbook Kalman filter of a linear model as an estimator, for epochs of
    `simulate.linear_epochs`.
    """

    model: LinearModel

    def predict(self, state: State, epoch: Epoch) -> Prior:
        m = self.model
        n = len(m.layout)
        if not len(state):
            return Prior(
                State(epoch.t_ns, np.zeros(n), m.P0, m.layout), np.zeros((n, 0)), m.P0, events=("start",)
            )
        P = m.F @ state.P @ m.F.T + m.Q
        return Prior(State(epoch.t_ns, m.F @ state.mean, 0.5 * (P + P.T), m.layout), m.F, m.Q)

    def relax(self, prior: Prior) -> Prior:
        m = self.model
        state = replace(prior.state, P=m.P0)
        return Prior(state, np.zeros_like(prior.F), m.P0, len(m.layout), (*prior.events, "started anew"))

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        m, o = self.model, epoch.observations[0]
        row = {k: i for i, k in enumerate(m.keys)}
        at = np.array([row[k] for k in o.keys], dtype=np.intp)
        H, R = m.H[at], m.R[np.ix_(at, at)]
        nu = o.y - H @ prior.state.mean
        used = np.array([group_of(k) not in exclude for k in o.keys], dtype=bool)
        keys = tuple(k for k, u in zip(o.keys, used, strict=True) if u)
        reason = "" if used.any() else "no rows"
        update = Update.of(prior, keys, nu[used], H[used], R[np.ix_(used, used)], reason=reason)
        spare = tuple(k for k, u in zip(o.keys, used, strict=True) if not u)
        return update.with_spares(spare, nu[~used], H[~used], np.diagonal(R)[~used]) if spare else update


def fingerprint(value: Any) -> Any:
    """Return all that a value says, byte for byte, as something that can be compared; caches left out."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, np.ascontiguousarray(value).tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, *(fingerprint(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, tuple | list):
        return tuple(map(fingerprint, value))
    if hasattr(value, "items"):
        return tuple((k, fingerprint(v)) for k, v in sorted(value.items()))
    if isinstance(value, frozenset):
        return tuple(sorted(value))
    return value


def run(
    estimator: Estimator, monitors: Sequence[Monitor], epochs: Sequence[Epoch], **policy: Any
) -> list[Any]:
    """Return the outcomes of a pipeline."""
    from pntegrity.exclusion import Policy
    from pntegrity.pipeline import Pipeline

    pipeline = Pipeline(estimator, monitors, Policy(**policy))
    return [pipeline.push(e) for e in epochs]


def horizontal_m(outcome: Any, truth_m: Any = PLACE) -> float:
    """Return the horizontal error of an outcome's position."""
    from pntegrity.physics.frames import enu_rotation

    return float(np.linalg.norm((enu_rotation(PLACE) @ (outcome.update.posterior.mean[:3] - truth_m))[:2]))
