"""A vehicle as its description has it: sources of navigation by type, and what they said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.discovery import classes_with
from pntegrity.errors import InputError
from pntegrity.formats._acoustics import check_in_common, epochs_of
from pntegrity.physics.time import SECOND_NS, to_iso
from pntegrity.records import Epoch, Observation
from pntegrity.sensors.source import Source
from pntegrity.source_files import LOADING, fields_of, read_source

__all__ = ["check_clocks", "loaded", "priors_of", "sources_of", "types"]

#: A source that begins so much later than the first, or ends so much earlier than the last, is told, s.
LATE_S = 60.0


def types() -> dict[str, type[Any]]:
    """Return the types of sources by name: the modules of `sensors` that hold a class with ``rows``."""
    return classes_with("pntegrity.sensors", "rows")


def sources_of(tables: Sequence[Mapping[str, Any]]) -> tuple[Source, ...]:
    """Return the sources of ``[[source]]`` tables.

    Parameters
    ----------
    tables : sequence of mapping
        ``type``, ``name`` and the fields of the type.

    Raises
    ------
    ValueError
        Naming the source, the field and what is allowed.
    """
    made = tuple(_source(dict(t), i + 1) for i, t in enumerate(tables))
    names = [s.name for s in made]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two sources are called {name!r}: give each a `name` of its own")
    return made


def priors_of(tables: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the fault probabilities that ``[[source]]`` tables state: `prior` of the source as ``"lbl"``,
    `prior_sensor` of any one of its sensors as ``"lbl.*"``; fields of `Ism.sources`.
    """
    names = [str(t.get("name") or t.get("type")) for t in tables]
    whole = {n: t["prior"] for n, t in zip(names, tables, strict=True) if "prior" in t}
    each = {f"{n}.*": t["prior_sensor"] for n, t in zip(names, tables, strict=True) if "prior_sensor" in t}
    return whole | each


def _source(table: dict[str, Any], number: int) -> Source:
    kind = str(table.pop("type", ""))
    if kind not in types():
        known = ", ".join(sorted(types()))
        raise ValueError(f"[[source]] {number}: `type` must be one of {known}, not {kind!r}")
    cls = types()[kind]
    name = str(table.setdefault("name", kind))
    if not name.isidentifier():
        raise ValueError(f"[[source]] {number}: `name` must be letters, digits and _, not {name!r}")
    allowed = [f.name for f in fields(cls)]
    given = {k: _plain(v) for k, v in table.items() if k in allowed or k not in LOADING}
    for key in given:
        if key not in allowed:
            raise ValueError(
                f"source {name}: a source of type {kind} has no `{key}`; it has {', '.join(allowed)}"
            )
    told = fields_of(kind, table)
    named = {k for k in given if isinstance(given[k], str)} & told.keys()  # a file in the place of a value
    try:
        made: Source = cls(**(told | {k: v for k, v in given.items() if k not in named}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"source {name}: {error}") from None
    return made


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def loaded(tables: Sequence[Mapping[str, Any]], notes: list[str]) -> tuple[Epoch, ...]:
    """Return what all sources said, by time.

    Parameters
    ----------
    tables : sequence of mapping
        As for `sources_of`, each with its ``file``.
    notes : list of str
        Gets what was dropped, and which source said nothing.

    Raises
    ------
    InputError
        A file that cannot be used, or a table without one.
    """
    said: list[Observation] = []
    for table in tables:
        kind = str(table["type"])
        found = read_source(kind, table, notes).observations
        if not found:
            notes.append(f"source {table.get('name', kind)} said nothing")
        said += found
    _told_apart(said, notes)
    return epochs_of(said)


Times = npt.NDArray[np.int64]


def _times_of(observations: Iterable[Observation]) -> dict[str, Times]:
    """Return when each source said something."""
    times: dict[str, list[int]] = {}
    for o in observations:
        times.setdefault(o.sensor, []).append(o.t_ns)
    return {name: np.array(t, dtype=np.int64) for name, t in times.items()}


def _told_apart(said: Iterable[Observation], notes: list[str]) -> None:
    """Note sources that have no time in common: one may have ended before the other began."""
    times = _times_of(said)
    for a, b in combinations(times, 2):
        try:
            check_in_common((a, times[a]), (b, times[b]))
        except InputError as error:
            notes.append(f"sources {a} and {b}: {error.message}")


def check_clocks(
    tables: Sequence[Mapping[str, Any]], epochs: Sequence[Epoch], imu_ns: Times, path: Path, notes: list[str]
) -> None:
    """Check that each source of a vehicle has times in common with its inertial measurement unit.

    Parameters
    ----------
    tables : sequence of mapping
        As for `sources_of`.
    epochs : sequence of Epoch
        Of the run.
    imu_ns : ndarray of int64
        Times of the unit.
    path : Path
        Of the unit's table, for messages.
    notes : list of str
        Gets which source says nothing in the run, begins late or ends early.

    Raises
    ------
    InputError
        A source's clock and that of the unit disagree; both spans are named.
    """
    times = _times_of(o for e in epochs for o in e.observations)
    for table in tables:
        name = str(table.get("name", table["type"]))
        if name not in times:
            notes.append(f"source {name} says nothing in the time of the run")
            continue
        check_in_common((name, times[name]), ("the IMU", imu_ns), path)
        first, last = int(times[name].min()), int(times[name].max())
        if first - epochs[0].t_ns > LATE_S * SECOND_NS:
            notes.append(
                f"source {name} begins at {to_iso(first)}, {(first - epochs[0].t_ns) * 1e-9:.0f} s late"
            )
        if epochs[-1].t_ns - last > LATE_S * SECOND_NS:
            notes.append(
                f"source {name} ends at {to_iso(last)}, {(epochs[-1].t_ns - last) * 1e-9:.0f} s early"
            )
