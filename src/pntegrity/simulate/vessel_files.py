"""A simulated vessel as files: what `run --config vehicle.toml` takes, and its truth."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.formats.atomic import write_text
from pntegrity.formats.imu_write import write_imu
from pntegrity.formats.rinex_write import write_observations
from pntegrity.kernels.rotations import attitude_angles
from pntegrity.physics.frames import enu_rotations
from pntegrity.physics.tables import SignalTable
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors.imu import ImuSpec
from pntegrity.sensors.imu_spec import imu_spec_toml
from pntegrity.sensors.source import Source
from pntegrity.simulate.receiver import keep_only
from pntegrity.simulate.vessel_log import VesselLog
from pntegrity.states import sensor_of

__all__ = ["DESCRIPTION", "Sky", "write_vessel"]

#: The file that describes the vessel.
DESCRIPTION = "vehicle.toml"
#: Kind and sensor of a row -> column of a table, decimals, and the factor from SI. Times of beacons have a
#: line each.
COLUMNS: dict[str, tuple[str, int, float]] = {
    "R.time": ("one_way_ms", 9, 1e3), "R.range": ("range_m", 6, 1.0), "R.z": ("depth_m", 6, 1.0),
    "A.bearing": ("bearing_deg", 9, 180.0 / np.pi), "A.elevation": ("elevation_deg", 9, 180.0 / np.pi),
    "D.X": ("forward_mps", 9, 1.0), "D.Y": ("right_mps", 9, 1.0), "D.Z": ("down_mps", 9, 1.0),
}  # fmt: skip
#: Decimals of numbers in the description: coordinates to a micrometre.
DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Sky:
    """What a receiver tracked, and the ephemerides as the text of a RINEX file."""

    signals: SignalTable
    navigation: str


def write_vessel(
    folder: Path, log: VesselLog, spec: ImuSpec, sky: Sky, ism: Mapping[str, Any], remark: str = ""
) -> Path:
    """Write a vessel as files; each is whole or not there, the description comes last.

    Parameters
    ----------
    folder : Path
        Exists. The description names its files by it, as they are seen from where this is called.
    log : VesselLog
        One of its sources says satellites, as ``"<name>:R.G05"``.
    spec : ImuSpec
    sky : Sky
        Of the satellites; those that the log has are written, at its epochs.
    ism : mapping
        The integrity support message.
    remark : str
        One line that stands on top of tables and description.

    Returns
    -------
    path : Path
        The description.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    write_imu(folder / "imu.csv", log.inertial, remark)
    write_text(folder / "spec.toml", imu_spec_toml(spec))
    write_text(folder / "truth.csv", _table(*_truth(log), remark))
    tables = [_write_source(folder, source, log, sky, remark) for source in log.sources]
    head = {
        "estimator": "multi_source", "imu": (folder / "imu.csv").as_posix(),
        "imu_spec": (folder / "spec.toml").as_posix(), "heading_deg": round(_attitude_deg(log)[0, 2], 3),
        "truth": (folder / "truth.csv").as_posix(),
    }  # fmt: skip
    write_text(folder / DESCRIPTION, "\n".join(_described(head, tables, ism, remark)) + "\n")
    return folder / DESCRIPTION


# --- tables -------------------------------------------------------------------------------------------------


def _table(names: Sequence[str], lines: Iterable[str], remark: str) -> str:
    head = [f"# {remark}"] if remark else []
    return "\n".join([*head, ",".join(names), *lines]) + "\n"


def _truth(log: VesselLog) -> tuple[list[str], Iterator[str]]:
    """Return names and lines of the truth at the epochs."""
    names = [
        "t_ns",
        "x_m",
        "y_m",
        "z_m",
        "vx_mps",
        "vy_mps",
        "vz_mps",
        "roll_deg",
        "pitch_deg",
        "heading_deg",
    ]
    t_ns = log.truth.t_ns
    position, velocity, _ = log.motion.at(t_ns)
    rows = np.hstack([position, velocity, _attitude_deg(log)])
    return names, (f"{t}," + ",".join(f"{v:.6f}" for v in row) for t, row in zip(t_ns, rows, strict=True))


def _attitude_deg(log: VesselLog) -> FloatArray:
    """Return roll, pitch and heading at the epochs, (n, 3)."""
    position, _, C = log.motion.at(log.truth.t_ns)
    return np.degrees(attitude_angles(enu_rotations(position) @ C))


def _measurements(said: Sequence[Observation]) -> tuple[list[str], list[str]]:
    """Return names and lines of what a source said: a line a time and beacon."""
    rows = list(dict.fromkeys(_row_of(k)[1] for o in said for k in o.keys))
    beacons = any(_row_of(k)[0] for o in said for k in o.keys)
    lines = []
    for o in said:
        found: dict[str, dict[str, str]] = {}
        for key, y in zip(o.keys, o.y.tolist(), strict=True):
            beacon, row = _row_of(key)
            found.setdefault(beacon, {})[row] = f"{y * COLUMNS[row][2]:.{COLUMNS[row][1]}f}"
        for beacon, cells in found.items():
            who = [beacon] if beacons else []
            lines.append(",".join([str(o.t_ns), *who, *(cells.get(r, "") for r in rows)]))
    return ["t_ns", *(["beacon"] if beacons else []), *(COLUMNS[r][0] for r in rows)], lines


def _row_of(key: str) -> tuple[str, str]:
    """Return the beacon of a row, empty where it has none, and what its column holds."""
    row = key.partition(":")[2]
    return ("", row) if row in COLUMNS else (sensor_of(key), "R.time")


# --- sources ------------------------------------------------------------------------------------------------


def _write_source(folder: Path, source: Source, log: VesselLog, sky: Sky, remark: str) -> dict[str, Any]:
    """Write what a source said, and return its table of the description."""
    said = [o for o in (e.sensor(source.name) for e in log.epochs) if o is not None]
    kind = type(source).__module__.rpartition(".")[2]
    if kind == "gnss":
        obs, nav = folder / f"{source.name}.rnx", folder / f"{source.name}.nav"
        write_observations(obs, _tracked(sky.signals, said), comment=remark)
        write_text(nav, sky.navigation, "ascii")
        files: dict[str, Any] = {"obs": obs.as_posix(), "nav": [nav.as_posix()]}
    else:
        path = folder / f"{source.name}.csv"
        write_text(path, _table(*_measurements(said), remark))
        files = {"file": path.as_posix()}
    return {"type": kind, "name": source.name, **files, **_fields(source)}


def _tracked(signals: SignalTable, said: Sequence[Observation]) -> SignalTable:
    """Return the signals of the satellites that were said, at these times."""
    sats = {sensor_of(k) for o in said for k in o.keys}
    some = keep_only(signals, lambda _, sat: sat in sats)
    first, last = np.searchsorted(some.t_ns, [said[0].t_ns, said[-1].t_ns])
    inside: npt.NDArray[np.bool_] = (some.epoch >= first) & (some.epoch <= last)
    columns = ("epoch", "sat", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz", "lli")
    cut: dict[str, Any] = {name: getattr(some, name)[inside] for name in columns}
    return replace(some, **cut | {"t_ns": some.t_ns[first : last + 1], "epoch": cut["epoch"] - first})


def _fields(source: Any) -> dict[str, Any]:
    """Return the fields of a source that are not what its type has anyway, and what tells its noise."""
    values = {f: getattr(source, f.name) for f in fields(source) if f.name not in ("name", "klobuchar")}
    return {
        f.name: _plain(v) for f, v in values.items() if v != _usual(f) or f.name.startswith("sigma_")
    }  # fmt: skip


def _usual(f: Field[Any]) -> Any:
    return f.default_factory() if f.default_factory is not MISSING else f.default


def _plain(value: Any) -> Any:
    """Return a value as TOML may hold it."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return round(value, DECIMALS) if isinstance(value, float) and abs(value) >= 1.0 else value


# --- the description ----------------------------------------------------------------------------------------


def _described(
    head: Mapping[str, Any], sources: Iterable[Mapping[str, Any]], ism: Mapping[str, Any], remark: str
) -> Iterator[str]:
    """Yield the lines of the description."""
    if remark:
        yield f"# {remark}"
    yield "# Paths are relative to where the program is started."
    yield from _section("", "", head)
    for table in sources:
        yield from _section("[[source]]", "source", table)
    yield from _section("[ism]", "ism", ism)


def _section(title: str, name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield a table; mappings in it become tables of their own, the innermost ones are written in line."""
    if title:
        yield from ("", title)
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping)}
    yield from (f"{k} = {json.dumps(v)}" for k, v in table.items() if k not in nested)
    for k, v in nested.items():
        yield from ("", f"[{name}.{k}]")
        yield from (f"{_key(i)} = {_value(w)}" for i, w in v.items())


def _key(name: str) -> str:
    return name if name.replace("_", "").isalnum() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)
