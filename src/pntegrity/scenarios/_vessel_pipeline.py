"""Runs of the pipeline over logs of the vessel: who was left out when, who came back, errors and levels."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import Ism
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.exclusion import Policy
from pntegrity.monitors.sensor_window import SensorWindow
from pntegrity.monitors.separation import Separation
from pntegrity.monitors.source_separation import SourceSeparation
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.protocols import Monitor
from pntegrity.records import Bound, FloatArray
from pntegrity.scenarios._vessel_logs import Ship, estimator
from pntegrity.simulate.vessel_log import VesselLog

__all__ = ["Run", "monitors_of", "run_log", "until"]


@dataclass(frozen=True, eq=False)
class Run:
    """Outcomes of one log, their errors (n, 3) north, east, down, m, and the processor time, s."""

    log: VesselLog
    outcomes: tuple[Outcome, ...]
    cpu_s: float

    @cached_property
    def t_s(self) -> FloatArray:
        """Times after the begin of the log."""
        return np.array([(o.t_ns - self.log.motion.span_ns[0]) * 1e-9 for o in self.outcomes])

    @cached_property
    def error_m(self) -> FloatArray:
        """Errors of the position, north, east, down."""
        truth = self.log.truth.position_m[: len(self.outcomes)]
        where = np.array([o.update.posterior.mean[:3] for o in self.outcomes])
        east, north, up = enu_rotation(truth[0]) @ (where - truth).T
        return np.stack([north, east, -up], axis=1)

    def excluded(self, from_s: float, to_s: float) -> list[tuple[float, str]]:
        """Return who was left out when, between two times."""
        return [(t, e.group) for t, o in self.between(from_s, to_s) for e in o.exclusions]

    def between(self, from_s: float, to_s: float) -> list[tuple[float, Outcome]]:
        """Return the outcomes between two times, with their times."""
        return [(float(t), o) for t, o in zip(self.t_s, self.outcomes, strict=True) if from_s <= t < to_s]

    def first_with(self, keys: frozenset[str], from_s: float) -> float:
        """Return when all of some rows are used from a time on; inf: never."""
        times = (t for t, o in self.between(from_s, np.inf) if keys <= set(o.update.keys))
        return next(times, float("inf"))

    def rmse_m(self, from_s: float, to_s: float) -> FloatArray:
        """Return the errors' RMS between two times, north, east, down."""
        at = (self.t_s >= from_s) & (self.t_s < to_s)
        return np.asarray(np.sqrt((self.error_m[at] ** 2).mean(axis=0)))

    def levels_m(self) -> FloatArray:
        """Return the protection levels, east, north, up, shape (n, 3); inf where there are none."""
        return np.array([_level(o) for o in self.outcomes])

    def beyond(self) -> npt.NDArray[np.bool_]:
        """Tell which epochs have an error beyond a level, and no alert."""
        beyond = (np.abs(self.error_m[:, [1, 0, 2]]) > self.levels_m()).any(axis=1)
        return np.asarray(beyond & np.array([o.status == "ok" for o in self.outcomes]))

    def misleading(self) -> int:
        """Return how many epochs have an error beyond a level, and no alert."""
        return int(self.beyond().sum())


def _level(outcome: Outcome) -> tuple[float, float, float]:
    found: Bound | None = next((v.bound for v in outcome.verdicts if v.bound is not None), None)
    return (np.inf,) * 3 if found is None else (found.east_m, found.north_m, found.up_m)


def monitors_of(study: Mapping[str, Any], variant: Literal["exact", "published"] = "exact") -> list[Monitor]:
    """Return the monitors of a vessel with the rates and priors of the study."""
    p = study["experiment"]
    ism = Ism.from_table({"sources": p["p_prior"], "p_hmi": p["p_hmi"], "split": study["levels"]["split"]})
    return [
        SourceSeparation(p["p_fa"], variant, **MultiSource.monitoring["source_separation"]),
        SensorWindow(study["sensors"]["p_fa"], variant),
        Separation(1e-6, ism=ism, pairs=False, levels="observed"),
    ]  # fmt: skip


def until(log: VesselLog, to_s: float) -> VesselLog:
    """Return the log up to a time."""
    end_ns = log.motion.span_ns[0] + round(to_s * 1e9)
    return replace(log, epochs=tuple(e for e in log.epochs if e.t_ns < end_ns))


def run_log(vessel: Ship, log: VesselLog, monitors: Sequence[Monitor], **policy: Any) -> Run:
    """Return the run of a log.

    Parameters
    ----------
    vessel : Ship
    log : VesselLog
    monitors : sequence of Monitor
    **policy
        Fields of the exclusion policy that differ from the estimator's.
    """
    model = estimator(log, vessel.spec)
    driver = Pipeline(model, monitors, Policy(**(dict(model.policy) | policy)))
    begin = time.process_time()
    outcomes = tuple(driver.push(e) for e in log.epochs)
    return Run(log, outcomes, time.process_time() - begin)
