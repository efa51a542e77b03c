"""Delays of the atmosphere that somebody else determined, and how they come to the epochs of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from pntegrity.physics._assembly import _counted
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.states import frozen

__all__ = [
    "METRES_PER_TECU_HZ2",
    "AtmosphereProducts",
    "Samples",
    "Valid",
    "metres_per_tecu",
    "origin",
    "with_products",
]

METRES_PER_TECU_HZ2 = 40.3082e16
"""Delay of code, m, by 1 TECU (1e16 electrons per m^2), times the square of the frequency, Hz^2."""
SENSOR = "atmosphere"
Kind = Literal["ZWD", "ZTD"]
Index = npt.NDArray[np.intp]


def metres_per_tecu(freq_hz: npt.ArrayLike) -> FloatArray:
    """Return the delay of code by 1 TECU on frequencies, m."""
    return np.asarray(METRES_PER_TECU_HZ2 / np.square(np.asarray(freq_hz, dtype=np.float64)))


class Samples(NamedTuple):
    """One product over time: GPS time, value and standard deviation, each of shape (n,)."""

    t_ns: npt.NDArray[np.int64]
    value: FloatArray
    sigma: FloatArray

    @staticmethod
    def none() -> Samples:
        """Return no sample."""
        return Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))

    def last(self, t_ns: npt.NDArray[np.int64]) -> tuple[Index, FloatArray]:
        """Return for each time the last sample that is not after it (-1: none), and its age, s (inf)."""
        at = np.searchsorted(self.t_ns, t_ns, side="right") - 1
        if not len(self.t_ns):
            return at, np.full(len(at), np.inf)
        return at, np.where(at >= 0, (t_ns - self.t_ns[at]) / SECOND_NS, np.inf)


class Valid(NamedTuple):
    """What holds at one time: value and sigma of each product, and which are too old or not there yet."""

    stec_tecu: Mapping[str, tuple[float, float]]
    troposphere_m: tuple[float, float] | None
    stale: tuple[str, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class AtmosphereProducts:
    """Slant delays of the ionosphere and zenith delays of the troposphere at one place.

    Samples that are not finite or whose sigma is not above 0 are left out, samples of the same time but the
    last too; `notes` count both. The rest is put in the order of time.

    Parameters
    ----------
    ionosphere : mapping of str to (t_ns, stec_tecu, sigma_tecu)
        Slant electron content by satellite, each of shape (n,). What is common to the satellites of a
        constellation may be arbitrary.
    troposphere : (t_ns, delay_m, sigma_m)
        Delay at the zenith.
    troposphere_kind : "ZWD" or "ZTD"
        Its wet part (upon the standard atmosphere's hydrostatic one) or all of it.
    interval_s : float, optional
        Usual step; where it is not given the median of all steps.
    source : str
        Who made them, and of what.
    self_derived : bool
        Whether they come of the receiver that will use them: then its noise is in both.
    latency_s : float
        Age of the estimate that a sample holds; 0 where unknown.
    notes : tuple of str
        What was left out.
    """

    ionosphere: Mapping[str, tuple[npt.NDArray[np.int64], FloatArray, FloatArray]] = field(
        default_factory=dict
    )
    troposphere: tuple[npt.NDArray[np.int64], FloatArray, FloatArray] = field(default_factory=Samples.none)
    troposphere_kind: Kind = "ZWD"
    interval_s: float = 0.0
    source: str = ""
    self_derived: bool = False
    latency_s: float = 0.0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.troposphere_kind not in ("ZWD", "ZTD"):
            raise ValueError(f"`troposphere_kind` must be ZWD or ZTD, not {self.troposphere_kind!r}")
        counts = np.zeros(2, dtype=np.int64)
        iono = {sat: _cleaned(s, counts) for sat, s in sorted(self.ionosphere.items())}
        kept = {sat: s for sat, s in iono.items() if len(s.t_ns)}
        object.__setattr__(self, "ionosphere", MappingProxyType(kept))
        object.__setattr__(self, "troposphere", _cleaned(self.troposphere, counts))
        object.__setattr__(self, "interval_s", float(self.interval_s) or self._usual_step_s())
        object.__setattr__(self, "notes", (*self.notes, *_told(counts)))

    def __reduce__(self) -> tuple[object, ...]:
        rest = (self.troposphere_kind, self.interval_s, self.source, self.self_derived, self.latency_s)
        iono = {sat: tuple(s) for sat, s in self.ionosphere.items()}
        return type(self), (iono, tuple(self.troposphere), *rest, self.notes)

    def _usual_step_s(self) -> float:
        steps = [np.diff(s[0]) for s in (*self.ionosphere.values(), self.troposphere)]
        joined = np.concatenate(steps)
        return float(np.median(joined)) / SECOND_NS if len(joined) else 0.0

    @property
    def max_age_s(self) -> float:
        """Age up to which a sample is used where nothing else is said: two intervals, at least a minute."""
        return max(60.0, 2.0 * self.interval_s)

    def at(self, t_ns: int, max_age_s: float | None = None) -> Valid:
        """Return the last samples that are not after a time, and not older than `max_age_s`.

        Parameters
        ----------
        t_ns : int
            ns of GPS time.
        max_age_s : float, optional
            `max_age_s` of the products where not given.

        Returns
        -------
        Valid
            `missing` names products without a sample until then, `stale` those whose last is too old:
            ``"iono:G05"``, ``"trop:ZWD"``.
        """
        limit = self.max_age_s if max_age_s is None else max_age_s
        series = {f"iono:{sat}": Samples(*s) for sat, s in self.ionosphere.items()}
        series[f"trop:{self.troposphere_kind}"] = Samples(*self.troposphere)
        found: dict[str, tuple[float, float]] = {}
        stale, missing = [], []
        for name, samples in series.items():
            (at,), (age,) = samples.last(np.array([t_ns], dtype=np.int64))
            if at < 0:
                missing.append(name)
            elif age > limit:
                stale.append(name)
            else:
                found[name] = float(samples.value[at]), float(samples.sigma[at])
        zenith = found.pop(f"trop:{self.troposphere_kind}", None)
        slant = {name.partition(":")[2]: value for name, value in found.items()}
        return Valid(slant, zenith, tuple(stale), tuple(missing))


def _cleaned(samples: Sequence[npt.ArrayLike], counts: npt.NDArray[np.int64]) -> Samples:
    """Return usable samples in the order of time; `counts`: those left out, by cause."""
    t_ns, value, sigma = np.asarray(samples[0], dtype=np.int64), *(np.asarray(a, float) for a in samples[1:])
    if not t_ns.shape == value.shape == sigma.shape == (len(t_ns),):
        raise ValueError(f"times {t_ns.shape}, values {value.shape} and sigmas {sigma.shape} must be as long")
    good = np.isfinite(value) & np.isfinite(sigma) & (sigma > 0.0)
    order = np.flatnonzero(good)[np.argsort(t_ns[good], kind="stable")]
    last = np.append(np.diff(t_ns[order]) > 0, True)[: len(order)]
    counts += np.array([len(t_ns) - len(order), np.count_nonzero(~last)])
    at = order[last]
    times = t_ns[at].view()
    times.flags.writeable = False
    return Samples(times, frozen(value[at]), frozen(sigma[at]))


def _told(counts: npt.NDArray[np.int64]) -> list[str]:
    bad, doubled = counts.tolist()
    words = {
        "samples left out: value or sigma is not finite, or sigma is not above 0": bad,
        "samples left out: another one of the same product and time follows": doubled,
    }
    return [f"{n} {what}" for what, n in words.items() if n]


# --- to the epochs of a log -----------------------------------------------------------------------------


def with_products(
    epochs: Sequence[Epoch], products: AtmosphereProducts, max_age_s: float | None = None
) -> tuple[list[Epoch], tuple[str, ...]]:
    """Return epochs with the products as an observation of sensor ``"atmosphere"``, and what is not there.

    Rows are ``"trop:ZWD"`` or ``"trop:ZTD"``, zenith delay, and ``"iono:G05"`` for each satellite whose code
    the epoch has, slant delay of code on the satellite's first frequency; `y` and `sigma` in m. `aux` has
    ``age_s``, the time since the sample, and ``freq_hz`` (nan for the troposphere). The last sample that is
    not after the epoch counts, never a later one. An epoch without code gets nothing; an observation of this
    sensor that is there already is replaced.

    Parameters
    ----------
    epochs : sequence of Epoch
        With code on single frequencies: a satellite's first frequency is that of its row whose
        ``iono_factor`` is 1.
    products : AtmosphereProducts
    max_age_s : float, optional
        Older samples are not used; `AtmosphereProducts.max_age_s` where not given.

    Returns
    -------
    epochs : list of Epoch
    notes : tuple of str
        Where the products come from; what is missing, counted by cause; the products' own notes.
    """
    limit = products.max_age_s if max_age_s is None else max_age_s
    code = {i: o for i, e in enumerate(epochs) if (o := e.sensor("code")) is not None and len(o.keys)}
    t_ns = np.array([epochs[i].t_ns for i in code], dtype=np.int64)
    zenith, told = _zenith(products, t_ns, limit)
    slant, also_told = _slant(products, t_ns, list(code.values()), limit)
    found = _observations(t_ns, zenith.and_then(slant))
    out = list(epochs)
    for i, o in zip(code, found, strict=True):
        out[i] = _with(epochs[i], o)
    bare = sum(o is None for o in found)
    told += [f"no product of the atmosphere at all: {bare} of {len(code)} epochs"] if bare else []
    return out, (*origin(products), *products.notes, *told, *also_told)


def origin(products: AtmosphereProducts) -> tuple[str, ...]:
    """Say where products come from, and whether they are self-derived."""
    if products.self_derived:
        whose = "made of a receiver's own data: where it is the same, they share its noise and multipath"
        return (f"products of the atmosphere: {products.source or 'unknown source'}, {whose}",)
    return (f"products of the atmosphere: {products.source}",) if products.source else ()


def _with(epoch: Epoch, o: Observation | None) -> Epoch:
    kept = tuple(x for x in epoch.observations if x.sensor != SENSOR)
    return replace(epoch, observations=kept if o is None else (*kept, o))


class _Rows(NamedTuple):
    """Rows of many epochs: number of the epoch, key, value, sigma, age, frequency; each of shape (n,)."""

    epoch: Index
    key: npt.NDArray[np.object_]
    y: FloatArray
    sigma: FloatArray
    age_s: FloatArray
    freq_hz: FloatArray

    def and_then(self, other: _Rows) -> _Rows:
        """Return both, in the order of epochs."""
        both = [np.concatenate(pair) for pair in zip(self, other, strict=True)]
        order = np.argsort(both[0], kind="stable")
        return _Rows(*(a[order] for a in both))


def _zenith(
    products: AtmosphereProducts, t_ns: npt.NDArray[np.int64], limit_s: float
) -> tuple[_Rows, list[str]]:
    samples, n = Samples(*products.troposphere), len(t_ns)
    at, age = samples.last(t_ns)
    ok = np.flatnonzero(age <= limit_s)
    missing, stale = np.count_nonzero(at < 0), np.count_nonzero((at >= 0) & (age > limit_s))
    notes = [f"no troposphere product: {missing} of {n} epochs"] if missing else []
    notes += [f"troposphere product older than {limit_s:g} s: {stale} of {n} epochs"] if stale else []
    keys = np.full(len(ok), f"trop:{products.troposphere_kind}", dtype=object)
    nowhere = np.full(len(ok), np.nan)
    return _Rows(ok, keys, samples.value[at[ok]], samples.sigma[at[ok]], age[ok], nowhere), notes


def _slant(
    products: AtmosphereProducts, t_ns: npt.NDArray[np.int64], code: Sequence[Observation], limit_s: float
) -> tuple[_Rows, list[str]]:
    epoch, number, sats, freq_hz = _views(code)
    value, sigma = np.zeros(len(epoch)), np.ones(len(epoch))
    age = np.full(len(epoch), np.inf)
    for i, sat in enumerate(sats):
        samples = Samples(*products.ionosphere.get(sat, Samples.none()))
        mine = np.flatnonzero(number == i)
        at, age[mine] = samples.last(t_ns[epoch[mine]])
        known = at >= 0
        value[mine[known]], sigma[mine[known]] = samples.value[at[known]], samples.sigma[at[known]]
    old = f"ionosphere product older than {limit_s:g} s"
    no_band = "no code of the first frequency for the ionosphere product"
    reason = np.select(
        [np.isnan(freq_hz), np.isinf(age), age > limit_s], [no_band, "no ionosphere product", old], ""
    )
    names, ok, lost = np.array(sats, dtype=str)[number], reason == "", reason != ""
    metres = metres_per_tecu(freq_hz[ok])
    keys = np.array([f"iono:{sat}" for sat in sats], dtype=object)[number[ok]]
    rows = _Rows(epoch[ok], keys, metres * value[ok], metres * sigma[ok], age[ok], freq_hz[ok])
    return rows, _counted(names[lost].tolist(), reason[lost].tolist(), len(t_ns))


def _views(code: Sequence[Observation]) -> tuple[Index, Index, list[str], FloatArray]:
    """Return for each satellite of each epoch: number of the epoch and of the satellite, the satellites'
    names, and the first frequency (nan: no such row).
    """
    number = {k: 0 for o in code for k in o.keys}
    sats = list(dict.fromkeys(map(group_of, number)))
    place = {sat: i for i, sat in enumerate(sats)}
    number = {k: place[group_of(k)] for k in number}
    flat = np.array([number[k] for o in code for k in o.keys], dtype=np.intp)
    epoch = np.repeat(np.arange(len(code)), [len(o.keys) for o in code])
    first = _joined([o.aux["iono_factor"] for o in code]) == 1.0
    freq_hz = np.where(first, _joined([o.aux["freq_hz"] for o in code]), np.nan)
    one = np.lexsort((~first, epoch * max(len(sats), 1) + flat))
    one = one[np.append(True, np.diff((epoch * len(sats) + flat)[one]) > 0)[: len(one)]]
    return epoch[one], flat[one], sats, freq_hz[one]


def _joined(parts: Sequence[npt.NDArray[np.generic]]) -> FloatArray:
    return np.concatenate([np.zeros(0), *parts])


def _observations(t_ns: npt.NDArray[np.int64], rows: _Rows) -> list[Observation | None]:
    """Return one observation for each time, None where there is no row."""
    keys = rows.key.tolist()
    bounds = np.searchsorted(rows.epoch, np.arange(len(t_ns) + 1)).tolist()
    out: list[Observation | None] = []
    for t, i, j in zip(t_ns.tolist(), bounds, bounds[1:], strict=False):
        aux = {"age_s": rows.age_s[i:j], "freq_hz": rows.freq_hz[i:j]}
        one = Observation(SENSOR, t, tuple(keys[i:j]), rows.y[i:j], rows.sigma[i:j], aux) if j > i else None
        out.append(one)
    return out
