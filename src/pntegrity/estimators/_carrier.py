"""Rows of code and carrier at a position: what precise filters start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._layout import IndexArray
from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.noise import LAST_BDS2
from pntegrity.sensors.pseudoranges import elevations, model_m, sensor
from pntegrity.sensors.ranges import geometry
from pntegrity.states import is_left_out

__all__ = ["PRODUCTS", "Names", "PreciseRows", "names_of", "precise_rows"]

#: What the keys of atmosphere products begin with.
PRODUCTS = ("iono", "trop")

CLOCKS = ("G", "E", "R", "C", "C2", "J", "I", "S")
"""Constellations with a clock of their own, in the order in which they are taken for reference."""


@dataclass(frozen=True, eq=False)
class Names:
    """What the names of rows say, made once for all epochs with the same rows.

    `ambiguity`, `isb`, `bias`, `satellite_clock`, `ionosphere`, `offset` and `product` name the states that a
    row may have, empty where it has none; `ionosphere` itself is empty where no row has one. `system` numbers
    the constellations. A row is of code, of a carrier, or of an atmosphere product.
    """

    keys: tuple[str, ...]
    ambiguity: tuple[str, ...]
    groups: tuple[str, ...]
    isb: tuple[str, ...]
    bias: tuple[str, ...]
    satellite_clock: tuple[str, ...]
    ionosphere: tuple[str, ...]
    offset: tuple[str, ...]
    product: tuple[str, ...]
    system: npt.NDArray[np.intp]
    code: npt.NDArray[np.bool_]
    carrier: npt.NDArray[np.bool_]
    glonass: npt.NDArray[np.bool_]
    slanted: IndexArray

    def marked(self, ambiguity: tuple[str, ...]) -> Names:
        """Return the names with other ambiguities."""
        return names_of(self.keys, ambiguity, self.ionosphere)

    def left_out(self, exclude: frozenset[str]) -> npt.NDArray[np.bool_]:
        """Return which rows go with some groups, read-only."""
        return _left_out(self.keys, exclude)


def clock_of(key: str) -> str:
    """Return whose clock a row has: its constellation's letter, and ``"C2"`` for BDS-2.

    Receivers hear BDS-2 and BDS-3 metres apart.
    """
    return "C2" if key[0] == "C" and key[1:3] <= LAST_BDS2 else key[0]


def owner_of(key: str) -> str:
    """Return the satellite of a row, empty where it is of none."""
    group, _, about = key.partition(":")
    return {"iono": about, "trop": ""}.get(group, group)


@lru_cache(maxsize=256)
def names_of(keys: tuple[str, ...], ambiguity: tuple[str, ...], ionosphere: tuple[str, ...] = ()) -> Names:
    """Return what the names of rows say."""
    owners, groups = tuple(map(owner_of, keys)), tuple(map(group_of, keys))
    letters = [clock_of(s) if s else "" for s in owners]
    given = [g in PRODUCTS for g in groups]
    signals = [not p for p in given]
    carrier = np.array([bool(a) for a in ambiguity], dtype=bool)
    return Names(
        keys, ambiguity, groups, _where(signals, "isb:", letters),
        _where([s and not a for s, a in zip(signals, ambiguity, strict=True)], "bias:", keys),
        _where(signals, "svclk:", owners), ionosphere if any(ionosphere) else (),
        _where([g == "iono" for g in groups], "off:", letters),
        _where(given, "prod:", [k if s else "trop" for k, s in zip(keys, owners, strict=True)]),
        np.array([CLOCKS.index(s) if s else -1 for s in letters], dtype=np.intp),
        np.array(signals, dtype=bool) & ~carrier, carrier,
        np.array([s == "R" for s in letters], dtype=bool),
        np.array([i for i, n in enumerate(ionosphere) if n], dtype=np.intp),
    )  # fmt: skip


def _where(here: Sequence[bool], kind: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a kind of states, empty for rows that have none."""
    return tuple(kind + n if h else "" for h, n in zip(here, names, strict=True))


@lru_cache(maxsize=256)
def _left_out(keys: tuple[str, ...], exclude: frozenset[str]) -> npt.NDArray[np.bool_]:
    out = np.array([is_left_out(k, exclude) for k in keys], dtype=bool)
    out.flags.writeable = False
    return out


@dataclass(frozen=True, eq=False)
class PreciseRows:
    """Code rows, then carrier rows, then rows of atmosphere products; all of shape (n,) or (n, 3).

    `predicted` is what the row would read with perfect clocks, no wet delay and no ambiguity. `wet` is the
    wet mapping factor; `north` and `east` are those of its gradients. `sigma_m` is the noise of one epoch,
    `inflation` the factor of its variance that makes up for its correlation with epochs before, `slow` says
    how much larger than at the zenith slow code errors are (of a product: the standard deviation of its
    slow error), `node_s` (n, 2) how long ago the last sample of the satellite's clock is and how far ahead
    the next. `iono` is what a metre of the satellite's slant delay adds to the row. `names.ambiguity` names
    the state of a carrier's arc and is empty for all others.
    """

    names: Names
    y: FloatArray
    predicted: FloatArray
    los: FloatArray
    wet: FloatArray
    north: FloatArray
    east: FloatArray
    sigma_m: FloatArray
    inflation: FloatArray
    slow: FloatArray
    node_s: FloatArray
    iono: FloatArray
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
    kept = (names.keys, names.ambiguity, names.ionosphere or ("",) * len(names.keys))
    return names_of(*(tuple(t[i] for i in index) for t in kept))


def precise_rows(epoch: Epoch, position_m: FloatArray, options: GnssOptions) -> PreciseRows:
    """Return the code and carrier rows above the mask; carriers of satellites without code are left out."""
    code, carrier = sensor(epoch, "code"), sensor(epoch, "carrier")
    own, of_code = paired(code.keys, carrier.keys)
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
            code.keys + tuple(carrier.keys[i] for i in own), ("",) * len(code.keys) + arc_names(carrier, own)
        ),
        np.concatenate([code.y, carrier.y[own]]),
        path[both] + np.concatenate([model_m(code), model_m(carrier)[own]]),
        g.los[both], wet[both], (tilt * np.cos(az))[both], (tilt * np.sin(az))[both],
        np.concatenate([
            noise.code_white_m * scale * noise.code_factor(code.keys),
            noise.carrier_m * scale[of_code] * noise.carrier_factor(code.keys)[of_code],
        ]),
        np.ones(len(both)), (noise.obliquity(el) * noise.bias_factor(code.keys))[both], nodes_s(code)[both],
        np.zeros(len(both)), el[both], az[both], cn0[both],
    )  # fmt: skip
    return rows.select(rows.el_rad >= options.mask_rad)


def nodes_s(o: Observation) -> FloatArray:
    """Return the times from and to the samples of satellite clocks, zeros where there are none."""
    known = o.aux.get("clk_node_s")
    return np.zeros((len(o.keys), 2)) if known is None else np.asarray(known)


@lru_cache(maxsize=64)
def paired(code: tuple[str, ...], carrier: tuple[str, ...]) -> tuple[IndexArray, IndexArray]:
    """Return which carriers have a code of their satellite, and where it (the last of several) stands."""
    where = {group_of(k): i for i, k in enumerate(code)}
    pairs = [(i, where[group_of(k)]) for i, k in enumerate(carrier) if group_of(k) in where]
    index = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return index[:, 0], index[:, 1]


def arc_names(carrier: Observation, own: IndexArray) -> tuple[str, ...]:
    """Return the names of the ambiguities of some carriers."""
    arcs = carrier.aux.get("arc")
    numbers = [1] * len(own) if arcs is None else arcs[own].tolist()
    return _names(tuple(carrier.keys[i] for i in own), tuple(numbers))


@lru_cache(maxsize=64)
def _names(keys: tuple[str, ...], arcs: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(f"amb:{k}:{a}" for k, a in zip(keys, arcs, strict=True))
