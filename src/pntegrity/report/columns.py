"""What all tables share: columns of numbers, time stamps, and the groups of rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.kernels.signatures import family_of
from pntegrity.physics.time import to_iso
from pntegrity.records import group_of

__all__ = ["column", "family_counts", "groups_in", "or_inf", "stamps"]


@lru_cache(maxsize=4096)
def groups_in(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return the groups of some rows, each once, in order."""
    return tuple(dict.fromkeys(map(group_of, keys)))


@lru_cache(maxsize=4096)
def family_counts(keys: tuple[str, ...]) -> Counter[str]:
    """Return how many groups of each family (constellation) some rows belong to."""
    return Counter(map(family_of, groups_in(keys)))


def column(values: npt.ArrayLike) -> pl.Series:
    """Return numbers, null where they are not finite."""
    numbers = np.asarray(values, dtype=np.float64)
    return or_inf(np.where(np.isfinite(numbers), numbers, np.nan))


def or_inf(values: npt.ArrayLike) -> pl.Series:
    """Return numbers that may be infinite, null where they are nan."""
    return pl.Series(np.asarray(values, dtype=np.float64), dtype=pl.Float64).fill_nan(None)


def stamps(t_ns: Sequence[int]) -> dict[str, pl.Series]:
    """Return the columns ``t_ns`` and ``time_gps``."""
    text = {t: to_iso(t) for t in set(t_ns)}
    return {
        "t_ns": pl.Series(list(t_ns), dtype=pl.Int64),
        "time_gps": pl.Series([text[t] for t in t_ns], dtype=pl.String),
    }
