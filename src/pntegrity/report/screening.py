"""What an estimator's own fault detection did with the rows before the filter used them: tables, numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from pntegrity.kernels.signatures import is_rate
from pntegrity.pipeline import Outcome
from pntegrity.records import Screening, group_of
from pntegrity.report.columns import column, groups_in, or_inf, stamps
from pntegrity.states import is_satellite

__all__ = ["NONE", "araim_sets", "dropped", "found_in", "screening", "screening_numbers"]

NONE = "none"
"""Method of an estimator that screens nothing."""
AT_ONCE = 3
"""So many faults at once ARAIM is compared with."""
NUMBERS = (
    "first", "first_limit", "last", "last_limit", "missed_m", "missed_limit_m", "false_alarm_m",
    "false_alarm_limit_m",
)  # fmt: skip


def found_in(outcomes: Sequence[Outcome]) -> list[tuple[Outcome, Screening]]:
    """Return the epochs at which an estimator screened its rows, and what it found."""
    pairs = ((o, o.update.screening) for o in outcomes)
    return [(o, s) for o, s in pairs if s is not None and s.method != NONE]


def araim_sets(satellites: int, at_once: int = AT_ONCE) -> int:
    """Return how many sets of satellites ARAIM would test for up to `at_once` faults.

    Examples
    --------
    >>> araim_sets(16)
    696
    """
    return sum(math.comb(satellites, k) for k in range(1, at_once + 1))


def screening(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row an epoch that was screened: statistics and limits, satellites and PDOP before and
    after, the checks of missed detection and false alarm; null where there was no test, a PDOP of inf where
    the satellites determine no position.
    """
    found = found_in(outcomes)
    told = [s for _, s in found]
    return pl.DataFrame(
        {
            **stamps([o.t_ns for o, _ in found]),
            "method": pl.Series([s.method for s in told], dtype=pl.String),
            "variant": pl.Series([s.variant for s in told], dtype=pl.String),
            **{n: column([getattr(s, n) for s in told]) for n in NUMBERS},
            "tests": pl.Series([s.tests for s in told], dtype=pl.Int32),
            "dropped": pl.Series([len(s.dropped) for s in told], dtype=pl.Int32),
            "satellites_before": pl.Series([s.satellites[0] for s in told], dtype=pl.Int32),
            "satellites_after": pl.Series([s.satellites[1] for s in told], dtype=pl.Int32),
            "pdop_before": or_inf([s.pdop[0] for s in told]),
            "pdop_after": or_inf([s.pdop[1] for s in told]),
            "used": pl.Series([s.used for s in told], dtype=pl.Boolean),
            "reason": pl.Series([s.reason for s in told], dtype=pl.String),
        }
    )


def dropped(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row a row that was left out: when, which, its satellite, and the iteration that did so."""
    rows = [(o.t_ns, key, i) for o, s in found_in(outcomes) for key, i in s.dropped]
    return pl.DataFrame(
        {
            **stamps([t for t, _, _ in rows]),
            "key": pl.Series([key for _, key, _ in rows], dtype=pl.String),
            "satellite": pl.Series([group_of(key) for _, key, _ in rows], dtype=pl.String),
            "iteration": pl.Series([i for _, _, i in rows], dtype=pl.Int32),
        }
    )


def screening_numbers(outcomes: Sequence[Outcome]) -> dict[str, Any] | None:
    """Return what the estimator's own fault detection did in numbers, null where it has none.

    ================ ======================================================================================
    key              value
    ================ ======================================================================================
    method, variant  which detection, and whether it is the ``exact`` or the ``published`` one
    epochs           epochs that it looked at
    used             ``{"epochs", "share"}`` of these: the filter was updated
    reasons          why not, with how often
    dropped          ``rows``, ``rates`` (how many of them range rates), ``epochs`` (with any row left out)
                     and ``satellites``, one entry each: ``satellite``, ``rows``, ``rates``, ``epochs``,
                     ``share`` of the epochs in which it was seen, ``iterations`` (rows left out by the
                     first, the second, the third and any later iteration)
    tests            ``{"median", "max"}`` of the sets of rows that were tested at an epoch
    araim_tests      the same of what ARAIM would test for up to three faults of as many satellites
    missed           ``{"checked", "failed"}``: epochs; the missed-detection factor was above its threshold
    false_alarm      the same of the false-alarm factor
    satellites       mean ``before`` and ``after``
    pdop             median ``before`` and ``after``; null where it is infinite
    ================ ======================================================================================
    """
    found = found_in(outcomes)
    if not found:
        return None
    told = [s for _, s in found]
    used = sum(s.used for s in told)
    return {
        "method": told[-1].method,
        "variant": told[-1].variant,
        "epochs": len(told),
        "used": {"epochs": used, "share": used / len(told)},
        "reasons": dict(Counter(s.reason or "no reason given" for s in told if not s.used).most_common()),
        "dropped": _dropped(found),
        "tests": _most([s.tests for s in told]),
        "araim_tests": _most([araim_sets(s.satellites[0]) for s in told]),
        "missed": _checked([(s.missed_m, s.missed_limit_m) for s in told]),
        "false_alarm": _checked([(s.false_alarm_m, s.false_alarm_limit_m) for s in told]),
        "satellites": _pair([s.satellites for s in told], np.mean),
        "pdop": _pair([s.pdop for s in told], np.median),
    }


def _most(counts: Sequence[int]) -> dict[str, float]:
    return {"median": float(np.median(counts)), "max": max(counts)}


def _checked(pairs: Sequence[tuple[float, float]]) -> dict[str, int]:
    value, limit = np.array(pairs, dtype=np.float64).T
    there = np.isfinite(value) & np.isfinite(limit)
    return {"checked": int(there.sum()), "failed": int((value[there] > limit[there]).sum())}


def _pair(pairs: Sequence[tuple[float, float]], how: Any) -> dict[str, float | None]:
    values = [float(how(v)) for v in np.array(pairs, dtype=np.float64).T]
    return {k: v if math.isfinite(v) else None for k, v in zip(("before", "after"), values, strict=True)}


def _dropped(found: Sequence[tuple[Outcome, Screening]]) -> dict[str, Any]:
    every = [(o.t_ns, key, i) for o, s in found for key, i in s.dropped]
    seen = Counter(g for o, s in found for g in _in_view(o, s))
    of: dict[str, list[tuple[int, str, int]]] = {}
    for one in every:
        of.setdefault(group_of(one[1]), []).append(one)
    rows = [_satellite(g, out, seen[g]) for g, out in of.items()]
    return {
        "rows": len(every),
        "rates": sum(is_rate(key) for _, key, _ in every),
        "epochs": sum(bool(s.dropped) for _, s in found),
        "satellites": sorted(rows, key=lambda r: (-r["rows"], r["satellite"])),
    }


def _in_view(o: Outcome, s: Screening) -> set[str]:
    keys = (*o.update.keys, *o.update.spare_keys)
    return {g for g in (*groups_in(keys), *(group_of(k) for k, _ in s.dropped)) if is_satellite(g)}


def _satellite(name: str, out: Sequence[tuple[int, str, int]], seen: int) -> dict[str, Any]:
    epochs, iterations = len({t for t, _, _ in out}), [i for _, _, i in out]
    return {
        "satellite": name, "rows": len(out), "rates": sum(is_rate(key) for _, key, _ in out),
        "epochs": epochs, "share": epochs / max(seen, epochs, 1),
        "iterations": [*(iterations.count(k) for k in (1, 2)), sum(i >= 3 for i in iterations)],
    }  # fmt: skip
