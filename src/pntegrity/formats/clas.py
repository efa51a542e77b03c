"""Decoded corrections of QZSS CLAS (CSV) -> `ClasCorrections`: files of satellites and of the troposphere.

Both are what a decoder had at hand in one place, a row (a satellite) every few seconds; the header names the
columns. See docs/formats/clas.md.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text, without_cut_line
from pntegrity.physics.ssr_corrections import ClasCorrections, SatelliteCorrections, quality_tecu
from pntegrity.physics.time import from_week_tow

__all__ = ["ClasCorrections", "Row", "read_clas", "series", "unknown_in_words"]

TIME = ("gps_week", "tow")
SATELLITE = (
    *TIME, "sat", "iode", "dorb_radial_m", "dorb_along_m", "dorb_cross_m", "dclk_m", "ura_m", "stec_tecu",
    "stec_quality", "cbias", "pbias",
)  # fmt: skip
TROPOSPHERE = (*TIME, "network", "zhd_at_0m", "zwd_at_0m")
SYSTEMS = "GREJC"
_HINT = "Give the CSV files of satellites and troposphere (docs/formats/clas.md), or the raw L6 file"


@dataclass(frozen=True)
class Row:
    """One satellite at one time, as the service codes it: a line of the file.

    Parameters
    ----------
    iode : int
        Issue of data.
    numbers : tuple of float
        Orbit (radial, along, cross), clock, URA (m), slant content (TECU), its quality (m on L1).
    code, phase : mapping of str to float
        Biases by signal, m.
    """

    iode: int
    numbers: tuple[float, ...]
    code: Mapping[str, float]
    phase: Mapping[str, float]


@dataclass
class _Found:
    """Rows as read: by satellite and time, and of the troposphere by time."""

    satellites: dict[str, dict[int, Row]] = field(default_factory=dict)
    troposphere: dict[int, tuple[float, float]] = field(default_factory=dict)
    networks: set[int] = field(default_factory=set)


def read_clas(paths: Sequence[Path | str] | Path | str) -> ClasCorrections:
    """Read decoded CLAS corrections; the header tells which file is which, of equal rows the last counts.

    Parameters
    ----------
    paths : sequence of Path
        One or several files of satellites and of the troposphere, plain or gzip, in any order.

    Returns
    -------
    ClasCorrections
        Its `notes` count what is marked as not known.

    Raises
    ------
    InputError
        A file is missing or of another kind, a line cannot be read, or no satellite is in them.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no file of CLAS corrections given", hint=_HINT)
    found, notes = _Found(), list[str]()
    for path in files:
        _read(path, found, notes)
    if not found.satellites:
        raise InputError("no satellite's corrections in these files", path=files[0], hint=_HINT)
    satellites = {sat: series(rows) for sat, rows in sorted(found.satellites.items())}
    if not found.troposphere:
        notes.append("no file of the troposphere: no zenith delay")
    if len(found.networks) > 1:
        names = ", ".join(map(str, sorted(found.networks)))
        notes.append(f"zenith delays of several networks ({names}): the receiver moved, or files are mixed")
    times = np.array(sorted(found.troposphere), dtype=np.int64)
    delays = np.array([found.troposphere[t] for t in times.tolist()]).reshape(-1, 2)
    return ClasCorrections(
        satellites, times, delays[:, 0], delays[:, 1], max(found.networks, default=0),
        tuple(p.name for p in files), (*notes, *unknown_in_words(satellites)),
    )  # fmt: skip


def unknown_in_words(satellites: Mapping[str, SatelliteCorrections]) -> list[str]:
    """Return notes on the values that the service marks as not known."""
    kinds = {
        "accuracy (URA) not known, satellite not used then": [c.ura_m for c in satellites.values()],
        "quality of the slant delay not known, delay not used then": [
            c.stec_sigma_tecu for c in satellites.values()
        ],
        "biases not known, signal not used then": [
            v for c in satellites.values() for v in (*c.code_bias_m.values(), *c.phase_bias_m.values())
        ],
    }
    counts = {what: sum(int(np.isnan(v).sum()) for v in rows) for what, rows in kinds.items()}
    return [f"{what}: {n} values" for what, n in counts.items() if n]


def _read(path: Path, found: _Found, notes: list[str]) -> None:
    told: list[str] = []
    text = without_cut_line(read_text(path), told)
    notes += [f"{path.name}: {n}" for n in told]
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    if set(SATELLITE) <= set(header):
        add = _add_satellite
    elif set(TROPOSPHERE) <= set(header):
        add = _add_troposphere
    else:
        raise InputError(
            "this is no file of CLAS corrections: its header lacks "
            f"{', '.join(c for c in SATELLITE if c not in header)}",
            path=path,
            line=1,
            hint=_HINT,
        )
    for number, row in _rows(header, lines):
        try:
            add(row, found)
        except (ValueError, OverflowError) as error:
            raise InputError(
                f"this line cannot be read ({error})", path=path, line=number, hint="Decode the log again"
            ) from None


def _rows(header: list[str], lines: Iterator[list[str]]) -> Iterator[tuple[int, dict[str, str]]]:
    for number, row in enumerate(lines, 2):
        if row:
            padded = row + [""] * (len(header) - len(row))
            yield number, dict(zip(header, padded, strict=False))


def _t_ns(row: Mapping[str, str]) -> int:
    week, tow = int(row["gps_week"]), float(row["tow"])
    if not (0 <= week < 10_000 and 0.0 <= tow <= 604_800.0):
        raise ValueError(f"no such GPS time: week {week}, second {tow:g}")
    return int(from_week_tow(week, tow))


def _add_satellite(row: Mapping[str, str], found: _Found) -> None:
    sat = row["sat"].strip()
    if len(sat) != 3 or sat[0] not in SYSTEMS or not sat[1:].isdigit():
        raise ValueError(f"no such satellite: {sat!r}")
    numbers = tuple(_number(row[name]) for name in SATELLITE[4:11])
    of = Row(
        int(row["iode"]), numbers, _biases(row["cbias"], sat[0] + "C"), _biases(row["pbias"], sat[0] + "L")
    )
    found.satellites.setdefault(sat, {})[_t_ns(row)] = of


def _add_troposphere(row: Mapping[str, str], found: _Found) -> None:
    found.networks.add(int(row["network"]))
    found.troposphere[_t_ns(row)] = _number(row["zhd_at_0m"]), _number(row["zwd_at_0m"])


def _number(text: str) -> float:
    """Return a number; an empty field is nan."""
    value = float(text) if text.strip() else math.nan
    if math.isinf(value):
        raise ValueError(f"not finite: {text!r}")
    return value


def _biases(text: str, kind: str) -> dict[str, float]:
    """Return biases by signal of ``"GC1C=0.0000;GC2X=1.8600"``."""
    out = {}
    for item in filter(None, (part.strip() for part in text.split(";"))):
        name, equals, value = item.partition("=")
        if not equals or len(name) != 4 or name[:2] != kind:
            raise ValueError(f"no bias: {item!r}")
        out[name[2:]] = _number(value)
    return out


def series(rows: Mapping[int, Row]) -> SatelliteCorrections:
    """Return the rows of a satellite, by time (ns), as columns."""
    times = sorted(rows)
    ordered = [rows[t] for t in times]
    numbers = np.array([r.numbers for r in ordered], dtype=np.float64)
    code, phase = ([getattr(r, name) for r in ordered] for name in ("code", "phase"))
    return SatelliteCorrections(
        np.array(times, dtype=np.int64), np.array([r.iode for r in ordered]), numbers[:, :3], numbers[:, 3],
        numbers[:, 4], numbers[:, 5], quality_tecu(numbers[:, 6]), _columns(code), _columns(phase),
    )  # fmt: skip


def _columns(rows: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    signals = sorted({s for row in rows for s in row})
    return {s: np.array([row.get(s, math.nan) for row in rows]) for s in signals}
