"""Our own stages, one callable each: what a run spends its time on."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.workload import FIRST, LAST, Workload
from pntegrity.config import make_monitor
from pntegrity.estimators import discover as estimators
from pntegrity.evaluate.montecarlo import count_alarms, plans
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.monitors import discover as monitors
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.physics.orbits import satellite_states
from pntegrity.pipeline import Pipeline
from pntegrity.records import Prior, State, Update
from pntegrity.report.write import write_results
from pntegrity.run import RunResult, options_for, pipeline_for
from pntegrity.simulate.linear import gains, spp_model

__all__ = ["Stage", "audit_stages", "log_stages", "monitor_variants"]


@dataclass(frozen=True)
class Stage:
    """A piece of work: `run` does it once, for `units` epochs (or epoch-tests)."""

    name: str
    units: int
    run: Callable[[], object]


def monitor_variants() -> list[tuple[str, str]]:
    """Return every monitor with every variant it has."""
    out = []
    for name, cls in monitors().items():
        both = "published" in str(cls.__annotations__.get("variant", ""))
        out += [(name, v) for v in (("exact", "published") if both else ("exact",))]
    return out


def log_stages(work: Workload) -> Iterator[Stage]:
    """Yield the stages of a run on a log, in order; what a stage needs is made before it is yielded."""
    n = len(work.loaded.epochs)
    yield from _reading(work, n)
    updates: list[Update] = []
    for name in estimators():
        found = list(_estimating(work, name, n))
        yield from (stage for stage, _ in found)
        updates = found[-1][1] if name == "spp_kf" else updates
    for name, variant in monitor_variants():
        monitor = make_monitor(name, 1e-6, variant)
        yield Stage(f"{name}, {variant}: step", n, partial(_stepped, monitor, updates))
    yield from _driving(work, n)


def _reading(work: Workload, n: int) -> Iterator[Stage]:
    table, nav = read_observations(work.obs), read_navigation([work.nav])
    rows = np.flatnonzero(_first_code(table.sat, table.signal, table.pseudorange_m))
    states = (
        nav,
        table.sat[rows],
        table.t_ns[table.epoch[rows]],
        table.pseudorange_m[rows],
        table.signal[rows],
    )
    yield Stage("read observations", n, lambda: read_observations(work.obs))
    yield Stage("read navigation", n, lambda: read_navigation([work.nav]))
    yield Stage("satellite states", n, lambda: satellite_states(*states))
    yield Stage("epochs, with satellite states", n, lambda: gnss_epochs(table, nav))


def _first_code(sat: Any, signal: Any, pseudorange_m: Any) -> Any:
    first = (signal == "1C") | ((np.char.startswith(sat, "C")) & (signal == "2I"))
    return first & np.isfinite(pseudorange_m)


def _estimating(work: Workload, name: str, n: int) -> Iterator[tuple[Stage, list[Update]]]:
    estimator = estimators()[name](options_for(work.config(), work.loaded))
    state, befores, priors, updates = State.empty(), [], [], []
    for epoch in work.loaded.epochs:
        befores.append(state)
        priors.append(estimator.predict(state, epoch))
        updates.append(estimator.correct(priors[-1], epoch))
        state = updates[-1].posterior
    yield Stage(f"{name}: predict", n, lambda: _predicted(work, estimator, befores)), updates
    yield Stage(f"{name}: correct", n, lambda: _corrected(work, estimator, priors)), updates


def _predicted(work: Workload, estimator: Any, befores: Sequence[State]) -> None:
    for state, epoch in zip(befores, work.loaded.epochs, strict=True):
        estimator.predict(state, epoch)


def _corrected(work: Workload, estimator: Any, priors: Sequence[Prior]) -> None:
    for prior, epoch in zip(priors, work.loaded.epochs, strict=True):
        estimator.correct(prior, epoch)


def _stepped(monitor: Any, updates: Sequence[Update]) -> None:
    memory = monitor.start()
    for update in updates:
        for lazy in ("white", "absorbed"):  # made once and then kept: every round must make them again
            update.__dict__.pop(lazy, None)
        _, memory = monitor.step(memory, update)


def _driving(work: Workload, n: int) -> Iterator[Stage]:
    config = work.config()

    def pushed(epochs: Any, pipeline: Pipeline) -> list[Any]:
        return [pipeline.push(e) for e in epochs]

    yield Stage(
        "push: spp_kf, five monitors",
        n,
        lambda: pushed(work.loaded.epochs, pipeline_for(config, work.loaded)),
    )
    if work.name == "brux":
        before = pipeline_for(config, work.faulted)
        pushed(work.faulted.epochs[:FIRST], before)
        span = work.faulted.epochs[FIRST:LAST]

        def through() -> list[Any]:
            at = Pipeline(before.estimator, before.monitors, before.policy, before.checkpoint)
            return pushed(span, at)

        yield Stage("push: the same while three satellites are 60 m off", len(span), through)
    result = work.finished()
    assert isinstance(result, RunResult)
    yield Stage("write all results", n, lambda: _written(result))


def _written(result: RunResult) -> None:
    with tempfile.TemporaryDirectory(prefix="pntegrity-bench-") as folder:
        write_results(Path(folder), result.outcomes, result.facts)


def audit_stages(epochs: int = 200, runs: int = 4096, threads: int = 1) -> Iterator[Stage]:
    """Yield the Monte Carlo of every monitor on the 10-satellite record of the literature's simulations."""
    updates = gains(spp_model(), epochs)
    for name, variant in monitor_variants():
        planned = list(plans(updates, make_monitor(name, 1e-3, variant)))

        def drawn(planned: Any = planned) -> object:
            return count_alarms(planned, runs, np.random.default_rng(0), threads=threads)

        yield Stage(f"audit {name}, {variant}", (epochs - 1) * runs, drawn)
