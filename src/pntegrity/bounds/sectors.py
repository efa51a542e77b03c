"""Sectors of the sky whose satellites fail together, as behind the houses on one side of a street."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import degrees, isfinite

from pntegrity.bounds.ism import Ism
from pntegrity.states import is_satellite

__all__ = ["Sectors", "sectors_at", "with_risen"]

Sectors = tuple[tuple[str, tuple[str, ...]], ...]
"""Names of sectors, and the satellites of each; sorted."""


def sectors_at(ism: Ism, az_rad: float) -> tuple[str, ...]:
    """Return the names of the sectors in which an azimuth lies: ``"az045"`` is the one around 45 degrees.

    A sector holds its first edge and not its second one, so that an azimuth lies in equally many sectors
    everywhere where the width is a multiple of the spacing.

    Examples
    --------
    >>> sectors_at(Ism(sectors=8, p_sector=1e-4), 0.1)
    ('az000', 'az045')
    """
    if not isfinite(az_rad):
        return ()
    half, az_deg = 0.5 * ism.sector_width_deg, degrees(az_rad)
    centres = (360.0 * k / ism.sectors for k in range(ism.sectors))
    return tuple(f"az{round(c):03d}" for c in centres if (az_deg - c + half) % 360.0 < ism.sector_width_deg)


def with_risen(ism: Ism, before: Sectors, known: Collection[str], az_rad: Mapping[str, float]) -> Sectors:
    """Return the sectors after an epoch.

    A satellite takes its place when it is first seen and keeps it until it is forgotten: a subfilter without
    a sector has then never used any satellite of it.

    Parameters
    ----------
    ism : Ism
    before : tuple of (str, tuple of str)
        The sectors before the epoch.
    known : collection of str
        Groups that were seen before and are not forgotten; those that are in no sector stay in none.
    az_rad : mapping of str to float
        Azimuths of what is in view.
    """
    if not (ism.sectors and ism.p_sector):
        return ()
    places = {name: [g for g in groups if g in known] for name, groups in before}
    for group, az in az_rad.items():
        if group not in known and is_satellite(group):
            for name in sectors_at(ism, az):
                places.setdefault(name, []).append(group)
    return tuple((name, tuple(sorted(groups))) for name, groups in sorted(places.items()) if groups)
