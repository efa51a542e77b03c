"""Tables of a vehicle's sources: each row of each epoch, and the trials of who was left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import polars as pl

from pntegrity.kernels.signatures import is_rate
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, Update
from pntegrity.report.columns import column, member_of, stamps
from pntegrity.report.sources import Doing, doings, lanes
from pntegrity.states import group_of, sensor_of

__all__ = ["proofs", "sensors"]


def sensors(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row an epoch and measured row: its source and sensor, whether it was used, its innovation
    (of a row left out the residual against the solution without it), the standard deviation of that, and
    what its sensor did at the epoch.
    """
    shown = lanes(outcomes)
    done = doings(outcomes, shown)
    place = {m: i for i, lane in enumerate(shown) for m in lane.members}  # the sensor's lane comes last
    found = [row for k, o in enumerate(outcomes) for row in _rows(k, o.update)]
    keys = [key for _, key, _, _, _ in found]
    nu, sigma = (np.array([row[j] for row in found], dtype=np.float64) for j in (3, 4))
    at = {key: place[member_of(key)] for key in set(keys)}
    doing = [Doing(done[at[key], k]).name.lower() for k, key, _, _, _ in found]
    return pl.DataFrame(
        {
            **stamps([outcomes[k].t_ns for k, _, _, _, _ in found]),
            "source": pl.Series([group_of(k) for k in keys], dtype=pl.String),
            "sensor": pl.Series([sensor_of(k) for k in keys], dtype=pl.String),
            "key": pl.Series(keys, dtype=pl.String),
            "rate": pl.Series([is_rate(k) for k in keys], dtype=pl.Boolean),
            "used": pl.Series([used for _, _, used, _, _ in found], dtype=pl.Boolean),
            "innovation": column(nu),
            "sigma": column(sigma),
            "normalised": column(nu / np.where(sigma > 0.0, sigma, np.nan)),
            "doing": pl.Series(doing, dtype=pl.String),
        }
    )


def _rows(k: int, u: Update) -> Iterator[tuple[int, str, bool, float, float]]:
    """Yield index of the epoch, key, whether used, innovation and sigma of the rows of an update."""
    sides = ((True, u.keys, u.nu, _variance(u)), (False, u.spare_keys, u.spare_nu, u.spare_var))
    for used, keys, nu, var in sides:
        for key, value, v in zip(keys, nu.tolist(), np.asarray(var).tolist(), strict=True):
            yield k, key, used, value, float(np.sqrt(max(v, 0.0)))


def _variance(u: Update) -> FloatArray:
    """Return the variances of the innovations, without what an update may have let go of."""
    return np.asarray(np.einsum("ij,jk,ik->i", u.H, u.prior.P, u.H, optimize=True) + np.diagonal(u.R))


def proofs(outcomes: Sequence[Outcome]) -> pl.DataFrame:
    """Return one row a trial of who was left out: who, of how many epochs, whether it passed, the largest
    deviation and its limit (standard deviations), and the probability with which it passes if it is still as
    far off.
    """
    made = [p for o in outcomes for p in o.proofs]
    return pl.DataFrame(
        {
            **stamps([p.t_ns for p in made]),
            "key": pl.Series([p.name for p in made], dtype=pl.String),
            "epochs": pl.Series([p.epochs for p in made], dtype=pl.Int32),
            "passed": pl.Series([p.passed for p in made], dtype=pl.Boolean),
            "statistic": column([p.statistic for p in made]),
            "limit": column([p.limit for p in made]),
            "readmission": column([p.readmission for p in made]),
            "reason": pl.Series([p.reason for p in made], dtype=pl.String),
        }
    )
