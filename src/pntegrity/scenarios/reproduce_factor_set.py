"""The field test of factor-set fault detection (tables 5 to 14) on other data: the paper's is not public.

The drive through Nagoya at moderate load, at which the published method gains what the paper prints, and the
real log of Tsim Sha Tsui with a simulated IMU. Absolute errors are those of other streets; what compares is
by how much each method is better than the EKF.

References
----------
Chen, Sun, Cheng, Yang (2023), A factor set-based GNSS fault detection and exclusion for vehicle navigation in
urban environments, GPS Solutions 27:87.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.errors import InputError
from pntegrity.records import FloatArray
from pntegrity.scenarios._city_runs import (
    EKF,
    EXACT,
    LSR,
    METHODS,
    OURS,
    PUBLISHED,
    SPECS,
    Drive,
    Tracked,
    drives,
)
from pntegrity.scenarios._city_tables import HEADING, HORIZONTAL, SPACE, WHOLE, Found, gain, of_section, rmse
from pntegrity.scenarios._real_logs import rms
from pntegrity.scenarios._urban_logs import missing, scenario
from pntegrity.scenarios.reproduce_sraime_spp import Result, Row, row

__all__ = ["SHOWN", "TABLES", "Table", "figures", "reproduce", "rows_of"]

#: Methods in the tables, and what the paper's file calls them.
SHOWN: Mapping[str, str | None] = {
    EKF: "EKF", LSR: "LSR", PUBLISHED: "factor_set", EXACT: None, OURS: None,
}  # fmt: skip
#: Sections of the paper's tables in their order.
ORDER = (WHOLE, "open", "challenging", "denied")


@dataclass(frozen=True)
class Table:
    """A kind of table: its key in the paper's file, numbers by section, columns, and the errors (n, columns)
    of a run; `statistics` tells mean, largest and standard deviation instead of the root mean square.
    """

    key: str
    numbers: Mapping[str, int]
    columns: str
    errors: Callable[[Tracked], FloatArray]
    statistics: bool = False


def _position(run: Tracked) -> FloatArray:
    east, north, up = run.position_m.T
    return np.stack([north, east, -up, run.horizontal_m, np.linalg.norm(run.position_m, axis=1)], axis=1)


def _motion(run: Tracked) -> FloatArray:
    east, north, up = run.velocity_mps.T
    return np.column_stack([north, east, -up, np.rad2deg(run.attitude_rad)])


TABLES = (
    Table(
        "position", dict(zip(ORDER, (5, 7, 9, 11), strict=True)),
        "position RMSE north / east / down / horizontal / 3-D, m", _position,
    ),
    Table(
        "motion", dict(zip(ORDER, (6, 8, 10, 12), strict=True)),
        "RMSE of velocity north / east / down, m/s, roll / pitch / heading, degrees", _motion,
    ),
    Table(
        "horizontal", dict.fromkeys(ORDER[1:], 13), "horizontal error, mean / largest / STD, m",
        lambda run: run.horizontal_m[:, None], statistics=True,
    ),
    Table(
        "heading", dict.fromkeys(ORDER[1:], 14), "heading error, mean / largest / STD, degrees",
        lambda run: np.rad2deg(np.abs(run.attitude_rad[:, 2:])), statistics=True,
    ),
)  # fmt: skip


def reproduce(seeds: int = 3, *, data: Path | None = None) -> Result:
    """Run the experiment.

    Parameters
    ----------
    seeds : int
        Drives, the first of the quoted seeds; as many IMUs on the real log.
    data : Path, optional
        Folder of the real logs: trajectory and ephemerides of Nagoya, the log of Tsim Sha Tsui.

    Raises
    ------
    InputError
        No data folder, or files missing in it.
    """
    known = scenario().quoted
    if not 1 <= seeds <= len(known):
        raise InputError(f"factor-set has 1 to {len(known)} seeds, not {seeds}")
    if data is None:
        raise InputError(
            "factor-set runs on a real trajectory and a real log, and no folder was given",
            hint="Give the folder of the real logs with --data",
        )
    if lost := missing(data):
        raise InputError(lost, path=data, hint="Give the folder of the real logs with --data")
    methods = {n: METHODS[n] for n in SHOWN}
    nagoya = drives(Drive(data, "moderate", SPECS["STIM300"]), known[:seeds], methods)
    tst = drives(Drive(data, "tst", SPECS["STIM300"]), known[:seeds], methods)
    count = "1 seed" if seeds == 1 else f"{seeds} seeds"
    rows = [_note_row(count), *_gain_rows(nagoya, "Nagoya", compare=True), *rows_of(nagoya, published())]
    rows += [*_gain_rows(tst, "Tsim Sha Tsui", compare=False), *_tst_rows(tst)]
    return Result(tuple(rows), f"Factor-set fault detection (tables 5 to 14): Nagoya simulated, {count}")


def published() -> dict[str, Any]:
    """Return the paper's tables."""
    text = files("pntegrity.scenarios").joinpath("factor_set_published.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def figures(table: Table, runs: Sequence[Tracked], section: str) -> FloatArray:
    """Return the figures of one row of a table, means over the runs."""
    each = [_one(table, of_section(r, table.errors(r), section)) for r in runs]
    return np.asarray(np.mean(each, axis=0))


def _one(table: Table, errors: FloatArray) -> FloatArray:
    known = errors[np.isfinite(errors).all(axis=1)]
    if not table.statistics:
        return np.array([rms(column) for column in known.T])
    values = known[:, 0]
    return np.array([values.mean(), values.max(), values.std()])


def rows_of(found: Found, printed: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the paper's tables, a row a method and section."""
    for section in ORDER:
        for table in TABLES:
            if section not in table.numbers:
                continue
            for name, theirs in SHOWN.items():
                label = f"table {table.numbers[section]}, {section}: {table.columns}: {name}"
                paper = printed[table.key][section].get(theirs)
                measured = _text(figures(table, found[name], section))
                yield row(label, None if paper is None else _text(paper), measured, None)


def _tst_rows(found: Found) -> Iterator[Row]:
    for table in TABLES:
        for name in SHOWN:
            measured = _text(figures(table, found[name], WHOLE))
            yield row(f"Tsim Sha Tsui: {table.columns}: {name}", None, measured, None)


def _text(values: Sequence[float] | FloatArray) -> str:
    return " / ".join(f"{v:.3f}" for v in values)


def _note_row(count: str) -> Row:
    note = (
        f"Nagoya: real trajectory and ephemerides, moderate load, GNSS at 1 Hz and IMU simulated, {count}; "
        f"Tsim Sha Tsui: real GPS and BDS, IMU simulated on the truth, {count}; STIM300 at 125 Hz; paper: "
        "Nanjing, GPS and BDS at 10 Hz, STIM300"
    )
    return row("ran on", "one drive in Nanjing", "Nagoya and Tsim Sha Tsui", None, note)


#: What a method must gain on the EKF to reproduce the paper, per cent: least and most.
NEAR = {
    (LSR, HORIZONTAL): (10.0, 25.0), (LSR, SPACE): (10.0, 25.0), (PUBLISHED, HORIZONTAL): (45.0, 100.0),
    (PUBLISHED, SPACE): (50.0, 100.0), (PUBLISHED, HEADING): (10.0, 100.0),
}  # fmt: skip
#: What the paper prints of it.
PRINTED = {
    (LSR, HORIZONTAL): 16.6, (LSR, SPACE): 13.4, (LSR, HEADING): 18.0, (PUBLISHED, HORIZONTAL): 52.2,
    (PUBLISHED, SPACE): 56.9, (PUBLISHED, HEADING): 52.1,
}  # fmt: skip


def _gain_rows(found: Found, where: str, compare: bool) -> Iterator[Row]:
    """Yield by how much each method is better than the EKF, per cent, with the interval over seeds."""
    for name in (n for n in SHOWN if n != EKF):
        for quantity in (HORIZONTAL, SPACE, HEADING):
            value, (low, high) = gain(rmse(found[name], quantity), rmse(found[EKF], quantity))
            least, most = NEAR.get((name, quantity), (None, None)) if compare else (None, None)
            ok = None if least is None or most is None else least <= value <= most
            note = f"99 % interval over seeds {low:.1f} to {high:.1f}" if len(found[name]) > 1 else "one seed"
            note += "" if least is None else f"; reproduced from {least:g} to {most:g}"
            label = f"{where}, {WHOLE}: {quantity} error of {name} below that of the EKF, %"
            yield row(label, PRINTED.get((name, quantity)) if compare else None, round(value, 1), ok, note)
