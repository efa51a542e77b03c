"""Logs and products -> the epochs of a run, whichever way satellites are placed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.formats.clas_l6 import corrections_for
from pntegrity.formats.products import ProductFiles, read_products
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.physics.atmosphere_products import AtmosphereProducts, origin, with_products
from pntegrity.physics.gnss_epochs import GnssEpochs, gnss_epochs
from pntegrity.physics.precise_epochs import precise_epochs
from pntegrity.physics.ssr_log import CLAS_SIGNALS, clas_inputs
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import FloatArray
from pntegrity.sensors.noise import PPP, NoiseModel
from pntegrity.sensors.snapshot import track

__all__ = ["Span", "clas_log", "precise_log", "with_atmosphere"]

#: The first fix within this time tells where the receiver is, to 100 m.
FIRST_S = 300

Span = tuple[int | None, int | None]


def precise_log(
    table: SignalTable, files: ProductFiles, systems: str, span: Span = (None, None), noise: NoiseModel = PPP,
    *, combined: bool = True,
) -> GnssEpochs:  # fmt: skip
    """Return the epochs of a log with precise products.

    Parameters
    ----------
    table : SignalTable
    files : ProductFiles
        Names of the products.
    systems : str
        Letters of the constellations.
    span : (int or None, int or None)
        First and last time, ns of GPS time.
    noise : NoiseModel
        Weights of the code from which rough positions are made.
    combined : bool
        False: rows of each band apart; see `precise_epochs`.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    products, site = read_products(files, table)
    channels = read_navigation(files.nav).glonass_channels if files.nav else {}
    options = GnssOptions(noise=noise)
    return precise_epochs(
        table, products, lambda epochs: track(epochs, options), systems=systems, site=site, channels=channels,
        start_ns=span[0], end_ns=span[1], combined=combined,
    )  # fmt: skip


def with_atmosphere(loaded: GnssEpochs, products: AtmosphereProducts) -> GnssEpochs:
    """Return epochs with what is known of the atmosphere at their times."""
    epochs, notes = with_products(loaded.epochs, products)
    return replace(loaded, epochs=tuple(epochs), notes=(*loaded.notes, *notes), products=origin(products))


def clas_log(
    table: SignalTable, nav: Sequence[Path], clas: Sequence[Path], grid: Path | None, systems: str,
    span: Span = (None, None), noise: NoiseModel = PPP,
) -> GnssEpochs:  # fmt: skip
    """Return the epochs of a log with the corrections of CLAS, bands apart, with its delays of the
    atmosphere.

    Parameters
    ----------
    table : SignalTable
    nav, clas : sequence of Path
        Broadcast ephemerides; corrections as decoded files, or one raw file of L6 messages.
    grid : Path or None
        Definition of the grid points, for raw messages.
    systems, span, noise
        As for `precise_log`.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    navigation = read_navigation(nav)
    options = GnssOptions(noise=noise)
    place = _place(table, navigation, systems, options)
    inputs = clas_inputs(table, corrections_for(table, clas, grid, place), navigation, place)
    found = precise_epochs(
        inputs.table, inputs.products, lambda epochs: track(epochs, options), systems=systems,
        signals=CLAS_SIGNALS, start_ns=span[0], end_ns=span[1], combined=False,
    )  # fmt: skip
    return with_atmosphere(found, inputs.atmosphere)


def _place(table: SignalTable, navigation: Navigation, systems: str, options: GnssOptions) -> FloatArray:
    """Return about where the receiver is, from code and broadcast ephemerides."""
    end_ns = int(table.t_ns[0]) + FIRST_S * SECOND_NS
    rough = gnss_epochs(table, navigation, systems=systems, end_ns=end_ns).epochs
    fixes = track(rough, options)
    known = fixes[np.isfinite(fixes).all(axis=1)]
    if not len(known):
        raise InputError(
            f"no position could be made from code in the first {FIRST_S} s", path=table.source,
            hint="Corrections hold for a place: give navigation files that cover the log's beginning",
        )  # fmt: skip
    return np.asarray(np.median(known, axis=0))
