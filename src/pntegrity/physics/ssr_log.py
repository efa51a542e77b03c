"""A log and the corrections of CLAS -> usable observations, products, delays of the atmosphere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pntegrity.physics._rows import rows_by_kind
from pntegrity.physics.atmosphere import zenith_delays_m
from pntegrity.physics.atmosphere_products import AtmosphereProducts
from pntegrity.physics.frames import geodetic_of, geodetic_to_ecef
from pntegrity.physics.precise_epochs import Products
from pntegrity.physics.signals import WORDS
from pntegrity.physics.ssr import SsrBiases, SsrClocks, SsrOrbits
from pntegrity.physics.ssr_corrections import MAX_CORRECTION_AGE_S, ClasCorrections
from pntegrity.physics.tables import Navigation, SignalTable

__all__ = [
    "CLAS_SIGNALS", "TROPOSPHERE_SIGMA_M", "ClasInputs", "clas_atmosphere", "clas_inputs", "clas_products",
    "with_known_biases",
]  # fmt: skip

CLAS_SIGNALS: dict[str, tuple[str, ...]] = {
    "G": ("1C",), "G2": ("2W",), "E": ("1C", "1X"), "E2": ("5Q", "5X"), "J": ("1C",), "J2": ("2L", "2X"),
}  # fmt: skip
"""Pairs of signals for which CLAS sends biases of all its satellites; for `precise_epochs`' `signals`."""
TROPOSPHERE_SIGMA_M = 0.02
"""Of the zenith delay: it jumps by up to this from one message to the next. The stated 2 mm is less."""


@dataclass(frozen=True, eq=False)
class ClasInputs:
    """What `precise_epochs` and an estimator take: usable observations, products, atmosphere."""

    table: SignalTable
    products: Products
    atmosphere: AtmosphereProducts


def clas_inputs(
    table: SignalTable,
    corrections: ClasCorrections,
    navigation: Navigation,
    receiver_m: npt.ArrayLike,
    max_age_s: float = MAX_CORRECTION_AGE_S,
) -> ClasInputs:
    """Return a log and the corrections as `precise_epochs` and the estimators take them.

    Parameters
    ----------
    table : SignalTable
    corrections : ClasCorrections
        As they were at hand where the receiver is.
    navigation : Navigation
        With the messages that the corrections name.
    receiver_m : array, shape (3,)
        ECEF, good to 100 m: the troposphere is reduced to its height.
    max_age_s : float
        Older corrections are not used.

    Returns
    -------
    ClasInputs
        Notes count what could not be corrected, by cause.
    """
    products = clas_products(corrections, navigation, max_age_s)
    usable, told = with_known_biases(table, SsrBiases(corrections, max_age_s))
    causes = _causes(table, SsrOrbits(corrections, navigation, max_age_s))
    notes = (*products.notes, *causes, *told)
    return ClasInputs(usable, replace(products, notes=notes), clas_atmosphere(corrections, receiver_m))


def clas_products(
    corrections: ClasCorrections, navigation: Navigation, max_age_s: float = MAX_CORRECTION_AGE_S
) -> Products:
    """Return orbits, clocks and biases for `precise_epochs`; positions are phase centres, so no antennas.

    Parameters
    ----------
    corrections : ClasCorrections
    navigation : Navigation
    max_age_s : float
    """
    orbits = SsrOrbits(corrections, navigation, max_age_s)
    biases = SsrBiases(corrections, max_age_s)
    return Products(orbits, SsrClocks(orbits), biases, None, corrections.notes)  # type: ignore[arg-type]


def _causes(table: SignalTable, orbits: SsrOrbits) -> list[str]:
    """Return notes on satellites without orbit and clock, counted by cause."""
    counts: Counter[str] = Counter()
    names: dict[str, set[str]] = {}
    for sat, rows in rows_by_kind(table.sat):
        epochs = np.unique(table.epoch[rows])
        found: Counter[str] = Counter(orbits.reasons(sat, table.t_ns[epochs]).tolist())
        found.pop("", None)
        counts += found
        for reason in found:
            names.setdefault(reason, set()).add(sat)
    return [
        f"{reason}: {', '.join(sorted(names[reason]))}, {n} satellite epochs"
        for reason, n in counts.most_common()
    ]


# --- biases -------------------------------------------------------------------------------------------------


def with_known_biases(table: SignalTable, biases: SsrBiases) -> tuple[SignalTable, tuple[str, ...]]:
    """Return the log with those observations of corrected satellites hidden whose bias is not known.

    Beside the others they would be off by metres. Notes name the signals.
    """
    t_ns = table.t_ns[table.epoch]
    ours = np.isin(table.sat, list(biases.corrections.satellites))
    code, phase = (biases.of_m(kind, table.sat, table.signal, t_ns) for kind in ("code", "phase"))
    names = np.char.add(table.sat.astype("<U1"), table.signal)
    known = set(names[ours & np.isfinite(code)].tolist())
    told = sorted(set(names[ours].tolist()) - known)
    notes = tuple(f"no bias of {WORDS[n[0]]} {n[1:]} in the corrections: not used" for n in told)
    return replace(
        table,
        pseudorange_m=np.where(ours & np.isnan(code), np.nan, table.pseudorange_m),
        carrier_cycles=np.where(ours & np.isnan(phase), np.nan, table.carrier_cycles),
    ), notes


# --- atmosphere ---------------------------------------------------------------------------------------------


def clas_atmosphere(corrections: ClasCorrections, receiver_m: npt.ArrayLike) -> AtmosphereProducts:
    """Return slant electron content by satellite and the zenith total delay at the receiver's height.

    Hydrostatic and wet delay are each reduced by the standard atmosphere's ratio between the height and the
    ellipsoid. The content holds a part that is common to a constellation, and the datum of the code biases.

    Parameters
    ----------
    corrections : ClasCorrections
    receiver_m : array, shape (3,)
        ECEF.
    """
    dry, wet = _height_ratios(receiver_m)
    total = corrections.zhd_m * dry + corrections.zwd_m * wet
    sigma = np.full(len(total), TROPOSPHERE_SIGMA_M)
    slant = {
        sat: (c.t_ns, c.stec_tecu, c.stec_sigma_tecu) for sat, c in sorted(corrections.satellites.items())
    }
    name = f"CLAS, network {corrections.network}" if corrections.network else "CLAS"
    return AtmosphereProducts(
        slant, (corrections.t_ns, total, sigma), "ZTD", source=_joined((name, *corrections.sources))
    )


def _height_ratios(receiver_m: npt.ArrayLike) -> tuple[float, float]:
    """Return what is left at the receiver's height of the zenith delays on the ellipsoid, dry and wet."""
    lat, lon, _ = geodetic_of(*np.asarray(receiver_m, dtype=np.float64).tolist())
    here, below = zenith_delays_m(receiver_m), zenith_delays_m(geodetic_to_ecef(lat, lon, 0.0))
    return (here[0] / below[0], here[1] / below[1]) if below[0] and below[1] else (1.0, 1.0)


def _joined(words: Iterable[str]) -> str:
    return "; ".join(w for w in words if w)
