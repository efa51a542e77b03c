"""Campaign: CPU time, on one thread, of the inertial filter at 125 Hz with ten updates a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_loose import ORDER
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.kernels.rotations import attitude_angles
from pntegrity.kernels.strapdown import mechanise
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation
from pntegrity.physics.tables import Klobuchar
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import Epoch, FloatArray, Observation, State, Update
from pntegrity.scenarios import _python_ins
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._urban_logs import missing, nagoya_truth, scenario
from pntegrity.sensors.imu import STIM300
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.noise import CITY
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import motion_of
from pntegrity.simulate.receiver import Receiver, epochs_of, simulate

__all__ = ["FastLog", "fast_log", "filter_of", "fixes_only", "ins_speed", "python_ins", "updates"]

NAME = "ins-speed"
#: Where the drive goes through streets; the mask that leaves 15 satellites of GPS and BDS.
START_S, SECONDS, RATE_HZ, IMU_HZ, MASK_DEG = 130.0, 60.0, 10.0, 125.0, 15.0
#: Times real time that the whole must be faster than.
MUST = 50.0
ROUNDS = 3
#: Errors of the fixes that both libraries take, m and m/s.
FIX_M, FIX_MPS = 1.0, 0.1


@dataclass(frozen=True, eq=False)
class FastLog:
    """A part of the drive through Nagoya with ten epochs and 125 increments a second, and its truth."""

    epochs: tuple[Epoch, ...]
    position_m: FloatArray
    axes: FloatArray
    antenna_m: FloatArray
    antenna_mps: FloatArray
    klobuchar: Klobuchar | None
    lever_arm_m: tuple[float, float, float]

    @property
    def seconds(self) -> float:
        """How long it is."""
        return (self.epochs[-1].t_ns - self.epochs[0].t_ns) / SECOND_NS


def fast_log(data: Path, seconds: float = SECONDS) -> FastLog:
    """Return the log: code and Doppler of 15 satellites under an open sky."""
    town, motion = scenario(), motion_of(nagoya_truth(data))
    nav = read_navigation([data / "nagoya-truth/20230711/base.nav.gz"])
    nav = replace(nav, kepler=tuple(r for r in nav.kepler if r.satellite[0] in town.systems), glonass=())
    start = motion.span_ns[0] + round(START_S * SECOND_NS)
    t_ns = start + np.arange(round(seconds * RATE_HZ), dtype=np.int64) * round(SECOND_NS / RATE_HZ)
    arm, rng = town.lever_arm_m, np.random.default_rng(5)

    def antenna(at_s: float) -> tuple[FloatArray, FloatArray]:
        place, speed = motion.of_point(start + round(at_s * SECOND_NS), arm)
        return place[0], speed[0]

    made = simulate(nav, antenna, t_ns, Receiver(town.noise, mask_rad=float(np.deg2rad(MASK_DEG))), rng)
    kept = [_without_carrier(e) for e in epochs_of(made.table, nav)]
    felt = increments(motion, int(t_ns[0]) - SECOND_NS, int(t_ns[-1]), IMU_HZ)
    whole, _ = with_errors(felt, replace(STIM300, rate_hz=IMU_HZ), rng)
    position, _, axes = motion.at(t_ns)
    place, speed = motion.of_point(t_ns, arm)
    klobuchar = nav.klobuchar.get("G")
    return FastLog(with_increments(kept, whole), position, axes, place, speed, klobuchar, arm)


def _without_carrier(epoch: Epoch) -> Epoch:
    return replace(epoch, observations=tuple(o for o in epoch.observations if o.sensor != "carrier"))


def fixes_only(log: FastLog) -> tuple[Epoch, ...]:
    """Return the epochs with fixes of a receiver in place of its rows."""
    sigma, rng = np.repeat([FIX_M, FIX_MPS], 3), np.random.default_rng(6)
    truth = np.hstack([log.antenna_m, log.antenna_mps])
    measured = truth + sigma * rng.standard_normal(truth.shape)
    aux = {"cov": np.diag(sigma**2)}
    fixes = [Observation("fix", e.t_ns, ORDER, y, aux=aux) for e, y in zip(log.epochs, measured, strict=True)]
    return tuple(replace(e, observations=(f,)) for e, f in zip(log.epochs, fixes, strict=True))


def filter_of(log: FastLog, coupling: Any, fde: Any) -> GnssIns:
    """Return the filter of the log, which is given its heading."""
    heading = float(attitude_angles(enu_rotation(log.position_m[0]) @ log.axes[0])[2])
    ins = InsOptions(
        spec=replace(STIM300, rate_hz=IMU_HZ), lever_arm_m=log.lever_arm_m, coupling=coupling, fde=fde,
        heading_rad=heading,
    )  # fmt: skip
    return GnssIns(GnssOptions(noise=CITY, klobuchar=log.klobuchar, ins=ins))


def updates(estimator: GnssIns, epochs: Sequence[Epoch]) -> list[Update]:
    """Return what the filter makes of the epochs."""
    state, out = State.empty(epochs[0].t_ns - 1), []
    for epoch in epochs:
        out.append(estimator.correct(estimator.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out


def _fastest(run: Callable[[], object]) -> float:
    """Return the CPU time of the fastest round, s; one more before them is not counted."""
    run()
    best = float("inf")
    for _ in range(ROUNDS):
        start = time.thread_time()
        run()
        best = min(best, time.thread_time() - start)
    return best


def ins_speed(data: Path) -> list[Row]:
    """Return how many times faster than real time the filters are, and beside python-ins."""
    if reason := missing(data):
        return skipped(NAME, reason)
    log = fast_log(data)
    with threadpool_limits(1):
        return [*_filters(log), *_parts(log), *_beside(log)]


def _filters(log: FastLog) -> list[Row]:
    rows = []
    cases = (("tight", "ours", MUST), ("loose", "factor-set", None), ("loose", "lsr", None))
    for coupling, fde, must in cases:
        estimator = filter_of(log, coupling, fde)
        last = updates(estimator, log.epochs)[-1]
        spent = _fastest(lambda e=estimator: updates(e, log.epochs))  # type: ignore[misc]
        times = log.seconds / spent
        size = f"{len(last.keys)} rows, {len(last.posterior)} states, 12 or 13 increments"
        note = f"{spent / len(log.epochs) * 1e3:.2f} ms an epoch: {size}"
        wanted = "stated" if must is None else f"at least {must:g}"
        ok = None if must is None else bool(times >= must)
        what = f"125 Hz, 10 updates a second, {coupling}, {fde}: times real time"
        rows.append(row(NAME, what, wanted, round(times), ok, note=note))
    return rows


def _parts(log: FastLog) -> list[Row]:
    """Return the cost of the mechanisation with its linear step, a second at 125 Hz."""
    imu = [e.imu for e in log.epochs[1:11] if e.imu is not None]
    dt = np.concatenate([i.dt_s for i in imu])
    angle, velocity = (np.concatenate([getattr(i, n) for i in imu]) for n in ("angle_rad", "velocity_mps"))
    known = (log.position_m[0], np.zeros(3), log.axes[0], dt, angle, velocity)
    errors, densities = np.zeros(12), STIM300.densities()
    spent = min(_fastest(lambda: mechanise(*known, errors, densities)) for _ in range(30))
    note = "position, velocity, attitude, and F and Q of 21 errors"
    return [
        row(
            NAME,
            f"mechanisation of {len(dt)} increments at once: ms",
            "stated",
            round(spent * 1e3, 3),
            note=note,
        )
    ]


def _beside(log: FastLog) -> list[Row]:
    """Return our loose filter and that of python-ins, both on the same increments and fixes."""
    epochs = fixes_only(log)
    estimator = filter_of(log, "loose", "none")
    found = updates(estimator, epochs)
    ours = _fastest(lambda: updates(estimator, epochs))
    off = _rms([u.posterior.mean[:3] for u in found], log)
    what = "10 fixes a second with their velocity, mechanisation and filter: times real time"
    rows = [
        row(NAME, f"{what}, ours", "stated", round(log.seconds / ours), note=f"position off {off:.2f} m rms")
    ]
    if not _python_ins.available():
        return [*rows, row(NAME, f"{what}, python-ins", "stated", None, note=_python_ins.MISSING)]

    python_ins(log, epochs, found[0].posterior)
    start = time.thread_time()
    track = python_ins(log, epochs, found[0].posterior).track
    spent = time.thread_time() - start
    off = _theirs_rms(track, log)
    note = (
        f"position off {off:.2f} m rms; 15 or 21 states of its own; ours is {spent / ours:.1f} times as fast"
    )
    return [*rows, row(NAME, f"{what}, python-ins", "stated", round(log.seconds / spent), note=note)]


def python_ins(log: FastLog, epochs: Sequence[Epoch], first: State) -> _python_ins.Filtered:
    """Return what python-ins makes of `fixes_only`, begun at our first state."""
    return _python_ins.Filtered(epochs, 0, first, STIM300, FIX_M, FIX_MPS, np.array(log.lever_arm_m))


def _rms(places: Sequence[FloatArray], log: FastLog) -> float:
    """Return the error of the unit's position in the second half, m."""
    half = len(log.epochs) // 2
    d = np.array(places[half:]) - log.position_m[half:]
    return float(np.sqrt((d**2).sum(axis=1).mean()))


def _theirs_rms(track: Any, log: FastLog) -> float:
    """Return the same of its track, at our epochs."""
    seconds = np.array([(e.t_ns - log.epochs[0].t_ns) / SECOND_NS for e in log.epochs])
    at = np.abs(track.index.to_numpy()[:, None] - seconds[None, :]).argmin(axis=0)
    table = track[["lat", "lon", "alt"]].to_numpy()[at]
    geodetic = ecef_to_geodetic(log.position_m)
    half = len(seconds) // 2
    d = (table - np.column_stack([np.degrees(geodetic[:, :2]), geodetic[:, 2]]))[half:]
    metres = d * [np.deg2rad(6.37e6), np.deg2rad(6.37e6) * np.cos(geodetic[0, 0]), 1.0]
    return float(np.sqrt((metres**2).sum(axis=1).mean()))
