"""Stretches of a run by what surrounded the receiver: open, challenging, denied; and the errors in each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.kernels.signatures import is_rate
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, Update
from pntegrity.report.columns import column, groups_in
from pntegrity.report.facts import RunFacts
from pntegrity.report.inertial import from_gnss, spread
from pntegrity.states import is_satellite

__all__ = ["CHALLENGING", "DENIED", "HOW", "OPEN", "by_section", "order", "section_columns"]

OPEN, CHALLENGING, DENIED = "open", "challenging", "denied"
FEWEST = 4
"""Fewer satellites in view than this: denied."""
AROUND_S = 5.0
"""So long before and after a pseudorange was dropped it is challenging."""
PDOP = 4.0
"""A larger PDOP is challenging."""
ALL = "all"
HOW = (
    f"Told from what the receiver saw, not from a map. Denied: fewer than {FEWEST} satellites in view, or no "
    f"update from GNSS. Challenging: a pseudorange left out within {AROUND_S:g} s, or a PDOP above {PDOP:g} "
    "before that. Open: the rest."
)
BoolArray = npt.NDArray[np.bool_]


def section_columns(outcomes: Sequence[Outcome], facts: RunFacts, inertial: bool) -> dict[str, pl.Series]:
    """Return the section of each epoch and the time since the last update from GNSS (0: at this epoch; null:
    none before); nothing where it does not matter: no INS, no screening, no sections given.

    Parameters
    ----------
    outcomes : sequence of Outcome
    facts : RunFacts
    inertial : bool
        Whether an INS runs.
    """
    if not (inertial or facts.sections or any(o.update.screening is not None for o in outcomes)):
        return {}
    if not facts.sections and not any(from_gnss(o.update) for o in outcomes):
        return {}  # sources that are no satellites have no sky
    age = _age_s(outcomes)
    labels = _given(facts.sections, len(outcomes)) if facts.sections else _told(outcomes, age)
    return {"section": pl.Series(labels, dtype=pl.String), "gnss_age_s": column(age)}


def _given(labels: Sequence[str], n: int) -> list[str | None]:
    return [label or None for label in labels[:n]] + [None] * max(n - len(labels), 0)


def _age_s(outcomes: Sequence[Outcome]) -> FloatArray:
    out, last = np.full(len(outcomes), np.nan), None
    for i, o in enumerate(outcomes):
        last = o.t_ns if from_gnss(o.update) else last
        out[i] = np.nan if last is None else (o.t_ns - last) * 1e-9
    return out


def _told(outcomes: Sequence[Outcome], age_s: FloatArray) -> list[str | None]:
    """Return the section of each epoch from what the receiver saw, see `HOW`; None before the filter runs."""
    updates = [o.update for o in outcomes]
    t_s = np.array([o.t_ns for o in outcomes], dtype=np.float64) * 1e-9
    usual = float(np.median(np.diff(t_s[age_s == 0.0]))) if (age_s == 0.0).sum() > 1 else 0.0
    denied = np.array([_few(u) for u in updates], dtype=bool) | ~(age_s < max(0.99 * usual, 1e-3))
    dropped = np.array([_left_out(u) for u in updates], dtype=bool)
    weak = np.array([u.screening is not None and u.screening.pdop[0] > PDOP for u in updates], dtype=bool)
    hard = weak | _near(t_s, dropped)
    running = [len(u.posterior) > 0 for u in updates]
    return [
        None if not r else DENIED if d else CHALLENGING if h else OPEN
        for r, d, h in zip(running, denied, hard, strict=True)
    ]


def _few(update: Update) -> bool:
    """Tell whether fewer satellites than four were in view; not where nothing tells how many."""
    seen = update.screening.satellites[0] if update.screening is not None else 0
    in_rows = {g for g in groups_in((*update.keys, *update.spare_keys)) if is_satellite(g)}
    known = update.screening is not None or bool(in_rows) or not update.keys
    return known and max(seen, len(in_rows)) < FEWEST


def _left_out(update: Update) -> bool:
    """Tell whether a pseudorange was left out; range rates fail in the open as well."""
    s = update.screening
    return bool(update.excluded) if s is None else any(not is_rate(key) for key, _ in s.dropped)


def _near(t_s: FloatArray, which: BoolArray) -> BoolArray:
    """Return which instants have a true one within `AROUND_S`."""
    at = t_s[which]
    if not len(at):
        return np.zeros(len(t_s), dtype=bool)
    right = np.searchsorted(at, t_s).clip(0, len(at) - 1)
    left = (right - 1).clip(0)
    return np.asarray(np.minimum(np.abs(at[right] - t_s), np.abs(at[left] - t_s)) <= AROUND_S)


def order(labels: Sequence[str | None]) -> list[str]:
    """Return the different sections: open, challenging, denied, then others in order of appearance."""
    there = [s for s in dict.fromkeys(labels) if s]
    usual = [s for s in (OPEN, CHALLENGING, DENIED) if s in there]
    return usual + [s for s in there if s not in usual]


def by_section(table: pl.DataFrame, facts: RunFacts) -> dict[str, Any] | None:
    """Return the errors by section, null where `solution` tells no sections.

    ========= =============================================================================================
    key       value
    ========= =============================================================================================
    source    ``"given"``, or ``"derived"`` from what the receiver saw
    rows      one entry a section, and last ``"all"``: ``section``; ``epochs`` and ``share`` of the run;
              ``used``: share of its epochs that GNSS updated; ``horizontal_m``, ``spatial_m`` (3-D),
              ``velocity_mps`` and ``heading_deg``: ``{"mean", "rms", "p95", "max"}`` of the errors, null
              where no truth is known; ``sigma_m``: median horizontal standard deviation; ``hpl_m``: median
              of the horizontal protection levels, null where so many are unbounded or there are none
              (``has_hpl`` false)
    ========= =============================================================================================
    """
    if "section" not in table.columns:
        return None
    labels = table["section"]
    known = order(labels.to_list())
    rows = [_row(name, table.filter(labels == name), len(table)) for name in known]
    return {
        "source": "given" if facts.sections else "derived",
        "rows": [*rows, _row(ALL, table, len(table))],
    }


def _row(name: str, part: pl.DataFrame, n: int) -> dict[str, Any]:
    levels = part["hpl_m"].drop_nulls().to_numpy()
    median = float(np.quantile(levels, 0.5, method="higher")) if len(levels) else np.inf
    sigma = _size(part, ("sigma_e_m", "sigma_n_m")).median()
    return {
        "section": name,
        "epochs": len(part),
        "share": len(part) / n if n else 0.0,
        "used": float((part["gnss_age_s"] == 0.0).fill_null(False).mean() or 0.0) if len(part) else 0.0,  # type: ignore[arg-type]
        "horizontal_m": spread(part["error_h_m"]),
        "spatial_m": spread(_size(part, ("error_e_m", "error_n_m", "error_u_m"))),
        "velocity_mps": spread(_size(part, ("error_ve_mps", "error_vn_mps", "error_vu_mps"))),
        "heading_deg": spread(_size(part, ("error_heading_deg",))),
        "sigma_m": sigma,
        "has_hpl": len(levels) > 0,
        "hpl_m": median if np.isfinite(median) else None,
    }


def _size(part: pl.DataFrame, names: Sequence[str]) -> pl.Series:
    """Return the length of vectors whose parts are columns, null where one is not known."""
    if not set(names) <= set(part.columns):
        return pl.Series([None] * len(part), dtype=pl.Float64)
    parts = part.select(names).cast(pl.Float64).fill_null(np.nan).to_numpy()
    return column(np.sqrt((parts**2).sum(axis=1)))
