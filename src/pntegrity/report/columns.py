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
from pntegrity.pipeline import Outcome
from pntegrity.records import Update, group_of
from pntegrity.states import is_satellite, sensor_of, source_of

__all__ = [
    "HELD", "column", "family_counts", "groups_in", "is_part_of", "is_vehicle",
    "member_of", "members_in", "names_in", "or_inf", "stamps", "unit_of_row",
]  # fmt: skip

HELD = 2.5
"""Who measures less often than the epochs come is there for so many of its usual intervals."""
KINDS = ("R", "A")
"""How the rows of a source begin that are no rates: ranges and levels, angles."""


#: A metre changes a row by less than this where it is a time of travel of sound, s/m.
SLOW_SPM = 0.01


def unit_of_row(update: Update, row: int) -> str:
    """Return the unit of a row of a source: ``"rad"``, ``"s"`` (a metre changes it little), or ``"m"``."""
    kind = update.keys[row].partition(":")[2][:1]
    if kind == "A":
        return "rad"
    block = "vel" if kind == "D" else "pos"
    slope = np.linalg.norm(update.H[row, update.prior.layout.block(block)])
    return "s" if 0.0 < slope < SLOW_SPM else "m"


@lru_cache(maxsize=4096)
def groups_in(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return the groups of some rows, each once, in order."""
    return tuple(dict.fromkeys(map(group_of, keys)))


def member_of(key: str) -> str:
    """Return the smallest that can be left out: a sensor of a source (``"lbl.AP1"``), else the group."""
    source, sensor = group_of(key), sensor_of(key)
    return f"{source}.{sensor}" if sensor else source


@lru_cache(maxsize=4096)
def members_in(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return the sensors, or groups, of some rows, each once, in order."""
    return tuple(dict.fromkeys(map(member_of, keys)))


@lru_cache(maxsize=4096)
def names_in(keys: tuple[str, ...]) -> frozenset[str]:
    """Return all that can be left out of some rows: groups, and sensors of sources."""
    return frozenset((*groups_in(keys), *members_in(keys)))


def is_vehicle(outcomes: Sequence[Outcome]) -> bool:
    """Tell whether the rows of a run are those of sources of a vehicle."""
    return any(_of_source(keys) for o in outcomes for keys in (o.update.keys, o.update.spare_keys))


@lru_cache(maxsize=4096)
def _of_source(keys: tuple[str, ...]) -> bool:
    """Tell whether any row is one of a source: of a kind, as `sensors.source` has it, or of a sensor."""
    return any(sensor_of(key) or _has_kind(*key.split(":", 1)) for key in keys)


def _has_kind(group: str, about: str = "") -> bool:
    return about[:1] in KINDS and not is_satellite(group) and not is_satellite(about)


def is_part_of(member: str, name: str) -> bool:
    """Tell whether a sensor (or group) goes with what is left out: itself, or its source."""
    return member == name or member.startswith(f"{name}.")


@lru_cache(maxsize=4096)
def family_counts(keys: tuple[str, ...]) -> Counter[str]:
    """Return how many groups of each family (constellation), or sensors of each source, some rows have."""
    return Counter(family_of(m) if is_satellite(m) else source_of(m) for m in members_in(keys))


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
