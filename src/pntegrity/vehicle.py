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
from pntegrity.source_files import LOADING, fields_of, listed, name_of, read_source
from pntegrity.states import source_of

__all__ = [
    "carried_on",
    "check_clocks",
    "check_names",
    "loaded",
    "priors_of",
    "sources_of",
    "types",
    "with_fields",
]

#: A source that begins so much later than the first, or ends so much earlier than the last, is told, s.
LATE_S = 30.0
#: Fields of any type that are vectors.
THREE = ("lever_arm_m", "mount_deg")
#: By how much GPS time is ahead of UTC, s, and how close to it a shift of stamps looks like it.
UTC_S, NEARLY_S = 18.0, 1.5
#: A silence of all sources is longer than so many usual steps, and than so long, s.
SILENT_STEPS, SILENT_S = 5, 2.0
#: How long the inertial unit alone is asked where the vehicle is after a source spoke, s.
ALONE_S = 120.0


def types() -> dict[str, type[Any]]:
    """Return the types of sources by name: the modules of `sensors` that hold a class with ``rows``."""
    found = classes_with("pntegrity.sensors", "rows")
    return {
        n: c for n, c in found.items() if hasattr(c, "nuisances") and not getattr(c, "_is_protocol", False)
    }


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

    Raises
    ------
    ValueError
        Naming the source whose value is no probability.
    """
    names = list(map(name_of, tables))
    for name, table in zip(names, tables, strict=True):
        for field in ("prior", "prior_sensor"):
            p = table.get(field, 0.0)
            if isinstance(p, bool) or not isinstance(p, int | float) or not 0.0 <= p <= 1.0:
                raise ValueError(f"source {name}: `{field}` must be a number of 0 to 1, not {p!r}")
    whole = {n: t["prior"] for n, t in zip(names, tables, strict=True) if "prior" in t}
    each = {f"{n}.*": t["prior_sensor"] for n, t in zip(names, tables, strict=True) if "prior_sensor" in t}
    return whole | each


def check_names(tables: Sequence[Mapping[str, Any]], stated: Iterable[str]) -> None:
    """Refuse priors of what is no source of a vehicle; without sources nothing is known of them.

    Raises
    ------
    ValueError
        Naming the prior, and the sources that there are.
    """
    names = list(map(name_of, tables))
    for name in stated:
        if names and source_of(name) not in names:
            raise ValueError(f"[ism.sources] has {name!r}, which is no source; there are {', '.join(names)}")


def with_fields(tables: Sequence[Mapping[str, Any]], given: Any) -> tuple[dict[str, Any], ...]:
    """Return ``[[source]]`` tables with other fields, such as the sigmas of a calibration.

    Parameters
    ----------
    tables : sequence of mapping
    given : mapping of str to mapping
        Fields by name of the source; they win.

    Raises
    ------
    ValueError
        Naming what is no source, or no table of fields.
    """
    names = list(map(name_of, tables))
    for name, fields_ in given.items() if isinstance(given, Mapping) else [("", given)]:
        if not isinstance(fields_, Mapping):
            raise ValueError(f"[noise.sources] must hold a table for each source, not {fields_!r}")
        if name not in names:
            there = f"there are {', '.join(names)}" if names else "the run has no [[source]] tables"
            raise ValueError(f"[noise.sources] has {name!r}, which is no source; {there}")
    return tuple({**table, **given.get(name, {})} for name, table in zip(names, tables, strict=True))


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
        if key in THREE and not _is_three_numbers(given[key]):
            raise ValueError(f"source {name}: `{key}` must be three numbers, not {table[key]!r}")
    told = fields_of(kind, table)
    named = {k for k in given if isinstance(given[k], str)} & told.keys()  # a file in the place of a value
    try:
        made: Source = cls(**(told | {k: v for k, v in given.items() if k not in named}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"source {name}: {error}") from None
    return made


def _is_three_numbers(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 3 and all(isinstance(v, int | float) for v in value)


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
            notes.append(f"source {name_of(table)} said nothing")
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
        name = name_of(table)
        if name not in times:
            notes.append(f"source {name} says nothing in the time of the run")
            continue
        file = next((Path(p) for key in ("file", "obs") for p in listed(table.get(key))), path)
        check_in_common((name, times[name]), ("the IMU", imu_ns), file)
        _told_late(f"source {name}", times[name], epochs, notes)
    _told_late("the IMU", imu_ns, epochs, notes, SILENT_S)
    _told_shifted(times, notes)


def _told_late(
    who: str, times: Times, epochs: Sequence[Epoch], notes: list[str], least_s: float = LATE_S
) -> None:
    """Note what begins later, or ends earlier, by more than some seconds."""
    late = (int(times.min()) - epochs[0].t_ns) * 1e-9
    early = (epochs[-1].t_ns - int(times.max())) * 1e-9
    if late > least_s:
        notes.append(f"{who} begins at {to_iso(int(times.min()))}, {late:.0f} s late")
    if early > least_s:
        notes.append(f"{who} ends at {to_iso(int(times.max()))}, {early:.0f} s early")


def _told_shifted(times: Mapping[str, Times], notes: list[str]) -> None:
    """Note which source is early or late from its begin to its end as if its stamps were UTC."""
    spans = np.array([[t.min(), t.max()] for t in times.values()])
    for name, off in zip(times, (spans - np.median(spans, axis=0)) * 1e-9, strict=True):
        if (np.abs(np.abs(off) - UTC_S) < NEARLY_S).all() and off[0] * off[1] > 0.0:
            notes.append(
                f"all times of source {name} are {UTC_S:g} s {'after' if off[0] > 0.0 else 'before'} those "
                "of the others, which is what UTC and GPS time differ by: see its stamps"
            )


def carried_on(
    epochs: Sequence[Epoch], imu_ns: Times, notes: list[str], end_ns: int | None = None
) -> tuple[Epoch, ...]:
    """Return the epochs, and empty ones where no source says anything and the inertial unit goes on.

    Parameters
    ----------
    epochs : sequence of Epoch
    imu_ns : ndarray of int64
        Times of the unit.
    notes : list of str
        Gets where it is alone.
    end_ns : int, optional
        End of the run.
    """
    t = np.array([e.t_ns for e in epochs], dtype=np.int64)
    if len(t) < 2:
        return tuple(epochs)
    step = int(np.median(np.diff(t)))
    silent = max(SILENT_STEPS * step, round(SILENT_S * SECOND_NS))
    until = int(imu_ns.max()) if end_ns is None else min(int(imu_ns.max()), end_ns)
    out = list(epochs)
    for a, b in zip(t.tolist(), [*t[1:].tolist(), max(until, int(t[-1])) + 1], strict=True):
        if b - a <= silent:
            continue
        alone = range(a + step, min(b - step // 2, until + 1, a + round(ALONE_S * SECOND_NS) + 1), step)
        inside = [k for k in alone if imu_ns[np.searchsorted(imu_ns, k)] - k < silent]
        out += [Epoch(k, ()) for k in inside]
        if inside:
            notes.append(f"no source says anything after {to_iso(a)}: {len(inside)} epochs of the INS alone")
    return tuple(sorted(out, key=lambda e: e.t_ns))
