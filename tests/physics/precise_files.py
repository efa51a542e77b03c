"""The precise products of the ESBC log, for us and for RTKLIB, read once."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib as rtk

from pntegrity.physics.time import from_iso, to_week_tow

T0 = from_iso("2020-06-25T00:00:00")
ESBC = np.array([3582105.2910, 532589.7313, 5232754.8054])
SECOND = 10**9


@dataclass(frozen=True, eq=False)
class Rtklib:
    """Orbits, clocks, ephemerides and antennas in RTKLIB's own structure, and unpacked files."""

    nav: Any
    folder: Path


def unpacked(source: Path, folder: Path, name: str) -> str:
    path = folder / name
    path.write_bytes(gzip.decompress(source.read_bytes()))
    return str(path)


def gps_time(t_ns: int) -> Any:
    return rtk.gpst2time(*to_week_tow(int(t_ns)))


def utc_time(t_ns: int) -> Any:
    return rtk.gpst2utc(gps_time(t_ns))


def vector(values: Any, n: int = 3) -> np.ndarray:
    return np.array([values[k] for k in range(n)])


def filled(kind: Any, values: Any) -> Any:
    out = kind(len(values))
    for k, v in enumerate(values):
        out[k] = float(v)
    return out


def antennas(nav: Any, path: str) -> None:
    """Give each satellite the antenna that is valid at `T0`."""
    found = rtk.pcvs_t()
    assert rtk.readpcv(path, found) == 1
    now = gps_time(T0).time
    for i in range(found.n):
        one = found.pcv[i]
        if one.sat and one.ts.time <= now and (not one.te.time or one.te.time >= now):
            nav.pcvs[one.sat - 1] = one
