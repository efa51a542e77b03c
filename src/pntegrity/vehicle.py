"""A vehicle as its description has it: sources of navigation by type, and what they said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pntegrity.discovery import classes_with
from pntegrity.errors import InputError
from pntegrity.formats._acoustics import epochs_of
from pntegrity.formats.acoustic_table import read_acoustics
from pntegrity.formats.fixes import read_fixes
from pntegrity.records import Epoch, Observation
from pntegrity.sensors.source import Source

__all__ = ["LOADING", "loaded", "sources_of", "types"]

#: Fields of a ``[[source]]`` table that say where its measurements are; all others are those of its type.
LOADING = ("type", "file", "origin_ns")


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


def _source(table: dict[str, Any], number: int) -> Source:
    kind = str(table.pop("type", ""))
    if kind not in types():
        known = ", ".join(sorted(types()))
        raise ValueError(f"[[source]] {number}: `type` must be one of {known}, not {kind!r}")
    cls = types()[kind]
    name = str(table.setdefault("name", kind))
    if not name.isidentifier():
        raise ValueError(f"[[source]] {number}: `name` must be letters, digits and _, not {name!r}")
    given = {k: _plain(v) for k, v in table.items() if k not in LOADING}
    allowed = [f.name for f in fields(cls)]
    for key in given:
        if key not in allowed:
            raise ValueError(
                f"source {name}: a source of type {kind} has no `{key}`; it has {', '.join(allowed)}"
            )
    try:
        made: Source = cls(**given)
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
    for source, table in zip(sources_of(tables), tables, strict=True):
        if not table.get("file"):
            raise InputError(f"source {source.name}: no `file`", hint='Write file = "its measurements.csv"')
        found = _read(source, str(table["type"]), Path(table["file"]), table.get("origin_ns"), notes)
        if not found:
            notes.append(f"source {source.name} said nothing")
        said += found
    return epochs_of(said)


def _read(
    source: Source, kind: str, path: Path, origin_ns: int | None, notes: list[str]
) -> Sequence[Observation]:
    if kind == "fix":
        return [
            _named(e.observations[0], source.name) for e in read_fixes(path, origin_ns=origin_ns, notes=notes)
        ]
    beacons = getattr(source, "beacons", None)
    return read_acoustics(
        path,
        source=source.name,
        beacons=tuple(beacons) if beacons else None,
        origin_ns=origin_ns,
        notes=notes,
    )


def _named(fix: Observation, source: str) -> Observation:
    """Return a receiver's fix as a source of another name says it."""
    keys = tuple(f"{source}:{'D' if k[4] == 'D' else 'R'}.{k[-1]}" for k in fix.keys)
    return replace(fix, sensor=source, keys=keys)
