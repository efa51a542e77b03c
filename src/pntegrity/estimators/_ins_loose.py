"""Loose coupling: a fix of position and velocity is measured, a receiver's own or one of screened rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_motion import Moved, inertial_prior
from pntegrity.estimators._ins_solution import antenna, arm_slopes, with_aside
from pntegrity.estimators._ins_still import standing, zero_velocity
from pntegrity.kernels.factor_set import screen_factor_set
from pntegrity.kernels.lsr import screen_lsr, screen_none
from pntegrity.kernels.snapshot_fix import Fix, Pseudoranges
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, FloatArray, Prior, State, Update, group_of
from pntegrity.sensors.pseudoranges import Rows, code_rows, rate_rows, sensor, system_of, without
from pntegrity.sensors.snapshot import velocity_of

__all__ = ["correct", "predict"]

ORDER = ("fix:X", "fix:Y", "fix:Z", "fix:DX", "fix:DY", "fix:DZ")
GROUP = "fix"
SCREENS = {"factor-set": screen_factor_set, "lsr": screen_lsr, "none": screen_none, "ours": screen_none}


def predict(state: State, moved: Moved, epoch: Epoch, dt: float, options: GnssOptions) -> Prior:
    """Return the prior after a step of the INS."""
    aside = state.aside.with_(C=moved.C, rate_radps=moved.rate_radps)
    return inertial_prior(state, moved, aside, epoch.t_ns)


def correct(prior: Prior, epoch: Epoch, options: GnssOptions, exclude: frozenset[str]) -> Update:
    """Use the fix, or leave it out where its group is in `exclude` or the screening says so."""
    place, speed = antenna(prior.state)
    if epoch.sensor(GROUP) is not None:
        return _use(prior, epoch, options, _own(epoch, place, speed), exclude)
    rows = without(code_rows(epoch, place, options), exclude)
    screening, fix, kept, memory = SCREENS[options.ins.fde](
        options.ins.factors, prior.state.aside.factors, pseudoranges(rows, place, options)
    )
    if fix is None or not screening.used:
        found = Measured(reason=screening.reason or "the fix was not accepted")
    else:
        found = _measured(epoch, options, rows, fix, kept, place, speed)
    update = _use(prior, epoch, options, found, exclude)
    return with_aside(update.altered(screening=screening), prior.state.aside.with_(factors=memory))


@dataclass(frozen=True, eq=False)
class Measured:
    """A fix less its prediction: names of its rows, differences and covariance; `reason`: why there is
    none.
    """

    keys: tuple[str, ...] = ()
    nu: FloatArray = field(default_factory=lambda: np.zeros(0))
    cov: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    reason: str = ""


def pseudoranges(rows: Rows, place_m: FloatArray, options: GnssOptions) -> Pseudoranges:
    """Return code rows as detection takes them; their sigma is that of a solver without error states."""
    systems = [system_of(k) for k in rows.keys]
    numbers = {s: i for i, s in enumerate(sorted(set(systems)))}
    clock = np.array([numbers[s] for s in systems], dtype=np.int64)
    sigma = options.noise.snapshot_sigma_m(rows.scale, rows.slow)
    return Pseudoranges(rows.keys, rows.los, clock, rows.y - rows.predicted, sigma, enu_rotation(place_m))


def _own(epoch: Epoch, place: FloatArray, speed: FloatArray) -> Measured:
    """Return a receiver's own fix less its prediction."""
    own = sensor(epoch, GROUP)
    if not len(own.keys):
        return Measured(reason="no fix")
    at = [ORDER.index(k) for k in own.keys]
    expected = np.concatenate([place, speed])[at]
    return Measured(own.keys, own.y - expected, own.aux["cov"][:, at])


def _measured(
    epoch: Epoch, options: GnssOptions, rows: Rows, fix: Fix, kept: npt.NDArray[np.bool_],
    place: FloatArray, speed: FloatArray,
) -> Measured:  # fmt: skip
    """Return the fix of the kept satellites, with a velocity where their range rates give one."""
    satellites = {group_of(k) for k, use in zip(rows.keys, kept, strict=True) if use}
    rate = rate_rows(epoch, place + fix.offset_m, np.zeros(3), options)
    rate = rate.select(np.array([group_of(k) in satellites for k in rate.keys], dtype=bool))
    velocity = velocity_of(rate, options.noise.doppler_mps)
    if velocity is None:
        return Measured(ORDER[:3], fix.offset_m, fix.cov)
    nu, cov = np.concatenate([fix.offset_m, velocity[0] - speed]), np.zeros((6, 6))
    cov[:3, :3], cov[3:, 3:] = fix.cov, velocity[2]
    return Measured(ORDER, nu, cov)


def _use(
    prior: Prior, epoch: Epoch, options: GnssOptions, found: Measured, exclude: frozenset[str]
) -> Update:
    """Return the update with a fix, spare where its group is in `exclude`, and with a standstill."""
    out = bool(found.keys) and GROUP in exclude
    used = Measured(reason="the fix is left out") if out else found
    keys, nu, H, R = used.keys, used.nu, _jacobian(prior.state, used.keys), used.cov
    if standing(epoch.imu, prior.state, options.ins):
        still = zero_velocity(prior.state)
        keys, nu, H = keys + still.keys, np.concatenate([nu, still.nu]), np.vstack([H, still.H])
        R = block_diag(R, np.diag(still.variance))
    update = Update.of(prior, keys, nu, H, R, reason="" if keys else used.reason)
    if not out:
        return update
    return update.with_spares(found.keys, found.nu, _jacobian(prior.state, found.keys), found.cov)


def _jacobian(state: State, keys: tuple[str, ...]) -> FloatArray:
    """Return how rows of the antenna's position and velocity depend on the states, shape (len(keys), n)."""
    H, block = np.zeros((6, len(state))), state.layout.block
    H[range(6), range(6)] = 1.0
    slopes = arm_slopes(state.aside)
    H[:3, block("att")] = slopes[0]
    for kind, slope in zip(("att", "bg", "sg"), slopes[1:], strict=True):
        if len(at := block(kind)):
            H[3:, at] = slope
    return H[[ORDER.index(k) for k in keys]]
