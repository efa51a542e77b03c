"""Rows of code and carrier of each band apart, and of atmosphere products, at a position."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._carrier import PreciseRows, arc_names, names_of, nodes_s, owner_of, paired
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._layout import IndexArray
from pntegrity.physics.atmosphere import klobuchar_m, mapping_factors, zenith_delays_m
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import elevations, model_m, sensor
from pntegrity.sensors.ranges import geometry

__all__ = ["ionosphere_free", "uncombined_rows"]


def uncombined_rows(epoch: Epoch, position_m: FloatArray, options: GnssOptions) -> PreciseRows:
    """Return the code, carrier and product rows above the mask.

    Carriers and products of satellites without code are left out. A satellite has a slant delay where it has
    two frequencies or a product; otherwise the broadcast model of the ionosphere takes its place, if there is
    one.
    """
    code, carrier = sensor(epoch, "code"), sensor(epoch, "carrier")
    products = _usable(sensor(epoch, "atmosphere"))
    own, of_code = paired(code.keys, carrier.keys)
    one, satellite = _satellites(code.keys)
    known, of_product = _of_satellites(code.keys, products.keys)
    row = np.concatenate([np.arange(len(code.keys)), of_code])
    at = satellite[row]
    g = geometry(position_m, code.aux["sv_pos_m"][one])
    el, az, _ = elevations(position_m, g.los)
    factor = np.concatenate([code.aux["iono_factor"], -carrier.aux["iono_factor"][own]])
    keys = code.keys + tuple(carrier.keys[i] for i in own)
    given = tuple(products.keys[i] for i in known)
    slants = _slants(keys, tuple(factor.tolist()), given)
    names = names_of(
        keys + given, ("",) * len(code.keys) + arc_names(carrier, own) + ("",) * len(given), slants
    )
    dry, wet = mapping_factors(position_m, el, epoch.t_ns)
    path = g.range_m + zenith_delays_m(position_m)[0] * dry
    model = np.concatenate([model_m(code), model_m(carrier)[own]])
    predicted = path[at] - code.aux["sv_clk_m"][row] + model
    if options.klobuchar is not None and not all(slants[: len(row)]):
        freq = code.aux["freq_hz"][one]
        delay = klobuchar_m(options.klobuchar, position_m, el, az, epoch.t_ns, freq)[at]
        predicted = predicted + np.where([not s for s in slants[: len(row)]], factor * delay, 0.0)
    noise, cn0 = options.noise, np.concatenate([code.aux["cn0_dbhz"], carrier.aux["cn0_dbhz"][own]])
    tilt = wet / np.tan(np.maximum(el, 0.05))
    signals = PreciseRows(
        names, np.concatenate([code.y, carrier.y[own]]), predicted, g.los[at], wet[at],
        (tilt * np.cos(az))[at], (tilt * np.sin(az))[at],
        _sigma_m(noise, keys, len(code.keys), el[at], cn0), np.ones(len(at)),
        noise.obliquity(el)[at] * noise.bias_factor(keys),
        nodes_s(code)[row], factor, el[at], az[at], cn0,
    )  # fmt: skip
    rows = _with_products(signals, products, known, of_product, position_m, noise)
    return rows.select(rows.el_rad >= options.mask_rad)


@lru_cache(maxsize=64)
def _satellites(code: tuple[str, ...]) -> tuple[IndexArray, IndexArray]:
    """Return a code row of each satellite, and the satellite of each code row."""
    groups = list(map(group_of, code))
    number = {g: i for i, g in enumerate(dict.fromkeys(groups))}
    index = np.array([groups.index(g) for g in number], dtype=np.intp)
    return index, np.array([number[g] for g in groups], dtype=np.intp)


def _usable(o: Observation) -> Observation:
    """Return the products that are numbers with a standard deviation."""
    if o.sigma is None:
        return o if not len(o.keys) else o.select(np.zeros(len(o.keys), dtype=bool))
    good = np.isfinite(o.y) & np.isfinite(o.sigma) & (o.sigma > 0.0)
    return o if good.all() else o.select(good)


@lru_cache(maxsize=64)
def _of_satellites(code: tuple[str, ...], products: tuple[str, ...]) -> tuple[IndexArray, IndexArray]:
    """Return which products are of a satellite with code or of none, and where that stands (-1: of none)."""
    where = {group_of(k): i for i, k in enumerate(code)} | {"": -1}
    pairs = [(i, where[s]) for i, k in enumerate(products) if (s := owner_of(k)) in where]
    index = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return index[:, 0], index[:, 1]


@lru_cache(maxsize=64)
def _slants(keys: tuple[str, ...], factor: tuple[float, ...], products: tuple[str, ...]) -> tuple[str, ...]:
    """Return the name of the slant delay of each row, products at the end; empty where it has none."""
    factors: dict[str, set[float]] = {}
    for key, f in zip(keys, factor, strict=True):
        if f:
            factors.setdefault(group_of(key), set()).add(abs(f))
    told = {owner_of(k) for k in products}
    states = {s for s, different in factors.items() if len(different) > 1 or s in told}
    signals = [
        f"ion:{group_of(k)}" if f and group_of(k) in states else "" for k, f in zip(keys, factor, strict=True)
    ]
    return (*signals, *(f"ion:{s}" if (s := owner_of(k)) in states else "" for k in products))


def _sigma_m(
    noise: NoiseModel, keys: tuple[str, ...], codes: int, el: FloatArray, cn0: FloatArray
) -> FloatArray:
    """Return the white noise of code rows, then of carriers."""
    zenith = np.concatenate([
        noise.code_white_m * noise.code_factor(keys)[:codes],
        noise.carrier_m * noise.carrier_factor(keys)[codes:],
    ])  # fmt: skip
    return np.asarray(zenith * noise.scale(el, cn0))


def _with_products(
    signals: PreciseRows, products: Observation, known: IndexArray, at: IndexArray, position_m: FloatArray,
    noise: NoiseModel,
) -> PreciseRows:  # fmt: skip
    """Return the rows with those of products behind them, which `signals.names` names already."""
    if not len(known) or products.sigma is None:
        return signals
    n, zenith = len(known), at < 0
    total = np.array([products.keys[i] == "trop:ZTD" for i in known], dtype=bool)
    stated = products.sigma[known]
    el, az = (np.append(a, last)[at] for a, last in ((signals.el_rad, 0.5 * np.pi), (signals.az_rad, 0.0)))

    def joined(values: FloatArray, more: npt.ArrayLike) -> FloatArray:
        out = np.empty((len(values) + n, *values.shape[1:]))
        out[: len(values)], out[len(values) :] = values, more
        return out

    return PreciseRows(
        signals.names, joined(signals.y, products.y[known]),
        joined(signals.predicted, zenith_delays_m(position_m)[0] * total), joined(signals.los, 0.0),
        joined(signals.wet, zenith), joined(signals.north, 0.0), joined(signals.east, 0.0),
        joined(signals.sigma_m, stated * (noise.product_white if noise.product_tau_s > 0.0 else 1.0)),
        joined(signals.inflation, 1.0), joined(signals.slow, stated), joined(signals.node_s, 0.0),
        joined(signals.iono, ~zenith),
        joined(signals.el_rad, el), joined(signals.az_rad, az), joined(signals.cn0_dbhz, np.nan),
    )  # fmt: skip


def ionosphere_free(epoch: Epoch) -> Epoch:
    """Return the epoch with the ionosphere-free code of each satellite that has two, for a code fix."""
    code = sensor(epoch, "code")
    first, second = _pairs(code.keys, tuple(code.aux["iono_factor"].tolist()))
    if not len(first):
        return epoch
    one, two = code.aux["iono_factor"][first], code.aux["iono_factor"][second]

    def combined(values: FloatArray) -> FloatArray:
        return np.asarray((two * values[first] - one * values[second]) / (two - one))

    rest = np.setdiff1d(np.arange(len(code.keys)), np.concatenate([first, second]))
    order = np.concatenate([first, rest])
    keys = tuple(f"{code.keys[i]}+{code.keys[j][4:]}" for i, j in zip(first, second, strict=True))
    aux = {k: v[order] for k, v in code.aux.items()}
    aux["iono_factor"] = np.concatenate([np.zeros(len(first)), code.aux["iono_factor"][rest]])
    aux["model_m"] = np.concatenate([combined(model_m(code)), model_m(code)[rest]])
    y = np.concatenate([combined(code.y), code.y[rest]])
    made = Observation("code", code.t_ns, keys + tuple(code.keys[i] for i in rest), y, None, aux)
    others = tuple(o for o in epoch.observations if o.sensor != "code")
    return replace(epoch, observations=(made, *others))


@lru_cache(maxsize=64)
def _pairs(keys: tuple[str, ...], factor: tuple[float, ...]) -> tuple[IndexArray, IndexArray]:
    """Return the first rows of each satellite's two different frequencies."""
    rows: dict[str, list[int]] = {}
    for i, key in enumerate(keys):
        rows.setdefault(group_of(key), []).append(i)
    found = [(own[0], own[-1]) for own in rows.values() if factor[own[0]] != factor[own[-1]]]
    pairs = np.array(found, dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
