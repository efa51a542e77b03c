"""Acoustic and other underwater measurements as CSV, units in the columns' names -> observations.

One file holds what one source said: travel times, ranges and directions, depths, or velocities over the
ground.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._acoustics import with_repeats
from pntegrity.formats._columns import (
    TIMES,
    checked,
    first_of,
    has_time,
    matched,
    second_time,
    split_csv,
    time_of,
)  # fmt: skip
from pntegrity.formats._source import read_text
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


class _Value(NamedTuple):
    """One measured value: key, SI value and sigma (nan: not declared), ways, time of transmission (-1:
    none).
    """

    key: str
    value: float
    sigma: float
    ways: int
    sent_ns: int


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
    cells = split_csv(read_text(path), path)
    lines = _Lines(_plain(cells.names), source, beacons, origin_ns, path)
    by_time: dict[int, list[_Value]] = {}
    bad: list[int] = []
    for number, row in zip(cells.lines, cells.rows, strict=True):
        found = lines.read(row, number)
        if found is None:
            bad.append(number)
        elif found[1]:
            by_time.setdefault(found[0], []).extend(found[1])
    _check_any(by_time, bad, path, told)
    _check_sizes([v for values in by_time.values() for v in values], lines.columns, path)
    _tell_twice(by_time, path, told)
    return with_repeats([_observation(source, t, by_time[t]) for t in sorted(by_time)], told)


def _plain(names: Sequence[str]) -> list[str]:
    """Return names of columns in lower case, with the unit behind a ``_``, also where it is in brackets."""
    return [re.sub(r"[\s_]*[\[(](.*?)[\])]", r"_\1", n).strip().lower().replace(" ", "_") for n in names]


def _check_any(
    by_time: Mapping[int, Sequence[_Value]], bad: Sequence[int], path: Path, notes: list[str]
) -> None:
    if bad:
        notes.append(
            f"{path.name}: {len(bad)} lines dropped: no time or no usable number, first line {bad[0]}"
        )
    if not any(by_time.values()):
        why = ": each is without a time or a usable number" if bad else ""
        raise InputError(f"no usable line{why}", path=path, line=bad[0] if bad else None, hint=HINT)


def _tell_twice(by_time: Mapping[int, Sequence[_Value]], path: Path, notes: list[str]) -> None:
    twice = {t: len(values) - len({v.key for v in values}) for t, values in by_time.items()}
    if any(twice.values()):
        first = to_iso(min(t for t, n in twice.items() if n))
        notes.append(
            f"{path.name}: {sum(twice.values())} rows dropped: one of the same name and time comes later, "
            f"first at {first}"
        )


class _Lines:
    """What the lines of a table mean."""

    def __init__(
        self, plain: Sequence[str], source: str, beacons: Sequence[str] | None, origin_ns: int | None,
        path: Path,
    ) -> None:  # fmt: skip
        self.source, self.beacons, self.path = source, beacons, path
        self.columns = _columns(plain, path)
        self.clock = _Clock(plain, origin_ns, path)
        self.beacon_at = first_of(plain, BEACONS)

    def read(self, cells: Sequence[str], line: int) -> tuple[int, list[_Value]] | None:
        """Return the time and what was measured; None where there is no time or a number is none.

        Raises
        ------
        InputError
            A beacon without coordinates, an angle that is none, or seconds from an unknown time on.
        """
        try:
            t = self.clock.read(cells)
            found, sent = self._measured(cells, line), self.clock.sent(cells)
        except InputError:
            raise
        except (ValueError, IndexError, OverflowError):
            return None
        return t, [v._replace(sent_ns=sent) for v in found]

    def _measured(self, cells: Sequence[str], line: int) -> list[_Value]:
        """Return the values of a line's cells that are not empty."""
        beacon = self._beacon(cells, line)
        return [_value(cells, c, self.source, beacon, line, self.path) for c in self.columns if cells[c.at]]

    def _beacon(self, cells: Sequence[str], line: int) -> str:
        if self.beacon_at is None:
            return ""
        beacon = cells[self.beacon_at]
        if self.beacons is not None and beacon not in self.beacons:
            raise InputError(
                f"beacon {beacon!r} has no coordinates", path=self.path, line=line,
                hint=f"There are those of {', '.join(self.beacons)}",
            )  # fmt: skip
        return beacon


class _Clock:
    """Times of the lines of a table."""

    def __init__(self, plain: Sequence[str], origin_ns: int | None, path: Path) -> None:
        self.column = matched(plain)
        self.origin_ns, self.path = origin_ns, path
        self.seconds = first_of(plain, TIMES["t_s"])
        self.sent_at = first_of(plain, ("sent_t_ns",))
        self.bare = not has_time(self.column)
        if self.bare and self.seconds is None:
            raise InputError("no column for the time", path=path, line=1, hint=HINT)

    def read(self, cells: Sequence[str]) -> int:
        """Return the time of a line (ValueError: none)."""
        if not self.bare or self.seconds is None:
            return time_of(cells, self.column)
        return second_time(cells[self.seconds], self.origin_ns, self.path)

    def sent(self, cells: Sequence[str]) -> int:
        """Return the time of transmission; -1 where the table has none (ValueError: it is none)."""
        if self.sent_at is None or not cells[self.sent_at]:
            return -1
        return checked(int(cells[self.sent_at]))


def _columns(plain: Sequence[str], path: Path) -> list[_Column]:
    found = [_recognised(at, name, plain, path) for at, name in enumerate(plain)]
    columns = [c for c in found if c is not None]
    if not columns:
        raise InputError(
            f"no column with a measurement among {', '.join(plain)[:200]}", path=path, line=1, hint=HINT
        )
    return columns


def _recognised(at: int, name: str, plain: Sequence[str], path: Path) -> _Column | None:
    """Return what a column holds; None where that is no measurement."""
    if name in QUANTITIES:
        raise InputError(
            f"column {name!r} has no unit", path=path, line=1,
            hint=f"Call it {' or '.join(f'{name}_{u}' for u in QUANTITIES[name][1])}",
        )  # fmt: skip
    head, _, unit = name.rpartition("_")
    if head not in QUANTITIES:
        return None
    rows, units, ways = QUANTITIES[head]
    if unit not in units:
        raise InputError(
            f"column {name!r}: unknown unit {unit!r}", path=path, line=1, hint=f"Known are {', '.join(units)}"
        )
    return _Column(at, rows, units[unit], ways, first_of(plain, (f"sigma_{name}",)), name)


def _value(cells: Sequence[str], column: _Column, source: str, beacon: str, line: int, path: Path) -> _Value:
    """Return the value of a cell (ValueError: it is none)."""
    value = _finite(cells[column.at])
    if column.rows in ANGLES:
        _check_angle(value, column, line, path)
    if column.rows in ABOVE_ZERO and value <= 0.0:
        raise ValueError(f"{value:g} is no time and no distance")
    key = f"{source}:R.{beacon}" if beacon and column.rows == "R.time" else f"{source}:{column.rows}"
    declared = "" if column.sigma is None else cells[column.sigma]
    sigma = _finite(declared) * column.factor if declared else np.nan
    return _Value(key, value * column.factor, sigma, column.ways, -1)


def _check_angle(value: float, column: _Column, number: int, path: Path) -> None:
    if abs(value * column.factor) > TURN_RAD:
        unit = column.name.rpartition("_")[2]
        hint = "These look like degrees: call the column " + column.name.rpartition("_")[0] + "_deg"
        raise InputError(
            f"{value:g} {unit} in column {column.name!r} is more than a turn", path=path, line=number,
            hint=hint if unit != "deg" else "Directions lie within 360 degrees",
        )  # fmt: skip


def _check_sizes(values: Sequence[_Value], columns: Sequence[_Column], path: Path) -> None:
    """Refuse columns whose usual value is larger than any in the unit declared."""
    for c in columns:
        of_it = [v.value for v in values if (v.ways == c.ways if c.ways else v.key.endswith(f":{c.rows}"))]
        usual = float(np.median(of_it)) if of_it else 0.0
        if usual > LARGEST.get(c.rows, np.inf):
            raise _too_large(usual, c, path)


def _too_large(usual: float, column: _Column, path: Path) -> InputError:
    head, _, unit = column.name.rpartition("_")
    units = ", ".join(u for u in QUANTITIES[head][1] if u != unit)
    kind, si = ("time", "s") if column.ways else (column.rows.partition(".")[2], "m")
    return InputError(
        f"column {column.name!r}: a {kind} of {usual / column.factor:g} {unit} is usual there, more than "
        f"{LARGEST[column.rows]:g} {si}", path=path,
        hint=f"If it is in another unit, call the column {head}_ and {units}" if units else HINT,
    )  # fmt: skip


def _finite(cell: str) -> float:
    value = float(cell)
    if not np.isfinite(value):
        raise ValueError(f"{cell!r} is no number")
    return value


def _observation(source: str, t_ns: int, values: Sequence[_Value]) -> Observation:
    unique = {v.key: v for v in values}
    facts = [v[1:] for v in unique.values()]
    y, sigma, ways, sent = (np.array(column) for column in zip(*facts, strict=True))
    aux = {"ways": ways} if ways.any() else {}
    if (sent >= 0).all():
        aux["t0_ns"] = sent.astype(np.int64)
    declared = sigma if (sigma > 0.0).all() else None
    return Observation(source, t_ns, tuple(unique), y, declared, aux)
