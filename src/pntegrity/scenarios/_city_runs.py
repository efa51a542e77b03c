"""Methods of fusing GNSS with an IMU, run over drives through towns: errors and what detection did, epoch by
epoch.

Every method has the same filter settings: noise model `CITY`, satellites above 10 degrees, the truth's
heading and one degree at the start, specification and lever arm of the log. Methods go epoch by epoch through
the estimator's own two steps, without a monitor: what is compared is the detection in the estimator, and no
policy of the pipeline comes on top.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_options import Coupling, Detection, InsOptions
from pntegrity.estimators._ins_solution import solution_of
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.evaluate.train_factors import Training, train_factors, without_limits
from pntegrity.kernels.factor_set import FactorSet
from pntegrity.kernels.rotations import attitude_angles
from pntegrity.records import FloatArray, State, Update
from pntegrity.scenarios._urban_logs import UrbanLog, nagoya_log, tst_library, tst_with_imu
from pntegrity.sensors.imu import LOW_COST, STIM300, ImuSpec
from pntegrity.sensors.noise import CITY
from pntegrity.verdicts import Screening

__all__ = [
    "EKF", "EXACT", "LSR", "METHODS", "OURS", "PUBLISHED", "SPECS", "WEIGHTED", "Drive", "Method", "Tracked",
    "alone", "drives", "estimator_for", "options_of", "track", "trained", "updates",
]  # fmt: skip

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

EKF, WEIGHTED, LSR = "EKF", "EKF, weighted", "EKF with LSR FDE"
PUBLISHED, EXACT, OURS = "factor set, published", "factor set, exact", "ours"
SPECS = {"STIM300": STIM300, "low-cost": LOW_COST}
#: Off the true heading at the start, and satellites below which are not used, rad.
HEADING_OFF_RAD, MASK_RAD = float(np.deg2rad(1.0)), float(np.deg2rad(10.0))
#: Thresholds of the two checks, m: those with which the factor sets are best on tuning seeds, see the
#: campaign city-thresholds.
LIMITS_M = {"published": (30.0, 30.0), "exact": (30.0, 30.0)}


def _factors(variant: str) -> FactorSet:
    missed, false_alarm = LIMITS_M[variant]
    made = FactorSet(missed_limit_m=missed, false_alarm_limit_m=false_alarm)
    return replace(made, variant="published") if variant == "published" else made


@dataclass(frozen=True)
class Method:
    """What is done with the rows of an epoch; `factors` says too whether least squares has weights."""

    coupling: Coupling
    fde: Detection
    factors: FactorSet


#: The methods by name, in the order of the tables.
METHODS: Mapping[str, Method] = {
    EKF: Method("loose", "none", _factors("published")),
    WEIGHTED: Method("loose", "none", _factors("exact")),
    LSR: Method("loose", "lsr", _factors("published")),
    PUBLISHED: Method("loose", "factor-set", _factors("published")),
    EXACT: Method("loose", "factor-set", _factors("exact")),
    OURS: Method("tight", "ours", _factors("exact")),
}


@dataclass(frozen=True, eq=False)
class Tracked:
    """What one method made of a drive; errors are nan before the filter has started.

    Parameters
    ----------
    position_m, velocity_mps : ndarray, shape (n, 3)
        Errors of the IMU's position and velocity east, north, up.
    attitude_rad : ndarray, shape (n, 3)
        Errors of roll, pitch and heading.
    sigma_m : ndarray, shape (n,)
        Standard deviation that the filter gives its horizontal position.
    used : ndarray of bool, shape (n,)
        Whether GNSS was used.
    tests : ndarray of int, shape (n,)
        Subsets that detection tested.
    satellites : ndarray of int, shape (n, 2)
        Before and after detection.
    pdop : ndarray, shape (n, 2)
        The same.
    fix_m : ndarray, shape (n,)
        Horizontal error of the fix that was used, nan where there was none: of loose coupling.
    kind : ndarray of str, shape (n,)
        Section of each epoch.
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    attitude_rad: FloatArray
    sigma_m: FloatArray
    used: BoolArray
    tests: IntArray
    satellites: IntArray
    pdop: FloatArray
    fix_m: FloatArray
    kind: npt.NDArray[np.str_]

    @property
    def horizontal_m(self) -> FloatArray:
        """Horizontal errors, shape (n,)."""
        return np.asarray(np.hypot(self.position_m[:, 0], self.position_m[:, 1]))


def options_of(log: UrbanLog, method: Method) -> GnssOptions:
    """Return the estimator's options for a log."""
    true = attitude_angles(log.to_enu @ log.axes[0])[2]
    ins = InsOptions(
        spec=log.spec, lever_arm_m=log.lever_arm_m, coupling=method.coupling, fde=method.fde,
        factors=method.factors, heading_rad=float(true) + HEADING_OFF_RAD,
    )  # fmt: skip
    return GnssOptions(
        noise=CITY, klobuchar=log.klobuchar, mask_rad=MASK_RAD, max_gap_s=GnssIns.max_gap_s, ins=ins
    )


def estimator_for(log: UrbanLog, name: str) -> GnssIns:
    """Return the estimator of a method of `METHODS` for a log."""
    return GnssIns(options_of(log, METHODS[name]))


def updates(log: UrbanLog, method: Method) -> Iterable[Update]:
    """Yield the update of each epoch of a log."""
    estimator, state = GnssIns(options_of(log, method)), State.empty(log.epochs[0].t_ns - 1)
    for epoch in log.epochs:
        update = estimator.correct(estimator.predict(state, epoch), epoch)
        state = update.posterior
        yield update


def track(log: UrbanLog, method: Method) -> Tracked:
    """Return what a method makes of a drive.

    Parameters
    ----------
    log : UrbanLog
    method : Method
    """
    to_enu = log.to_enu
    n = len(log.epochs)
    errors, used = np.full((n, 10), np.nan), np.zeros(n, dtype=bool)
    counts, pdop, fix = np.zeros((n, 3), dtype=np.int64), np.full((n, 2), np.nan), np.full(n, np.nan)
    for k, update in enumerate(updates(log, method)):
        if update.screening is not None:
            counts[k] = update.screening.tests, *update.screening.satellites
            pdop[k] = update.screening.pdop
        if len(update.posterior):
            errors[k] = _errors(log, k, update.posterior, to_enu)
            used[k] = len(update.keys) > 0
        if update.keys[:1] == ("fix:X",):
            off = to_enu @ (update.prior.mean[:3] + update.nu[:3] - log.position_m[k])
            fix[k] = np.hypot(off[0], off[1])
    return Tracked(
        errors[:, :3], errors[:, 3:6], errors[:, 6:9], errors[:, 9], used, counts[:, 0], counts[:, 1:], pdop,
        fix, np.array(log.kind),
    )  # fmt: skip


def _errors(log: UrbanLog, k: int, state: State, to_enu: FloatArray) -> FloatArray:
    """Return errors of position, velocity and attitude, and the horizontal sigma, shape (10,)."""
    solution = solution_of(state)
    if solution is None:
        return np.full(10, np.nan)
    turned = solution.attitude_rad - attitude_angles(to_enu @ log.axes[k])
    spread = to_enu @ state.block("pos")[1] @ to_enu.T
    return np.concatenate([
        to_enu @ (state.mean[:3] - log.position_m[k]), to_enu @ (state.mean[3:6] - log.velocity_mps[k]),
        (turned + np.pi) % (2.0 * np.pi) - np.pi, [np.sqrt(spread[0, 0] + spread[1, 1])],
    ])  # fmt: skip


# --- thresholds of the two checks ---------------------------------------------------------------------------


def trained(log: UrbanLog, variant: str, alpha: float = 3.0, gamma: float = 3.0) -> Training:
    """Return the thresholds that a log without faults teaches.

    Parameters
    ----------
    log : UrbanLog
    variant : str
        ``"published"`` or ``"exact"``.
    alpha, gamma : float
        Standard deviations above the mean.
    """
    factors = _factors(variant)
    method = Method("loose", "factor-set", without_limits(factors))
    found: list[Screening] = [u.screening for u in updates(log, method) if u.screening is not None]
    return train_factors(found, factors, alpha=alpha, gamma=gamma)


# --- many drives --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """Which drive: the simulation in Nagoya at a load, or Tsim Sha Tsui where `load` is ``"tst"``.

    Parameters
    ----------
    data : Path
    load : str
        ``"full"``, ``"moderate"`` or ``"tst"``.
    spec : ImuSpec
    section : str, optional
        ``"open"``: the whole drive in Nagoya is under the open sky.
    """

    data: Path
    load: str
    spec: ImuSpec
    section: str | None = None

    def log(self, seed: int) -> UrbanLog:
        """Return the log of a seed."""
        if self.load == "tst":
            return tst_with_imu(self.data, seed, self.spec)
        return nagoya_log(self.data, self.load, seed, self.spec, self.section)


def drives(
    drive: Drive, seeds: Sequence[int], methods: Mapping[str, Method] = METHODS, workers: int | None = None
) -> dict[str, list[Tracked]]:
    """Return what each method makes of each seed's drive, in the order of the seeds.

    Parameters
    ----------
    drive : Drive
    seeds : sequence of int
    methods : mapping of str to Method
    workers : int, optional
        Processes; None: as many as there are cores. The result does not depend on it.
    """
    workers = min(workers or os.cpu_count() or 1, len(seeds))
    job = partial(_one, drive, methods)
    if workers == 1:
        found = [job(s) for s in seeds]
    else:
        tst_library(drive.data)  # once, before the processes part
        with ProcessPoolExecutor(workers, initializer=alone) as pool:
            found = list(pool.map(job, seeds))
    return {name: [f[name] for f in found] for name in methods}


def _one(drive: Drive, methods: Mapping[str, Method], seed: int) -> dict[str, Tracked]:
    log = drive.log(seed)
    return {name: track(log, method) for name, method in methods.items()}


@cache
def alone() -> None:
    """Keep linear algebra of a process on one thread."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")
