"""States of precise positioning: how they are named, step from epoch to epoch, and are born."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pntegrity.estimators._carrier import CLOCKS, Names, PreciseRows, clock_of
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
#: The same of what ionosphere products share: it may be anything.
OFFSET_M = 1000.0
#: Standard deviation of a product that pauses: above those that products state, m.
PAUSED_M = 0.5
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
    kinds = (*biased, noise.gradient_m > 0.0, drifting, noise.product_tau_s > 0.0)
    return _layout(old, options.motion, rows.names, kinds)


@lru_cache(maxsize=512)
def _layout(old: Layout, motion: str, names: Names, kinds: tuple[bool, bool, bool, bool, bool]) -> Layout:
    biased, glonass, gradients, drifting, remembered = kinds
    seen = sorted({clock_of(k) for k, c in zip(names.keys, names.code, strict=True) if c}, key=CLOCKS.index)
    clock = clock_name(old) if len(old) else f"clk:{seen[0]}"
    isb = [n for n in old.names if n.startswith("isb:")]
    isb += [n for s in seen if (n := f"isb:{s}") not in isb and s != clock[4:]]
    tilt = ["grad:n", "grad:e"] if gradients else []
    bias = [b for b, g in zip(names.bias, names.glonass, strict=True) if b and (biased or (glonass and g))]
    moving = _each(names.satellite_clock) if drifting else ()
    slant = _each(names.ionosphere)
    given = (*_each(names.offset), *(_remembered(old, names, slant) if remembered else ()))
    arcs = _each(names.ambiguity)
    return Layout((
        *motion_names(motion), clock, *isb, "zwd", *tilt, *bias, *moving, *slant, *given, *arcs,
    ))  # fmt: skip


def _each(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of states that rows have, each once."""
    return tuple(n for n in dict.fromkeys(names) if n)


def _remembered(old: Layout, names: Names, slant: tuple[str, ...]) -> tuple[str, ...]:
    """Return the products whose errors have a state: also those that pause while their satellite goes on."""
    kept = [n for n in old.names if n == "prod:trop" or n.replace("prod:iono", "ion") in slant]
    return _each((*names.product, *(n for n in kept if n.startswith("prod:"))))


def stationary_variance(layout: Layout, rows: PreciseRows, options: GnssOptions) -> FloatArray:
    """Return the variance of each state where nothing is known of it yet."""
    noise = options.noise
    first = {
        "pos": START_POS_M**2, "vel": START_VEL_MPS**2, "clk": CLOCK_M**2, "isb": CLOCK_M**2,
        "zwd": noise.zwd_m**2, "grad": noise.gradient_m**2, "amb": BORN_M**2, "ion": BORN_M**2,
        "off": OFFSET_M**2,
    }  # fmt: skip
    out = np.zeros(len(layout))
    for block, variance in first.items():
        out[layout.block(block)] = variance
    at = columns(layout, rows.names.bias)
    out[at[at >= 0]] = _bias_variance(rows, noise)[at >= 0]
    at = columns(layout, rows.names.satellite_clock)
    out[at[at >= 0]] = satellite_clock_variance(rows, noise)[at >= 0]
    at = columns(layout, rows.names.product)
    out[at[at >= 0]] = rows.slow[at >= 0] ** 2
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
    _products(F, walk, new, rows, dt, noise)
    if len(born):
        walk[born] = stationary_variance(new, rows, options)[born]
    for block, size in (("clk", CLOCK_M), ("off", OFFSET_M)):
        white = new.block(block)
        F[white], walk[white] = 0.0, size**2
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


def _products(
    F: FloatArray, walk: FloatArray, layout: Layout, rows: PreciseRows, dt: float, noise: NoiseModel
) -> None:
    """Write the step of the errors of atmosphere products, first-order Gauss-Markov processes.

    Where a product pauses nobody states its standard deviation: a large one bounds the drive.
    """
    held = layout.block("prod")
    if not len(held):
        return
    kept = np.exp(-dt / noise.product_tau_s)
    F[held] *= kept
    walk[held] = PAUSED_M**2 * (1.0 - kept**2)
    at = columns(layout, rows.names.product)
    here = at >= 0
    walk[at[here]] = rows.slow[here] ** 2 * (1.0 - kept**2)


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
    here = at >= 0
    if not here.any():
        return
    at, since, until = at[here], *rows.node_s[here].T
    goes_on = (since >= dt) & F[at].any(axis=1)
    left = until / np.maximum(until + dt, 1e-9)
    F[at] *= np.where(goes_on, left, 0.0)[:, None]
    spectral = (noise.satellite_clock_factor(rows.keys)[here] * noise.satellite_clock_m) ** 2
    walk[at] = np.where(goes_on, spectral * dt * left, satellite_clock_variance(rows, noise)[here])


def _walks(noise: NoiseModel) -> tuple[tuple[str, float], ...]:
    return (
        ("isb", noise.isb_m), ("zwd", noise.zwd_walk_m), ("grad", noise.gradient_walk_m),
        ("ion", noise.iono_walk_m),
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
    slanted = rows.names.slanted
    if len(slanted):
        H[slanted, columns(layout, rows.names.ionosphere)[slanted]] = rows.iono[slanted]
    H.flags.writeable = False
    rows.__dict__["jacobian"] = layout, H
    return H


@lru_cache(maxsize=64)
def _template(layout: Layout, names: Names) -> FloatArray:
    """Return the part of a Jacobian that geometry does not change: clocks, biases, ambiguities."""
    H = np.zeros((len(names.keys), len(layout)))
    H[:, layout.block("clk")[0]] = names.code | names.carrier
    ones = (names.isb, names.bias, names.satellite_clock, names.ambiguity, names.offset, names.product)
    for states in ones:
        at: IndexArray = columns(layout, states)
        here = np.flatnonzero(at >= 0)
        H[here, at[here]] = 1.0
    H.flags.writeable = False
    return H
