"""Campaigns in the layout of GARPOS: seafloor transponders ranged from a ship -> `AcousticLog`.

Files, plain or gzip: ``*initcfg.ini`` (site, transponders east, north, up, lever arm), ``*obs.csv`` (a line a
shot: ``MT`` transponder, ``TT`` two-way time without its delay, ``ST`` and ``RT`` seconds of the day at which
it was sent and received, antenna ``ant_e0`` ... and attitude ``head0`` ... at both) and ``*svp.csv`` (depth,
speed).
"""

from __future__ import annotations

import configparser
from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._acoustics import AcousticLog, fix_of, seconds_text_to_ns, with_repeats
from pntegrity.formats._source import read_text
from pntegrity.formats.acoustic_profile import read_profile
from pntegrity.formats.truth import Truth
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation, geodetic_to_ecef
from pntegrity.physics.time import utc_to_ns
from pntegrity.records import FloatArray, Observation

__all__ = ["read_garpos"]

ENDS = ("0", "1")
POSE = ("ant_e", "ant_n", "ant_u", "head", "pitch", "roll")
COLUMNS = ("MT", "TT", "ST", "RT", *(name + end for end in ENDS for name in POSE))
HINT = "docs/formats/acoustics.md lists the files of a GARPOS campaign"


def read_garpos(
    folder: Path | str, *, source: str = "lbl", sigma_s: float = 1e-5, fix_sigma_m: float = 0.05
) -> AcousticLog:
    """Read a campaign in the layout of GARPOS.

    Parameters
    ----------
    folder : Path or str
        With one ``*initcfg.ini``, one ``*obs.csv`` and one ``*svp.csv``.
    source : str
        What rows begin with: ``"lbl:R.M11"``.
    sigma_s : float
        Standard deviation of a travel time.
    fix_sigma_m : float
        Standard deviation of the antenna's coordinates, which the files do not state.

    Returns
    -------
    AcousticLog
        One observation a shot, at its reception; travel times are without delays. Shots that the file flags
        are left out and noted.

    Raises
    ------
    InputError
        A missing file or key, a transponder without coordinates, a line that cannot be read.
    """
    folder = Path(folder)
    notes: list[str] = []
    config_path, path = _only(folder, "*initcfg.ini"), _only(folder, "*obs.csv*")
    config = _config(config_path)
    origin = _origin(config, config_path)
    beacons = _beacons(config, config_path, origin)
    table = _shots(path, notes)
    _check_known(table["MT"], beacons, path, config_path)
    sent, received = (_times(table[n], _date(config, config_path), path) for n in ("ST", "RT"))
    attitude = _attitude(table, sent, received, origin)
    profile = read_profile(_only(folder, "*svp.csv*"), notes=notes)
    arm = _numbers(config, config_path, "Model-parameter", "ATDoffset", 3)
    shots = with_repeats(_observations(table, source, sent, received, sigma_s), notes)
    return AcousticLog(
        source, shots, _fixes(attitude, fix_sigma_m), attitude, beacons, (arm[0], arm[1], arm[2]),
        float(ecef_to_geodetic(origin)[2]), profile, tuple(notes),
    )  # fmt: skip


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise InputError(f"{len(found)} files {pattern}, not one", path=folder, hint=HINT)
    return found[0]


# --- configuration ------------------------------------------------------------------------------------------


def _config(path: Path) -> configparser.ConfigParser:
    config = configparser.ConfigParser(comment_prefixes=("#",), interpolation=None)
    try:
        config.read_string(read_text(path))
    except configparser.Error as error:
        raise InputError(f"is no INI file: {error.message}", path=path, hint=HINT) from None
    return config


def _numbers(
    config: configparser.ConfigParser, path: Path, section: str, key: str, n: int
) -> tuple[float, ...]:
    try:
        values = tuple(float(w) for w in config[section][key].split()[:n])
    except (KeyError, ValueError):
        values = ()
    if len(values) < n:
        raise InputError(f"`{key}` of [{section}] does not hold {n} numbers", path=path, hint=HINT)
    return values


def _origin(config: configparser.ConfigParser, path: Path) -> FloatArray:
    lat, lon, height = (
        _numbers(config, path, "Site-parameter", k, 1)[0] for k in ("Latitude0", "Longitude0", "Height0")
    )
    return geodetic_to_ecef(np.radians(lat), np.radians(lon), height)


def _date(config: configparser.ConfigParser, path: Path) -> int:
    text = config.get("Obs-parameter", "Date(UTC)", fallback="")
    try:
        year, month, day = (int(w) for w in text.split("-"))
        return utc_to_ns(year, month, day)
    except ValueError:
        raise InputError(f"Date(UTC) {text!r} is no date", path=path, hint="Write 2019-03-15") from None


def _beacons(
    config: configparser.ConfigParser, path: Path, origin: FloatArray
) -> dict[str, dict[str, float]]:
    names = config.get("Site-parameter", "Stations", fallback="").split()
    if not names:
        raise InputError("no `Stations`", path=path, hint=HINT)
    turn = enu_rotation(origin).T
    out = {}
    for name in names:
        enu = _numbers(config, path, "Model-parameter", f"{name}_dPos", 3)
        out[name] = dict(zip(("x_m", "y_m", "z_m"), (origin + turn @ enu).tolist(), strict=True))
    return out


# --- shots --------------------------------------------------------------------------------------------------


def _shots(path: Path, notes: list[str]) -> dict[str, npt.NDArray[np.object_]]:
    """Return the columns that are used, as text."""
    lines = [(i, line) for i, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    lines = [(i, line) for i, line in lines if not line.startswith("#")]
    names = [c.strip() for c in lines[0][1].split(",")] if lines else []
    missing = [c for c in COLUMNS if c not in names]
    if missing:
        raise InputError(f"no column {missing[0]}", path=path, line=lines[0][0] if lines else None, hint=HINT)
    rows = [_cells(line, names, path, i) for i, line in lines[1:]]
    flagged = [bool("flag" in names and row[names.index("flag")] == "True") for row in rows]
    if any(flagged):
        notes.append(f"{path.name}: {sum(flagged)} shots that the file flags left out")
    kept = [row for row, bad in zip(rows, flagged, strict=True) if not bad]
    if not kept:
        raise InputError("no usable shot", path=path, hint=HINT)
    return {c: np.array([row[names.index(c)] for row in kept], dtype=object) for c in COLUMNS}


def _cells(line: str, names: Sequence[str], path: Path, number: int) -> list[str]:
    cells = [c.strip() for c in line.split(",")]
    try:
        numbers = [float(cells[names.index(c)]) for c in COLUMNS[1:]]
        if len(cells) != len(names) or not np.isfinite(numbers).all() or not numbers[0] > 0.0:
            raise ValueError("not a shot")
    except (ValueError, IndexError):
        raise InputError("this line is no shot", path=path, line=number, hint=HINT) from None
    return cells


def _times(cells: npt.NDArray[np.object_], midnight_ns: int, path: Path) -> npt.NDArray[np.int64]:
    try:
        return np.array([midnight_ns + seconds_text_to_ns(c) for c in cells], dtype=np.int64)
    except ValueError as error:
        raise InputError(f"a time of the day: {error}", path=path, hint=HINT) from None


def _check_known(names: npt.NDArray[np.object_], beacons: Container[str], path: Path, config: Path) -> None:
    unknown = sorted(n for n in set(names) if n not in beacons)
    if unknown:
        raise InputError(
            f"transponder {unknown[0]} has no coordinates", path=path,
            hint=f"Add {unknown[0]}_dPos to {config.name}",
        )  # fmt: skip


def _observations(
    table: dict[str, npt.NDArray[np.object_]], source: str, sent: npt.NDArray[np.int64],
    received: npt.NDArray[np.int64], sigma_s: float,
) -> list[Observation]:  # fmt: skip
    """Return the shots by their reception."""
    return [
        _observation(source, table["MT"][i], float(table["TT"][i]), int(sent[i]), int(received[i]), sigma_s)
        for i in np.argsort(received, kind="stable")
    ]


def _observation(
    source: str, name: str, took_s: float, t0: int, received: int, sigma_s: float
) -> Observation:
    return Observation(
        source, received, (f"{source}:R.{name}",), np.array([took_s]), np.array([sigma_s]),
        {"t0_ns": np.array([t0]), "received_ns": np.array([received]), "ways": np.array([2])},
    )  # fmt: skip


def _fixes(attitude: Truth, sigma_m: float) -> tuple[Observation, ...]:
    cov = np.eye(3) * sigma_m**2
    return tuple(fix_of(t, x, cov) for t, x in zip(attitude.t_ns.tolist(), attitude.position_m, strict=True))


def _attitude(
    table: dict[str, npt.NDArray[np.object_]], sent: npt.NDArray[np.int64], received: npt.NDArray[np.int64],
    origin: FloatArray,
) -> Truth:  # fmt: skip
    """Return the antenna and its attitude at transmissions and receptions."""
    t_ns, first = np.unique(np.append(sent, received), return_index=True)

    def both(*names: str) -> FloatArray:
        ends = [np.stack([table[n + k].astype(np.float64) for n in names], axis=1) for k in ENDS]
        return np.concatenate(ends)[first]

    angles = np.radians(both("roll", "pitch", "head"))
    angles[:, 2] %= 2.0 * np.pi
    place = origin + both("ant_e", "ant_n", "ant_u") @ enu_rotation(origin)
    return Truth(t_ns, place, None, (), angles)
