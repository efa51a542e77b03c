"""Outcomes as tables (polars): the solution, what the monitors said, what was excluded.

A table tells what was known at the time: an epoch that a later repair went over keeps the row it had. Where a
number is not known there is a null, never a nan; a protection level without a bound is inf. Time is ``t_ns``
(ns of GPS time) and ``time_gps`` (the same, ISO format).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.exclusion import SEPARATION
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotations
from pntegrity.physics.time import to_iso
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, Suspect, Verdict
from pntegrity.report.columns import column, groups_in, names_in, stamps
from pntegrity.report.facts import RunFacts
from pntegrity.report.inertial import antenna, attitude_columns, solutions, velocity_columns
from pntegrity.report.levels import bounds_of, level_columns
from pntegrity.report.sections import section_columns
from pntegrity.report.units import length

__all__ = ["exclusions", "solution", "suspect_text", "verdicts"]

#: Closer to the Earth's centre than this a state called "pos" is not Earth-fixed, m.
EARTH_FIXED_M = 6.2e6
XYZ, ENU = ("x", "y", "z"), ("e", "n", "u")


def solution(outcomes: Sequence[Outcome], facts: RunFacts) -> pl.DataFrame:
    """Return one row an epoch: status, position, velocity, clocks, uncertainty, error where truth is known.

    ``sigma_e_m``, ... are the filter's own standard deviations; ``error_h_m`` is the horizontal error;
    ``clk_m`` the clock of the constellation ``clk_system``, ``isb_<X>_m`` what constellation X differs from
    it. ``zwd_m`` is the zenith wet delay, ``n_arcs`` counts ambiguities, ``n_arcs_born`` those born at this
    epoch. ``hpl_m``, ``vpl_m``, ``pl_east_m``, ... are the protection levels, ``pl_mode`` is the fault mode
    that dominates the largest of them, ``pl_exceeded`` tells whether the error is beyond the horizontal or
    the vertical one. ``ve_mps``, ... are the velocity east, north and up with its ``sigma_ve_mps``, ...;
    ``roll_deg``, ``pitch_deg``, ``heading_deg`` with theirs are there for filters with an INS, whose position
    is that of the antenna; ``section`` and ``gnss_age_s`` for these and for filters that screen their rows.
    """
    position, P = _positions(outcomes)
    ins = solutions(outcomes)
    position = antenna(ins, position)
    there = _earth_fixed(position)
    llh, to_enu = ecef_to_geodetic(there), enu_rotations(there)
    sigma = np.sqrt(np.maximum(np.einsum("nij,njk,nik->ni", to_enu, P, to_enu), 0.0))
    truth = facts.truth(len(outcomes))
    error = np.einsum("nij,nj->ni", enu_rotations(_earth_fixed(truth)), position - truth)
    updates = [o.update for o in outcomes]
    columns: dict[str, Any] = {
        **stamps([o.t_ns for o in outcomes]),
        "status": pl.Series([o.status for o in outcomes], dtype=pl.String),
        **{f"{a}_m": column(position[:, i]) for i, a in enumerate(XYZ)},
        "lat_deg": column(np.degrees(llh[:, 0])),
        "lon_deg": column(np.degrees(llh[:, 1])),
        "height_m": column(llh[:, 2]),
        **{f"v{a}_mps": column(_state(outcomes, f"vel:{a}")) for a in XYZ},
        **velocity_columns(outcomes, to_enu, facts),
        **attitude_columns(ins, facts),
        **{f"sigma_{a}_m": column(sigma[:, i]) for i, a in enumerate(ENU)},
        **_clocks(outcomes),
        **_precise(outcomes),
        "n_rows": pl.Series([len(u.keys) for u in updates], dtype=pl.Int32),
        "n_satellites": pl.Series([len(groups_in(u.keys)) for u in updates], dtype=pl.Int32),
        "excluded": pl.Series([",".join(u.excluded) for u in updates], dtype=pl.String),
        **{f"error_{a}_m": column(error[:, i]) for i, a in enumerate(ENU)},
        "error_h_m": column(np.hypot(error[:, 0], error[:, 1])),
        **_protection(outcomes, error),
        **section_columns(outcomes, facts, any(s is not None for s in ins)),
        "reason": pl.Series([o.reason for o in outcomes], dtype=pl.String),
    }
    return pl.DataFrame(columns)


def _positions(outcomes: Sequence[Outcome]) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, 3) and their covariances (n, 3, 3), nan where there is no position."""
    position, P = np.full((len(outcomes), 3), np.nan), np.full((len(outcomes), 3, 3), np.nan)
    for i, o in enumerate(outcomes):
        mean, covariance = o.update.posterior.block("pos")
        if len(mean) == 3:
            position[i], P[i] = mean, covariance
    return position, P


def _earth_fixed(position_m: FloatArray) -> FloatArray:
    """Return positions, nan where they are not Earth-fixed."""
    far = np.linalg.norm(position_m, axis=1) > EARTH_FIXED_M
    return np.where(far[:, None], position_m, np.nan)


def _state(outcomes: Sequence[Outcome], name: str) -> FloatArray:
    """Return one scalar of the posterior at every epoch, nan where there is none."""
    states = [o.update.posterior for o in outcomes]
    at = [s.layout.index.get(name, -1) for s in states]
    return np.array(
        [s.mean[i] if i >= 0 else np.nan for s, i in zip(states, at, strict=True)], dtype=np.float64
    )


def _clocks(outcomes: Sequence[Outcome]) -> dict[str, pl.Series]:
    layouts = dict.fromkeys(o.update.posterior.layout for o in outcomes)
    isb = sorted({n for layout in layouts for n in layout.names if n.startswith("isb:")})
    reference = {x: next((n for n in x.names if n.partition(":")[0] == "clk"), "") for x in layouts}
    names = [reference[o.update.posterior.layout] for o in outcomes]
    clock = np.full(len(outcomes), np.nan)
    for name in filter(None, set(names)):
        clock = np.where(np.array(names) == name, _state(outcomes, name), clock)
    return {
        "clk_m": column(clock),
        "clk_system": pl.Series([n.partition(":")[2] or None for n in names], dtype=pl.String),
        "drift_mps": column(_state(outcomes, "drift")),
        **{f"isb_{n[4:]}_m": column(_state(outcomes, n)) for n in isb},
    }


def _protection(outcomes: Sequence[Outcome], error_m: FloatArray) -> dict[str, pl.Series]:
    """Return the protection levels, and whether the errors (n, 3) are beyond them."""
    levels = level_columns(bounds_of(outcomes))
    horizontal, vertical = (levels[name].fill_null(np.nan).to_numpy() for name in ("hpl_m", "vpl_m"))
    size = np.hypot(error_m[:, 0], error_m[:, 1]), np.abs(error_m[:, 2])
    known = ~np.isnan(np.stack([*size, horizontal, vertical])).any(axis=0)
    beyond = (size[0] > horizontal) | (size[1] > vertical)
    told = [bool(b) if k else None for b, k in zip(beyond, known, strict=True)]
    return levels | {"pl_exceeded": pl.Series(told, dtype=pl.Boolean)}


def _precise(outcomes: Sequence[Outcome]) -> dict[str, pl.Series]:
    """Return the wet delay, its gradients where there are any, and how many arcs are followed."""
    updates = [o.update for o in outcomes]
    tilted = any(u.posterior.layout.block("grad").size for u in updates)
    wet = {"zwd": "zwd_m"} | ({"grad:n": "grad_n_m", "grad:e": "grad_e_m"} if tilted else {})
    states = {name: _state(outcomes, state) for state, name in wet.items()}
    sigmas = {f"sigma_{name}": _sigma(outcomes, state) for state, name in wet.items()}
    arcs = [u.posterior.layout.block("amb") for u in updates]
    born = [int((~u.F[a].any(axis=1)).sum()) for u, a in zip(updates, arcs, strict=True)]
    return {
        **{name: column(values) for name, values in (states | sigmas).items()},
        "n_arcs": pl.Series([len(a) for a in arcs], dtype=pl.Int32),
        "n_arcs_born": pl.Series(born, dtype=pl.Int32),
    }


def _sigma(outcomes: Sequence[Outcome], name: str) -> FloatArray:
    """Return the standard deviation of one scalar of the posterior at every epoch, nan where there is
    none.
    """
    blocks = [o.update.posterior.block(name)[1] for o in outcomes]
    return np.sqrt(np.array([P[0, 0] if P.size else np.nan for P in blocks], dtype=np.float64))


def suspect_text(s: Suspect) -> str:
    """Say who may be at fault and how: ``G05 ramp 0.10/s since 06:20:01 (explains 45.2)``, ``lbl (AP1, AP3)
    bias since 06:20:01 (explains 45.2)``, or ``G05 separation 2.1 m (rest at 0.85 of what is allowed)``.
    """
    if s.kind == SEPARATION:
        return (
            f"{'+'.join(s.groups)} separation {length(s.size)} (rest at {s.statistic:.2f} of what is allowed)"
        )
    rate = "/s" if s.kind == "ramp" else ""
    digits = ".2f" if abs(s.size) >= 0.1 else "#.2g"
    size = f" {s.size:{digits}}{rate}" if s.size else ""
    who = "+".join(s.groups) + (f" ({', '.join(s.sensors)})" if s.sensors else "")
    return f"{who} {s.kind}{size} since {to_iso(s.onset_ns)[11:]} (explains {s.statistic:.1f})"


def verdicts(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row an epoch and monitor, and the first look (`final` false) where exclusion changed it.

    `statistic` and `threshold` are null where no test was made; `suspects` in words, the most likely first.
    ``hpl_m``, ``vpl_m``, ``pl_east_m``, ... are the levels of each verdict, null where it gives none.
    """
    rows: list[tuple[Verdict, bool]] = []
    for o in outcomes:
        for first, last in zip(o.first, o.verdicts, strict=True):
            if first != last:
                rows.append((first, False))
            rows.append((last, True))
    frame = verdict_frame([v for v, _ in rows])
    return frame.with_columns(pl.Series("final", [final for _, final in rows], dtype=pl.Boolean))


def verdict_frame(found: Sequence[Verdict]) -> pl.DataFrame:
    """Return one row a verdict."""
    tested = np.array([v.status != "unavailable" for v in found], dtype=bool)

    def number(name: str) -> pl.Series:
        values = np.array([getattr(v, name) for v in found], dtype=np.float64)
        return column(np.where(tested, values, np.nan))

    def text(name: str) -> pl.Series:
        return pl.Series([getattr(v, name) for v in found], dtype=pl.String)

    return pl.DataFrame(
        {
            **stamps([v.t_ns for v in found]),
            **{n: text(n) for n in ("monitor", "variant", "status")},
            **{n: number(n) for n in ("statistic", "threshold", "p_fa")},
            "dof": pl.Series([v.dof for v in found], dtype=pl.Int32),
            "suspects": pl.Series(["; ".join(map(suspect_text, v.suspects)) for v in found], dtype=pl.String),
            "ambiguous": pl.Series([v.ambiguous for v in found], dtype=pl.Boolean),
            "reason": text("reason"),
            **_bounds(found),
        }
    )


def _bounds(found: Sequence[Verdict]) -> dict[str, pl.Series]:
    """Return the protection levels of each verdict, how many modes they cover, and since when."""
    bounds = [v.bound for v in found]

    def value(name: str, dtype: type[pl.DataType]) -> pl.Series:
        return pl.Series([None if b is None else getattr(b, name) for b in bounds], dtype=dtype)

    return {
        **level_columns([() if b is None else (b,) for b in bounds]),
        "pl_modes": value("modes", pl.Int32),
        "pl_unmonitored": value("unmonitored", pl.Float64),
        "pl_since_ns": value("since_ns", pl.Int64),
    }


def exclusions(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row an exclusion: when, who, by which test, how large, since when, and when it came back.

    `estimated_bias` is the size at the time of exclusion and `estimated_rate` its growth per second (ramps),
    both in units of the row that carries the fault (m for ranges); null where no size is known, as where
    solutions were compared. `readmitted_gps` is null where the group did not come back.
    """
    made = [(e, _back_ns(outcomes, i, e.group)) for i, o in enumerate(outcomes) for e in o.exclusions]
    ramps: npt.NDArray[np.bool_] = np.array([e.kind == "ramp" for e, _ in made], dtype=bool)
    of_rows = [e.kind != SEPARATION or e.monitor == "subset" for e, _ in made]
    size = np.array([e.size or np.nan if row else np.nan for (e, _), row in zip(made, of_rows, strict=True)])
    age = np.array([(e.t_ns - e.onset_ns) * 1e-9 for e, _ in made], dtype=np.float64)
    return pl.DataFrame(
        {
            **stamps([e.t_ns for e, _ in made]),
            "key": pl.Series([e.group for e, _ in made], dtype=pl.String),
            "monitor": pl.Series([e.monitor for e, _ in made], dtype=pl.String),
            "statistic": column(np.array([e.statistic for e, _ in made], dtype=np.float64)),
            "estimated_bias": column(np.where(ramps, size * age, size)),
            "estimated_rate": column(np.where(ramps, size, np.nan)),
            "kind": pl.Series([e.kind for e, _ in made], dtype=pl.String),
            "onset_gps": pl.Series([to_iso(e.onset_ns) for e, _ in made], dtype=pl.String),
            "ambiguous": pl.Series([e.ambiguous for e, _ in made], dtype=pl.Boolean),
            "readmitted_gps": pl.Series([None if t is None else to_iso(t) for _, t in made], dtype=pl.String),
        }
    )


def _back_ns(outcomes: Sequence[Outcome], i: int, group: str) -> int | None:
    """Return when a group excluded at outcome `i` came back: readmitted, or used after a new start."""
    later = (o for o in outcomes[i + 1 :] if group in o.readmitted or group in names_in(o.update.keys))
    return next((o.t_ns for o in later), None)
