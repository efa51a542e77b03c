"""All files of precise products together: what a precise solution needs beside its observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pntegrity.formats.antex import Antennas, read_antex
from pntegrity.formats.bias import read_biases
from pntegrity.formats.blq import read_blq
from pntegrity.formats.erp import read_erp
from pntegrity.formats.rinex_clk import read_clocks
from pntegrity.formats.sp3 import read_orbits
from pntegrity.physics.precise_epochs import Products, SiteFacts
from pntegrity.physics.product_antennas import ReceiverAntenna
from pntegrity.physics.tables import SignalTable

__all__ = ["ProductFiles", "read_products"]


ALIASES = {"AIU": "COD", "WUM": "WHU", "GRG": "GRG", "CNE": "GRG", "CNT": "GRG"}
"""Agencies by the first three letters that their files call them."""


@dataclass(frozen=True)
class ProductFiles:
    """Names of files; only orbits are needed.

    Parameters
    ----------
    sp3, clk, bias, antex : sequence of Path
        Orbits of one or several days, clocks (else those of the orbit files), code biases, antennas.
    blq : Path or None
        Ocean loading.
    erp : Path or None
        Polar motion.
    station : str
        Name of the station in the loading file; the marker's first four letters where not given.
    nav : sequence of Path
        Broadcast ephemerides, for GLONASS channels that the log does not tell.
    """

    sp3: Sequence[Path]
    clk: Sequence[Path] = ()
    bias: Sequence[Path] = ()
    antex: Sequence[Path] = ()
    blq: Path | None = None
    erp: Path | None = None
    station: str = ""
    nav: Sequence[Path] = ()


def read_products(files: ProductFiles, table: SignalTable) -> tuple[Products, SiteFacts]:
    """Read the files for a log; what is missing is told with its expected effect.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    orbits = read_orbits(files.sp3)
    clocks = read_clocks(files.clk) if files.clk else orbits.clocks
    biases = read_biases(files.bias, int(table.t_ns[len(table.t_ns) // 2])) if files.bias else None
    antennas = read_antex(files.antex) if files.antex else None
    notes = [note for read in (orbits, clocks, biases, antennas) if read is not None for note in read.notes]
    notes += _datum(orbits.agency, clocks.agency) + _long_steps(clocks.kind, clocks.interval_s)
    site = _site(files, table, antennas, notes)
    satellites = antennas.satellite if antennas else None
    return Products(orbits, clocks, biases, satellites, tuple(dict.fromkeys(notes))), site


def _site(files: ProductFiles, table: SignalTable, antennas: Antennas | None, notes: list[str]) -> SiteFacts:
    """Return what is known of the station; what is missing is noted."""
    antenna = _antenna(antennas, table.antenna, notes)
    ocean, told = read_blq(files.blq, files.station or table.marker[:4]) if files.blq else (None, ())
    notes += [f"{note}: up to 5 cm near coasts" for note in told]
    pole = read_erp([files.erp]) if files.erp else None
    if pole is not None and not np.isfinite(pole.at(table.t_ns[[0, -1]])).all():
        notes.append(f"{files.erp}: does not cover the whole log, no pole tide outside: up to 2 cm")
    return SiteFacts(antenna, ocean, pole)


def _antenna(antennas: Antennas | None, name: str, notes: list[str]) -> ReceiverAntenna | None:
    if antennas is None:
        notes.append(
            "no satellite antennas (--antex): phase centres are taken for centres of mass, 1 to 3 m off"
        )
    antenna = antennas.receiver(name) if antennas else None
    if antenna is None:
        notes.append(
            f"no calibration of the receiver's antenna {name!r}: up may be 5 to 20 cm off, constantly"
        )
    return antenna


def _datum(orbits: str, clocks: str) -> list[str]:
    names = {ALIASES.get(agency[:3].upper(), agency[:3].upper()) for agency in (orbits, clocks) if agency}
    if len(names) < 2:
        return []
    return [
        f"orbits of {orbits} with clocks of {clocks}: they belong to different solutions, ranges may be off "
        "by decimetres"
    ]


def _long_steps(kind: str, interval_s: float) -> list[str]:
    if interval_s <= 300.0:
        return []
    return [
        f"clocks of {kind} every {interval_s:.0f} s: between them they are off by 3 (GPS) to 10 cm "
        "(GLONASS), give a CLK file of 30 s where there is one"
    ]
