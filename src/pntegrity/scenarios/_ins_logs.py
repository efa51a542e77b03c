"""Real logs with an inertial measurement unit: how they are run, and what came out beside the truth."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_solution import InsSolution, solution_of
from pntegrity.estimators._usual import MONITORS
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.exclusion import Policy
from pntegrity.formats._source import read_text
from pntegrity.formats.truth import read_truth
from pntegrity.inertial import InertialConfig, fixes_of, with_imu
from pntegrity.physics.frames import enu_rotation, geodetic_to_ecef
from pntegrity.physics.tables import Klobuchar
from pntegrity.physics.time import SECOND_NS, from_iso
from pntegrity.pipeline import Outcome, Pipeline, uncollected
from pntegrity.records import Epoch, FloatArray, State, group_of
from pntegrity.scenarios._real_logs import WALK, Site, monitors, without_groups
from pntegrity.sensors.noise import CITY
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = [
    "DRIVE",
    "FUSION",
    "FUSION_FOLDER",
    "WALK_FOLDER",
    "Branches",
    "Bridge",
    "InsLog",
    "Track",
    "drive_log",
    "ellipsoidal_m",
    "fusion_log",
    "tracked",
    "walk_log",
    "write_spec",
]

DRIVE, WALK_FOLDER, FUSION_FOLDER = "imu-drive-2025189", "imu-walk-2025240", "imu-gnss-fusion"
FUSION = ("urban-mixed-turns-nominal-001", "urban-stop-go-tight-turns-nominal-001")
#: Where bare seconds of the fusion logs begin: any day will do.
FUSION_DAY = "2025-01-01"
#: Errors of the unit on the drive, by likelihood of the innovations of the first 300 s. Its data sheet has
#: 0.0038 deg/s/sqrt(Hz) and 70 ug/sqrt(Hz); at rest, before the drive, its gyroscopes show up to 0.05 at 1 s:
#: the car shakes it. The floors of the fixes below are the smallest of a few without an alarm in these 300 s.
DRIVE_SPEC = """name = "unit of the drive"
rate_hz = 100.0
gyro_noise_deg_s_sqrt_hz = 0.1
gyro_bias_instability_deg_h = 20.0
gyro_turn_on_bias_deg_s = 0.2
gyro_scale_factor_ppm = 5000.0
accel_noise_ug_sqrt_hz = 2500.0
accel_bias_instability_mg = 5.0
accel_correlation_time_s = 200.0
accel_turn_on_bias_mg = 20.0
accel_scale_factor_ppm = 5000.0
"""


def write_spec(folder: Path) -> Path:
    """Write the specification of the drive's unit into a folder; return its file."""
    path = folder / "drive_unit.toml"
    path.write_text(DRIVE_SPEC, encoding="utf-8")
    return path


@dataclass(frozen=True, eq=False)
class InsLog:
    """A log with an inertial unit in memory: epochs with its increments, how it is run, and the truth.

    Parameters
    ----------
    epochs : tuple of Epoch
    estimator : GnssIns
    truth_m, truth_mps : ndarray, shape (n, 3)
        At the epochs, ECEF, nan where they are not known.
    notes : tuple of str
    names : tuple of str
        Monitors.
    """

    epochs: tuple[Epoch, ...]
    estimator: GnssIns
    truth_m: FloatArray
    truth_mps: FloatArray
    notes: tuple[str, ...]
    names: tuple[str, ...]

    def until(self, seconds: float) -> InsLog:
        """Return its beginning."""
        n = sum(e.t_ns - self.epochs[0].t_ns <= seconds * SECOND_NS for e in self.epochs)
        return replace(self, epochs=self.epochs[:n], truth_m=self.truth_m[:n], truth_mps=self.truth_mps[:n])

    def with_fault(self, fault: str) -> InsLog:
        """Return the log with a fault in the grammar of `simulate.faults`."""
        return replace(self, epochs=tuple(apply_faults(self.epochs, [parse_fault(fault)])))


def _ins_log(
    config: InertialConfig, epochs: Sequence[Epoch], klobuchar: Klobuchar | None, notes: list[str],
    truth: tuple[FloatArray, FloatArray], names: tuple[str, ...],
) -> InsLog:  # fmt: skip
    options = GnssOptions(
        noise=CITY, klobuchar=klobuchar, ins=config.ins_options(), max_gap_s=GnssIns.max_gap_s
    )
    return InsLog(with_imu(config, epochs, options, notes), GnssIns(options), *truth, tuple(notes), names)


def _fixed(config: InertialConfig, truth: Path | None) -> InsLog:
    notes: list[str] = []
    epochs = fixes_of(config, notes)
    t_ns = np.array([e.t_ns for e in epochs], dtype=np.int64)
    none = np.full((len(t_ns), 3), np.nan)
    known = (read_truth(truth).at(t_ns)[0], none) if truth is not None else (none, none)
    return _ins_log(config, epochs, None, notes, known, MONITORS)


def drive_log(data: Path, spec: str, **changes: Any) -> InsLog:
    """Return the drive: RTK fixes whose velocities are late, floors that fit them."""
    folder = data / DRIVE
    fixes = folder / "gnss_1934_sf.pos.gz"
    values: dict[str, Any] = {
        "imu": folder / "imu_gpst.csv.gz", "imu_spec": spec, "imu_axes": "-x,y,-z",
        "imu_mount_deg": (0.0, -6.79, 5.35), "lever_arm_m": (0.0, -0.05, 0.0), "imu_lag_s": 0.22,
        "fixes": fixes, "fix_velocity_lag_s": 0.125, "fix_floor_m": 0.05, "fix_floor_mps": 0.2,
    }  # fmt: skip
    return _fixed(InertialConfig.model_validate(values | changes), fixes)


def walk_log(data: Path) -> InsLog:
    """Return the walk: raw GNSS, tight."""
    folder, site = data / WALK_FOLDER, Site(WALK, data)
    config = InertialConfig.model_validate({
        "imu": folder / "imu_gpst.csv.gz", "imu_spec": "low-cost", "imu_axes": "-y,-x,-z",
        "imu_lag_s": "auto",
    })  # fmt: skip
    speed = read_truth(folder / "gnss_1730_sf.pos.gz")
    t_ns = np.array([e.t_ns for e in site.epochs], dtype=np.int64)
    assert speed.velocity_mps is not None
    since, known_s = (t_ns - speed.t_ns[0]) * 1e-9, (speed.t_ns - speed.t_ns[0]) * 1e-9
    mps = np.stack([np.interp(since, known_s, v, np.nan, np.nan) for v in speed.velocity_mps.T], axis=1)
    truth = (site.truth_m, np.where(np.isfinite(site.truth_m), mps, np.nan))
    return _ins_log(config, site.epochs, site.loaded.klobuchar, [], truth, ("factor_set",))


def fusion_log(data: Path, name: str, floor_m: float = 0.0, floor_mps: float = 0.0) -> InsLog:
    """Return a car drive whose fixes are those of a receiver's own fusion; so is the reference."""
    folder = data / FUSION_FOLDER / name
    config = InertialConfig.model_validate({
        "imu": folder / "imu.csv.gz", "imu_spec": "low-cost", "imu_axes": "rfu", "imu_lag_s": "auto",
        "imu_start": FUSION_DAY, "fixes": folder / "gnss.csv.gz", "fix_floor_m": floor_m,
        "fix_floor_mps": floor_mps,
    })  # fmt: skip
    log = _fixed(config, None)
    return replace(log, truth_m=_fusion_reference(folder, [e.t_ns for e in log.epochs]))


def _fusion_reference(folder: Path, t_ns: Sequence[int]) -> FloatArray:
    """Return positions of the receiver's fusion at times, ECEF, nan outside."""
    lines = read_text(folder / "reference_position.csv.gz").splitlines()[1:]
    table = np.array([[float(v) for v in line.split(",")[:4]] for line in lines])
    place = np.array([geodetic_to_ecef(np.deg2rad(a), np.deg2rad(b), c) for a, b, c in table[:, 1:]])
    seconds = (np.asarray(t_ns) - from_iso(FUSION_DAY)) / SECOND_NS
    return np.stack([np.interp(seconds, table[:, 0], x, np.nan, np.nan) for x in place.T], axis=1)


def ellipsoidal_m(ubx: Path) -> FloatArray:
    """Return heights above the ellipsoid and the geoid of a receiver's NAV-PVT messages, shape (n, 2)."""
    raw, found, at = ubx.read_bytes(), [], 0
    while (at := raw.find(b"\xb5\x62\x01\x07\x5c\x00", at)) >= 0 and at + 100 <= len(raw):
        found.append(struct.unpack_from("<ii", raw, at + 6 + 32))
        at += 100
    return np.array(found, dtype=np.float64).reshape(-1, 2) * 1e-3


@dataclass(frozen=True, eq=False)
class Track:
    """A run beside the truth: seconds since its first epoch, differences east, north, up (nan: none)."""

    seconds: FloatArray
    enu_m: FloatArray
    enu_mps: FloatArray
    outcomes: tuple[Outcome, ...]

    @cached_property
    def nis(self) -> FloatArray:
        """Innovations squared over their covariance, per row, of the epochs that have rows."""
        updates = [o.update for o in self.outcomes if o.update.keys]
        return np.array([float(u.white @ u.white) / len(u.keys) for u in updates])

    @property
    def horizontal_m(self) -> FloatArray:
        """Horizontal differences, nan where there are none."""
        return np.asarray(np.hypot(self.enu_m[:, 0], self.enu_m[:, 1]))

    def at(self, t_ns: int) -> float:
        """Return the seconds of a time."""
        return (t_ns - self.outcomes[0].t_ns) / SECOND_NS


def tracked(log: InsLog) -> Track:
    """Run a log and return it beside its truth."""
    tests = monitors(1e-6, CITY, log.names, GnssIns)
    pipeline = Pipeline(log.estimator, tests, Policy(**log.estimator.policy))
    truth = log.truth_m
    with uncollected():
        outcomes = tuple(pipeline.push(e) for e in log.epochs)
    found = [solution_of(o.update.posterior) for o in outcomes]
    turn = enu_rotation(truth[np.isfinite(truth).all(axis=1)][0])
    place = _places(outcomes, found) - truth
    motion = _column(found, "velocity_mps") - log.truth_mps
    seconds = np.array([(o.t_ns - outcomes[0].t_ns) / SECOND_NS for o in outcomes])
    return Track(seconds, place @ turn.T, motion @ turn.T, outcomes)


def _places(outcomes: Sequence[Outcome], found: Sequence[InsSolution | None]) -> FloatArray:
    """Return positions of the antenna, nan where there is none."""
    means = [o.update.posterior.mean for o in outcomes]
    plain = np.array([m[:3] if len(m) else np.full(3, np.nan) for m in means])
    return np.where([[s is not None] for s in found], _column(found, "position_m"), plain)


def _column(found: Sequence[InsSolution | None], name: str) -> FloatArray:
    return np.array([np.full(3, np.nan) if s is None else getattr(s, name) for s in found])


@dataclass(frozen=True, eq=False)
class Bridge:
    """What the unit alone makes of an outage: difference from the fix at its end, east, north, up (m), and
    its covariance as the filter predicts it.
    """

    begin_s: float
    enu_m: FloatArray
    cov: FloatArray

    @property
    def horizontal_m(self) -> float:
        """Its horizontal size."""
        return float(np.hypot(self.enu_m[0], self.enu_m[1]))

    @property
    def square(self) -> float:
        """Horizontal difference squared over its covariance: chi-square with two degrees of freedom."""
        d = self.enu_m[:2]
        return float(d @ np.linalg.solve(self.cov[:2, :2], d))


class Branches:
    """The filter over all fixes of a log, from whose states outages branch off."""

    def __init__(self, log: InsLog) -> None:
        self.epochs, self.estimator = log.epochs, log.estimator
        self.seconds = np.array([(e.t_ns - self.epochs[0].t_ns) / SECOND_NS for e in self.epochs])
        self.states = self._along(self.epochs)

    def _step(self, state: State, epoch: Epoch) -> State:
        return self.estimator.correct(self.estimator.predict(state, epoch), epoch).posterior

    def _along(self, epochs: Sequence[Epoch]) -> tuple[State, ...]:
        state, states = State.empty(epochs[0].t_ns - 1), []
        for epoch in epochs:
            state = self._step(state, epoch)
            states.append(state)
        return tuple(states)

    def with_satellites(self, begin_s: float, end_s: float, most: int) -> tuple[State, ...]:
        """Return the states of the log with at most so many satellites for a while."""
        return self._along([
            _fewer(e, most) if begin_s <= s < end_s else e
            for e, s in zip(self.epochs, self.seconds.tolist(), strict=True)
        ])  # fmt: skip

    def without(self, begin_s: float, end_s: float) -> tuple[FloatArray, FloatArray]:
        """Return horizontal differences from the fixes, with none used for a while, and their times."""
        gone = (self.seconds >= begin_s) & (self.seconds < end_s)
        epochs = [replace(e, observations=()) if out else e for e, out in zip(self.epochs, gone, strict=True)]
        found = _column([solution_of(s) for s in self._along(epochs)], "position_m")
        fixes = np.array([e.observations[0].y[:3] for e in self.epochs])
        enu = (found - fixes) @ enu_rotation(fixes[0]).T
        known = np.isfinite(enu[:, 0])
        return np.asarray(np.hypot(enu[known, 0], enu[known, 1])), np.asarray(self.seconds[known])

    @property
    def first(self) -> int:
        """Index of the epoch at which the filter started."""
        return next(i for i, s in enumerate(self.states) if len(s))

    def index(self, seconds: float) -> int:
        """Return the index of the first epoch from a time on."""
        return int(np.searchsorted(self.seconds, seconds))

    def bridge(self, begin_s: float, length_s: float) -> Bridge:
        """Return an outage: no fixes after `begin_s`, for `length_s`."""
        i, j = self.index(begin_s), self.index(begin_s + length_s)
        state = self.states[i]
        for epoch in self.epochs[i + 1 : j + 1]:
            state = self._step(state, replace(epoch, observations=()))
        solution = solution_of(state)
        assert solution is not None
        turn = enu_rotation(solution.position_m)
        fix = self.epochs[j].observations[0].y[:3]
        return Bridge(begin_s, turn @ (solution.position_m - fix), turn @ state.block("pos")[1] @ turn.T)


def _fewer(epoch: Epoch, most: int) -> Epoch:
    """Return the epoch with the first satellites of each sensor."""
    kept = frozenset(sorted({group_of(k) for o in epoch.observations for k in o.keys})[:most])
    return without_groups(epoch, kept)
