"""Protection levels of verdicts as columns: what each monitor promised, and what counts at an epoch.

Several monitors may each give levels; the largest of each epoch counts, number by number, since every one of
them claims to bound the error and the largest is the claim that all of them make. Null (nan inside): no level
was given. inf: unbounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import polars as pl

from pntegrity.pipeline import Outcome
from pntegrity.records import Bound, FloatArray, join_reasons

__all__ = ["FAULT_FREE", "bounds_of", "has_bounds", "level_columns", "mode_name", "only_beyond"]

FAULT_FREE = "fault-free"
"""What a dominant mode without any fault is called."""

LEVELS: dict[str, Callable[[Bound], float | None]] = {
    "hpl_m": lambda b: b.hpl_m,
    "vpl_m": lambda b: b.vpl_m,
    "pl_east_m": lambda b: b.east_m,
    "pl_north_m": lambda b: b.north_m,
    "pl_up_m": lambda b: b.up_m,
    "pl_along_m": lambda b: b.along_m,
    "pl_cross_m": lambda b: b.cross_m,
}
"""The columns, and where each comes from."""


def bounds_of(outcomes: Sequence[Outcome]) -> list[tuple[Bound, ...]]:
    """Return the bounds of each epoch, after the last exclusion."""
    return [tuple(v.bound for v in o.verdicts if v.bound is not None) for o in outcomes]


def has_bounds(outcomes: Sequence[Outcome]) -> bool:
    """Tell whether any verdict has a bound."""
    return any(v.bound is not None for o in outcomes for v in o.verdicts)


def only_beyond(o: Outcome) -> bool:
    """Tell whether an alert is given because a level is above its alert limit, and no monitor alarms."""
    alarmed = any(v.status == "alert" for v in o.verdicts)
    return o.status == "alert" and not alarmed and any(v.beyond for v in o.verdicts)


def level_columns(bounds: Sequence[Sequence[Bound]]) -> dict[str, pl.Series]:
    """Return the columns ``hpl_m`` ... ``pl_cross_m``, ``pl_mode`` and ``pl_reason``, one row an entry."""
    return {
        **{name: _series(bounds, value) for name, value in LEVELS.items()},
        "pl_mode": pl.Series([_mode(b) for b in bounds], dtype=pl.String),
        "pl_reason": pl.Series([join_reasons(x.reason for x in b) for b in bounds], dtype=pl.String),
    }


def _series(bounds: Sequence[Sequence[Bound]], value: Callable[[Bound], float | None]) -> pl.Series:
    largest: FloatArray = np.array([_largest(b, value) for b in bounds], dtype=np.float64)
    return pl.Series(largest, dtype=pl.Float64).fill_nan(None)


def _largest(bounds: Sequence[Bound], value: Callable[[Bound], float | None]) -> float:
    """Return the largest of some levels, nan where there is none; a level that is not a number bounds
    nothing.
    """
    given = [x for x in map(value, bounds) if x is not None]
    return max((np.inf if np.isnan(x) else x for x in given), default=np.nan)


def _mode(bounds: Sequence[Bound]) -> str | None:
    """Return the mode that dominates the largest of the levels east, north and up."""
    all_levels = [
        (level, mode)
        for b in bounds
        for level, mode in zip((b.east_m, b.north_m, b.up_m), b.dominant, strict=True)
    ]
    return mode_name(max(all_levels, key=lambda x: x[0])[1]) if all_levels else None


def mode_name(mode: str) -> str:
    """Return what a fault mode is called in tables."""
    return mode or FAULT_FREE
