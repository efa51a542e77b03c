"""Logs and products -> the epochs of a run, whichever way satellites are placed."""

from __future__ import annotations

from pntegrity.estimators._gnss import GnssOptions, track
from pntegrity.formats.products import ProductFiles, read_products
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.physics.gnss_epochs import GnssEpochs
from pntegrity.physics.precise_epochs import precise_epochs
from pntegrity.physics.tables import SignalTable
from pntegrity.sensors.noise import PPP, NoiseModel

__all__ = ["Span", "precise_log"]

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
