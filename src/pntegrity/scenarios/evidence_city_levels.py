"""Campaign ``city-levels``: protection levels of the tight filter in streets, and what misleads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import CITY as MESSAGE
from pntegrity.bounds.ism import Ism
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.evaluate.stanford import plain_levels, stanford
from pntegrity.monitors.separation import Separation
from pntegrity.records import FloatArray, State
from pntegrity.scenarios._city_runs import OURS, estimator_for
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._urban_logs import UrbanLog, missing, nagoya_log, scenario, tst_with_imu
from pntegrity.sensors.imu import LOW_COST, STIM300

__all__ = ["city_levels"]

NAME = "city-levels"
KINDS = ("open", "challenging", "denied")
#: Alert limits of the diagram, m: a street and the next one.
HAL_M, VAL_M = 25.0, 40.0
#: Seeds of the IMU beside the real log; of the quoted drives through Nagoya these come first.
IMU_SEEDS, DRIVES = (1, 2), 5
SINGLES = replace(MESSAGE, sectors=0, p_constellation=0.0, constellations=())
MESSAGES: dict[str, Ism] = {"city": MESSAGE, "satellites only": SINGLES}


@dataclass(frozen=True, eq=False)
class Levels:
    """Errors and levels of a run, (n,) each: horizontal and vertical; `sigma_m` (n, 3) east, north, up."""

    kind: npt.NDArray[np.str_]
    error_m: FloatArray
    error_up_m: FloatArray
    sigma_m: FloatArray
    hpl_m: Mapping[str, FloatArray]
    vpl_m: Mapping[str, FloatArray]


def levels_of(log: UrbanLog, messages: Mapping[str, Ism] = MESSAGES) -> Levels:
    """Return the levels of the tight filter over a log, one set a message."""
    estimator, to_enu = estimator_for(log, OURS), log.to_enu
    monitors = {n: Separation(ism=m, pairs=False, levels="observed") for n, m in messages.items()}
    memories = {n: m.start() for n, m in monitors.items()}
    state = State.empty(log.epochs[0].t_ns - 1)
    kinds, facts, found = [], [], []
    for k, epoch in enumerate(log.epochs):
        update = estimator.correct(estimator.predict(state, epoch), epoch)
        state, bounds = update.posterior, []
        for n, monitor in monitors.items():
            verdict, memories[n] = monitor.step(memories[n], update)
            bounds += [verdict.bound] if verdict.bound is not None else []
        if len(state) and len(bounds) == len(monitors):
            kinds.append(log.kind[k])
            east, north, up = to_enu @ (state.mean[:3] - log.position_m[k])
            facts.append([np.hypot(east, north), abs(up), *bounds[0].sigma_m])
            found.append([(b.hpl_m, b.vpl_m) for b in bounds])
    x, levels = np.array(facts), np.array(found)
    hpl, vpl = ({n: levels[:, i, q] for i, n in enumerate(messages)} for q in (0, 1))
    return Levels(np.array(kinds), x[:, 0], x[:, 1], x[:, 2:], hpl, vpl)


def joined(runs: Sequence[Levels]) -> Levels:
    """Return several runs as one."""

    def all_of(field: str) -> FloatArray:
        return np.concatenate([getattr(r, field) for r in runs])

    hpl = {n: np.concatenate([r.hpl_m[n] for r in runs]) for n in runs[0].hpl_m}
    vpl = {n: np.concatenate([r.vpl_m[n] for r in runs]) for n in runs[0].vpl_m}
    return Levels(
        np.concatenate([r.kind for r in runs]), all_of("error_m"), all_of("error_up_m"), all_of("sigma_m"),
        hpl, vpl,
    )  # fmt: skip


def city_levels(data: Path) -> list[Row]:
    """Return the campaign's rows."""
    lost = missing(data)
    if lost:
        return skipped(NAME, lost)
    seeds = scenario().quoted[:DRIVES]
    logs = {
        "TST, real GNSS": [tst_with_imu(data, s, STIM300) for s in IMU_SEEDS],
        "Nagoya, full load, STIM300": [nagoya_log(data, "full", s, STIM300) for s in seeds],
        "Nagoya, full load, low-cost": [nagoya_log(data, "full", s, LOW_COST) for s in seeds],
    }
    return [r for where, some in logs.items() for r in rows_of(where, joined([levels_of(x) for x in some]))]


def rows_of(where: str, x: Levels) -> list[Row]:
    """Return the rows of one place."""
    n = len(x.error_m)
    out = []
    for name in x.hpl_m:
        beyond = x.error_m > x.hpl_m[name], x.error_up_m > x.vpl_m[name]
        out.append(_misled(where, f"separation, {name}", beyond, 0))
        out.append(row(NAME, f"{where}: HPL / VPL by section, median, {name}", "stated", _by_kind(x, name)))
    plain = plain_levels(x.sigma_m, MESSAGE.risks())
    out.append(_misled(where, "K sigma", (x.error_m > plain[0], x.error_up_m > plain[1]), None))
    for label, error, level, limit in (
        ("horizontal", x.error_m, x.hpl_m["city"], HAL_M), ("vertical", x.error_up_m, x.vpl_m["city"], VAL_M),
    ):  # fmt: skip
        regions = stanford(error, level, limit, np.zeros(n, dtype=bool))
        text = f"{regions.normal} normal, {regions.exceeded} misleading, {regions.unavailable} unavailable"
        out.append(
            row(NAME, f"{where}: Stanford diagram, {label}, alert limit {limit:.0f} m", "stated", text)
        )
    return out


def _misled(
    where: str, what: str, beyond: tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]], must: int | None
) -> Row:
    n = len(beyond[0])
    either = int((beyond[0] | beyond[1]).sum())
    note = f"{int(beyond[0].sum())} horizontally, {int(beyond[1].sum())} vertically"
    return row(
        NAME, f"{where}: misleading epochs of {n}, {what}", "stated" if must is None else f"{must}", either,
        None if must is None else either <= must, interval=binomial_interval(either, n), note=note,
    )  # fmt: skip


def _by_kind(x: Levels, name: str) -> str:
    parts = []
    for kind in KINDS:
        at = x.kind == kind
        if at.any():
            h, v = np.median(x.hpl_m[name][at]), np.median(x.vpl_m[name][at])
            parts.append(f"{kind} {h:.1f} / {v:.1f} m")
    return ", ".join(parts)
