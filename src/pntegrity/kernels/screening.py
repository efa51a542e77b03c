"""What fault detection before a filter's update says that it did."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Screening"]


@dataclass(frozen=True)
class Screening:
    """What fault detection inside an estimator did with an epoch's rows before the filter used them.

    Parameters
    ----------
    method, variant : str
        ``"ours"``, ``"factor-set"``, ``"lsr"`` or ``"none"``; ``"exact"`` or ``"published"``.
    first, first_limit : float
        Detection statistic with all rows, and its threshold; nan where no test was possible.
    last, last_limit : float
        The same with the rows that were kept.
    dropped : tuple of (str, int)
        Rows that were left out, each with the iteration that did so, from 1.
    tests : int
        Sets of rows that were tested beside the one with all rows.
    missed_m, missed_limit_m : float
        Factor of the missed-detection check and its threshold; nan where there was none.
    false_alarm_m, false_alarm_limit_m : float
        The same of the false-alarm check; the factor is there for every fix, the threshold where it decided.
    satellites : (int, int)
        Before and after.
    pdop : (float, float)
        Before and after; inf where the satellites do not determine a position.
    dof : int
        Degrees of freedom of a chi-square `last`; 0 where no test was possible or it is none.
    used : bool
        Whether the filter was updated.
    reason : str
        Why not, or what else there is to say.
    """

    method: str
    variant: str = "exact"
    first: float = float("nan")
    first_limit: float = float("nan")
    last: float = float("nan")
    last_limit: float = float("nan")
    dropped: tuple[tuple[str, int], ...] = ()
    tests: int = 0
    missed_m: float = float("nan")
    missed_limit_m: float = float("nan")
    false_alarm_m: float = float("nan")
    false_alarm_limit_m: float = float("nan")
    satellites: tuple[int, int] = (0, 0)
    pdop: tuple[float, float] = (float("inf"), float("inf"))
    used: bool = True
    reason: str = ""
    dof: int = 0
