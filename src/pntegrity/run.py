"""The main job: files in, outcomes out. What the command line calls, and what a script can call."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pntegrity import vehicle
from pntegrity.config import RunConfig
from pntegrity.errors import InputError
from pntegrity.estimators import discover
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.exclusion import Policy
from pntegrity.formats.atmosphere import read_atmosphere
from pntegrity.formats.products import ProductFiles
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import SignalTable, read_observations
from pntegrity.formats.truth import read_truth
from pntegrity.inertial import fixes_of, with_imu
from pntegrity.logs import Span, clas_log, precise_log, with_atmosphere
from pntegrity.physics.gnss_epochs import GnssEpochs, gnss_epochs
from pntegrity.physics.time import from_iso, to_iso
from pntegrity.pipeline import Outcome, Pipeline, uncollected
from pntegrity.records import Epoch, group_of
from pntegrity.report.blind_spots import blind_spots
from pntegrity.report.facts import RunFacts
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.faults import (
    Fault,
    apply_faults,
    describe,
    out_of_time,
    parse_fault,
    touches_any,
    units_of,
)
from pntegrity.source_files import name_of
from pntegrity.states import is_satellite, sensor_of

__all__ = ["RunResult", "load_epochs", "pipeline_for", "run"]

#: Epochs after which an update is no longer in any window, and its gains are let go of.
KEPT = 1000
#: What it means where a precise estimator gets no precise products.
BROADCAST_NOTES = (
    "broadcast ephemerides instead of precise orbits (--sp3): positions are off by 1 to 3 m, and jump with "
    "every new message; no tides, antennas and wind-up, and carriers are not searched for cycle slips",
)
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class RunResult:
    """The outcomes of a run, and what a reader of them needs to know."""

    outcomes: tuple[Outcome, ...]
    facts: RunFacts


def _silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def load_epochs(config: RunConfig) -> GnssEpochs:
    """Read the log and the ephemerides, cut the time span, inject the faults.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    if config.imu is not None:
        config.ins_options(config.variant)  # its files are read before the long ones
    loaded, span = _observed(config) if config.obs is not None else _said(config)
    if config.imu is not None:
        notes: list[str] = []
        epochs = with_imu(config, loaded.epochs, options_for(config, loaded), notes, span[1])
        loaded = replace(loaded, epochs=epochs, notes=(*loaded.notes, *notes))
    faults = [parse_fault(text) for text in config.faults]
    return replace(loaded, epochs=tuple(_with_faults(loaded.epochs, faults)))


def _observed(config: RunConfig) -> tuple[GnssEpochs, Span]:
    """Return the epochs of a RINEX log, and the run's begin and end."""
    assert config.obs is not None
    table = read_observations(config.obs)
    span = _span(config, int(table.t_ns[0]))
    loaded = (_precise if config.sp3 else _clas if config.clas else _broadcast)(config, table, span)
    if config.atmosphere is not None:
        loaded = with_atmosphere(loaded, read_atmosphere(config.atmosphere))
    return replace(loaded, notes=table.notes + loaded.notes), span


def _said(config: RunConfig) -> tuple[GnssEpochs, Span]:
    """Return a receiver's own fixes, or what the sources of a vehicle said, and the run's begin and end."""
    notes: list[str] = []
    epochs = vehicle.loaded(config.source, notes) if config.source else fixes_of(config, notes)
    if not epochs:
        raise InputError("no source said anything", hint="See the files of the [[source]] tables")
    start, end = span = _span(config, epochs[0].t_ns)
    inside = [e for e in epochs if (start is None or e.t_ns >= start) and (end is None or e.t_ns <= end)]
    if not inside:
        raise InputError("nothing lies between --start and --end", path=config.fixes)
    return GnssEpochs(tuple(inside), tuple(notes), None), span


def _broadcast(config: RunConfig, table: SignalTable, span: Span) -> GnssEpochs:
    precise = discover()[config.estimator].bands != "one"  # these have no model of the ionosphere
    found = gnss_epochs(
        table,
        read_navigation(config.nav),
        systems=config.systems,
        ionosphere_free=config.ionosphere_free or precise,
        start_ns=span[0],
        end_ns=span[1],
    )
    return replace(found, notes=(*BROADCAST_NOTES, *found.notes)) if precise else found


def _precise(config: RunConfig, table: SignalTable, span: Span) -> GnssEpochs:
    files = ProductFiles(
        config.sp3, config.clk, config.bias, config.antex, config.blq, config.erp, config.station, config.nav
    )
    apart = discover()[config.estimator].bands == "apart"
    return precise_log(table, files, config.systems, span, config.noise_model(), combined=not apart)


def _clas(config: RunConfig, table: SignalTable, span: Span) -> GnssEpochs:
    return clas_log(
        table, config.nav, config.clas, config.clas_grid, config.systems, span, config.noise_model()
    )


def _with_faults(epochs: Sequence[Epoch], faults: Sequence[Fault]) -> Sequence[Epoch]:
    """Return the epochs with the faults in them.

    Raises
    ------
    InputError
        Where a fault falls on nothing.
    """
    for fault in faults:
        if touches_any(fault, epochs):
            continue
        when = out_of_time(fault, epochs)
        if when:
            raise InputError(f"fault: {describe(fault)}: {when}", hint="Give START:END within these")
        keys = {k for e in epochs for o in e.observations for k in o.keys}
        measured = units_of(replace(fault, begin_ns=0, stop_ns=None, absolute=False), epochs)
        who = f"{fault.groups}.{fault.sensor}" if fault.sensor else fault.groups
        why = f": {who} measures {' and '.join(measured)}, not {fault.unit}" if measured else ""
        raise InputError(f"fault: {describe(fault)}: no such row{why}", hint=f"The log has {_named(keys)}")
    return apply_faults(epochs, faults) if faults else epochs


def _named(keys: Iterable[str]) -> str:
    """Return who measures something: groups, and the sensors of sources with the units of their faults."""
    sensors = sorted({f"{group_of(k)}.{sensor_of(k)}" for k in keys if sensor_of(k)})
    there = ", ".join(sorted({group_of(k) for k in keys}))
    rows = sorted(k for k in keys if not sensor_of(k) and not is_satellite(group_of(k)))
    there += f" (rows {', '.join(rows)})" if rows else ""
    if not sensors:
        return there
    units = "travel times take ms or s, lengths m, angles deg"
    return f"{there} ({', '.join(sensors)}); {units}"


def _span(config: RunConfig, first_ns: int) -> Span:
    return time_of(config.start, first_ns), time_of(config.end, first_ns)


def time_of(text: str | None, first_ns: int) -> int | None:
    """Return a time given as seconds from the first epoch or as GPS time in ISO form, ns of GPS time.

    Raises
    ------
    InputError
        Where it is neither.
    """
    if text is None:
        return None
    try:
        return first_ns + round(float(text) * 1e9)
    except ValueError:
        pass
    try:
        return from_iso(text)
    except ValueError as error:
        raise InputError(
            f"{text!r} is neither seconds from the start nor a time like 2019-01-14T06:20:00"
        ) from error


def run(config: RunConfig, progress: Progress = _silent) -> RunResult:
    """Run a configuration to its end, or to an interrupt: what was computed until then is kept.

    Parameters
    ----------
    config : RunConfig
    progress : callable
        Told the stage, how much is done and how much there is.
    """
    progress("reading", 0, 1)
    loaded = load_epochs(config)
    # small matrices: threads only get in each other's way
    with threadpool_limits(1, user_api="blas"), uncollected():
        outcomes, interrupted = _loop(pipeline_for(config, loaded), loaded.epochs, progress)
    return RunResult(outcomes, _facts(config, loaded, outcomes, interrupted))


def options_for(config: RunConfig, loaded: GnssEpochs, noise: NoiseModel | None = None) -> GnssOptions:
    """Return the estimator's options."""
    return GnssOptions(
        noise=noise or config.noise_model(), mask_rad=float(np.deg2rad(config.mask_deg)),
        klobuchar=loaded.klobuchar,
        doppler=config.doppler, motion=config.motion, max_gap_s=discover()[config.estimator].max_gap_s,
        ins=config.ins_options(config.variant) if config.imu is not None else InsOptions(),
        sources=vehicle.sources_of(config.source),
    )  # fmt: skip


def pipeline_for(config: RunConfig, loaded: GnssEpochs) -> Pipeline:
    """Return the pipeline of a configuration."""
    estimator = discover()[config.estimator](options_for(config, loaded))
    chosen: dict[str, Any] = {"exclude": config.exclude, "p_fa": config.p_fa}
    policy = Policy(**(chosen | dict(estimator.policy)))
    if policy.proof == "trial" and config.variant == "published":
        policy = replace(policy, proof="passes")
    return Pipeline(estimator, config.build_monitors(), policy)


def _loop(
    pipeline: Pipeline, epochs: Sequence[Epoch], progress: Progress
) -> tuple[tuple[Outcome, ...], bool]:
    outcomes: list[Outcome] = []
    try:
        with _interrupts() as interrupted:
            for i, epoch in enumerate(epochs):
                outcomes.append(pipeline.push(epoch))
                if i >= KEPT:
                    release(outcomes[i - KEPT])
                progress("monitoring", i + 1, len(epochs))
                if interrupted():
                    return tuple(outcomes), True
    except KeyboardInterrupt:
        return tuple(outcomes), True
    return tuple(outcomes), False


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether an interrupt was asked for: the epoch that is computed then is finished, since
    compiled functions turn an exception into another error. A second interrupt is one at once.
    """
    asked: list[int] = []
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(usual):
        yield lambda: False
        return

    def ask(number: int, frame: object) -> None:
        asked.append(number)
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, ask)
    try:
        yield lambda: bool(asked)
    finally:
        signal.signal(signal.SIGINT, usual)


def release(outcome: Outcome) -> None:
    """Let go of what an outcome's updates can compute again."""
    for update in outcome.updates:
        update.release()


def _protection(config: RunConfig, monitors: Sequence[Any]) -> dict[str, Any]:
    """Return what the protection levels assume, and how they are made; empty where there are none."""
    made = next((m for m in monitors if m.name == "separation"), None)
    return {} if made is None else config.ism_model().to_table() | {"levels": made.levels}


def _facts(config: RunConfig, loaded: GnssEpochs, outcomes: Sequence[Outcome], interrupted: bool) -> RunFacts:
    noise, monitors = config.noise_model(), config.build_monitors()
    return RunFacts(
        estimator=config.estimator,
        config=config.model_dump(mode="json"),
        noise_name="of its sources" if config.source else noise.name,
        blind_spots=blind_spots(
            config.estimator, noise, config.motion, monitors, options_for(config, loaded).ins
        ),
        products=loaded.products,
        protection=_protection(config, monitors),
        **_truth(config, [o.t_ns for o in outcomes]),
        notes=loaded.notes,
        faults=tuple(describe(parse_fault(f)) for f in config.faults),
        started=to_iso(loaded.epochs[0].t_ns) if loaded.epochs else "",
        sources=tuple(map(name_of, config.source)),
        interrupted=interrupted,
    )


def _truth(config: RunConfig, t_ns: list[int]) -> dict[str, Any]:
    """Return what is known of the truth at the epochs, by field of `RunFacts`."""
    if config.truth_ecef_m is not None:
        return {"truth_m": np.tile(np.array(config.truth_ecef_m), (len(t_ns), 1))}
    if config.truth is None:
        return {}
    truth, t = read_truth(config.truth), np.array(t_ns, dtype=np.int64)
    position, valid = truth.at(t)
    out = {"truth_m": np.where(valid[:, None], position, np.nan)}
    since, known_s = (t - truth.t_ns[0]) * 1e-9, (truth.t_ns - truth.t_ns[0]) * 1e-9
    angles = None if truth.attitude_rad is None else np.unwrap(truth.attitude_rad, axis=0)
    for name, rows in (("truth_velocity_mps", truth.velocity_mps), ("truth_attitude_rad", angles)):
        if rows is not None and len(t):
            there = np.stack([np.interp(since, known_s, column) for column in rows.T], axis=1)
            out[name] = np.where(valid[:, None], there, np.nan)
    return out
