"""Real vessels as vehicles: sources of their logs, a unit simulated on their track, and runs with faults."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import MESSAGES
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.exclusion import Policy
from pntegrity.monitors import discover
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Outcome, Pipeline, uncollected
from pntegrity.records import Epoch, FloatArray, Update, group_of
from pntegrity.sensors.imu import STIM300
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.source import Source
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.log_imu import simulated_imu
from pntegrity.simulate.motion import Motion
from pntegrity.source_files import read_log
from pntegrity.states import sensor_of
from pntegrity.vehicle import loaded, sources_of

__all__ = ["P_FA", "Ride", "Vessel", "missing", "monitors", "vessel", "vessels"]

#: Of each monitor, an epoch.
P_FA = 1e-6
#: The unit and the seed of its errors.
SPEC, SEED = STIM300, 1


@cache
def vessels() -> dict[str, Any]:
    """Return what ``vessels.toml`` holds."""
    return tomllib.loads(files("pntegrity.scenarios").joinpath("vessels.toml").read_text(encoding="utf-8"))


def missing(data: Path) -> str:
    """Return which log is not there, empty where all are."""
    return next(
        (f"{v['folder']} is not there" for v in vessels().values() if not (data / v["folder"]).is_dir()), ""
    )


@dataclass(frozen=True, eq=False)
class Vessel:
    """A span of a log as a vehicle.

    Parameters
    ----------
    name : str
    sources : tuple of Source
    epochs : tuple of Epoch
        With increments.
    motion : Motion
        The truth: that of the simulated unit.
    heading_rad : float
        At the first epoch.
    """

    name: str
    sources: tuple[Source, ...]
    epochs: tuple[Epoch, ...]
    motion: Motion
    heading_rad: float

    @property
    def beacons(self) -> tuple[str, ...]:
        """Sensors of the source ``lbl``."""
        keys = {k for e in self.epochs for o in e.observations for k in o.keys if group_of(k) == "lbl"}
        return tuple(sorted(map(sensor_of, keys)))

    def ride(self, faults: Sequence[str] = (), *, monitored: bool = True) -> Ride:
        """Return a run of the whole pipeline.

        Parameters
        ----------
        faults : sequence of str
            In the grammar of `simulate.faults`.
        monitored : bool
            False: the filter alone, which believes all.
        """
        estimator = MultiSource(self.options)
        policy: dict[str, Any] = {"p_fa": P_FA} | dict(estimator.policy)
        pipeline = Pipeline(estimator, monitors() if monitored else (), Policy(**policy))
        epochs = apply_faults(self.epochs, [parse_fault(f) for f in faults])
        begin = time.thread_time()
        with uncollected():
            outcomes = tuple(pipeline.push(e) for e in epochs)
        return Ride(self, outcomes, time.thread_time() - begin, tuple(faults))

    @property
    def options(self) -> GnssOptions:
        """Options of its filter."""
        ins = InsOptions(spec=SPEC, coupling="loose", heading_rad=self.heading_rad)
        return GnssOptions(max_gap_s=MultiSource.max_gap_s, ins=ins, sources=self.sources)


def monitors() -> tuple[Any, ...]:
    """Return the monitors of a run that names none."""
    usual = MultiSource.monitoring
    ism = {"separation": {"ism": MESSAGES[MultiSource.surroundings]}}
    return tuple(
        discover()[n](**({"p_fa": P_FA} | ism.get(n, {}) | usual.get(n, {}))) for n in MultiSource.monitors
    )


def vessel(name: str, data: Path, span_s: Sequence[float]) -> Vessel:
    """Return a span of a log of `vessels`, seconds after its first epoch."""
    table = vessels()[name]
    folder = data / table["folder"]
    log = read_log(folder, table["format"])
    tables: list[Mapping[str, Any]] = [
        t | {"file": str(folder), "format": table["format"]} for t in table["source"]
    ]
    whole = loaded(tables, [])
    begin, end = (whole[0].t_ns + round(s * 1e9) for s in span_s)
    unit = simulated_imu(log, SPEC, SEED, begin, end)
    inside = [e for e in whole if begin <= e.t_ns <= end]
    heading = unit.heading_rad(inside[0].t_ns)
    return Vessel(name, sources_of(tables), with_increments(inside, unit.increments), unit.motion, heading)


@dataclass(frozen=True, eq=False)
class Ride:
    """What came of a run.

    Parameters
    ----------
    vessel : Vessel
    outcomes : tuple of Outcome
    cpu_s : float
    faults : tuple of str
    """

    vessel: Vessel
    outcomes: tuple[Outcome, ...]
    cpu_s: float
    faults: tuple[str, ...] = ()

    @property
    def since_s(self) -> FloatArray:
        """Times after the first epoch."""
        t = np.array([o.t_ns for o in self.outcomes], dtype=np.int64)
        return np.asarray((t - t[0]) * 1e-9)

    @property
    def errors_m(self) -> FloatArray:
        """Errors of the position, east, north, up, shape (n, 3); nan where there is none."""
        truth, _, _ = self.vessel.motion.at([o.t_ns for o in self.outcomes])
        found = np.full_like(truth, np.nan)
        for i, o in enumerate(self.outcomes):
            if len(o.update.posterior):
                found[i] = o.update.posterior.mean[:3]
        return np.asarray((found - truth) @ enu_rotation(truth[0]).T)

    @property
    def left(self) -> list[tuple[float, str]]:
        """When who came to be left out, s after the first epoch."""
        pairs = zip(self.since_s.tolist(), self.outcomes, strict=True)
        return [(s, e.group) for s, o in pairs for e in o.exclusions]

    @property
    def back(self) -> list[tuple[float, str]]:
        """When who came back."""
        pairs = zip(self.since_s.tolist(), self.outcomes, strict=True)
        return [(s, g) for s, o in pairs for g in o.readmitted]

    @property
    def alerts(self) -> npt.NDArray[np.bool_]:
        """Epochs that end with an alert."""
        return np.array([o.status == "alert" for o in self.outcomes])

    @property
    def first_alarms(self) -> npt.NDArray[np.bool_]:
        """Epochs in which a monitor alarms before anything is left out."""
        return np.array([any(v.status == "alert" for v in o.first) for o in self.outcomes])

    def innovations(self, source: str, after_s: float = 300.0) -> tuple[FloatArray, FloatArray]:
        """Return innovations of a source's rows and their standard deviations, as far as it was used."""
        used = self._used(source, after_s)
        found = [np.stack([u.nu[at], np.sqrt(np.diagonal(u.S)[at])], axis=1) for u, at in used]
        nu, sigma = np.concatenate(found).T
        return nu, sigma

    def nis(self, source: str, after_s: float = 300.0) -> float:
        """Return the mean square of a source's normalised innovations, over its rows."""
        total, rows = 0.0, 0
        for u, at in self._used(source, after_s):
            total += float(u.nu[at] @ np.linalg.solve(u.S[np.ix_(at, at)], u.nu[at]))
            rows += len(at)
        return total / rows

    def _used(self, source: str, after_s: float) -> Iterator[tuple[Update, list[int]]]:
        """Yield the updates that use a source, and its rows in each."""
        for s, o in zip(self.since_s, self.outcomes, strict=True):
            at = [i for i, k in enumerate(o.update.keys) if group_of(k) == source]
            if at and s >= after_s:
                yield o.update, at
