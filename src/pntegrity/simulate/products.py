"""Errors of atmosphere products: what a network's products have, and those of the own receiver have not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere_products import AtmosphereProducts, Samples, metres_per_tecu
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import FloatArray
from pntegrity.simulate import receiver

__all__ = ["REFERENCE_HZ", "disturbed", "gauss_markov"]

REFERENCE_HZ = 1575.42e6
"""Frequency on which sizes of slant errors in metres are meant."""


def gauss_markov(
    t_ns: npt.NDArray[np.int64], sigma: float, tau_s: float, rng: np.random.Generator
) -> FloatArray:
    """Return a stationary first-order Gauss-Markov process at some times, shape (n,).

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Not falling.
    sigma : float
        Its standard deviation at each time.
    tau_s : float
        Correlation time; 0: white noise.
    rng : numpy Generator
    """
    drawn = rng.standard_normal((len(t_ns), 1))
    if tau_s <= 0.0:
        return np.asarray(sigma * drawn[:, 0])
    dt = np.diff(t_ns, prepend=t_ns[:1]) / SECOND_NS
    return np.asarray(sigma * receiver.gauss_markov(dt, drawn, tau_s)[:, 0])


def disturbed(
    products: AtmosphereProducts,
    sigma_iono_m: float,
    sigma_zwd_m: float,
    tau_s: float,
    rng: np.random.Generator,
) -> AtmosphereProducts:
    """Return products with errors added, independent from product to product, and their sigmas with them.

    Parameters
    ----------
    products : AtmosphereProducts
    sigma_iono_m, sigma_zwd_m : float
        Standard deviations of the errors: slant, on `REFERENCE_HZ`, and at the zenith; 0: none.
    tau_s : float
        Their correlation time; 0: white from sample to sample.
    rng : numpy Generator

    Raises
    ------
    ValueError
        Where a standard deviation or the time is below 0 or not finite.
    """
    for name, value in (("sigma_iono_m", sigma_iono_m), ("sigma_zwd_m", sigma_zwd_m), ("tau_s", tau_s)):
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"`{name}` must be at least 0, not {value}")
    tecu = sigma_iono_m / float(metres_per_tecu(REFERENCE_HZ))
    troposphere = _with_error(Samples(*products.troposphere), sigma_zwd_m, tau_s, rng)
    slant = {sat: _with_error(Samples(*s), tecu, tau_s, rng) for sat, s in products.ionosphere.items()}
    how = f"correlated over {tau_s:g} s" if tau_s > 0.0 else "white"
    told = f"errors added: slant {sigma_iono_m:g} m on L1, zenith {sigma_zwd_m:g} m, {how}"
    source = "; ".join(filter(None, (products.source, told)))
    return replace(products, ionosphere=slant, troposphere=troposphere, source=source)


def _with_error(samples: Samples, sigma: float, tau_s: float, rng: np.random.Generator) -> Samples:
    error = gauss_markov(samples.t_ns, sigma, tau_s, rng)
    return Samples(samples.t_ns, samples.value + error, np.hypot(samples.sigma, sigma))
