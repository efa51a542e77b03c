"""What a ``[[source]]`` table reads: one reader for each type of source and layout of files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._acoustics import AcousticLog, with_repeats
from pntegrity.formats.acoustic_garpos import read_garpos
from pntegrity.formats.acoustic_gnatss import read_gnatss
from pntegrity.formats.acoustic_profile import read_profile
from pntegrity.formats.acoustic_table import read_acoustics
from pntegrity.formats.fixes import read_fixes
from pntegrity.records import Observation
from pntegrity.states import sensor_of

__all__ = [
    "LOADING", "LOGS", "SourceFile", "fields_of", "formats_of", "listed", "name_of", "read_log",
    "read_source",
]  # fmt: skip

#: Fields of a ``[[source]]`` table that say where its measurements are; all others are those of its type.
LOADING = (
    "type", "file", "format", "origin_ns", "sigma_m", "obs", "nav", "systems", "prior", "prior_sensor",
)  # fmt: skip
#: Layouts of whole logs, which hold a vessel's fixes, its travel times and where the beacons are.
LOGS: dict[str, Callable[..., AcousticLog]] = {"gnatss": read_gnatss, "garpos": read_garpos}
#: Types that whole logs have measurements for.
IN_LOGS = ("fix", "lbl")
#: Standard deviation of a travel time there and back, s, where neither table nor log tells one: what sound
#: that is not quite as the profile says leaves of real ones.
SIGMA_S = 2e-4
#: What --imu-start is for the unit's table is a field for a source's.
ORIGIN_HINT = "Say in its [[source]] table when second 0 was: origin_ns = 1436038440000000000, ns of GPS time"
#: Half a turn or a whole one, rad: where no more degrees than that are in a file, of so many rows at least,
#: these look like radians.
TURN, FEWEST_ANGLES = {"bearing": 2.0 * np.pi, "elevation": 0.5 * np.pi}, 20
#: The layout of a type of source where the table names none.
USUAL = {"gnss": "rinex"}


@dataclass(frozen=True, eq=False)
class SourceFile:
    """What a source's files hold.

    Parameters
    ----------
    fields : mapping
        Fields of the type that the files tell; those of the table go before.
    observations : tuple of Observation
        By time; rows begin with the source's name.
    """

    fields: Mapping[str, Any] = field(default_factory=dict)
    observations: tuple[Observation, ...] = ()


Table = Mapping[str, Any]
Reader = Callable[[str, Table, list[str]], SourceFile]


def name_of(table: Table, kind: str = "") -> str:
    """Return what the source of a table is called: its type, where no name is given."""
    return str(table.get("name", kind or table.get("type", "")))


def formats_of(kind: str) -> tuple[str, ...]:
    """Return the layouts that a type of source is read in; the first is taken where a table names none."""
    usual = USUAL.get(kind, "csv")
    return (usual, *(LOGS if kind in IN_LOGS else ()))


def read_source(kind: str, table: Table, notes: list[str]) -> SourceFile:
    """Return what a source's files hold.

    Parameters
    ----------
    kind : str
        The type.
    table : mapping
        The ``[[source]]`` table: its `LOADING` fields, and ``name``.
    notes : list of str
        Gets what was dropped, and what is odd.

    Raises
    ------
    InputError
        No file is named, its layout is not known, or it cannot be used; with the source's name.
    """
    name = name_of(table, kind)
    reader = READERS[_format(kind, name, table)]
    if not any(table.get(key) for key in ("file", "obs")):
        needed = "obs = [...] and nav = [...]" if USUAL.get(kind) else 'file = "its measurements.csv"'
        raise InputError(f"source {name}: no `{needed.split()[0]}`", hint=f"Write {needed}")
    _check_names(name, table)
    with _named_in_errors(name):
        return reader(kind, table, notes)


def _check_names(source: str, table: Table) -> None:
    """Refuse what is no name of a file, or no time."""
    origin = table.get("origin_ns", 0)
    if isinstance(origin, bool) or not isinstance(origin, int):
        raise InputError(
            f"source {source}: `origin_ns` must be a whole number, not {origin!r}",
            hint="It is the time of second 0, ns of GPS time since 1980-01-06",
        )
    for key in ("file", "obs", "nav"):
        value = table.get(key, "")
        names = value if isinstance(value, list | tuple) and key != "file" else [value]
        if not all(isinstance(n, str) for n in names):
            what = "the name of a file" if key == "file" else "names of files"
            raise InputError(
                f"source {source}: `{key}` must be {what}, not {value!r}",
                hint=f'Write {key} = "..."' if key == "file" else f'Write {key} = ["..."]',
            )


@contextmanager
def _named_in_errors(source: str) -> Iterator[None]:
    """Say in errors of files whose they are."""
    try:
        yield
    except InputError as error:
        if error.message.startswith("source "):
            raise
        raise InputError(
            f"source {source}: {error.message}", path=error.path, line=error.line, epoch=error.epoch,
            hint=ORIGIN_HINT if "--imu-start" in error.hint else error.hint,
        ) from None  # fmt: skip


def fields_of(kind: str, table: Table) -> dict[str, Any]:
    """Return the fields of the type that a source's files tell, and those of the table that name a file.

    Parameters
    ----------
    kind : str
    table : mapping

    Raises
    ------
    InputError
        As `read_source`.
    """
    layout = _format(kind, name_of(table, kind), table)
    told = {} if layout == "csv" else dict(read_source(kind, table, []).fields)
    if "sound_speed_mps" in table:
        told.pop("profile", None)
    if isinstance(table.get("profile"), str):
        with _named_in_errors(name_of(table, kind)):
            told["profile"] = read_profile(Path(table["profile"]))
    return told


def _format(kind: str, name: str, table: Table) -> str:
    known = formats_of(kind)
    layout = str(table.get("format", known[0]))
    if layout not in known:
        raise InputError(
            f"source {name}: `format` {layout!r} is not known for the type {kind}",
            hint=f"It is read in {' or '.join(known)}",
        )
    return layout


# --- tables -------------------------------------------------------------------------------------------------


def _csv(kind: str, table: Table, notes: list[str]) -> SourceFile:
    """Read a table of one source's measurements."""
    name, path, origin = name_of(table, kind), Path(table["file"]), table.get("origin_ns")
    if kind == "fix":
        told: list[str] = []
        fixes = [e.observations[0] for e in read_fixes(path, origin_ns=origin, notes=told)]
        notes += [t if t.startswith(path.name) else f"{path.name}: {t}" for t in told]
        return SourceFile({}, with_repeats([_named(o, name) for o in fixes], notes))
    beacons = table.get("beacons")
    known = tuple(beacons) if beacons else None
    said = read_acoustics(path, source=name, beacons=known, origin_ns=origin, notes=notes)
    silent = set(known or ()) - {sensor_of(k) for o in said for k in o.keys}
    notes += [f"source {name}: beacon {b!r} never replies" for b in sorted(silent)]
    _told_angles(path, said, notes)
    return SourceFile({}, said)


def _told_angles(path: Path, said: Sequence[Observation], notes: list[str]) -> None:
    """Note angles in degrees that are so small as if they were radians."""
    rows = [(sensor_of(k), abs(y)) for o in said for k, y in zip(o.keys, np.degrees(o.y), strict=True)]
    angles = {n: [y for name, y in rows if name == n] for n in ("bearing", "elevation")}
    if not all(len(y) >= FEWEST_ANGLES and 0.0 < max(y) <= TURN[n] for n, y in angles.items()):
        return
    notes.append(
        f"{path.name}: no bearing is above {max(angles['bearing']):.2g} deg and no elevation above "
        f"{max(angles['elevation']):.2g} deg: where these are radians, name the columns bearing_rad and "
        "elevation_rad"
    )


def _named(fix: Observation, source: str) -> Observation:
    """Return a receiver's fix as a source of another name says it."""
    keys = tuple(f"{source}:{'D' if k[4] == 'D' else 'R'}{k[-1]}" for k in fix.keys)
    return replace(fix, sensor=source, keys=keys)


# --- whole logs ---------------------------------------------------------------------------------------------


def read_log(path: Path | str, layout: str) -> AcousticLog:
    """Return a whole log; kept as long as none of its files changes.

    Parameters
    ----------
    path : Path or str
        Its folder.
    layout : str
        Of `LOGS`.

    Raises
    ------
    InputError
        No such folder, or as the layout's reader.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(
            "no such folder" if not folder.exists() else "this is a file", path=folder,
            hint=f"A log in the layout {layout} is a folder; docs/formats/acoustics.md lists its files",
        )  # fmt: skip
    return _log(str(folder), layout, _stamps([*folder.glob("*"), *folder.glob("*/*")]))


def _stamps(files: Iterable[Path]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((str(f), f.stat().st_mtime_ns) for f in files if f.is_file()))


@lru_cache(maxsize=4)
def _log(folder: str, layout: str, stamps: tuple[tuple[str, int], ...]) -> AcousticLog:
    return LOGS[layout](Path(folder))


def _of_log(kind: str, table: Table, notes: list[str]) -> SourceFile:
    """Take a source's measurements from a whole log; the vehicle's position is that of the antenna."""
    name = name_of(table, kind)
    log = read_log(table["file"], str(table["format"]))
    notes += [note for note in log.notes if note not in notes]
    if kind == "fix":
        fixes = (_renamed(o, name) for o in log.fixes)
        return SourceFile({}, with_repeats([_as_good(o, name, table.get("sigma_m")) for o in fixes], notes))
    _check_beacons(name, table, log)
    fields = {
        "beacons": log.beacons, "lever_arm_m": log.lever_arm_m, "two_way": True, "profile": log.profile,
        "sea_height_m": log.sea_height_m, "sigma_s": SIGMA_S,
    }  # fmt: skip
    return SourceFile(fields, tuple(replace(_renamed(o, name), sigma=None) for o in log.observations))


def _as_good(fix: Observation, name: str, sigma_m: Any) -> Observation:
    """Return a fix of a stated standard deviation, in place of that of the log."""
    if sigma_m is None:
        return fix
    if not (isinstance(sigma_m, int | float) and 0.0 < sigma_m < np.inf):
        raise InputError(f"source {name}: `sigma_m` must be a positive number, not {sigma_m!r}")
    n = len(fix.keys)
    return replace(fix, sigma=np.full(n, sigma_m), aux={**fix.aux, "cov": np.eye(n) * sigma_m**2})


def _renamed(o: Observation, source: str) -> Observation:
    return replace(o, sensor=source, keys=tuple(f"{source}:{k.partition(':')[2]}" for k in o.keys))


def _check_beacons(name: str, table: Table, log: AcousticLog) -> None:
    given = table.get("beacons")
    unknown = sorted(
        {sensor_of(k) for o in log.observations for k in o.keys} - set(given or log.beacons)
    )  # fmt: skip
    if unknown:
        raise InputError(
            f"source {name}: beacon {unknown[0]!r} has no coordinates", path=table["file"],
            hint=f"There are those of {', '.join(given or log.beacons)}",
        )  # fmt: skip


# --- satellites ---------------------------------------------------------------------------------------------


def _satellites(kind: str, table: Table, notes: list[str]) -> SourceFile:
    """Read a receiver's observations and the ephemerides."""
    files = [Path(p) for key in ("obs", "nav") for p in listed(table.get(key))]
    key = json.dumps(dict(table), default=str, sort_keys=True)
    found, told = _satellites_of(key, _stamps(files))
    notes += told
    return found


@lru_cache(maxsize=2)
def _satellites_of(table: str, stamps: tuple[tuple[str, int], ...]) -> tuple[SourceFile, tuple[str, ...]]:
    from pntegrity.satellite_source import satellites_of

    notes: list[str] = []
    fields, observations = satellites_of(json.loads(table), notes)
    return SourceFile(fields, tuple(observations)), tuple(notes)


def listed(value: Any) -> Sequence[str]:
    """Return the files that a field names: one, or a list of them."""
    return [] if not value else [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]


READERS: dict[str, Reader] = {"csv": _csv, "rinex": _satellites, **dict.fromkeys(LOGS, _of_log)}
