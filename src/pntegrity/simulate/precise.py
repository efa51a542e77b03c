"""A simulated receiver for precise positioning: satellites and a track in, ionosphere-free epochs out.

What is common to prediction and observation (antennas, tides, wind-up) is left out of both. Ranges, mapping
functions and elevations come from the code that the estimator uses; the errors from its `NoiseModel`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.physics.frames import elevation_azimuth
from pntegrity.physics.orbits import SatelliteStates
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.sensors.noise import PPP, NoiseModel
from pntegrity.sensors.ranges import C_MPS, Geometry, geometry
from pntegrity.simulate.receiver import gauss_markov

__all__ = ["PreciseReceiver", "States", "simulate_precise"]

States = Callable[[npt.NDArray[np.str_], npt.NDArray[np.int64], FloatArray], SatelliteStates]
"""Gives satellites at the emission of what was received: names, time tags, pseudoranges."""
PAIRS = {"G": "1W+2W", "R": "1P+2P", "E": "1C+5Q", "C": "2I+6I", "J": "1C+2L"}
CN0_DBHZ = 45.0


@dataclass(frozen=True)
class PreciseReceiver:
    """What the simulated receiver is like.

    Parameters
    ----------
    noise : NoiseModel
        White noise of code and carrier, code biases, walks of ambiguities and of the wet delay.
    mask_rad : float
        Satellites below this elevation are not tracked.
    clock_mps : float
        Random walk of the clock, m/sqrt(s).
    wet_m : float
        Zenith wet delay at the first epoch.
    clock_interval_s : float
        How far apart the samples of the satellites' clocks are: between them clocks walk
        (`NoiseModel.satellite_clock_m`) and predictions are linear. Zero: clocks are exact.
    """

    noise: NoiseModel = field(default_factory=lambda: PPP)
    mask_rad: float = float(np.deg2rad(7.0))
    clock_mps: float = 3.0
    wet_m: float = 0.15
    clock_interval_s: float = 0.0


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of each epoch and satellite, (n, m), and of the receiver, (n,); node times (n, 2)."""

    code_m: FloatArray
    carrier_m: FloatArray
    clock_m: FloatArray
    wet_m: FloatArray
    satellite_m: FloatArray
    node_s: FloatArray


def simulate_precise(
    states: States, sats: Sequence[str], t_ns: npt.NDArray[np.int64], track_m: FloatArray,
    receiver: PreciseReceiver, rng: np.random.Generator,
) -> tuple[Epoch, ...]:  # fmt: skip
    """Return what a receiver on a track would hand to a precise estimator.

    Parameters
    ----------
    states : callable
        Satellite positions and clocks (`physics.precise.precise_states`, `physics.orbits.satellite_states`).
    sats : sequence of str
        Satellites, in view or not.
    t_ns : ndarray of int64, shape (n,)
    track_m : ndarray, shape (n, 3)
        True positions of the antenna.
    receiver : PreciseReceiver
    rng : numpy.random.Generator

    Returns
    -------
    tuple of Epoch
        Observations ``"code"`` and ``"carrier"``, as `physics.precise_epochs` gives them.
    """
    names, found, el = placed(states, sats, t_ns, track_m)
    errors = _errors(receiver, tuple(sats), t_ns, el, rng)
    return tuple(
        _epoch(k, int(t), track_m[k], names, found, errors, receiver) for k, t in enumerate(t_ns.tolist())
    )


def placed(
    states: States, sats: Sequence[str], t_ns: npt.NDArray[np.int64], track_m: FloatArray
) -> tuple[npt.NDArray[np.str_], SatelliteStates, FloatArray]:
    """Return names of satellites (m,), where they were at emission (n * m, epoch by epoch), and elevations
    (n, m).
    """
    names = np.array(sats, dtype="<U3")
    travel = np.full((len(t_ns), len(sats)), 0.075 * C_MPS)
    for _ in range(3):  # a pass shrinks the error by the speed of satellites over that of light
        found = states(np.tile(names, len(t_ns)), np.repeat(t_ns, len(sats)), travel.ravel())
        position = found.position_m.reshape(len(t_ns), len(sats), 3)
        travel = np.stack([geometry(x, sv).range_m for x, sv in zip(track_m, position, strict=True)])
        travel = np.where(np.isfinite(travel), travel, 0.075 * C_MPS)
    return names, found, _elevations(track_m, position)


def _elevations(track_m: FloatArray, position_m: FloatArray) -> FloatArray:
    """Return elevations (n, m); -pi/2 of satellites without a place."""
    out = np.full(position_m.shape[:2], -0.5 * np.pi)
    for k, (place, sv) in enumerate(zip(track_m, position_m, strict=True)):
        known = np.isfinite(sv).all(axis=1)
        out[k, known] = elevation_azimuth(place, geometry(place, sv[known]).los)[0]
    return out


def _errors(
    receiver: PreciseReceiver, sats: tuple[str, ...], t_ns: npt.NDArray[np.int64], el_rad: FloatArray,
    rng: np.random.Generator,
) -> _Errors:  # fmt: skip
    """Draw all errors as the estimator's model has them."""
    noise, (n, m) = receiver.noise, el_rad.shape
    dt = np.diff(t_ns, prepend=t_ns[:1]) * 1e-9
    root = np.sqrt(dt)[:, None]
    zenith = noise.scale(el_rad, np.full(m, CN0_DBHZ))
    fast, phase, slow, steps = rng.standard_normal((4, n, m))
    code = fast * noise.code_white_m * noise.code_factor(sats) * zenith
    code = code + gauss_markov(dt, slow, noise.code_bias_tau_s) * noise.code_bias_m * (
        noise.obliquity(el_rad) * noise.bias_factor(sats)
    )
    code = code + np.array([s[0] == "R" for s in sats]) * noise.glonass_code_bias_m * rng.standard_normal(m)
    size = noise.carrier_factor(sats) / np.sin(np.maximum(el_rad, 0.05))
    walk = np.cumsum(root * steps * noise.ambiguity_m * size, axis=0)
    carrier = phase * noise.carrier_m * noise.carrier_factor(sats) * zenith + walk
    common = root * rng.standard_normal((n, 2)) * (receiver.clock_mps, noise.zwd_walk_m)
    clock, wet = np.cumsum(common, axis=0).T
    return _Errors(
        code, carrier + 20.0 * rng.standard_normal(m), 500.0 + clock, receiver.wet_m + wet,
        *bridges(receiver, sats, t_ns, rng),
    )  # fmt: skip


def bridges(
    receiver: PreciseReceiver, sats: tuple[str, ...], t_ns: npt.NDArray[np.int64], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return what linear interpolation leaves of the satellites' clocks (n, m), and the times from and to
    their samples (n, 2).
    """
    step = round(receiver.clock_interval_s * 1e9)
    if not step:
        return np.zeros((len(t_ns), len(sats))), np.zeros((len(t_ns), 2))
    nodes = np.arange(t_ns[0] // step, t_ns[-1] // step + 2) * step
    grid = np.union1d(nodes, t_ns)
    size = receiver.noise.satellite_clock_m * receiver.noise.satellite_clock_factor(sats)
    steps = np.sqrt(np.diff(grid, prepend=grid[:1]) * 1e-9)[:, None]
    walk = np.cumsum(steps * rng.standard_normal((len(grid), len(sats))), axis=0) * size
    at = np.searchsorted(grid, nodes)
    line = np.stack([np.interp(grid, nodes, w[at]) for w in walk.T], axis=1)
    since = (t_ns % step) * 1e-9
    apart = np.stack([since, receiver.clock_interval_s - since], axis=1)
    return (walk - line)[np.searchsorted(grid, t_ns)], apart


def in_view(
    k: int, n: int, place_m: FloatArray, found: SatelliteStates, mask_rad: float
) -> tuple[slice, Geometry, FloatArray, npt.NDArray[np.intp]]:
    """Return the rows of epoch `k` of `n` satellites, their geometry and elevations, and which are in
    view.
    """
    row = slice(k * n, (k + 1) * n)
    sv, ok = found.position_m[row], found.ok[row]
    g = geometry(place_m, np.where(ok[:, None], sv, 2.0 * place_m))
    el, _ = elevation_azimuth(place_m, g.los)
    return row, g, el, np.flatnonzero(ok & (el >= mask_rad))


def _epoch(
    k: int, t_ns: int, place_m: FloatArray, names: npt.NDArray[np.str_], found: SatelliteStates,
    errors: _Errors,
    receiver: PreciseReceiver,
) -> Epoch:  # fmt: skip
    """Return one epoch: the satellites above the mask."""
    row, g, el, seen = in_view(k, len(names), place_m, found, receiver.mask_rad)
    sv, clk = found.position_m[row], found.clock_m[row]
    keys = [f"{names[i]}:C{PAIRS[names[i][0]].replace('+', '+C')}" for i in seen]
    dry, wet = mapping_factors(place_m, el[seen], t_ns)
    air = zenith_delays_m(place_m)[0] * dry + errors.wet_m[k] * wet
    path = g.range_m[seen] - clk[seen] - errors.satellite_m[k, seen] + errors.clock_m[k] + air
    cn0 = np.full(len(seen), CN0_DBHZ)
    aux = {
        "sv_pos_m": sv[seen], "sv_vel_mps": found.velocity_mps[row][seen], "sv_clk_m": clk[seen],
        "sv_clk_rate_mps": found.clock_rate_mps[row][seen], "sv_var_m2": found.variance_m2[row][seen],
        "freq_hz": np.full(len(seen), 1.57542e9), "cn0_dbhz": cn0, "iono_factor": np.zeros(len(seen)),
        "clk_node_s": np.tile(errors.node_s[k], (len(seen), 1)),
    }  # fmt: skip
    phases = tuple(key.replace(":C", ":L").replace("+C", "+L") for key in keys)
    return Epoch(
        t_ns,
        (
            Observation("code", t_ns, tuple(keys), path + errors.code_m[k, seen], None, aux),
            Observation("carrier", t_ns, phases, path + errors.carrier_m[k, seen], None, aux),
        ),
    )
