"""How sure a counted rate is."""

from __future__ import annotations

from scipy import special

__all__ = ["binomial_interval"]


def binomial_interval(k: int, n: int, confidence: float = 0.99) -> tuple[float, float]:
    """Return the exact two-sided interval of a probability, from `k` hits in `n` independent trials.

    Parameters
    ----------
    k, n : int
        Hits and trials, ``0 <= k <= n``. Without a trial the interval is (0, 1).
    confidence : float
        Probability with which the interval holds the true value, at least.

    References
    ----------
    Clopper and Pearson (1934), Biometrika 26, 404-413.

    Examples
    --------
    >>> low, high = binomial_interval(0, 1000, 0.99)
    >>> low, round(high, 5)
    (0.0, 0.00528)
    """
    if not 0 <= k <= n:
        raise ValueError(f"`k` must be between 0 and `n`, not {k} of {n}")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"`confidence` must be between 0 and 1, not {confidence}")
    half = 0.5 * (1.0 - confidence)
    low = 0.0 if k == 0 else float(special.betaincinv(k, n - k + 1, half))
    high = 1.0 if k == n else float(special.betaincinv(k + 1, n - k, 1.0 - half))
    return low, high
