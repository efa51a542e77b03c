"""States of precise positioning: how they are named, step from epoch to epoch, and are born."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pntegrity.estimators._carrier import CLOCKS, Names, PreciseRows, clock_of, names_of
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._layout import IndexArray, columns, survivors
from pntegrity.estimators._navigation import MOTION, START_POS_M, START_VEL_MPS
from pntegrity.records import FloatArray, Layout
from pntegrity.sensors.noise import NoiseModel

__all__ = [
    "BORN_M", "clock_name", "jacobian", "layout_of", "motion_names", "stationary_variance", "transition",
]  # fmt: skip

#: Standard deviation of ambiguities and of a position without memory, which the data initialise, m.
BORN_M = 100.0
#: The same of clocks: ten times the error of a median of code, and no more, for the sake of numerics.
CLOCK_M = 30.0
#: Satellite clocks sampled further apart than this have a state each, s.
OFTEN_S = 60.0


def motion_names(motion: str) -> tuple[str, ...]:
    """Return the names of the states of motion."""
    return MOTION if motion == "velocity" else MOTION[:3]


def clock_name(layout: Layout) -> str:
    """Return the name of the receiver clock, to which inter-system biases refer."""
    return layout.names[int(layout.block("clk")[0])]


def layout_of(old: Layout, rows: PreciseRows, options: GnssOptions) -> Layout:
    """Return the layout after `old` with these rows: constellations stay, arcs and code biases come and
    go.
    """
    noise = options.noise
    biased = noise.code_bias_m > 0.0, noise.glonass_code_bias_m > 0.0
    drifting = bool(rows.node_s.sum(axis=1).max(initial=0.0) > OFTEN_S) and noise.satellite_clock_m > 0.0
    kinds = (*biased, noise.gradient_m > 0.0, drifting)
    return _layout(old, options.motion, rows.keys, rows.names.ambiguity, kinds)


@lru_cache(maxsize=512)
def _layout(
    old: Layout, motion: str, keys: tuple[str, ...], ambiguity: tuple[str, ...],
    kinds: tuple[bool, bool, bool, bool],
) -> Layout:  # fmt: skip
    biased, glonass, gradients, drifting = kinds
    names = names_of(keys, ambiguity)
    code = [k for k, a in zip(keys, ambiguity, strict=True) if not a]
    seen = sorted({clock_of(k) for k in code}, key=CLOCKS.index)
    clock = clock_name(old) if len(old) else f"clk:{seen[0]}"
    isb = [n for n in old.names if n.startswith("isb:")]
    isb += [n for s in seen if (n := f"isb:{s}") not in isb and s != clock[4:]]
    tilt = ["grad:n", "grad:e"] if gradients else []
    bias = [b for b, g in zip(names.bias, names.glonass, strict=True) if b and (biased or (glonass and g))]
    moving = dict.fromkeys(names.satellite_clock) if drifting else ()
    arcs = (a for a in ambiguity if a)
    return Layout((*motion_names(motion), clock, *isb, "zwd", *tilt, *bias, *moving, *arcs))


def stationary_variance(layout: Layout, rows: PreciseRows, options: GnssOptions) -> FloatArray:
    """Return the variance of each state where nothing is known of it yet."""
    noise = options.noise
    first = {
        "pos": START_POS_M**2, "vel": START_VEL_MPS**2, "clk": CLOCK_M**2, "isb": CLOCK_M**2,
        "zwd": noise.zwd_m**2, "grad": noise.gradient_m**2, "amb": BORN_M**2,
    }  # fmt: skip
    out = np.zeros(len(layout))
    for block, variance in first.items():
        out[layout.block(block)] = variance
    at = columns(layout, rows.names.bias)
    out[at[at >= 0]] = _bias_variance(rows, noise)[at >= 0]
    at = columns(layout, rows.names.satellite_clock)
    out[at[at >= 0]] = satellite_clock_variance(rows, noise)[at >= 0]
    return out


def _bias_variance(rows: PreciseRows, noise: NoiseModel) -> FloatArray:
    """Return the variance of each row's slow code error."""
    return np.asarray(
        (noise.code_bias_m * rows.slow) ** 2 + rows.names.glonass * noise.glonass_code_bias_m**2
    )


def transition(
    old: Layout, new: Layout, dt: float, rows: PreciseRows, options: GnssOptions
) -> tuple[FloatArray, FloatArray]:
    """Return the rectangular `F` and the `Q` of a step; clocks and what is born have only `Q`."""
    noise = options.noise
    n = len(new)
    to, source, born = survivors(old, new)
    F = np.zeros((n, len(old)))
    F[to, source] = 1.0
    walk = np.zeros(n)
    for block, size in _walks(noise):
        walk[new.block(block)] = size**2 * dt
    _satellite_errors(F, walk, new, rows, dt, noise)
    if len(born):
        walk[born] = stationary_variance(new, rows, options)[born]
    clock = new.block("clk")
    F[clock], walk[clock] = 0.0, CLOCK_M**2
    _satellite_clocks(F, walk, new, rows, dt, noise)
    Q = np.diag(walk)
    _motion(F, Q, dt, options)
    return F, Q


def _satellite_errors(
    F: FloatArray, walk: FloatArray, layout: Layout, rows: PreciseRows, dt: float, noise: NoiseModel
) -> None:
    """Write the step of ambiguities, which walk more towards the horizon, and of code biases.

    A GLONASS bias has a constant part that does not decay: all of it walks as the other part would.
    """
    at = columns(layout, rows.names.ambiguity)
    arc = at >= 0
    size = noise.ambiguity_m * noise.carrier_factor(rows.keys) / np.sin(np.maximum(rows.el_rad, 0.05))
    walk[at[arc]] = size[arc] ** 2 * dt
    at = columns(layout, rows.names.bias)
    here = at >= 0
    kept = np.exp(-dt / noise.code_bias_tau_s)
    walk[at[here]] = (noise.code_bias_m * rows.slow[here]) ** 2 * (1.0 - kept**2)
    constant = rows.names.glonass[here] & (noise.glonass_code_bias_m > 0.0)
    F[at[here]] *= np.where(constant, 1.0, kept)[:, None]


def satellite_clock_variance(rows: PreciseRows, noise: NoiseModel) -> FloatArray:
    """Return the variance of clocks that walk between two samples on which they are pinned (a Brownian
    bridge).
    """
    since, until = rows.node_s.T
    spectral = (noise.satellite_clock_factor(rows.keys) * noise.satellite_clock_m) ** 2
    return np.asarray(spectral * since * until / np.maximum(since + until, 1e-9))


def _satellite_clocks(
    F: FloatArray, walk: FloatArray, layout: Layout, rows: PreciseRows, dt: float, noise: NoiseModel
) -> None:
    """Write the step of the satellites' clocks, which walk between samples and are right at each."""
    at = columns(layout, rows.names.satellite_clock)
    if not len(at) or at[0] < 0:
        return
    since, until = rows.node_s.T
    goes_on = (since >= dt) & F[at].any(axis=1)
    left = until / np.maximum(until + dt, 1e-9)
    F[at] *= np.where(goes_on, left, 0.0)[:, None]
    spectral = (noise.satellite_clock_factor(rows.keys) * noise.satellite_clock_m) ** 2
    walk[at] = np.where(goes_on, spectral * dt * left, satellite_clock_variance(rows, noise))


def _walks(noise: NoiseModel) -> tuple[tuple[str, float], ...]:
    return (
        ("isb", noise.isb_m), ("zwd", noise.zwd_walk_m), ("grad", noise.gradient_walk_m),
    )  # fmt: skip


def _motion(F: FloatArray, Q: FloatArray, dt: float, options: GnssOptions) -> None:
    noise = options.noise
    if options.motion == "velocity":
        spectral = noise.accel_mps2**2
        for i in range(3):
            F[i, i + 3] = dt
            Q[i, i], Q[i + 3, i + 3] = spectral * dt**3 / 3.0, spectral * dt
            Q[i, i + 3] = Q[i + 3, i] = spectral * dt**2 / 2.0
        return
    variance = {"white": BORN_M**2, "walk": noise.position_m**2 * dt, "static": 0.0}[options.motion]
    Q[range(3), range(3)] = variance


def jacobian(layout: Layout, rows: PreciseRows) -> FloatArray:
    """Return the Jacobian of the rows, shape (m, n), read-only; kept with the rows for this layout."""
    kept: tuple[Layout, FloatArray] | None = rows.__dict__.get("jacobian")
    if kept is not None and kept[0] is layout:
        return kept[1]
    H = _template(layout, rows.names).copy()
    H[:, :3] = -rows.los
    H[:, layout.index["zwd"]] = rows.wet
    tilt = layout.block("grad")
    if len(tilt):
        H[:, tilt[0]], H[:, tilt[1]] = rows.north, rows.east
    H.flags.writeable = False
    rows.__dict__["jacobian"] = layout, H
    return H


@lru_cache(maxsize=64)
def _template(layout: Layout, names: Names) -> FloatArray:
    """Return the part of a Jacobian that geometry does not change: clocks, biases, ambiguities."""
    H = np.zeros((len(names.keys), len(layout)))
    H[:, layout.block("clk")[0]] = 1.0
    for states in (names.isb, names.bias, names.satellite_clock, names.ambiguity):
        at: IndexArray = columns(layout, states)
        here = np.flatnonzero(at >= 0)
        H[here, at[here]] = 1.0
    H.flags.writeable = False
    return H
