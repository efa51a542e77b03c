"""Earth rotation files of IGS (ERP, version 2) -> `PolarMotion`. Our own parser: sidereon has none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.formats.sp3 import civil_to_gps_ns
from pntegrity.physics.products import PolarMotion
from pntegrity.physics.time import DAY_NS, to_iso

__all__ = ["PolarMotion", "read_erp"]

_HINT = "Give an Earth rotation file of IGS (.ERP), version 2"
_MJD_GPS = 44_244
"""1980-01-06."""
MAX_ARCSEC = 5.0
"""The pole stays within 1 arcsec of the origin: larger numbers are of another column or unit."""


def read_erp(paths: Sequence[Path | str] | Path | str) -> PolarMotion:
    """Read the pole of one or several files; of a time in two files the later file's row counts.

    Parameters
    ----------
    paths : sequence of Path
        Plain or gzip.

    Returns
    -------
    PolarMotion
        Rising in time; its `notes` tell what was left out.

    Raises
    ------
    InputError
        A file is missing, no such file, or holds no row.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no Earth rotation file given", hint=_HINT)
    notes: list[str] = []
    rows: dict[int, tuple[float, float]] = {}
    sources = []
    for path in files:
        own = _read(path, notes)
        rows |= own
        sources.append(f"{path.name} ({to_iso(min(own))[:10]} to {to_iso(max(own))[:10]})")
    times = sorted(rows)
    pole = np.array([rows[t] for t in times])
    return PolarMotion(np.array(times, dtype=np.int64), pole[:, 0], pole[:, 1], tuple(sources), tuple(notes))


def _read(path: Path, notes: list[str]) -> dict[int, tuple[float, float]]:
    lines = read_text(path).splitlines()
    if not any(line.strip().upper().startswith("VERSION 2") for line in lines[:5]):
        raise InputError("this is no ERP file of version 2 (its first line)", path=path, line=1, hint=_HINT)
    start = next((k for k, line in enumerate(lines) if line.split()[:1] == ["MJD"]), len(lines))
    rows = {}
    for number, line in enumerate(lines[start + 1 :], start=start + 2):
        if not line[:1].isspace() and not line[:1].isdigit():
            continue
        words = line.split()
        if not words or not words[0][0].isdigit():
            continue
        row = _row(words)
        if row is None:
            notes.append(f"{path.name} line {number} dropped, it cannot be read")
        else:
            rows[row[0]] = row[1:]
    if not rows:
        raise InputError("the file holds no pole", path=path, hint="It is damaged or cut off: get it again")
    return rows


def _row(words: list[str]) -> tuple[int, float, float] | None:
    """Return time (UTC of the file as ns of GPS time) and pole, arcsec, of MJD, X and Y in 1e-6 arcsec."""
    try:
        mjd, x, y = (float(w) for w in words[:3])
    except ValueError:
        return None
    if not (40_000.0 < mjd < 100_000.0 and abs(x) < MAX_ARCSEC * 1e6 and abs(y) < MAX_ARCSEC * 1e6):
        return None
    utc = round((mjd - _MJD_GPS) * 86_400) * (DAY_NS // 86_400)
    return utc + civil_to_gps_ns(utc, "UTC"), x * 1e-6, y * 1e-6
