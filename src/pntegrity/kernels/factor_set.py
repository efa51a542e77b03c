"""Factor-set fault detection: consistency of an epoch's pseudoranges, and checks of what was kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["FactorSet"]


@dataclass(frozen=True)
class FactorSet:
    """What factor-set detection is told.

    Parameters
    ----------
    variant : str
        ``"exact"`` or ``"published"``.
    p_fa, p_md : float
        Probability of a false alarm of the consistency check, and of a missed detection behind the
        missed-detection factor.
    sigma_m, sigma_min_m : float
        Residual sigma at the start, and the smallest that adaptation may give.
    window : int
        Epochs of residuals that sigma is made of.
    filled : float
        Share of the window that must be filled before it counts.
    missed_limit_m, false_alarm_limit_m : float
        Thresholds of the two checks.
    """

    variant: Literal["exact", "published"] = "exact"
    p_fa: float = 1e-5
    p_md: float = 1e-5
    sigma_m: float = 1.0
    sigma_min_m: float = 0.3
    window: int = 1000
    filled: float = 0.8
    missed_limit_m: float = 18.0
    false_alarm_limit_m: float = 30.0
