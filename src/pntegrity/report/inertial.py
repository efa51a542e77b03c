"""What filters with an inertial measurement unit tell beside the others: the antenna, velocity, attitude, and
how long they went without GNSS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import polars as pl

from pntegrity.estimators._ins_solution import InsSolution, solution_of
from pntegrity.physics.time import to_iso
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, State, Update
from pntegrity.report.columns import column, groups_in, is_vehicle
from pntegrity.report.facts import RunFacts
from pntegrity.states import is_satellite

__all__ = [
    "ANGLES", "FIX", "Outage", "antenna", "attitude_columns", "from_gnss", "inertial", "outages", "solutions",
    "spread", "velocity_columns",
]  # fmt: skip

ANGLES = ("roll", "pitch", "heading")
ENU = ("e", "n", "u")
FIX = "fix"
"""Group of the rows of a loosely coupled fix."""
SHORT_S = 2.0
"""Between two updates this is no stretch without GNSS."""


def solutions(outcomes: Sequence[Outcome]) -> list[InsSolution | None]:
    """Return what the INS of each epoch says, None where there is none."""
    return [solution_of(o.update.posterior) for o in outcomes]


def antenna(found: Sequence[InsSolution | None], position_m: FloatArray) -> FloatArray:
    """Return positions (n, 3), those of the antenna where an INS tells them."""
    out = position_m.copy()
    for i, s in enumerate(found):
        if s is not None:
            out[i] = s.position_m
    return out


def velocity_columns(
    outcomes: Sequence[Outcome], to_enu: FloatArray, facts: RunFacts
) -> dict[str, pl.Series]:
    """Return velocity east, north and up with its sigmas, and its error where the truth is known.

    Parameters
    ----------
    outcomes : sequence of Outcome
    to_enu : ndarray, shape (n, 3, 3)
        What turns ECEF differences at each position into east, north, up; nan where there is none.
    facts : RunFacts
    """
    velocity, P = np.full((len(outcomes), 3), np.nan), np.full((len(outcomes), 3, 3), np.nan)
    for i, o in enumerate(outcomes):
        mean, covariance = o.update.posterior.block("vel")
        if len(mean) == 3:
            velocity[i], P[i] = mean, covariance
    local = np.einsum("nij,nj->ni", to_enu, velocity)
    sigma = np.sqrt(np.maximum(np.einsum("nij,njk,nik->ni", to_enu, P, to_enu), 0.0))
    out = {f"v{a}_mps": column(local[:, i]) for i, a in enumerate(ENU)}
    out |= {f"sigma_v{a}_mps": column(sigma[:, i]) for i, a in enumerate(ENU)}
    if facts.truth_velocity_mps is not None:
        error = np.einsum("nij,nj->ni", to_enu, velocity - facts.truth_velocity(len(outcomes)))
        out |= {f"error_v{a}_mps": column(error[:, i]) for i, a in enumerate(ENU)}
    return out


def attitude_columns(found: Sequence[InsSolution | None], facts: RunFacts) -> dict[str, pl.Series]:
    """Return roll, pitch and heading with their sigmas, deg, and their errors where the truth is known;
    nothing where no epoch has an attitude.
    """
    if not any(s is not None for s in found):
        return {}
    none = np.full(3, np.nan)
    angle = np.array([none if s is None else s.attitude_rad for s in found])
    sigma = np.array([none if s is None else s.attitude_sigma_rad for s in found])
    shown = np.degrees(angle)
    shown[:, 2] = np.mod(shown[:, 2], 360.0)
    out = {f"{a}_deg": column(shown[:, i]) for i, a in enumerate(ANGLES)}
    out |= {f"sigma_{a}_deg": column(np.degrees(sigma[:, i])) for i, a in enumerate(ANGLES)}
    if facts.truth_attitude_rad is not None:
        error = _half_turn(np.degrees(angle - facts.truth_attitude(len(found))))
        out |= {f"error_{a}_deg": column(error[:, i]) for i, a in enumerate(ANGLES)}
    return out


def _half_turn(angle_deg: FloatArray) -> FloatArray:
    """Return angles within -180 to 180 deg."""
    return np.asarray(np.mod(angle_deg + 180.0, 360.0) - 180.0)


# --- stretches without GNSS -------------------------------------------------------------------------------


def from_gnss(update: Update) -> bool:
    """Tell whether satellites, or a fix made of them, entered an update."""
    return any(is_satellite(g) or g == FIX for g in groups_in(update.keys))


@dataclass(frozen=True)
class Outage:
    """A stretch without GNSS, or any source: from the last update with it to the next one, or to the end of
    the run.

    `sigma_m` are the horizontal standard deviations at its beginning and its end.
    """

    start_ns: int
    end_ns: int
    sigma_m: tuple[float, float]
    ended: bool

    @property
    def seconds(self) -> float:
        """How long it lasted."""
        return (self.end_ns - self.start_ns) / 1e9


def outages(outcomes: Sequence[Outcome]) -> list[Outage]:
    """Return the stretches without GNSS, or without any source of a vehicle, after the first update with it,
    in order of time.

    Steps between updates that are the usual ones, or shorter than 2 s, do not count.
    """
    vehicle = is_vehicle(outcomes)
    at = [i for i, o in enumerate(outcomes) if (bool(o.update.keys) if vehicle else from_gnss(o.update))]
    if not at:
        return []
    t_ns = np.array([outcomes[i].t_ns for i in at], dtype=np.int64)
    least = max(SHORT_S, 1.5e-9 * float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0)
    long = [(a, b) for a, b in pairwise(at) if (outcomes[b].t_ns - outcomes[a].t_ns) / 1e9 > least]
    out = [_outage(outcomes, a, b, outcomes[b].update.prior, True) for a, b in long]
    if (outcomes[-1].t_ns - t_ns[-1]) / 1e9 > least:
        last = len(outcomes) - 1
        out.append(_outage(outcomes, at[-1], last, outcomes[last].update.posterior, False))
    return out


def _outage(outcomes: Sequence[Outcome], a: int, b: int, last: State, ended: bool) -> Outage:
    first, end = outcomes[a], outcomes[b]
    return Outage(first.t_ns, end.t_ns, (_flat_sigma(first.update.posterior), _flat_sigma(last)), ended)


def _flat_sigma(state: State) -> float:
    """Return the horizontal standard deviation of a state, m; nan where it has no position."""
    mean, P = state.block("pos")
    if len(mean) != 3:
        return float("nan")
    up = mean / np.linalg.norm(mean)
    return float(np.sqrt(max(np.trace(P) - up @ P @ up, 0.0)))


# --- in numbers -------------------------------------------------------------------------------------------


def inertial(outcomes: Sequence[Outcome], table: pl.DataFrame) -> dict[str, Any] | None:
    """Return what the INS did in numbers, null where none ran.

    ================== =======================================================================================
    key                value
    ================== =======================================================================================
    attitude_sigma_deg median standard deviation of ``roll``, ``pitch``, ``heading``
    attitude_error_deg the same angles, each ``{"mean", "rms", "p95", "max"}``; null without truth
    outages            stretches without GNSS, or of a vehicle without any source: ``count``, ``seconds``
                       (together) and ``longest``: ``{"from", "to", "seconds", "sigma_from_m", "sigma_to_m",
                       "ended"}``; null without any
    ================== =======================================================================================
    """
    if "roll_deg" not in table.columns:
        return None
    errors = {a: f"error_{a}_deg" for a in ANGLES}
    told = all(c in table.columns and table[c].null_count() < len(table) for c in errors.values())
    return {
        "attitude_sigma_deg": {a: table[f"sigma_{a}_deg"].median() for a in ANGLES},
        "attitude_error_deg": {a: spread(table[c]) for a, c in errors.items()} if told else None,
        "outages": _longest(outages(outcomes)),
    }


def spread(errors: pl.Series) -> dict[str, float] | None:
    """Return mean, RMS, 95 % and maximum of the sizes of some errors; null where none is known."""
    size = np.abs(errors.drop_nulls().to_numpy())
    if not len(size):
        return None
    return {
        "mean": float(size.mean()), "rms": float(np.sqrt(np.mean(size**2))),
        "p95": float(np.quantile(size, 0.95)), "max": float(size.max()),
    }  # fmt: skip


def _longest(found: Sequence[Outage]) -> Mapping[str, Any] | None:
    if not found:
        return None
    worst = max(found, key=lambda o: o.seconds)
    before, after = (s if np.isfinite(s) else None for s in worst.sigma_m)
    return {
        "count": len(found),
        "seconds": sum(o.seconds for o in found),
        "longest": {
            "from": to_iso(worst.start_ns), "to": to_iso(worst.end_ns), "seconds": worst.seconds,
            "sigma_from_m": before, "sigma_to_m": after, "ended": worst.ended,
        },
    }  # fmt: skip
