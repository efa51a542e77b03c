"""Campaigns on the simulated drive through Nagoya: what each method makes of the same GNSS and IMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pntegrity.scenarios._city_runs import (
    EKF,
    EXACT,
    LIMITS_M,
    LSR,
    METHODS,
    OURS,
    PUBLISHED,
    SPECS,
    Drive,
    Method,
    Tracked,
    drives,
    trained,
)
from pntegrity.scenarios._city_tables import (
    HEADING,
    HORIZONTAL,
    SECTIONS,
    SPACE,
    Found,
    error_rows,
    gain,
    gain_row,
    median_row,
    rmse,
    subset_rows,
    use_row,
    wrong_row,
)
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._urban_logs import missing, nagoya_log, scenario
from pntegrity.simulate.urban_scenario import CHALLENGING

__all__ = ["full", "low_cost", "moderate", "open_sky", "thresholds"]

TESTING = (PUBLISHED, EXACT, LSR)
#: How much worse than the EKF a method may be under the open sky, %, and seeds of that campaign.
OPEN_WORSE, OPEN_SEEDS = 3.0, 5


def moderate(data: Path) -> list[Row]:
    """Return the figures of the drive in which half of a street's satellites are free of the library's
    errors.
    """
    name, label = "city-moderate", "moderate load, STIM300"
    if lost := missing(data):
        return skipped(name, lost)
    found = drives(Drive(data, "moderate", SPECS["STIM300"]), scenario().quoted)
    return [
        gain_row(name, found, label, LSR, HORIZONTAL, 10.0, 25.0),
        gain_row(name, found, label, LSR, SPACE, 10.0, 25.0),
        gain_row(name, found, label, PUBLISHED, HORIZONTAL, 45.0, note="the paper: 52.2"),
        gain_row(name, found, label, PUBLISHED, SPACE, 50.0, note="the paper: 56.9"),
        gain_row(name, found, label, PUBLISHED, HEADING, 10.0, note="the paper: 52.1"),
        *_ours(name, found, label, 75.0, (HORIZONTAL, SPACE)),
        gain_row(name, found, label, OURS, HEADING, 40.0),
        *_all(name, found, label),
    ]


def full(data: Path) -> list[Row]:
    """Return the figures of the drive with all errors of the library, the better IMU."""
    return _loaded(data, "city-full", "STIM300", 75.0)


def low_cost(data: Path) -> list[Row]:
    """Return the figures of the same drives with the worse IMU."""
    return _loaded(data, "city-low-cost", "low-cost", 65.0)


def _loaded(data: Path, name: str, spec: str, least: float) -> list[Row]:
    if lost := missing(data):
        return skipped(name, lost)
    label = f"full load, {spec}"
    found = drives(Drive(data, "full", SPECS[spec]), scenario().quoted)
    return [
        *_ours(name, found, label, least, (HORIZONTAL, SPACE)),
        _everywhere_row(name, found, label),
        *_all(name, found, label),
    ]


def _ours(name: str, found: Found, label: str, least: float, quantities: Sequence[str]) -> list[Row]:
    return [gain_row(name, found, label, OURS, q, least) for q in quantities]


def _everywhere_row(name: str, found: Found, label: str) -> Row:
    """Return whether the mean error of ours is the smallest in every section."""
    lost = []
    for section in SECTIONS[1:]:
        for quantity in (HORIZONTAL, SPACE):
            each = {n: float(np.mean(rmse(r, quantity, section))) for n, r in found.items()}
            best = min(each, key=lambda n: each[n])
            if best != OURS:
                lost.append(f"{section}, {quantity}: {best} {each[best]:.2f} m, ours {each[OURS]:.2f} m")
    quantity = f"{label}: sections in which the position error of *ours* is below every other's"
    measured = "all" if not lost else f"all but {len(lost)} of 6"
    return row(name, quantity, "all", measured, not lost, note="; ".join(lost))


def _all(name: str, found: Found, label: str) -> list[Row]:
    """Return everything that is stated only."""
    return [
        *_gains(name, found, label), *error_rows(name, found, label), median_row(name, found, label),
        use_row(name, found, label), *_wrong(name, found, label),
        *subset_rows(name, found, label, TESTING),
    ]  # fmt: skip


def _wrong(name: str, found: Found, label: str) -> list[Row]:
    """Return what detection let through, where there are streets."""
    streets = any((t.kind == CHALLENGING).any() for t in found[EKF])
    return [wrong_row(name, found, label)] if streets else []


def _gains(name: str, found: Found, label: str) -> list[Row]:
    """Return what each method gains on the EKF."""
    return [
        row(
            name, f"{label}: {q} error below that of the EKF, %", "stated",
            {n: f"{gain(rmse(r, q), rmse(found[EKF], q))[0]:.1f}" for n, r in found.items() if n != EKF},
        )
        for q in (HORIZONTAL, SPACE, HEADING)
    ]  # fmt: skip


def open_sky(data: Path) -> list[Row]:
    """Return the figures of the drive without houses."""
    name, label = "city-open", "open sky, STIM300"
    if lost := missing(data):
        return skipped(name, lost)
    found = drives(Drive(data, "full", SPECS["STIM300"], "open"), scenario().quoted[:OPEN_SEEDS])
    rows = []
    for method in (m for m in METHODS if m != EKF):
        for quantity in (HORIZONTAL, SPACE):
            most = 0.0 if method == OURS else OPEN_WORSE
            value, interval = gain(rmse(found[method], quantity), rmse(found[EKF], quantity))
            words = f"{label}: {quantity} error of *{method}* above that of the EKF, %"
            worse = (-interval[1], -interval[0])
            rows.append(
                row(name, words, f"at most {most:g}", f"{-value:.1f}", -value <= most, interval=worse)
            )
    return [*rows, *_all(name, found, label)]


# --- thresholds of the factor sets, on tuning seeds ---------------------------------------------------------

#: Standard deviations above the mean: the least and the most that the paper allows.
ALPHA_GAMMA = ((3.0, 3.0), (5.0, 6.0))
PAPER_M, WIDE_M, WIDER_M = (9.0, 30.0), (18.0, 30.0), (30.0, 30.0)
TUNING_SEEDS = 5


def thresholds(data: Path) -> list[Row]:
    """Return what thresholds of the two checks make of the drives of the tuning seeds."""
    name = "city-thresholds"
    if lost := missing(data):
        return skipped(name, lost)
    seeds = scenario().tuning[:TUNING_SEEDS]
    taught = {v: _taught(data, seeds[0], v) for v in LIMITS_M}
    methods = {EKF: METHODS[EKF]} | {
        f"{v}, {words}": _with_limits(v, limits) for v in LIMITS_M for words, limits in taught[v].items()
    }
    found = drives(Drive(data, "moderate", SPECS["STIM300"]), seeds, methods)
    return [_threshold_row(name, v, words, taught[v][words], found) for v in LIMITS_M for words in taught[v]]


def _taught(data: Path, seed: int, variant: str) -> Mapping[str, tuple[float, float]]:
    """Return pairs of thresholds, m, by what they are of."""
    once = trained(nagoya_log(data, "full", seed, SPECS["STIM300"], "open"), variant)
    pairs = {
        f"trained under the open sky, alpha {a:g}, gamma {g:g}": (
            once.missed.limit_m(a), once.false_alarm.limit_m(g),
        )
        for a, g in ALPHA_GAMMA
    }  # fmt: skip
    return pairs | {"of the paper": PAPER_M, "wide": WIDE_M, "wider": WIDER_M}


def _with_limits(variant: str, limits: tuple[float, float]) -> Method:
    method = METHODS[PUBLISHED if variant == "published" else EXACT]
    factors = replace(method.factors, missed_limit_m=limits[0], false_alarm_limit_m=limits[1])
    return replace(method, factors=factors)


def _threshold_row(
    name: str, variant: str, words: str, limits: tuple[float, float], found: Mapping[str, Sequence[Tracked]]
) -> Row:
    runs = found[f"{variant}, {words}"]
    size = rmse(runs, HORIZONTAL)
    gained = [gain(rmse(runs, q), rmse(found[EKF], q))[0] for q in (HORIZONTAL, SPACE)]
    used = 100.0 * float(np.mean([t.used for t in runs]))
    chosen = "; chosen for the quoted seeds" if limits == LIMITS_M[variant] else ""
    note = (
        f"horizontal / 3-D error below that of the EKF: {gained[0]:.0f} / {gained[1]:.0f} %; worst seed "
        f"{size.max():.1f} m; GNSS used in {used:.0f} % of the epochs{chosen}"
    )
    quantity = f"{variant}, thresholds {words}, {limits[0]:.1f} and {limits[1]:.1f} m: horizontal RMSE, m"
    return row(name, quantity, "stated", f"{size.mean():.2f}", note=note)
