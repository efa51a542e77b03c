"""Campaigns on the real static BRUX log: positions and alarms without a fault, and how soon single faults are
found.

The log has 900 epochs at 1 Hz of GPS, GLONASS, Galileo and BDS. The noise model is fitted to its first half;
all that is counted comes from the second, by a filter that ran from the beginning.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import special

from pntegrity.estimators.spp import Spp
from pntegrity.evaluate.calibrate import updates_of, white_model
from pntegrity.evaluate.campaign import Trial, faulted, trials
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.evaluate.whiteness import whiteness
from pntegrity.kernels.linear import whiten
from pntegrity.kernels.signatures import is_rate
from pntegrity.protocols import Monitor
from pntegrity.records import FloatArray, State, Update, group_of
from pntegrity.scenarios._real_logs import BRUX, Log, Row, Site, monitors, rms, row, skipped
from pntegrity.sensors.noise import NoiseModel

__all__ = ["clean", "delays", "site_of"]

FAULTS = (("ramp", 0.1), ("ramp", 0.5), ("bias", 5.0), ("bias", 15.0))
#: Largest median delay, s, of the GLR for `FAULTS`: with the calibrated model, with the defaults.
TARGETS = {"calibrated": (10.0, 3.0, 0.0, 0.0), "default": (20.0, 3.0, 0.0, 0.0)}
#: Epochs after an onset that are looked at.
LONGEST = 90
ONSETS = (480, 580, 680, 780)
P_FA = 1e-6


@lru_cache(maxsize=4)
def site_of(data: Path, log: Log = BRUX) -> Site:
    """Return a log in memory; kept, so that campaigns after each other read and calibrate once."""
    return Site(log, data)


# --- without a fault
# ---------------------------------------------------------------------------------------------


def clean(data: Path) -> list[Row]:
    """Return the figures without a fault: position, alarms on the second half, whiteness of the innovations.

    Parameters
    ----------
    data : Path
        Folder that holds the folder of the log.
    """
    missing = BRUX.missing(data)
    if missing:
        return skipped("clean", missing)
    site = site_of(data)
    runs = {name: updates_of(site.epochs, site.options(m), ()) for name, m in site.models().items()}
    rows = _positions(site, runs)
    for p_fa in (P_FA, 1e-3):
        for name, noise in site.models().items():
            rows += _alarm_rows(site, name, runs[name], noise, p_fa)
    white = white_model(site.epochs[: site.half], site.options(), site.noise)
    runs["white"] = updates_of(site.epochs, site.options(white), ())
    note = f"code sigma {white.code_white_m:.2f} m at the zenith, fitted to the same first half"
    for name in ("calibrated", "default", "white"):
        rows += _whiteness_rows(name, runs[name][site.half :], note if name == "white" else "")
    return rows


def _positions(site: Site, runs: dict[str, list[Update]]) -> list[Row]:
    out = []
    for name, noise in site.models().items():
        for estimator in ("spp", "spp_kf"):
            run = runs[name] if estimator == "spp_kf" else snapshots(site, noise)
            error = rms(site.horizontal_m([u.posterior.mean[:3] for u in run]))
            quantity = f"horizontal RMS of {estimator}, {name} noise model, {len(run)} epochs, m"
            out.append(row("clean", quantity, "at most 1.0", error, error <= 1.0))
    return out


def snapshots(site: Site, noise: NoiseModel) -> list[Update]:
    """Return the updates of the snapshot estimator."""
    estimator, state, out = Spp(site.options(noise)), State.empty(), []
    for epoch in site.epochs:
        out.append(estimator.correct(estimator.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out


def _alarm_rows(
    site: Site, name: str, updates: Sequence[Update], noise: NoiseModel, p_fa: float
) -> list[Row]:
    out = []
    strict = p_fa == P_FA and name == "calibrated"
    for m in monitors(p_fa, noise):
        ratio = ratios(m, updates)[site.half :]
        tested, alarms = int(np.isfinite(ratio).sum()), int((ratio > 1.0).sum())
        quantity = f"alarms of exact {m.name} on the second half at p_fa {p_fa:g}, {name} noise model"
        note = f"of {tested} epochs; largest statistic {np.nanmax(ratio):.2f} of the threshold"
        factor = noise.factor(m.name)
        if factor > 1.0:
            note += f", which the calibration raised by {factor:.2f}"
        interval = binomial_interval(alarms, tested)
        out.append(
            row(
                "clean",
                quantity,
                "0" if strict else "stated",
                alarms,
                alarms == 0 if strict else None,
                interval=interval,
                note=note,
            )
        )
    return out


def ratios(monitor: Monitor, updates: Iterable[Update]) -> FloatArray:
    """Return statistic over threshold of a monitor at every update; nan where it could not test."""
    memory, out = monitor.start(), []
    for u in updates:
        verdict, memory = monitor.step(memory, u)
        out.append(np.nan if verdict.status == "unavailable" else verdict.statistic / verdict.threshold)
    return np.array(out)


def _whiteness_rows(name: str, updates: Sequence[Update], note: str) -> list[Row]:
    found = whiteness(updates)
    strict = name == "calibrated"
    out = []
    for lag, value in zip(found["lags_s"], found["code"]["autocorrelation"], strict=True):
        quantity = f"autocorrelation of the code innovations at {lag:g} s, {name} noise model"
        must = "below 0.1 in size" if strict else "stated"
        out.append(row("clean", quantity, must, value, abs(value) < 0.1 if strict else None, note=note))
    return out


# --- how soon single faults are found
# ---------------------------------------------------------------------------------


def delays(
    data: Path, faults: Sequence[tuple[str, float]] = FAULTS, onsets: Sequence[int] = ONSETS
) -> list[Row]:
    """Return how late each monitor sees faults on one code, all satellites in turn, and what could be done at
    best.

    Parameters
    ----------
    data : Path
    faults : sequence of (kind, size)
        m, or m/s from the onset on.
    onsets : sequence of int
        Epochs at which the faults begin.
    """
    missing = BRUX.missing(data)
    if missing:
        return skipped("delays", missing)
    site = site_of(data)
    rows = []
    for name, noise in site.models().items():
        updates = updates_of(site.epochs, site.options(noise), ())
        found = [
            trial
            for m in monitors(P_FA, noise, ("glr", "rctm", "aime", "sraime"))
            for trial in trials(updates, m, onsets, faults, LONGEST)
        ]
        for i, (kind, size) in enumerate(faults):
            rows += _delay_rows(
                name, [t for t in found if (t.kind, t.size) == (kind, size)], _target(name, i, faults)
            )
            rows.append(_bound_row(name, updates, onsets, kind, size))
    return rows


def _target(name: str, i: int, faults: Sequence[tuple[str, float]]) -> float:
    return TARGETS[name][FAULTS.index(faults[i])] if faults[i] in FAULTS else float("inf")


def _words(kind: str, size: float) -> str:
    return f"{kind} {size:g} {'m/s' if kind == 'ramp' else 'm'}"


def _delay_rows(name: str, found: Sequence[Trial], target: float) -> list[Row]:
    out = []
    for monitor in dict.fromkeys(t.monitor for t in found):
        own = [t for t in found if t.monitor == monitor]
        seen = [t for t in own if t.delay_s is not None]
        late = np.array([float("inf") if t.delay_s is None else t.delay_s for t in own])
        middle, most = _quantile(late, 0.5), _quantile(late, 0.9)
        words = f"{_words(own[0].kind, own[0].size)}, {name} noise model"
        strict = monitor == "glr" and np.isfinite(target)
        note = (
            f"90 % within {_seconds(most)}; {len(own)} trials, {len(own) - len(seen)} not within {LONGEST} s"
        )
        out.append(
            row(
                "delays",
                f"median delay of {monitor}, {words}, s",
                f"at most {target:g}" if strict else "stated",
                _figure(middle),
                middle <= target if strict else None,
                note=note,
            )
        )
        right = sum(t.named for t in seen)
        share = right / len(seen) if seen else None
        named = f"{right} of {len(seen)}"
        out.append(
            row(
                "delays",
                f"right satellite named first by {monitor}, {words}",
                "at least 0.98" if strict else "stated",
                share,
                share is not None and share >= 0.98 if strict else None,
                interval=binomial_interval(right, len(seen)) if seen else None,
                note=named,
            )
        )
    return out


def _quantile(late: FloatArray, q: float) -> float:
    return float(np.quantile(late, q, method="inverted_cdf"))


def _figure(seconds: float) -> float | str:
    return seconds if np.isfinite(seconds) else f"more than {LONGEST}"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if np.isfinite(value) else f"more than {LONGEST} s"


def _bound_row(name: str, updates: Sequence[Update], onsets: Sequence[int], kind: str, size: float) -> Row:
    by_satellite: dict[str, list[float]] = {}
    for onset in onsets:
        span = updates[onset : onset + LONGEST]
        for key in span[0].keys:
            if not is_rate(key) and all(key in u.keys for u in span):
                by_satellite.setdefault(group_of(key), []).append(known_fault_delay(span, key, kind, size))
    every = np.array([d for ds in by_satellite.values() for d in ds])
    slow = sorted(by_satellite, key=lambda g: -float(np.median(by_satellite[g])))[:6]
    note = "slowest (median): " + ", ".join(
        f"{g} {_seconds(float(np.median(by_satellite[g])))}" for g in slow
    )
    quantity = f"median delay of the best possible test, {_words(kind, size)}, {name} noise model, s"
    return row(
        "delays",
        quantity,
        "stated",
        _figure(_quantile(every, 0.5)),
        note=f"90 % within {_seconds(_quantile(every, 0.9))}; {note}",
    )


def known_fault_delay(span: Sequence[Update], key: str, kind: str, size: float, p_fa: float = P_FA) -> float:
    """Return when a matched filter that knows the fault would alarm with probability one half, s.

    Satellite, course, size, sign and onset are known to it, so it need test nothing else: by the lemma of
    Neyman and Pearson no test of that `p_fa` is more powerful at that epoch under this noise model. inf: not
    within the span.
    """
    needed = float(special.ndtri(1.0 - p_fa)) ** 2
    seen = 0.0
    for u in faulted([u.altered(nu=np.zeros(len(u.keys))) for u in span], key, kind, size):
        g = whiten(u.L, u.nu)
        seen += float(g @ g)
        if seen >= needed:
            return (u.t_ns - span[0].t_ns) * 1e-9
    return float("inf")
