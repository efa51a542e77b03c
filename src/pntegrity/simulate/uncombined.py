"""A simulated receiver for PPP-RTK: rows of each band apart, slant delays, and products of the atmosphere.

As `simulate.precise`, with the errors of a `NoiseModel`: of the variance of code and carrier a part is
correlated, and so are errors of products, over their times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.physics.orbits import SatelliteStates
from pntegrity.physics.signals import frequency_hz
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.precise import CN0_DBHZ, PreciseReceiver, States, bridges, in_view, placed
from pntegrity.simulate.receiver import gauss_markov

__all__ = ["Air", "Uncombined", "simulate_uncombined"]

SIGNALS = {"G": ("1C", "2W"), "R": ("1C", "2C"), "E": ("1C", "5Q"), "C": ("2I", "6I"), "J": ("1C", "2L")}


@dataclass(frozen=True)
class Air:
    """The atmosphere, and what products say of it.

    Parameters
    ----------
    zenith_m : float
        Delay of the ionosphere on the first frequency towards the zenith; slant delays walk about it
        (`NoiseModel.iono_walk_m`).
    iono_m, wet_m : float
        Standard deviations of the products' errors; 0: no such products.
    offset_m : float
        Standard deviation of what the ionosphere products of a constellation share at an epoch.
    total : bool
        The product of the troposphere is the total delay, not the wet one.
    """

    zenith_m: float = 3.0
    iono_m: float = 0.2
    wet_m: float = 0.1
    offset_m: float = 5.0
    total: bool = False


@dataclass(frozen=True, eq=False)
class Uncombined:
    """What was simulated, and the truth.

    Parameters
    ----------
    epochs : tuple of Epoch
    sats : tuple of str
    slant_m : ndarray, shape (n, m)
        Delays on the first frequency.
    wet_m : ndarray, shape (n,)
        Zenith wet delay.
    ambiguity_m : ndarray, shape (n, m, 2)
        On each band, with their walk.
    """

    epochs: tuple[Epoch, ...]
    sats: tuple[str, ...]
    slant_m: FloatArray
    wet_m: FloatArray
    ambiguity_m: FloatArray


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Errors and truth: (n, m, 2) of code and carrier, (n, m) of slants and products, (n,) of the rest."""

    code_m: FloatArray
    carrier_m: FloatArray
    slant_m: FloatArray
    product_m: FloatArray
    clock_m: FloatArray
    wet_m: FloatArray
    wet_product_m: FloatArray
    satellite_m: FloatArray
    node_s: FloatArray
    factor: FloatArray = field(default_factory=lambda: np.zeros(0))


def simulate_uncombined(
    states: States, sats: Sequence[str], t_ns: npt.NDArray[np.int64], track_m: FloatArray,
    receiver: PreciseReceiver, rng: np.random.Generator, air: Air | None = None,
) -> Uncombined:  # fmt: skip
    """Return what a receiver on a track would hand to `ppp_rtk`, and the truth.

    Parameters
    ----------
    states, sats, t_ns, track_m, receiver, rng
        As for `simulate_precise`; `receiver.noise` is a model like `PPP_RTK`.
    air : Air, optional
    """
    air = air or Air()
    names, found, el = placed(states, sats, t_ns, track_m)
    freq = np.array([[frequency_hz(s, signal, 0) for signal in SIGNALS[s[0]]] for s in sats])
    drawn, ambiguity = _draw(receiver, tuple(sats), t_ns, el, air, (freq[:, :1] / freq) ** 2, rng)
    epochs = tuple(
        _epoch(k, int(t), track_m[k], names, found, drawn, receiver, air, freq)
        for k, t in enumerate(t_ns.tolist())
    )
    return Uncombined(epochs, tuple(sats), drawn.slant_m, drawn.wet_m, ambiguity)


def _draw(
    receiver: PreciseReceiver, sats: tuple[str, ...], t_ns: npt.NDArray[np.int64], el_rad: FloatArray,
    air: Air, factor: FloatArray, rng: np.random.Generator,
) -> tuple[_Drawn, FloatArray]:  # fmt: skip
    noise, (n, m) = receiver.noise, el_rad.shape
    dt = np.diff(t_ns, prepend=t_ns[:1]) * 1e-9
    root = np.sqrt(dt)[:, None]
    zenith = noise.scale(el_rad, np.full(m, CN0_DBHZ))[:, :, None]
    code = _correlated(dt, noise, rng, (n, m, 2)) * noise.code_white_m * zenith
    carrier = _correlated(dt, noise, rng, (n, m, 2)) * noise.carrier_m * zenith
    size = noise.carrier_factor(sats) / np.sin(np.maximum(el_rad, 0.05)) * noise.ambiguity_m
    walk = np.cumsum((root * size)[:, :, None] * rng.standard_normal((n, m, 2)), axis=0)
    ambiguity = 20.0 * rng.standard_normal((m, 2)) + walk
    slant = air.zenith_m / np.sin(np.maximum(el_rad, 0.3))
    slant = slant[:1] + np.cumsum(root * rng.standard_normal((n, m)) * noise.iono_walk_m, axis=0)
    common = np.cumsum(root * rng.standard_normal((n, 2)) * (receiver.clock_mps, noise.zwd_walk_m), axis=0)
    wet = receiver.wet_m + common[:, 1]
    letters = sorted({s[0] for s in sats})
    offset = air.offset_m * rng.standard_normal((n, len(letters)))[:, [letters.index(s[0]) for s in sats]]
    product = slant + offset + air.iono_m * _product_errors(dt, noise, rng, (n, m))
    wet_product = wet + air.wet_m * _product_errors(dt, noise, rng, (n, 1))[:, 0]
    drawn = _Drawn(
        code * noise.code_factor(sats)[:, None] + factor * slant[:, :, None],
        carrier * noise.carrier_factor(sats)[:, None] + ambiguity - factor * slant[:, :, None],
        slant, product, 500.0 + common[:, 0], wet, wet_product, *bridges(receiver, sats, t_ns, rng), factor,
    )  # fmt: skip
    return drawn, ambiguity


def _correlated(
    dt: FloatArray, noise: NoiseModel, rng: np.random.Generator, shape: tuple[int, ...]
) -> FloatArray:
    """Return errors of unit variance of which a part is correlated."""
    fast, slow = rng.standard_normal((2, *shape))
    f = noise.correlated_part
    return np.asarray(np.sqrt(1.0 - f) * fast + np.sqrt(f) * gauss_markov(dt, slow, noise.correlated_tau_s))


def _product_errors(
    dt: FloatArray, noise: NoiseModel, rng: np.random.Generator, shape: tuple[int, ...]
) -> FloatArray:
    """Return errors of products, in units of what they state."""
    fast, slow = rng.standard_normal((2, *shape))
    if noise.product_tau_s == 0.0:
        return np.asarray(fast)
    return np.asarray(gauss_markov(dt, slow, noise.product_tau_s) + noise.product_white * fast)


def _epoch(
    k: int, t_ns: int, place_m: FloatArray, names: npt.NDArray[np.str_], found: SatelliteStates,
    drawn: _Drawn, receiver: PreciseReceiver, air: Air, freq_hz: FloatArray,
) -> Epoch:  # fmt: skip
    """Return one epoch: the satellites above the mask, two rows each of code and carrier."""
    row, g, el, seen = in_view(k, len(names), place_m, found, receiver.mask_rad)
    sv, clk = found.position_m[row], found.clock_m[row]
    dry, wet = mapping_factors(place_m, el[seen], t_ns)
    path = g.range_m[seen] - clk[seen] - drawn.satellite_m[k, seen] + drawn.clock_m[k]
    path = path + zenith_delays_m(place_m)[0] * dry + drawn.wet_m[k] * wet
    both = seen.repeat(2)
    aux = {
        "sv_pos_m": sv[both], "sv_vel_mps": found.velocity_mps[row][both], "sv_clk_m": clk[both],
        "sv_clk_rate_mps": found.clock_rate_mps[row][both], "sv_var_m2": found.variance_m2[row][both],
        "freq_hz": freq_hz[seen].ravel(), "cn0_dbhz": np.full(len(both), CN0_DBHZ),
        "iono_factor": drawn.factor[seen].ravel(), "clk_node_s": np.tile(drawn.node_s[k], (len(both), 1)),
    }  # fmt: skip
    keys = [tuple(f"{names[i]}:{x}{s}" for i in seen for s in SIGNALS[names[i][0]]) for x in "CL"]
    y = [(path[:, None] + e[k, seen]).ravel() for e in (drawn.code_m, drawn.carrier_m)]
    signals = [
        Observation(sensor, t_ns, key, value, None, aux)
        for sensor, key, value in zip(("code", "carrier"), keys, y, strict=True)
    ]
    products = _products(k, t_ns, names[seen].tolist(), seen, drawn, air, zenith_delays_m(place_m)[0])
    return Epoch(t_ns, (*signals, *products))


def _products(
    k: int, t_ns: int, sats: list[str], seen: npt.NDArray[np.intp], drawn: _Drawn, air: Air, dry_m: float
) -> tuple[Observation, ...]:
    """Return the observation of the atmosphere, none where there are no products."""
    keys = [f"iono:{s}" for s in sats] if air.iono_m else []
    y = drawn.product_m[k, seen].tolist() if air.iono_m else []
    sigma = [air.iono_m] * len(keys)
    if air.wet_m:
        keys.append("trop:ZTD" if air.total else "trop:ZWD")
        y.append(drawn.wet_product_m[k] + (dry_m if air.total else 0.0))
        sigma.append(air.wet_m)
    if not keys:
        return ()
    return (Observation("atmosphere", t_ns, tuple(keys), np.array(y), np.array(sigma)),)
