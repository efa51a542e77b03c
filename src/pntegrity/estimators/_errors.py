"""The slow errors of each satellite's code as Gauss-Markov states: a bias, and multipath behind the
receiver's smoothing.

``bias:KEY`` is first order. ``mp:KEY`` is first order too, or second order where the receiver smooths its
code: then it is driven by ``mpin:KEY``, the multipath before smoothing. All start in their stationary
distribution.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pntegrity.estimators._layout import IndexArray, columns
from pntegrity.records import FloatArray, Layout
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import Rows

KINDS = ("bias", "mp", "mpin")


@lru_cache(maxsize=512)
def error_states(keys: tuple[str, ...], kinds: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the satellites' states."""
    return tuple(f"{kind}:{key}" for kind in kinds for key in keys)


def error_kinds(noise: NoiseModel) -> tuple[str, ...]:
    """Return which kinds of states a noise model has."""
    smoothed = noise.code_multipath_m > 0.0 and noise.code_smoothing_tau_s > 0.0
    present = (noise.code_bias_m > 0.0, noise.code_multipath_m > 0.0, smoothed)
    return tuple(kind for kind, here in zip(KINDS, present, strict=True) if here)


@lru_cache(maxsize=512)
def _places(layout: Layout, keys: tuple[str, ...]) -> tuple[IndexArray, ...]:
    return tuple(columns(layout, tuple(f"{kind}:{k}" for k in keys)) for kind in KINDS)


def _there(places: IndexArray) -> bool:
    """Tell whether a layout has these states (all of a kind or none)."""
    return bool(len(places)) and bool(places[0] >= 0)


def stationary(P: FloatArray, layout: Layout, rows: Rows, noise: NoiseModel) -> None:
    """Write the stationary covariance of the satellites' states into `P`."""
    bias, mp, mpin = _places(layout, rows.keys)
    if _there(bias):
        P[bias, bias] = (noise.code_bias_m * rows.slow) ** 2
    if _there(mp):
        variance = (noise.code_multipath_m * rows.scale) ** 2
        P[mp, mp] = variance
        if _there(mpin):
            P[mpin, mpin] = variance * (1.0 + noise.code_multipath_tau_s / noise.code_smoothing_tau_s)
            P[mp, mpin] = P[mpin, mp] = variance


def propagate(F: FloatArray, layout: Layout, rows: Rows, noise: NoiseModel, dt: float) -> None:
    """Write the transition of the satellites' states into `F`, whose columns are in the same layout."""
    bias, mp, mpin = _places(layout, rows.keys)
    if _there(bias):
        F[bias, bias] = np.exp(-dt / noise.code_bias_tau_s)
    if _there(mp):
        slow = np.exp(-dt / noise.code_multipath_tau_s)
        F[mp, mp] = slow
        if _there(mpin):
            fast = np.exp(-dt / noise.code_smoothing_tau_s)
            F[mpin, mpin] = fast
            F[mp, mpin] = (slow - fast) / (noise.code_multipath_tau_s / noise.code_smoothing_tau_s - 1.0)
