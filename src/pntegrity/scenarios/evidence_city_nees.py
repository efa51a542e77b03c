"""Campaign ``city-nees``: whether the filters' covariances tell how large their errors are.

GNSS errors are drawn from the noise model that the filter has, on the real motion and under the real
ephemerides of Nagoya, errors of the IMU from its specification. The filter starts where its own fix is, with
its own standard deviations of 100 m and 10 m/s; attitude and the IMU's errors start with errors drawn from
the covariance that the filter starts with.

References
----------
Bar-Shalom, Li, Kirubarajan (2001), Estimation with applications to tracking and navigation, section 5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from os import cpu_count
from pathlib import Path

import numpy as np
from scipy import special

from pntegrity.estimators._ins_solution import attitude_now
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.kernels.rotations import rotation, rotvec_of
from pntegrity.records import FloatArray, Prior, State
from pntegrity.scenarios._city_runs import METHODS, OURS, WEIGHTED, Method, alone, options_of
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._urban_logs import UrbanLog, missing, open_log, tst_library
from pntegrity.sensors.imu import STIM300
from pntegrity.sensors.noise import CITY, NoiseModel

__all__ = ["CASES", "Case", "interval_of", "nees", "nees_of"]

NAME = "city-nees"
RUNS, FIRST_S, LAST_S = 50, 200.0, 380.0
#: Level and heading at the start, degrees.
START_DEG = (0.1, 0.1, 1.0)
KINDS = ("pos", "vel", "att", "bg", "ba", "sg", "sa")
#: States that are looked at: how many kinds of three.
LOOKED = {"position, velocity and attitude": 3, "these and the errors of the IMU": 7}
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Case:
    """A filter, the errors of GNSS, and whether the result must be in its interval."""

    method: Method
    noise: NoiseModel
    judged: bool


WHITE = replace(CITY, code_multipath_m=0.0, name="city, white")
CASES: dict[str, Case] = {
    "tight, no tests": Case(replace(METHODS[OURS], fde="none"), CITY, True),
    "ours (tight, tests on)": Case(METHODS[OURS], CITY, True),
    "loose, white code errors": Case(METHODS[WEIGHTED], WHITE, True),
    "loose, code errors that last 60 s": Case(METHODS[WEIGHTED], CITY, False),
}


def nees(data: Path) -> list[Row]:
    """Return the normalised squared errors of the filters."""
    if lost := missing(data):
        return skipped(NAME, lost)
    tst_library(data)  # once, before the processes part
    with ProcessPoolExecutor(cpu_count() or 1, initializer=alone) as pool:
        found = list(pool.map(partial(_seed, data), range(1, RUNS + 1)))
    rows = []
    for number, (label, case) in enumerate(CASES.items()):
        for which, (words, kinds) in enumerate(LOOKED.items()):
            values = np.array([f[number][which] for f in found])
            rows.append(_row(f"{label}: {words}", values, 3 * kinds, case.judged))
    return rows


def _seed(data: Path, seed: int) -> list[FloatArray]:
    """Return the figures of all cases, each of shape (2, epochs)."""
    out = []
    for case in CASES.values():
        log = open_log(data, case.noise, seed, STIM300, FIRST_S, LAST_S)
        out.append(nees_of(log, case, np.random.default_rng([seed, 1])))
    return out


def nees_of(log: UrbanLog, case: Case, rng: np.random.Generator) -> FloatArray:
    """Return the normalised squared errors of one run, a row for each entry of `LOOKED`, shape (2, n).

    Parameters
    ----------
    log : UrbanLog
        Without faults, errors of the case's noise model.
    case : Case
    rng : numpy.random.Generator
        Of the start.
    """
    options = replace(options_of(log, case.method), noise=case.noise)
    estimator, state = GnssIns(options), State.empty(log.epochs[0].t_ns - 1)
    out = np.full((len(LOOKED), len(log.epochs)), np.nan)
    for k, epoch in enumerate(log.epochs):
        prior = estimator.predict(state, epoch)
        if len(prior.state) and not len(state):
            prior = _drawn(prior, log, k, rng)
        state = estimator.correct(prior, epoch).posterior
        if len(state):
            out[:, k] = [_normalised(log, k, state, kinds) for kinds in LOOKED.values()]
    return out


def _drawn(prior: Prior, log: UrbanLog, k: int, rng: np.random.Generator) -> Prior:
    """Return a start whose attitude is wrong by what its covariance says, the IMU's errors unknown."""
    mean, P, layout = prior.state.mean.copy(), prior.state.P.copy(), prior.state.layout
    sigma = np.deg2rad(START_DEG)
    C = rotation(-log.to_enu.T @ (sigma * rng.standard_normal(3))) @ log.axes[k]
    att = layout.block("att")
    P[np.ix_(att, att)] = log.to_enu.T @ np.diag(sigma**2) @ log.to_enu
    unknown = np.concatenate([layout.block(kind) for kind in KINDS[3:]])
    mean[unknown] = 0.0
    P[unknown, unknown] = log.spec.start_sigma() ** 2
    state = replace(prior.state, mean=mean, P=P, aside=prior.state.aside.with_(C=C))
    return replace(prior, state=state, Q=P)


def _normalised(log: UrbanLog, k: int, state: State, kinds: int) -> float:
    """Return the squared error of the first kinds of states over its covariance."""
    errors = np.concatenate([
        log.position_m[k] - state.mean[:3], log.velocity_mps[k] - state.mean[3:6],
        rotvec_of(log.axes[k] @ attitude_now(state).T),
        log.imu_errors[k] - np.concatenate([state.block(kind)[0] for kind in KINDS[3:]]),
    ])[: 3 * kinds]  # fmt: skip
    at = np.concatenate([state.layout.block(kind) for kind in KINDS[:kinds]])
    return float(errors @ np.linalg.solve(state.P[np.ix_(at, at)], errors))


def interval_of(dof: int, runs: int) -> tuple[float, float]:
    """Return the interval of the mean over runs of a chi-square with `dof` degrees of freedom."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (2.0 * special.gammaincinv(0.5 * dof * runs, p) / runs for p in (tail, 1.0 - tail))
    return float(low), float(high)


def _row(quantity: str, values: FloatArray, dof: int, judged: bool) -> Row:
    """Return the mean over the runs at the last epoch, beside all epochs; values are (runs, n)."""
    low, high = interval_of(dof, len(values))
    each = values.mean(axis=0)
    each = each[np.isfinite(each)]
    inside = 100.0 * float(np.mean((each >= low) & (each <= high)))
    per_run = np.nanmean(values, axis=1)
    note = (
        f"{len(values)} runs; over all epochs {np.mean(per_run):.2f} (one sigma {_error(per_run):.2f}); "
        f"{inside:.0f} % of the epochs inside"
    )
    ok = bool(low <= each[-1] <= high) if judged else None
    must = f"95 % interval {low:.2f} to {high:.2f}" if judged else f"stated; {low:.2f} to {high:.2f} if true"
    words = f"{quantity} ({dof} states): mean NEES after {LAST_S - FIRST_S:.0f} s"
    return row(NAME, words, must, f"{each[-1]:.2f}", ok, note=note)


def _error(values: Sequence[float] | FloatArray) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values)))
