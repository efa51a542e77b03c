"""Protection levels against errors and alert limits: what is judged, and the numbers of the summary.

JSON knows no infinity: in the numbers, null stands for a level that is unbounded.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.evaluate.stanford import Region, Stanford, regions, stanford
from pntegrity.pipeline import Outcome
from pntegrity.records import Bound, FloatArray, join_reasons
from pntegrity.report.facts import RunFacts
from pntegrity.report.levels import bounds_of, mode_name

__all__ = ["Axis", "Protected", "protected", "protection"]

BoolArray = npt.NDArray[np.bool_]
BEYOND = (Region.MISLEADING, Region.HAZARDOUS, Region.UNAVAILABLE_MISLEADING)


@dataclass(frozen=True, eq=False)
class Axis:
    """One direction of a run: horizontal or vertical.

    Parameters
    ----------
    name : str
        ``"horizontal"`` or ``"vertical"``.
    error, level : ndarray, shape (n,)
        Size of the true error (nan: not known) and protection level (nan: none, inf: unbounded), m.
    limit : float
        Alert limit, m; inf: none.
    alert : ndarray of bool, shape (n,)
    """

    name: str
    error: FloatArray
    level: FloatArray
    limit: float
    alert: BoolArray

    @cached_property
    def region(self) -> npt.NDArray[np.int8]:
        """Region of the Stanford diagram of each epoch, shape (n,)."""
        return regions(self.error, self.level, self.limit, self.alert)

    @cached_property
    def counts(self) -> Stanford:
        """How many epochs are in each region."""
        return stanford(self.error, self.level, self.limit, self.alert)

    @property
    def beyond(self) -> BoolArray:
        """Epochs whose error is beyond the level, without an alert."""
        return np.isin(self.region, BEYOND)

    @property
    def compared(self) -> BoolArray:
        """Epochs that can show an error beyond its level: it is known, the level finite, no alert given."""
        return ~self.alert & ~np.isnan(self.error) & np.isfinite(self.level)


@dataclass(frozen=True, eq=False)
class Protected:
    """The protection levels of a run beside what they are held against.

    Parameters
    ----------
    horizontal, vertical : Axis
    ok : ndarray of bool, shape (n,)
        Epochs whose status is ``ok``.
    reason : tuple of str
        Why a level is unbounded, an epoch.
    """

    horizontal: Axis
    vertical: Axis
    ok: BoolArray
    reason: tuple[str, ...]

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """Both directions."""
        return self.horizontal, self.vertical

    @property
    def has_truth(self) -> bool:
        """Whether any error is known."""
        return any(bool(np.isfinite(a.error).any()) for a in self.axes)

    @property
    def has_limits(self) -> bool:
        """Whether there is any alert limit."""
        return any(a.limit < math.inf for a in self.axes)

    @property
    def given(self) -> BoolArray:
        """Epochs with levels, bounded or not."""
        return ~np.isnan(self.horizontal.level)

    @property
    def unbounded(self) -> BoolArray:
        """Epochs with a level of inf."""
        return np.isinf(self.horizontal.level) | np.isinf(self.vertical.level)

    @property
    def available(self) -> BoolArray:
        """Epochs with the status ``ok`` and both levels finite and within the alert limits."""
        serve = [np.isfinite(a.level) & (a.level <= a.limit) for a in self.axes]
        return self.ok & serve[0] & serve[1]

    @property
    def misleading(self) -> BoolArray:
        """Epochs with an error beyond its level in any direction, without an alert."""
        return self.horizontal.beyond | self.vertical.beyond

    @property
    def hazardous(self) -> BoolArray:
        """Epochs with an error beyond its alert limit, a level within it and no alert, in any direction."""
        found = [a.region == Region.HAZARDOUS for a in self.axes]
        return np.asarray(found[0] | found[1])

    @property
    def compared(self) -> BoolArray:
        """Epochs with an error that can be held against its level."""
        return self.horizontal.compared | self.vertical.compared


def protected(table: pl.DataFrame, facts: RunFacts) -> Protected | None:
    """Return what `solution` tells of protection levels, None where no epoch has any."""
    if table["hpl_m"].null_count() == len(table):
        return None
    status = table["status"].to_numpy()

    def axis(name: str, error: str, level: str, limit: str) -> Axis:
        values = (table[c].fill_null(np.nan).to_numpy() for c in (error, level))
        size, at = (np.abs(v) for v in values)
        return Axis(name, size, at, facts.alert_limit(limit), status == "alert")

    return Protected(
        axis("horizontal", "error_h_m", "hpl_m", "hal_m"),
        axis("vertical", "error_u_m", "vpl_m", "val_m"),
        status == "ok",
        tuple(table["pl_reason"].to_list()),
    )


# --- the numbers ------------------------------------------------------------------------------------------


def protection(outcomes: Sequence[Outcome], table: pl.DataFrame, facts: RunFacts) -> dict[str, Any] | None:
    """Return the protection levels in numbers, null where no verdict has any.

    ===================== ====================================================================================
    key                   value
    ===================== ====================================================================================
    epochs                epochs with levels, unbounded ones included
    hpl_m, vpl_m          ``{"median", "p95"}`` of the levels of these epochs; null: unbounded at so many
    along_m, cross_m      the same along and across the track; null without a course
    hal_m, val_m          alert limits; null: none
    available             ``{"epochs", "share"}`` of all epochs with the status ``ok``, HPL <= HAL and VPL <=
                          VAL; null without alert limits
    unbounded             ``{"epochs", "reasons"}``: HPL or VPL is infinite; how often for which reason
    without               ``{"epochs", "reasons"}``: no levels were given
    over_sigma            median of the level over the standard deviation, ``{"h", "v"}``, where it is finite
    over_smallest         median of the level over the smallest possible one, the same; null where not known
    misleading            null without truth; else ``epochs`` (error beyond its level without an alert, in any
                          direction), ``hazardous`` (of these, error beyond an alert limit that the level is
                          within), ``compared`` (epochs without an alert whose error is known and level
                          finite) and ``horizontal``, ``vertical``: epochs in each region of the Stanford
                          diagram, see `pntegrity.evaluate.stanford`
    modes                 ``{"mode", "east", "north", "up"}``: at how many epochs a fault mode dominates, the
                          most frequent first
    monitored             most fault modes that were monitored at an epoch
    unmonitored           largest probability of all others
    false_alerts_per_hour largest number that the probability of a false alert an epoch amounts to, at the
                          run's interval, were its epochs independent; null where not stated
    risk_per_epoch        share of the integrity risk that one epoch gets; null where not stated
    promise               what the levels assume, as the run was told
    ===================== ====================================================================================
    """
    p = protected(table, facts)
    if p is None:
        return None
    bounds = bounds_of(outcomes)
    given = [x for b in bounds for x in b]
    return {
        "epochs": int(p.given.sum()),
        **{name: _spread(table[name]) for name in ("hpl_m", "vpl_m")},
        **{f"{way}_m": _spread(table[f"pl_{way}_m"]) for way in ("along", "cross")},
        **{name: plain(facts.alert_limit(name)) for name in ("hal_m", "val_m")},
        "available": _share(p.available) if p.has_limits else None,
        "unbounded": _counted(p.unbounded, p.reason),
        "without": _counted(~p.given, _why_without(outcomes)),
        "over_sigma": _ratios(bounds, _sigma),
        "over_smallest": _ratios(bounds, _smallest),
        "misleading": _misleading(p) if p.has_truth else None,
        "modes": _modes(bounds),
        "monitored": max((b.modes for b in given), default=0),
        "unmonitored": plain(max((b.unmonitored for b in given), default=0.0)),
        "false_alerts_per_hour": _false_alerts_per_hour(outcomes, facts.protection),
        "risk_per_epoch": _risk_per_epoch(facts.protection),
        "promise": plain(facts.protection),
    }


def _false_alerts_per_hour(outcomes: Sequence[Outcome], told: Mapping[str, Any]) -> float | None:
    times = np.array([o.t_ns for o in outcomes], dtype=np.int64)
    if len(times) < 2 or "p_fa" not in told:
        return None
    return float(told["p_fa"]) * 3600e9 / float(np.median(np.diff(times)))


def plain(value: Any) -> Any:
    """Return what JSON can hold: null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def _spread(column: pl.Series) -> dict[str, float | None] | None:
    """Return median and 95 %, each a level that occurred: between a number and inf there is no other."""
    known = column.drop_nulls().to_numpy()
    if not len(known):
        return None
    found = np.quantile(known, [0.5, 0.95], method="higher")
    return {"median": plain(found[0]), "p95": plain(found[1])}


def _share(which: BoolArray) -> dict[str, Any]:
    return {"epochs": int(which.sum()), "share": float(which.mean())}


def _counted(which: BoolArray, reason: Sequence[str]) -> dict[str, Any]:
    why = Counter(reason[i] or "no reason given" for i in np.flatnonzero(which).tolist())
    return {"epochs": int(which.sum()), "reasons": dict(why.most_common())}


def _why_without(outcomes: Sequence[Outcome]) -> list[str]:
    """Return what the monitors that give levels elsewhere say of each epoch, else the epoch's own reason."""
    giving = {(v.monitor, v.variant) for o in outcomes for v in o.verdicts if v.bound is not None}
    return [
        join_reasons(v.reason for v in o.verdicts if (v.monitor, v.variant) in giving) or o.reason
        for o in outcomes
    ]


def _sigma(b: Bound) -> tuple[float, float, float]:
    return b.sigma_m


def _smallest(b: Bound) -> tuple[float, float, float]:
    return b.smallest_m


def _ratios(bounds: Iterable[Sequence[Bound]], of: Any) -> dict[str, float | None]:
    """Return the median of the levels over something (east, north, up) of the bound that gave them."""
    h, v = [], []
    for given in filter(None, bounds):
        flat, up = max(given, key=lambda b: b.hpl_m), max(given, key=lambda b: b.vpl_m)
        h.append((flat.hpl_m, math.hypot(*of(flat)[:2])))
        v.append((up.vpl_m, of(up)[2]))
    return {"h": _median_ratio(h), "v": _median_ratio(v)}


def _median_ratio(pairs: Sequence[tuple[float, float]]) -> float | None:
    known = [a / b for a, b in pairs if math.isfinite(a) and math.isfinite(b) and b > 0.0]
    return float(np.median(known)) if known else None


def _misleading(p: Protected) -> dict[str, Any]:
    return {
        "epochs": int(p.misleading.sum()),
        "hazardous": int(p.hazardous.sum()),
        "compared": int(p.compared.sum()),
        **{a.name: asdict(a.counts) for a in p.axes},
    }


def _modes(bounds: Iterable[Sequence[Bound]]) -> list[dict[str, Any]]:
    """Return how often each mode dominates; of several monitors, that of the largest level."""
    counts: tuple[Counter[str], ...] = (Counter(), Counter(), Counter())
    for given in filter(None, bounds):
        for i, level in enumerate(("east_m", "north_m", "up_m")):
            largest = max(given, key=lambda b, level=level: getattr(b, level))  # type: ignore[misc]
            counts[i][mode_name(largest.dominant[i])] += 1
    total = sum(counts, Counter())
    return [
        {"mode": mode, "east": counts[0][mode], "north": counts[1][mode], "up": counts[2][mode]}
        for mode, _ in sorted(total.items(), key=lambda x: (-x[1], x[0]))
    ]


def _risk_per_epoch(promise: Mapping[str, Any]) -> float | None:
    """Return the integrity risk over the number of independent epochs it is meant for."""
    risk, epochs = promise.get("p_hmi"), promise.get("independent_epochs", 1.0)
    return None if risk is None else float(risk) / float(epochs)
