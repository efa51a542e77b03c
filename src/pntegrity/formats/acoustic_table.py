"""Acoustic and other underwater measurements as CSV, units in the columns' names -> observations.

One file holds what one source said: travel times, ranges and directions, depths, or velocities over the
ground.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats import truth as tables
from pntegrity.formats._acoustics import with_repeats
from pntegrity.formats._source import read_text
from pntegrity.formats.imu_table import TIMES, seconds_to_ns
from pntegrity.physics.time import to_iso
from pntegrity.records import Observation

__all__ = ["QUANTITIES", "read_acoustics"]

DEG = np.pi / 180.0
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
LENGTH_UNITS = {"m": 1.0}
ANGLE_UNITS = {"rad": 1.0, "mrad": 1e-3, "deg": DEG}
SPEED_UNITS = {"mps": 1.0, "m/s": 1.0}
#: What a column is called before its unit -> kind and name of its rows, units, and how many ways.
QUANTITIES: dict[str, tuple[str, Mapping[str, float], int]] = {
    "two_way": ("R.time", TIME_UNITS, 2), "two_way_time": ("R.time", TIME_UNITS, 2),
    "twtt": ("R.time", TIME_UNITS, 2), "one_way": ("R.time", TIME_UNITS, 1),
    "one_way_time": ("R.time", TIME_UNITS, 1), "owtt": ("R.time", TIME_UNITS, 1),
    "range": ("R.range", LENGTH_UNITS, 0), "slant_range": ("R.range", LENGTH_UNITS, 0),
    "bearing": ("A.bearing", ANGLE_UNITS, 0), "elevation": ("A.elevation", ANGLE_UNITS, 0),
    "depth": ("R.z", LENGTH_UNITS, 0),
    "forward": ("D.X", SPEED_UNITS, 0), "right": ("D.Y", SPEED_UNITS, 0), "down": ("D.Z", SPEED_UNITS, 0),
}  # fmt: skip
BEACONS = ("beacon", "transponder", "sensor")
ANGLES = ("A.bearing", "A.elevation")
TURN_RAD = 2.0 * np.pi
#: Rows that are above 0, and all rows whose usual size tells a wrong unit: the largest that one can be, SI.
ABOVE_ZERO = ("R.time", "R.range")
LARGEST = {"R.time": 60.0, "R.range": 1e5, "R.z": 1.2e4}
HINT = "docs/formats/acoustics.md lists the columns"


@dataclass(frozen=True)
class _Column:
    """A column with measurements: where, what its rows are called, factor to SI, ways, where its sigma is."""

    at: int
    rows: str
    factor: float
    ways: int
    sigma: int | None
    name: str


def read_acoustics(
    path: Path | str, *, source: str, beacons: Sequence[str] | None = None, origin_ns: int | None = None,
    notes: list[str] | None = None,
) -> tuple[Observation, ...]:  # fmt: skip
    """Read the measurements of one source.

    Parameters
    ----------
    path : Path or str
        CSV, plain or gzip, with a header. Time of reception as in `read_truth`, or bare seconds ``t_s``;
        columns of `QUANTITIES` with their units (``two_way_ms``, ``bearing_deg``), each with its standard
        deviation in ``sigma_<name>`` where there is one; ``beacon`` names the beacon of travel times;
        ``sent_t_ns`` is the time of transmission.
    source : str
        What rows begin with: ``"lbl"``, ``"usbl"``, ...
    beacons : sequence of str, optional
        Beacons with known coordinates: any other is refused.
    origin_ns : int, optional
        GPS time of second 0 of bare seconds.
    notes : list of str, optional
        Gets what was dropped, and what is odd.

    Returns
    -------
    tuple of Observation
        By time, rows of one time together; ``aux["repeated"]`` counts how often a value came unchanged.

    Raises
    ------
    InputError
        No such file, unknown columns or columns without units, a beacon without coordinates, angles that are
        none in the unit declared, no usable line.
    """
    path, told = Path(path), [] if notes is None else notes
    names, rows, first_line = tables._split_csv(read_text(path), path)
    plain = [re.sub(r"[\s_]*[\[(](.*?)[\])]", r"_\1", n).strip().lower().replace(" ", "_") for n in names]
    columns = _columns(plain, path)
    by_time: dict[int, list[tuple[str, float, float, int, int]]] = {}
    bad: list[int] = []
    clock = _Clock(plain, origin_ns, path)
    for number, cells in enumerate(rows, first_line):
        try:
            t = clock.read(cells)
            found = _measured(cells, columns, plain, source, number, path, beacons)
        except InputError:
            raise
        except (ValueError, IndexError, OverflowError):
            bad.append(number)
            continue
        sent = clock.sent(cells)
        by_time.setdefault(t, []).extend((*entry, sent) for entry in found)
    if bad:
        told.append(
            f"{path.name}: {len(bad)} lines dropped: no time or no usable number, first line {bad[0]}"
        )
    if not any(by_time.values()):
        why = ": each is without a time or a usable number" if bad else ""
        raise InputError(f"no usable line{why}", path=path, line=bad[0] if bad else None, hint=HINT)
    _check_sizes([entry for entries in by_time.values() for entry in entries], columns, path)
    twice = {t: len(rows) - len({r[0] for r in rows}) for t, rows in by_time.items()}
    if any(twice.values()):
        first = to_iso(min(t for t, n in twice.items() if n))
        told.append(
            f"{path.name}: {sum(twice.values())} rows dropped: one of the same name and time comes later, "
            f"first at {first}"
        )
    return with_repeats([_observation(source, t, by_time[t]) for t in sorted(by_time)], told)


class _Clock:
    """Times of the lines of a table."""

    def __init__(self, plain: Sequence[str], origin_ns: int | None, path: Path) -> None:
        self.column = tables._match(plain)
        self.origin_ns, self.path = origin_ns, path
        self.seconds = next((plain.index(n) for n in TIMES["t_s"] if n in plain), None)
        self.sent_at = plain.index("sent_t_ns") if "sent_t_ns" in plain else None
        timed = "t_ns" in self.column or {"week", "tow"} <= self.column.keys() or "iso" in self.column
        self.bare = not timed
        if self.bare and self.seconds is None:
            raise InputError("no column for the time", path=path, line=1, hint=HINT)

    def read(self, cells: Sequence[str]) -> int:
        """Return the time of a line (ValueError: none)."""
        if not self.bare or self.seconds is None:
            return tables._time(cells, self.column)
        return int(seconds_to_ns(_finite(cells[self.seconds]), self.origin_ns, self.path))

    def sent(self, cells: Sequence[str]) -> int:
        """Return the time of transmission; -1 where the table has none."""
        return -1 if self.sent_at is None or not cells[self.sent_at] else int(cells[self.sent_at])


def _columns(plain: Sequence[str], path: Path) -> list[_Column]:
    out = []
    for at, name in enumerate(plain):
        head, _, unit = name.rpartition("_")
        if name in QUANTITIES:
            raise InputError(
                f"column {name!r} has no unit", path=path, line=1,
                hint=f"Call it {' or '.join(f'{name}_{u}' for u in QUANTITIES[name][1])}",
            )  # fmt: skip
        if head not in QUANTITIES:
            continue
        rows, units, ways = QUANTITIES[head]
        if unit not in units:
            raise InputError(
                f"column {name!r}: unknown unit {unit!r}", path=path, line=1,
                hint=f"Known are {', '.join(units)}",
            )  # fmt: skip
        sigma = plain.index(f"sigma_{name}") if f"sigma_{name}" in plain else None
        out.append(_Column(at, rows, units[unit], ways, sigma, name))
    if not out:
        raise InputError(
            f"no column with a measurement among {', '.join(plain)[:200]}", path=path, line=1, hint=HINT
        )
    return out


def _measured(
    cells: Sequence[str], columns: Sequence[_Column], plain: Sequence[str], source: str, number: int,
    path: Path, beacons: Sequence[str] | None,
) -> list[tuple[str, float, float, int]]:  # fmt: skip
    """Return key, value, sigma (nan: not declared) and ways of the cells of a line that are not empty."""
    at = next((plain.index(n) for n in BEACONS if n in plain), None)
    beacon = cells[at] if at is not None else ""
    if beacons is not None and at is not None and beacon not in beacons:
        raise InputError(
            f"beacon {beacon!r} has no coordinates", path=path, line=number,
            hint=f"There are those of {', '.join(beacons)}",
        )  # fmt: skip
    out = []
    for c in columns:
        if not cells[c.at]:
            continue
        value = _finite(cells[c.at])
        if c.rows in ANGLES:
            _check_angle(value, c, number, path)
        if c.rows in ABOVE_ZERO and value <= 0.0:
            raise ValueError(f"{value:g} is no time and no distance")
        key = f"{source}:R.{beacon}" if beacon and c.rows == "R.time" else f"{source}:{c.rows}"
        sigma = _finite(cells[c.sigma]) * c.factor if c.sigma is not None and cells[c.sigma] else np.nan
        out.append((key, value * c.factor, sigma, c.ways))
    return out


def _check_angle(value: float, column: _Column, number: int, path: Path) -> None:
    if abs(value * column.factor) > TURN_RAD:
        unit = column.name.rpartition("_")[2]
        hint = "These look like degrees: call the column " + column.name.rpartition("_")[0] + "_deg"
        raise InputError(
            f"{value:g} {unit} in column {column.name!r} is more than a turn", path=path, line=number,
            hint=hint if unit != "deg" else "Directions lie within 360 degrees",
        )  # fmt: skip


def _check_sizes(
    entries: Sequence[tuple[str, float, float, int, int]], columns: Sequence[_Column], path: Path
) -> None:
    """Refuse columns whose usual value is larger than any in the unit declared."""
    for c in columns:
        kind = "time" if c.ways else c.rows.partition(".")[2]
        values = [e[1] for e in entries if (e[3] == c.ways if c.ways else e[0].endswith(f":{c.rows}"))]
        most = LARGEST.get(c.rows, np.inf)
        usual = float(np.median(values)) if values else 0.0
        if usual > most:
            head, _, unit = c.name.rpartition("_")
            units = ", ".join(u for u in QUANTITIES[head][1] if u != unit)
            hint = f"If it is in another unit, call the column {head}_ and {units}" if units else HINT
            raise InputError(
                f"column {c.name!r}: a {kind} of {usual / c.factor:g} {unit} is usual there, more than "
                f"{most:g} {'s' if kind == 'time' else 'm'}", path=path, hint=hint,
            )  # fmt: skip


def _finite(cell: str) -> float:
    value = float(cell)
    if not np.isfinite(value):
        raise ValueError(f"{cell!r} is no number")
    return value


def _observation(
    source: str, t_ns: int, entries: Sequence[tuple[str, float, float, int, int]]
) -> Observation:
    unique = {key: entry for key, *entry in entries}
    y, sigma, ways, sent = (np.array(column) for column in zip(*unique.values(), strict=True))
    aux = {"ways": ways} if ways.any() else {}
    if (sent >= 0).all():
        aux["t0_ns"] = sent.astype(np.int64)
    declared = sigma if (sigma > 0.0).all() else None
    return Observation(source, t_ns, tuple(unique), y, declared, aux)
