"""Where satellites stand when a bank first sees them."""

from __future__ import annotations

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.sectors import Sectors
from pntegrity.monitors._members import groups_of
from pntegrity.records import Update
from pntegrity.states import is_satellite

__all__ = ["azimuths", "why_unplaced"]

MOST = 5
"""Satellites that a reason names."""


def azimuths(update: Update) -> dict[str, float]:
    """Return the azimuth of each group in view, rad, where the estimator tells: ``aux["az_rad"]``."""
    az_rad = update.aux.get("az_rad")
    if az_rad is None or len(az_rad) != len(update.keys):
        return {}
    return {group: float(az_rad[row]) for group, row in groups_of(update.keys).items()}


def why_unplaced(ism: Ism, sectors: Sectors, update: Update) -> str:
    """Return which satellites in view are in no sector, in words; ``""`` where all are or there are none."""
    if not ism.sectors:
        return ""
    placed = {g for _, groups in sectors for g in groups}
    lost = [g for g in groups_of(update.keys) if is_satellite(g) and g not in placed]
    if not lost:
        return ""
    names = ", ".join(sorted(lost)[:MOST]) + (" and others" if len(lost) > MOST else "")
    return f"no azimuth was given for {names}: no sector covers them"
