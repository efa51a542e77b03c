"""Protection levels: how large an error can be, at a given risk, where solution separation alerts on nothing.

A protection level is the root of a sum of normal tails: that of no fault, and one for each fault mode, times
the mode's probability. The sum falls with the level, so that a bracketed Newton step on its logarithm finds
the root in a few evaluations, to rounding and not to some centimetres.

Symbols: ``e_0`` is the error of the full solution (standard deviation ``sigma0``), ``e_i`` that of the
solution without what mode ``i`` may have spoilt (``sigma``), their difference the separation (``sigma_ss``),
which is tested against a ``threshold``.
"""

from __future__ import annotations

from functools import lru_cache
from math import inf

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.kernels.risk_roots import largest_term, least_root, level_root, observed_root

FloatArray = npt.NDArray[np.float64]

__all__ = [
    "dominant_mode", "false_alert_factor", "largest_threshold", "least_level", "observed_level",
    "protection_level",
]  # fmt: skip


@lru_cache(maxsize=1024)
def false_alert_factor(p_fa: float, modes: int) -> float:
    """Return the factor of the standard deviation that a separation exceeds, in any of some modes, with at
    most `p_fa`: ``Q^-1(p_fa / (2 modes))``; inf without modes.

    References
    ----------
    Equation (12) of the PPP-RTK paper; equation (18) of the ARAIM reference algorithm (WG-C, ADD v3.1).
    """
    return float(-special.ndtri(0.5 * p_fa / modes)) if modes else inf


def protection_level(
    risk: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    threshold: npt.ArrayLike,
) -> float:
    """Return the level that the error of the full solution exceeds, without an alert, with at most `risk`.

    The root of ``risk = 2 Q((PL - bias0) / sigma0) + sum_i p_i Q((PL - threshold_i - bias_i) / sigma_i)``, to
    1e-12 of itself.

    Parameters
    ----------
    risk : float
        Probability for this direction and epoch, that of unmonitored modes already taken off.
    sigma0, bias0 : float
        Standard deviation of the full solution and the largest nominal bias in it, m.
    p : array_like, shape (n,)
        Probabilities of the modes.
    sigma, bias, threshold : array_like, shape (n,)
        Of each mode's solution, m. Where one is not finite the mode is one that nothing detects: its whole
        probability is taken off the risk.

    Returns
    -------
    float
        m; inf where the risk is used up or `sigma0` is not finite.

    Raises
    ------
    ValueError
        Where a probability is not one.

    References
    ----------
    Equation (14) of the PPP-RTK paper. Blanch et al. (2015), Baseline advanced RAIM user algorithm and
    possible improvements, IEEE Trans. Aerosp. Electron. Syst. 51, 713-732.
    """
    reach = _array(threshold) + _array(bias)
    return float(level_root(float(risk), float(sigma0), float(bias0), _array(p), _array(sigma), reach))


def observed_level(
    risk: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    expected: npt.ArrayLike,
    apart: npt.ArrayLike,
) -> tuple[float, int]:
    """Return the level that the error of the full solution exceeds with at most `risk`, without any test of
    separations, and the mode that makes it as large as it is (-1: no fault does).

    ``PL = L + max_i (|d_i| - c_i)^+``, where ``d_i`` is the separation observed (`apart`), ``c_i`` the one
    `expected`, fixed before the data, and ``L`` the root of ``risk = 2 Q((L - bias0) / sigma0) + 2 sum_i p_i
    Q((L - c_i - bias_i) / sigma_i)``.

    It holds for any faults and separations, however these and the errors are correlated. Where mode ``i``
    happened, ``|e_0| <= |d_i| + |e_i|`` and ``PL - |d_i| >= L - c_i``, so that ``P(|e_0| > PL) <= P(|e_i| >
    L - c_i) <= 2 Q((L - c_i - bias_i) / sigma_i)``. Without a fault ``PL >= L`` gives ``2 Q((L - bias0) /
    sigma0)``. These, times the probabilities of the modes, add up to `risk`. What is expected only moves
    shares of the risk between modes. It must not depend on the data: with ``d_i`` in place of ``c_i`` in the
    sum the error is compared with a limit that knows it (measured: up to twice the risk).

    Parameters
    ----------
    risk, sigma0, bias0, p, sigma, bias
        As for `protection_level`.
    expected, apart : array_like, shape (n,)
        m. Of a mode that nothing detects they do not count.

    Returns
    -------
    level : float
        m; inf where the risk is used up or `sigma0` is not finite.
    mode : int
    """
    parts = (_array(a) for a in (p, sigma, bias, expected, apart))
    level, mode = observed_root(float(risk), float(sigma0), float(bias0), *parts)
    return float(level), int(mode)


def least_level(
    risk: float, sigma0: float, p: npt.ArrayLike, sigma_ss: npt.ArrayLike, threshold: npt.ArrayLike
) -> float:
    """Return the level below which the test of separations cannot keep `risk`, whatever formula is used.

    The exact risk at the fault that is worst for each mode. The error of an optimal full solution and a
    separation are independent, and a fault moves both by the same ``b``, so that mode ``i`` adds
    ``p_i max_b [Q((L - b) / sigma0) + Q((L + b) / sigma0)] P(|b + sigma_ss u| <= threshold)``. The level is
    exact for one separation a mode; nominal biases are left out.

    Parameters
    ----------
    risk, sigma0, p, threshold
        As for `protection_level`.
    sigma_ss : array_like, shape (n,)
        Standard deviations of the separations, m: those of the modes' solutions are
        ``sqrt(sigma0^2 + sigma_ss^2)``.

    Returns
    -------
    float
        m; never above `protection_level` of the same modes.
    """
    return float(least_root(float(risk), float(sigma0), _array(p), _array(sigma_ss), _array(threshold)))


def dominant_mode(
    level: float,
    sigma0: float,
    bias0: float,
    p: npt.ArrayLike,
    sigma: npt.ArrayLike,
    bias: npt.ArrayLike,
    threshold: npt.ArrayLike,
) -> int:
    """Return the mode that adds most to the risk at a protection level; -1: no fault does.

    Where the level is inf it is the most probable of the modes that nothing detects. Parameters as for
    `protection_level`.
    """
    reach = _array(threshold) + _array(bias)
    return int(largest_term(float(level), float(sigma0), float(bias0), _array(p), _array(sigma), reach))


def largest_threshold(p: npt.ArrayLike, threshold: npt.ArrayLike, p_least: float) -> float:
    """Return the effective monitor threshold: the largest of the modes at least as probable as `p_least`; 0
    where there is none.

    References
    ----------
    WG-C, ADD v3.1, section on the effective monitor threshold (there ``p_least`` is 1e-5).
    """
    return float(_array(threshold)[_array(p) >= p_least].max(initial=0.0))


def _array(a: npt.ArrayLike) -> FloatArray:
    return np.ascontiguousarray(a, dtype=np.float64)
