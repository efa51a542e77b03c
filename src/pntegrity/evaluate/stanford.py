"""Protection levels against true errors: the regions of the Stanford diagram.

An error is *within* a level where it is at most as large, and a level *serves* where it is finite and at most
the alert limit. The regions, in the order in which an epoch is put into one:

- alerted: an alert was given, so nothing was claimed.
- unknown: the true error is not known.
- unavailable: the level does not serve, and the error is within it. A level that is not there (nan) or
  unbounded (inf) does not serve.
- unavailable and misleading: the level does not serve, and the error is beyond it.
- normal operation: the level serves, and the error is within it.
- misleading: the level serves, and the error is beyond it, but within the alert limit.
- hazardously misleading: the level serves, and the error is beyond the alert limit.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from scipy import special

__all__ = ["Region", "Stanford", "plain_levels", "regions", "stanford"]


class Region(IntEnum):
    """Where an epoch stands in the diagram."""

    ALERTED = 0
    UNKNOWN = 1
    UNAVAILABLE = 2
    UNAVAILABLE_MISLEADING = 3
    NORMAL = 4
    MISLEADING = 5
    HAZARDOUS = 6


@dataclass(frozen=True)
class Stanford:
    """How many epochs stand in each region; the module's text defines them."""

    alerted: int = 0
    unknown: int = 0
    unavailable: int = 0
    unavailable_misleading: int = 0
    normal: int = 0
    misleading: int = 0
    hazardous: int = 0

    @property
    def judged(self) -> int:
        """Epochs without an alert whose error is known."""
        return int(sum(astuple(self))) - self.alerted - self.unknown

    @property
    def exceeded(self) -> int:
        """Epochs whose error was beyond the level without an alert, whatever the alert limit."""
        return self.misleading + self.hazardous + self.unavailable_misleading


def regions(
    error_m: npt.ArrayLike, level_m: npt.ArrayLike, limit_m: float, alert: npt.ArrayLike
) -> npt.NDArray[np.int8]:
    """Return the `Region` of each epoch, shape (n,).

    Parameters
    ----------
    error_m : array_like, shape (n,)
        True errors, m; the sign does not count; nan where not known.
    level_m : array_like, shape (n,)
        Protection levels, m; inf where unbounded, nan where there is none.
    limit_m : float
        Alert limit, m; inf: none.
    alert : array_like of bool, shape (n,)
        Whether an alert was given.

    Raises
    ------
    ValueError
        Where the lengths differ or the limit is not positive.

    References
    ----------
    Tossaint et al. (2007), "The Stanford-ESA integrity diagram: a new tool for the user domain SBAS integrity
    assessment", Navigation 54(2), 153-162.

    Examples
    --------
    >>> [Region(r).name for r in regions([0.1, 0.5, 9.0], [0.3, 0.3, 0.3], 2.0, [False] * 3)]
    ['NORMAL', 'MISLEADING', 'HAZARDOUS']
    """
    error, level = np.abs(np.asarray(error_m, dtype=np.float64)), np.asarray(level_m, dtype=np.float64)
    alerted = np.asarray(alert, dtype=bool)
    if not error.shape == level.shape == alerted.shape or error.ndim != 1:
        shapes = f"{error.shape}, {level.shape} and {alerted.shape}"
        raise ValueError(f"`error_m`, `level_m` and `alert` must have the same length, not {shapes}")
    if not limit_m > 0.0:
        raise ValueError(f"`limit_m` must be positive, not {limit_m}")
    serves, beyond = np.isfinite(level) & (level <= limit_m), error > level
    conditions = [alerted, np.isnan(error), ~serves & beyond, ~serves, error > limit_m, beyond]
    chosen = [
        Region.ALERTED, Region.UNKNOWN, Region.UNAVAILABLE_MISLEADING, Region.UNAVAILABLE, Region.HAZARDOUS,
        Region.MISLEADING,
    ]  # fmt: skip
    return np.select(conditions, [int(c) for c in chosen], int(Region.NORMAL)).astype(np.int8)


def stanford(
    error_m: npt.ArrayLike, level_m: npt.ArrayLike, limit_m: float, alert: npt.ArrayLike
) -> Stanford:
    """Return how many epochs stand in each region; see `regions` for the parameters."""
    found = np.bincount(regions(error_m, level_m, limit_m, alert), minlength=len(Region))
    return Stanford(**{r.name.lower(): int(found[r]) for r in Region})


def plain_levels(
    sigma_m: npt.ArrayLike, risk: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return horizontal and vertical levels of K sigma: what a filter could claim if nothing ever failed.

    They stand beside protection levels in the same diagram: how many epochs are misleading without fault
    hypotheses?

    Parameters
    ----------
    sigma_m : array_like, shape (n, 3)
        Standard deviations east, north and up, m (`Bound.sigma_m`).
    risk : array_like, shape (3,)
        Probability that an error is beyond its level, east, north and up (`Ism.risks`).

    Returns
    -------
    horizontal, vertical : ndarray, shape (n,)
        m; ``K = Q^-1(risk / 2)`` in each direction.

    Examples
    --------
    >>> h, v = plain_levels([[3.0, 4.0, 2.0]], [0.05, 0.05, 0.05])
    >>> round(float(h[0]), 2), round(float(v[0]), 2)
    (9.8, 3.92)
    """
    levels = np.asarray(sigma_m, dtype=np.float64) * -special.ndtri(0.5 * np.asarray(risk, dtype=np.float64))
    return np.hypot(levels[:, 0], levels[:, 1]), levels[:, 2]
