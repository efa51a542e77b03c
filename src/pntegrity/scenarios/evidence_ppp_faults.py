"""Campaigns on real precise logs with faults in them: growing errors of one carrier, of a whole satellite."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pntegrity.evaluate.campaign import carried
from pntegrity.kernels.signatures import is_carrier
from pntegrity.monitors.glr import Glr
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.records import Epoch, Update, group_of
from pntegrity.scenarios._ppp_logs import CARD, ESBC, P_FA, PreciseSite, opened
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios.evidence_ppp import fitted
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = ["carrier_ramps", "satellite_ramps"]

#: Growth of one carrier, m an epoch, and how long it lasts, epochs.
CARRIER_M, LASTS = 0.01, 50
#: Growth of a whole satellite, m an epoch.
SATELLITE_M = (0.02, 0.6)
#: Epochs that a satellite-wide ramp lasts, and that are looked at.
LONG = {"ESBC": (40, 60), "CARD": (40, 60)}
ONSETS = {"ESBC": (400, 500, 600)}


@dataclass(frozen=True)
class Found:
    """What became of one carrier ramp: alarm (epochs after the onset), whom it blamed, position error
    then.
    """

    key: str
    epoch: int | None
    named: bool
    error_m: float


def carrier_ramps(data: Path) -> list[Row]:
    """Return how soon the GLR bank sees a carrier that grows by 1 cm an epoch, each satellite in turn."""
    missing = ESBC.missing(data)
    if missing:
        return skipped("ppp-ramps", missing)
    rows = []
    for systems in ("GR", "GRE"):
        site, noise = opened(ESBC, data, systems), fitted(ESBC, data, systems)
        updates = site.updates(noise)
        found = [f for onset in ONSETS["ESBC"] for f in _each_carrier(updates, onset, noise)]
        rows += _ramp_rows(site, found)
    return rows


def _each_carrier(updates: Sequence[Update], onset: int, noise: NoiseModel) -> Iterator[Found]:
    monitor = Glr(P_FA, noise.factor("glr"))
    memory = monitor.start()
    for u in updates[max(onset - 150, 0) : onset]:
        _, memory = monitor.step(memory, u)
    span = updates[onset : onset + LASTS]
    arcs = [set(u.posterior.layout.names) for u in span]
    for key in span[0].keys:
        arc = next((n for n in span[0].posterior.layout.names if n.startswith(f"amb:{key}:")), "")
        if arc and all(arc in names for names in arcs) and all(key in u.keys for u in span):
            yield _one(span, monitor, memory, key)


def _one(span: Sequence[Update], monitor: Glr, memory: object, key: str) -> Found:
    interval = (span[1].t_ns - span[0].t_ns) * 1e-9
    for k, (u, error) in enumerate(carried(span, key, "ramp", CARRIER_M / interval)):
        verdict, memory = monitor.step(memory, u)  # type: ignore[arg-type]
        if verdict.status == "alert":
            named = verdict.suspect_groups == (group_of(key),)
            return Found(key, k, named, float(np.linalg.norm(error[:3])))
    return Found(key, None, False, float(np.linalg.norm(error[:3])))


def _ramp_rows(site: PreciseSite, found: Sequence[Found]) -> list[Row]:
    seen = [f for f in found if f.epoch is not None]
    right, n = sum(f.named for f in found), len(found)
    delays = np.array([f.epoch if f.epoch is not None else np.inf for f in found])
    errors = 100.0 * np.array([f.error_m for f in seen])
    label = f"{site.label}: carrier + {100 * CARRIER_M:g} cm an epoch"
    missed = ", ".join(f.key for f in found if not f.named)
    return [
        row("ppp-ramps", f"{label}, right satellite", "all", f"{right} of {n}", right == n,
            note=missed and f"not: {missed}"),
        row("ppp-ramps", f"{label}, median first alarm, epochs", "at most 8", float(np.median(delays)),
            bool(np.median(delays) <= 8), note=f"{len(seen)} of {n} found; slowest {delays.max():.0f}"),
        row("ppp-ramps", f"{label}, position error at the alarm, cm", "below 5",
            {"median": round(float(np.median(errors)), 1), "largest": round(float(errors.max()), 1)},
            bool(errors.max() < 5.0), note=f"{int((errors < 5.0).sum())} of {len(errors)} below 5"),
    ]  # fmt: skip


# --- a whole satellite, through the whole pipeline ----------------------------------------------------------


@dataclass(frozen=True)
class Repaired:
    """What the pipeline made of one ramp of a satellite.

    `alarm` is in epochs after the onset; `before_m` and `after_m` are the largest distance from the run
    without the fault before the alarm, and that at the end of the time looked at.
    """

    satellite: str
    size_m: float
    alarm: int | None
    named: bool
    before_m: float
    after_m: float
    others: tuple[str, ...]


def satellite_ramps(data: Path) -> list[Row]:
    """Return what the whole pipeline makes of ramps on code and carrier of each satellite."""
    rows = []
    for log, systems in ((ESBC, "GRE"), (CARD, "GREC")):
        missing = log.missing(data)
        if missing:
            rows += skipped("ppp-faults", missing)
            continue
        site, noise = opened(log, data, systems), fitted(log, data, systems)
        found = [r for onset in _onsets(site) for r in _each_satellite(site, noise, onset)]
        for size in SATELLITE_M:
            rows += _repair_rows(site, size, [r for r in found if r.size_m == size])
    return rows


def _each_satellite(site: PreciseSite, noise: NoiseModel, onset: int) -> Iterator[Repaired]:
    lasts, looked = LONG[site.log.name]
    pipeline = site.pipeline(noise)
    for epoch in site.epochs[:onset]:
        pipeline.push(epoch)
    before = pipeline.checkpoint
    span = site.epochs[onset : onset + looked]
    clean = [pipeline.push(e) for e in span]
    places = [o.update.posterior.mean[:3] for o in clean]
    for satellite in _lasting(clean[:lasts]):
        for size in SATELLITE_M:
            yield _through(site.pipeline(noise, before), span, places, satellite, size, lasts)


def _lasting(clean: Sequence[Outcome]) -> list[str]:
    """Return the satellites whose carrier the filter used at every epoch."""
    groups = [{group_of(k) for k in o.update.keys if is_carrier(k)} for o in clean]
    return sorted(set.intersection(*groups))


def _onsets(site: PreciseSite) -> tuple[int, ...]:
    """Return the onsets of the tables; on the road the two at which most satellites last, in the second
    half.
    """
    if site.log.name in ONSETS:
        return ONSETS[site.log.name]
    lasts, looked = LONG[site.log.name]
    seen = [
        {group_of(k) for o in e.observations if o.sensor == "carrier" for k in o.keys} for e in site.epochs
    ]
    starts = range(len(seen) // 2, len(seen) - looked, 10)
    most = sorted(starts, key=lambda k: (-len(set.intersection(*seen[k : k + lasts])), k))
    second = next(k for k in most if abs(k - most[0]) >= looked)
    return tuple(sorted((most[0], second)))


def _through(
    pipeline: Pipeline, span: Sequence[Epoch], places: Sequence[np.ndarray], satellite: str, size_m: float,
    lasts: int,
) -> Repaired:  # fmt: skip
    interval = (span[1].t_ns - span[0].t_ns) * 1e-9
    fault = parse_fault(f"{satellite}:* ramp {size_m / interval:.9f} m/s 0:{lasts * interval:g}")
    alarm, named, worst, others = None, False, 0.0, set()
    for k, epoch in enumerate(apply_faults(span, [fault])):
        outcome = pipeline.push(epoch)
        distance = float(np.linalg.norm(outcome.update.posterior.mean[:3] - places[k]))
        alarmed = [v for v in outcome.first if v.status == "alert"]
        if alarm is None and alarmed:
            alarm = k
            named = any(e.group == satellite for e in outcome.exclusions) or any(
                v.suspect_groups == (satellite,) for v in alarmed
            )
        worst = max(worst, distance) if alarm is None else worst
        others |= {e.group for e in outcome.exclusions} - {satellite}
    return Repaired(satellite, size_m, alarm, named, worst, distance, tuple(sorted(others)))


def _repair_rows(site: PreciseSite, size: float, found: Sequence[Repaired]) -> list[Row]:
    n, right = len(found), sum(r.named for r in found)
    delays = [r.alarm for r in found if r.alarm is not None]
    before, after = max(r.before_m for r in found), max(r.after_m for r in found)
    label = f"{site.label}: satellite + {100 * size:g} cm an epoch"
    wrong = ", ".join(r.satellite for r in found if not r.named)
    others = ", ".join(sorted({o for r in found for o in r.others}))
    late = sorted(r.after_m for r in found)
    return [
        row("ppp-faults", f"{label}, right satellite", "all", f"{right} of {n}", right == n,
            note="; ".join(filter(None, (wrong and f"not: {wrong}", others and f"also left out: {others}")))),
        row("ppp-faults", f"{label}, median alarm, epochs", "stated",
            float(np.median(delays)) if delays else None, note=f"{len(delays)} of {n} alarm"),
        row("ppp-faults", f"{label}, largest position change before the alarm, m", "below 0.5",
            round(before, 3), before < 0.5),
        row("ppp-faults", f"{label}, largest distance from the clean run at the end, m", "below 0.3",
            round(after, 3), after < 0.3, note=f"median {np.median(late):.3f}"),
    ]  # fmt: skip
