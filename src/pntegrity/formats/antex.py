"""ANTEX files -> the antennas of satellites and receivers, each looked up when it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.products import ReceiverAntenna, SatelliteAntenna
from pntegrity.physics.time import civil_to_ns, to_iso

__all__ = ["Antennas", "ReceiverAntenna", "SatelliteAntenna", "read_antex"]

_REFUSED = (sidereon.SidereonError, ValueError)
_HINT = "Give an ANTEX file (.atx), such as igs14.atx or igs20.atx of IGS"
FloatArray = npt.NDArray[np.float64]


class Antennas:
    """The antennas of one or several ANTEX files; of a block in two files the first file's counts.

    Parameters
    ----------
    products : sequence of sidereon.Antex
        The files, as read.
    sources, notes : tuple of str
        Names of the files; what was left out, in words.
    """

    def __init__(self, products: Sequence[Any], sources: tuple[str, ...], notes: tuple[str, ...]) -> None:
        self._products = tuple(products)
        self._types: dict[tuple[str, str], Any] | None = None
        self.sources = sources
        self.notes = notes

    def satellite(self, sat: str, t_ns: int) -> SatelliteAntenna | None:
        """Return the antenna of a satellite at a time (ns of GPS time), None where the files hold none."""
        at = datetime.fromisoformat(to_iso(t_ns)[:19])
        instant = sidereon.AntexDateTime(at.year, at.month, at.day, at.hour, at.minute, at.second)
        for product in self._products:
            block = product.satellite_antenna(sat, instant)
            if block is not None and any(_band(f, sat[0]) for f in block.frequencies):
                return _satellite(sat, block)
        return None

    def receiver(self, antenna_type: str) -> ReceiverAntenna | None:
        """Return a receiver antenna by the type of the RINEX header, ``"TRM59800.00     SCIS"``.

        A radome that is not calibrated is replaced by none at all, which a note tells; None where the type
        is not there either.
        """
        name, radome = _split(antenna_type)
        exact = self._receivers.get((name, radome))
        if exact is not None:
            return _receiver(name, radome, exact, ())
        bare = self._receivers.get((name, "NONE"))
        if bare is None:
            return None
        note = f"{name} is not calibrated with radome {radome}: taken without a radome"
        return _receiver(name, "NONE", bare, (note,))

    @property
    def _receivers(self) -> dict[tuple[str, str], Any]:
        """Blocks by name and radome; the type's mean before a single antenna's own calibration."""
        if self._types is None:
            kind = sidereon.AntennaKind.RECEIVER
            blocks = [b for p in self._products for b in p.antenna_blocks if b.kind == kind]
            blocks = [b for b in blocks if any(_band(f, f[0]) for f in b.frequencies)]
            blocks.sort(key=lambda b: bool(b.serial.strip()))
            self._types = {_split(b.antenna_type): b for b in reversed(blocks)}
        return self._types


def read_antex(paths: Sequence[Path | str] | Path | str) -> Antennas:
    """Read one or several ANTEX files.

    Parameters
    ----------
    paths : sequence of Path
        Plain or gzip; for example one with satellites and one of the own antenna.

    Returns
    -------
    Antennas
        Ask it for `Antennas.satellite` and `Antennas.receiver`.

    Raises
    ------
    InputError
        A file is missing, damaged or no ANTEX file, or holds no antenna.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no antenna file given", hint=_HINT)
    notes: list[str] = []
    products = [_read(path, notes) for path in files]
    sources = tuple(
        f"{path.name} (antennas: {p.antenna_count})" for path, p in zip(files, products, strict=True)
    )
    return Antennas(products, sources, tuple(notes))


def _read(path: Path, notes: list[str]) -> Any:
    text = read_text(path)
    if "ANTEX VERSION / SYST" not in text[:81]:
        raise InputError("this is not an ANTEX file (its first line)", path=path, line=1, hint=_HINT)
    again = "The file is damaged or cut off: download it again"
    if text.count("START OF ANTENNA") != text.count("END OF ANTENNA"):
        raise InputError("an antenna's block does not end", path=path, hint=again)
    try:
        product = sidereon.load_antex(text.encode("ascii"))
    except _REFUSED as error:
        raise InputError(f"cannot be read ({str(error)[:120]})", path=path, hint=again) from None
    if not product.antenna_count:
        raise InputError("the file holds no antenna", path=path, hint=again)
    kind = product.header.pcv_type
    if kind is not None and "Relative" in repr(kind):
        raise InputError(
            "its calibrations are relative to another antenna",
            path=path,
            hint="Give absolute ones (igs14.atx)",
        )
    if product.skipped_records:
        notes.append(f"{path.name}: {product.skipped_records} records left out")
    return product


def _split(antenna_type: str) -> tuple[str, str]:
    """Return name and radome: columns 1-16 and 17-20 of the header, ``NONE`` where blank."""
    words = antenna_type.upper().split()
    if len(words) > 1 and len(words[-1]) == 4:
        return " ".join(words[:-1]), words[-1]
    return " ".join(words), "NONE"


def _band(frequency: str, system: str) -> str:
    """Return the RINEX band of ANTEX's ``G05`` and the like, empty for another system."""
    own = len(frequency) == 3 and frequency[0] == system and frequency[1:].isdigit()
    return str(int(frequency[1:])) if own else ""


def _satellite(sat: str, block: Any) -> SatelliteAntenna:
    sections = {_band(s.frequency, sat[0]): s for s in block.frequency_sections}
    sections.pop("", None)
    grids = {band: _without_azimuth(s) for band, s in sections.items()}
    return SatelliteAntenna(
        sat=sat,
        block=block.antenna_type.strip(),
        pco_m={band: np.asarray(s.pco_m) for band, s in sections.items()},
        pcv={band: grid for band, grid in grids.items() if len(grid[0])},
        valid_ns=(_ns(block.valid_from), _ns(block.valid_until)),
    )


def _ns(instant: Any) -> int | None:
    if instant is None:
        return None
    second = instant.second + float(instant.fraction)
    return civil_to_ns(instant.year, instant.month, instant.day, instant.hour, instant.minute, second)


def _without_azimuth(section: Any) -> tuple[FloatArray, FloatArray]:
    """Return angles, rad, and variations, m, of the row that holds for all azimuths."""
    rows = [(p.zenith_deg, p.value_m) for p in section.pcv_samples if p.azimuth_deg is None]
    table = np.array(sorted(rows), dtype=np.float64).reshape(-1, 2)
    return np.radians(table[:, 0]), table[:, 1]


def _grid(section: Any) -> tuple[FloatArray, FloatArray | None, FloatArray]:
    """Return zenith angles, azimuths and variations; without azimuths where the file gives one row only."""
    rows = sorted(
        (p.azimuth_deg, p.zenith_deg, p.value_m) for p in section.pcv_samples if p.azimuth_deg is not None
    )
    azimuths = np.unique([r[0] for r in rows])
    if len(azimuths) < 2:
        angles, values = _without_azimuth(section)
        return angles, None, values
    zenith = np.unique([r[1] for r in rows])
    table = np.array([r[2] for r in rows], dtype=np.float64).reshape(len(azimuths), len(zenith))
    return np.radians(zenith), np.radians(azimuths), table


def _receiver(name: str, radome: str, block: Any, notes: tuple[str, ...]) -> ReceiverAntenna:
    sections = {(s.frequency[0], _band(s.frequency, s.frequency[0])): s for s in block.frequency_sections}
    sections = {key: s for key, s in sections.items() if key[1]}
    if block.serial.strip():
        notes += (f"{name}: the calibration is that of serial number {block.serial.strip()}",)
    grids = {key: _grid(s) for key, s in sections.items()}
    return ReceiverAntenna(
        antenna=name,
        radome=radome,
        pco_neu_m={key: np.asarray(s.pco_m) for key, s in sections.items()},
        pcv={key: grid for key, grid in grids.items() if len(grid[0])},
        notes=notes,
    )
