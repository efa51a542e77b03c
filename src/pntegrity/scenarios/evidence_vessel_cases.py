"""Campaign: the six cases of the multi-level study through the whole chain, from increments to proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.records import FloatArray
from pntegrity.scenarios._real_logs import Row, row
from pntegrity.scenarios._vessel_logs import facts, fault_of, ship, ship_log
from pntegrity.scenarios._vessel_pipeline import Run, monitors_of, run_log, until
from pntegrity.scenarios._vessel_rows import finite
from pntegrity.simulate.vessel_log import Fault, VesselLog, with_faults
from pntegrity.states import is_left_out

__all__ = ["CAMPAIGN", "vessel_cases", "vessel_speed"]

CAMPAIGN, SPEED = "vessel-cases", "vessel-speed"
SEED, CLEAN, RUNS, PUBLISHED = 5000, 40, 20, 6
SECONDS, SETTLED_S = 200.0, 15.0
#: Times real time that all levels must be faster than.
MUST = 20.0

Variant = Literal["exact", "published"]


def vessel_cases(data: Path) -> list[Row]:
    """Return the figures of all cases."""
    with threadpool_limits(1, user_api="blas"):
        study, vessel = facts(), ship(SECONDS)
        logs = [ship_log(vessel, SEED + i) for i in range(CLEAN)]
        clean = [run_log(vessel, log, monitors_of(study)) for log in logs]
        rows = _fault_free(study, clean)
        for case in study["cases"]:
            pairs = list(zip(logs, clean, strict=True))
            rows += _case(study, vessel, case, pairs[:RUNS], "exact")
            rows += _case(study, vessel, case, pairs[:PUBLISHED], "published")
        return rows


def _fault_free(study: Mapping[str, Any], runs: Sequence[Run]) -> list[Row]:
    rmse = np.array([r.rmse_m(SETTLED_S, SECONDS) for r in runs])
    false = sum(bool(r.excluded(0.0, SECONDS)) for r in runs)
    low, high = binomial_interval(false, len(runs))
    must = study["experiment"]["p_fa_run"]
    levels = np.concatenate([r.levels_m()[r.t_s >= SETTLED_S] for r in runs])
    hpl, vpl = np.median(np.hypot(levels[:, 0], levels[:, 1])), np.median(levels[:, 2])
    epochs = sum(len(r.outcomes) for r in runs)
    return [
        row(CAMPAIGN, "fault-free RMSE N E D, m", "stated", _three(np.median(rmse, axis=0)),
            note=f"median of {len(runs)} runs; published 0.35/0.17/0.48, the linear study 0.34/0.19/0.44"),
        row(CAMPAIGN, "false isolations a run", f"{must:g}", false / len(runs), low <= must <= high,
            interval=(low, high), note=f"{false} of {len(runs)} runs"),
        row(CAMPAIGN, "HPL and VPL, separation, levels observed, m", "stated", _three(np.array([hpl, vpl])),
            note="median; published 3.1 and 2.7"),
        row(CAMPAIGN, "misleading epochs without a fault", "0", sum(r.misleading() for r in runs),
            not any(r.misleading() for r in runs), note=f"of {epochs}"),
    ]  # fmt: skip


def _case(
    study: Mapping[str, Any], vessel: Any, case: Mapping[str, Any],
    pairs: Sequence[tuple[VesselLog, Run]], variant: Variant,
) -> list[Row]:  # fmt: skip
    from_s, to_s = case["from_to_s"]
    faults = _faults(pairs[0][0], case)
    begin = partial(run_log, vessel, monitors=monitors_of(study, variant))
    proof = {"exact": "trial", "published": "passes"}[variant]
    runs = [begin(log=with_faults(log, faults), proof=proof) for log, _ in pairs]
    name = f"case {case['case']}, {variant}"
    rows = [_named(name, runs, faults, from_s, to_s), _accuracy(name, runs, pairs)]
    rows.append(_recovery(name, runs, faults, from_s, to_s))
    if variant == "exact":
        wrong = sum(_wrong(r, faults, from_s) for r in runs)
        low, high = binomial_interval(wrong, len(runs))
        rows.append(
            row(CAMPAIGN, f"{name}: runs with a healthy source or sensor left out", "at most 0.02",
                wrong / len(runs), low <= 0.02, interval=(low, high))
        )  # fmt: skip
        bad = sum(r.misleading() for r in runs)
        rows.append(row(CAMPAIGN, f"{name}: misleading epochs", "0", bad, bad == 0))
    return rows


def _faults(log: VesselLog, case: Mapping[str, Any]) -> tuple[Fault, ...]:
    sky = log.epochs[0].sensor("gnss")
    assert sky is not None
    return fault_of(case, sky.keys)


def _is_right(name: str, faults: Sequence[Fault]) -> bool:
    return any(is_left_out(f[0], frozenset([name])) for f in faults)


def _wrong(run: Run, faults: Sequence[Fault], from_s: float) -> bool:
    """Tell whether anybody healthy was left out from the fault's begin on."""
    return any(not _is_right(n, faults) for _, n in run.excluded(from_s, SECONDS))


def _named(name: str, runs: Sequence[Run], faults: Sequence[Fault], from_s: float, to_s: float) -> Row:
    right = [[t for t, n in r.excluded(from_s, to_s) if _is_right(n, faults)] for r in runs]
    first = np.round([min(t) - from_s if t else np.inf for t in right], 3)
    exact = sum(
        {f"{f[0].partition(':')[0]}.{f[0].rpartition('.')[2]}" for f in faults}
        == {n for _, n in r.excluded(from_s, to_s)}
        for r in runs
    )
    low, mid, high = np.quantile(first, [0.1, 0.5, 0.9], method="nearest")
    note = (
        f"median of {len(runs)} runs; 80 % {low:.3g} to {high:.3g} s; never in {int(np.isinf(first).sum())}; "
        f"these sensors and nobody else in {exact}"
    )
    return row(CAMPAIGN, f"{name}: left out after, s", "stated", finite(mid), note=note)


def _accuracy(name: str, runs: Sequence[Run], pairs: Sequence[tuple[VesselLog, Run]]) -> Row:
    span = (SETTLED_S, SECONDS)
    with_fault = np.array([r.rmse_m(*span) for r in runs])
    clean = np.array([c.rmse_m(*span) for _, c in pairs])
    ratio = np.median(with_fault, axis=0) / np.median(clean, axis=0)
    ok = bool((ratio <= 1.2).all()) if name.endswith("exact") else None
    must = "at most 1.2" if ok is not None else "stated"
    note = f"medians of the runs; pooled {_three(_rms(with_fault) / _rms(clean))}"
    return row(CAMPAIGN, f"{name}: RMSE over fault-free N E D", must, _three(ratio), ok, note=note)


def _recovery(name: str, runs: Sequence[Run], faults: Sequence[Fault], from_s: float, to_s: float) -> Row:
    left = [r for r in runs if any(_is_right(n, faults) for _, n in r.excluded(from_s, to_s))]
    keys = frozenset(f[0] for f in faults)
    early = sum(_is_used_again(r, keys, from_s, to_s) for r in left)
    delays = [r.first_with(keys, to_s) - to_s for r in left]
    mid = float(np.quantile(delays, 0.5, method="nearest")) if delays else np.inf
    note = (
        f"after the fault's end, all rows in use; any of them in use again during the fault in {early} of "
        f"{len(left)} runs; never in {int(np.isinf(delays).sum())}"
    )
    return row(CAMPAIGN, f"{name}: back after, s", "stated", finite(mid), note=note)


def _is_used_again(run: Run, keys: frozenset[str], from_s: float, to_s: float) -> bool:
    """Tell whether any faulty row was in use again, while the fault lasted, after all had been left out."""
    gone = [t for t, o in run.between(from_s, to_s) if keys.isdisjoint(o.update.keys)]
    return bool(gone) and any(not keys.isdisjoint(o.update.keys) for _, o in run.between(gone[0], to_s))


def vessel_speed(data: Path) -> list[Row]:
    """Return how fast all levels are: 4 sources, 12 satellites, 4 beacons, 1 Hz, increments at 100 Hz."""
    with threadpool_limits(1, user_api="blas"):
        study, vessel = facts(), ship(SECONDS, 1.0, depth=True)
        log = ship_log(vessel, SEED)
        run_log(vessel, until(log, 60.0), monitors_of(study))  # compiled, and warm
        rows = [_speed(vessel, log, study, "without a fault")]
        for number in (2, 3, 6):
            case = study["cases"][number - 1]
            faulty = with_faults(log, _faults(log, case))
            rows.append(_speed(vessel, faulty, study, f"case {number}"))
        return rows


def _speed(vessel: Any, log: VesselLog, study: Mapping[str, Any], name: str) -> Row:
    run = run_log(vessel, log, monitors_of(study))
    seconds = (log.epochs[-1].t_ns - log.epochs[0].t_ns) * 1e-9
    times = seconds / run.cpu_s
    note = f"{1e3 * run.cpu_s / len(run.outcomes):.1f} ms an epoch, all sources, sensors and levels, one core"
    return row(
        SPEED, f"{name}: times faster than real time", f"above {MUST:g}", times, times > MUST, note=note
    )


def _rms(x: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def _three(x: FloatArray) -> list[float]:
    return [float(f"{v:.3g}") for v in x]
