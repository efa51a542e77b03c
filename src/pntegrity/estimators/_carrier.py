"""Rows of code and carrier at a position: what precise filters start from."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions, elevations, model_m, sensor
from pntegrity.estimators._layout import IndexArray
from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.gnss import geometry
from pntegrity.sensors.noise import LAST_BDS2

__all__ = ["Names", "PreciseRows", "precise_rows"]


CLOCKS = ("G", "E", "R", "C", "C2", "J", "I", "S")
"""Constellations with a clock of their own, in the order in which they are taken for reference."""


@dataclass(frozen=True, eq=False)
class Names:
    """What the names of rows say, made once for all epochs with the same rows.

    `ambiguity`, `isb` and `bias` name the states that a row may have; `system` numbers the constellations.
    """

    keys: tuple[str, ...]
    ambiguity: tuple[str, ...]
    groups: tuple[str, ...]
    isb: tuple[str, ...]
    bias: tuple[str, ...]
    satellite_clock: tuple[str, ...]
    system: npt.NDArray[np.intp]
    carrier: npt.NDArray[np.bool_]
    glonass: npt.NDArray[np.bool_]


def clock_of(key: str) -> str:
    """Return whose clock a row has: its constellation's letter, and ``"C2"`` for BDS-2.

    Receivers hear BDS-2 and BDS-3 metres apart.
    """
    return "C2" if key[0] == "C" and key[1:3] <= LAST_BDS2 else key[0]


@lru_cache(maxsize=256)
def names_of(keys: tuple[str, ...], ambiguity: tuple[str, ...]) -> Names:
    """Return what the names of rows say."""
    letters = [clock_of(k) for k in keys]
    return Names(
        keys, ambiguity, tuple(map(group_of, keys)), tuple(f"isb:{s}" for s in letters),
        tuple("" if a else f"bias:{k}" for k, a in zip(keys, ambiguity, strict=True)),
        tuple(f"svclk:{group_of(k)}" for k in keys),
        np.array([CLOCKS.index(s) for s in letters], dtype=np.intp),
        np.array([bool(a) for a in ambiguity], dtype=bool),
        np.array([s == "R" for s in letters], dtype=bool),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PreciseRows:
    """Code rows, then carrier rows; all of shape (n,) or (n, 3).

    `predicted` is what the row would read with perfect clocks, no wet delay and no ambiguity. `wet` is the
    wet mapping factor; `north` and `east` are those of its gradients. `sigma_m` is the white noise, `slow`
    says how much larger than at the zenith slow code errors are, `node_s` (n, 2) how long ago the last sample
    of the satellite's clock is and how far ahead the next. `names.ambiguity` names the state of a carrier's
    arc and is empty for code.
    """

    names: Names
    y: FloatArray
    predicted: FloatArray
    los: FloatArray
    wet: FloatArray
    north: FloatArray
    east: FloatArray
    sigma_m: FloatArray
    slow: FloatArray
    node_s: FloatArray
    el_rad: FloatArray
    az_rad: FloatArray
    cn0_dbhz: FloatArray

    def __len__(self) -> int:
        return len(self.y)

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the rows."""
        return self.names.keys

    def select(self, rows: npt.NDArray[np.bool_]) -> PreciseRows:
        """Return only some rows."""
        if rows.all():
            return self
        rest = (getattr(self, name)[rows] for name in _COLUMNS)
        return PreciseRows(_selected(self.names, rows.tobytes()), *rest)


_COLUMNS = tuple(f.name for f in fields(PreciseRows))[1:]


@lru_cache(maxsize=256)
def _selected(names: Names, rows: bytes) -> Names:
    """Return the names of some rows."""
    index = np.flatnonzero(np.frombuffer(rows, dtype=bool))
    return names_of(*(tuple(t[i] for i in index) for t in (names.keys, names.ambiguity)))


def precise_rows(epoch: Epoch, position_m: FloatArray, options: GnssOptions) -> PreciseRows:
    """Return the code and carrier rows above the mask; carriers of satellites without code are left out."""
    code, carrier = sensor(epoch, "code"), sensor(epoch, "carrier")
    own, of_code = _paired(code.keys, carrier.keys)
    g = geometry(position_m, code.aux["sv_pos_m"])
    el, az, _ = elevations(position_m, g.los)
    dry, wet = mapping_factors(position_m, el, epoch.t_ns)
    path = g.range_m - code.aux["sv_clk_m"] + zenith_delays_m(position_m)[0] * dry
    noise, cn0 = options.noise, code.aux["cn0_dbhz"]
    scale = noise.scale(el, cn0)
    both = np.concatenate([np.arange(len(code.keys)), of_code])
    tilt = wet / np.tan(np.maximum(el, 0.05))
    rows = PreciseRows(
        names_of(
            code.keys + tuple(carrier.keys[i] for i in own), ("",) * len(code.keys) + _arc_names(carrier, own)
        ),
        np.concatenate([code.y, carrier.y[own]]),
        path[both] + np.concatenate([model_m(code), model_m(carrier)[own]]),
        g.los[both], wet[both], (tilt * np.cos(az))[both], (tilt * np.sin(az))[both],
        np.concatenate([
            noise.code_white_m * scale * noise.code_factor(code.keys),
            noise.carrier_m * scale[of_code] * noise.carrier_factor(code.keys)[of_code],
        ]),
        (noise.obliquity(el) * noise.bias_factor(code.keys))[both], _nodes_s(code)[both], el[both], az[both],
        cn0[both],
    )  # fmt: skip
    return rows.select(rows.el_rad >= options.mask_rad)


def _nodes_s(o: Observation) -> FloatArray:
    """Return the times from and to the samples of satellite clocks, zeros where there are none."""
    known = o.aux.get("clk_node_s")
    return np.zeros((len(o.keys), 2)) if known is None else np.asarray(known)


@lru_cache(maxsize=64)
def _paired(code: tuple[str, ...], carrier: tuple[str, ...]) -> tuple[IndexArray, IndexArray]:
    """Return which carriers have a code, and where it stands."""
    where = {group_of(k): i for i, k in enumerate(code)}
    pairs = [(i, where[group_of(k)]) for i, k in enumerate(carrier) if group_of(k) in where]
    index = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return index[:, 0], index[:, 1]


def _arc_names(carrier: Observation, own: IndexArray) -> tuple[str, ...]:
    arcs = carrier.aux.get("arc")
    numbers = [1] * len(own) if arcs is None else arcs[own].tolist()
    return _names(tuple(carrier.keys[i] for i in own), tuple(numbers))


@lru_cache(maxsize=64)
def _names(keys: tuple[str, ...], arcs: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(f"amb:{k}:{a}" for k, a in zip(keys, arcs, strict=True))
