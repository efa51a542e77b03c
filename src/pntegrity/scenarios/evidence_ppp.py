"""Campaign on real precise logs: how well the filter knows the position, and whom its monitors alarm for
nothing.

Static logs are run as kinematic: the position is white noise. The noise model of the alarms is fitted to the
first half of each log, and judged on the second.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from pntegrity.estimators.ppp import Ppp
from pntegrity.evaluate.calibrate import calibrate
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.evaluate.whiteness import beside_others, whiteness
from pntegrity.physics.time import to_iso
from pntegrity.pipeline import uncollected
from pntegrity.records import FloatArray, Update
from pntegrity.scenarios._ppp_logs import (
    CARD,
    ESBC,
    OPEC,
    P_FA,
    PreciseLog,
    PreciseSite,
    opened,
    positions_of,
    precise_monitors,
)
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios.evidence_real import ratios
from pntegrity.sensors.noise import PPP, NoiseModel

__all__ = ["accuracy", "clean", "fitted", "speed"]

#: Largest standard deviation east, north, up, m, after an hour.
ESBC_MUST = {"GR": (0.015, 0.02, 0.03), "GRE": (0.01, 0.01, 0.03), "G": (0.03, 0.06, 0.05)}
OPEC_SYSTEMS = ("GC", "GE", "GR")
DRIVE_M = 3.0


def accuracy(data: Path) -> list[Row]:
    """Return positions of the static logs as kinematic, and of the drive."""
    rows = []
    for log, make in ((ESBC, _esbc), (OPEC, _opec), (CARD, _card)):
        missing = log.missing(data)
        rows += skipped("ppp", missing) if missing else make(data)
    return rows


def _esbc(data: Path) -> list[Row]:
    out = []
    for systems, must in ESBC_MUST.items():
        site = opened(ESBC, data, systems)
        std, mean = _spread(site)
        ok = bool(np.all(std <= np.array(must)))
        words = f"at most {_cm(must)}"
        out.append(
            row(
                "ppp", f"{site.label}: std E N U after 1 h, cm", words, _cm(std), ok, note=f"mean {_cm(mean)}"
            )
        )
    return out


def _opec(data: Path) -> list[Row]:
    out = []
    for systems in OPEC_SYSTEMS:
        site = opened(OPEC, data, systems)
        std, mean = _spread(site)
        worst = float(np.hypot(std, mean).max())
        quantity = f"{site.label}: std E N U after 1 h, cm"
        note = f"mean {_cm(mean)} against the PPP mean of the data's notes; clocks every 5 min"
        out.append(row("ppp", quantity, "RMS of a few dm or better", _cm(std), worst < 0.3, note=note))
    return out


def _spread(site: PreciseSite) -> tuple[FloatArray, FloatArray]:
    errors = site.errors_m(positions_of(site.updates()))[site.converged :]
    return np.nanstd(errors, axis=0), np.nanmean(errors, axis=0)


def _cm(values: Sequence[float] | FloatArray) -> str:
    return " / ".join(f"{100.0 * v:.1f}" for v in values)


def _card(data: Path) -> list[Row]:
    site = opened(CARD, data, "GREC")
    errors = site.errors_m(positions_of(site.updates()))
    known = np.asarray(np.isfinite(errors).all(axis=1))
    h, up = np.hypot(errors[known, 0], errors[known, 1]), errors[known, 2]
    size = float(np.sqrt(np.mean(h**2)))
    note = f"median {np.median(h):.2f}, largest {h.max():.1f} m; up {np.sqrt(np.mean(up**2)):.2f} m RMS"
    quantity = f"{site.label}: horizontal difference to the float PPK, RMS, m"
    must = f"at most {DRIVE_M:g}, the reference's own error"
    share = f"{int(known.sum())} of {len(known)}"
    return [
        row("ppp", quantity, must, round(size, 2), size <= DRIVE_M, note=note),
        row("ppp", f"{site.label}: epochs with a position", "stated", share),
    ]


# --- without a fault ----------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def fitted(log: PreciseLog, data: Path, systems: str) -> NoiseModel:
    """Return the noise model fitted to the first half of a log; kept."""
    site = opened(log, data, systems)
    return calibrate(site.epochs, site.options(), precise_monitors, estimator=Ppp).noise


def clean(data: Path) -> list[Row]:
    """Return the alarms on the second halves of the static logs, and whiteness."""
    rows = []
    for log, systems in ((ESBC, "GRE"), (ESBC, "GR"), (OPEC, "GE"), (OPEC, "GC")):
        missing = log.missing(data)
        rows += skipped("ppp-clean", missing) if missing else _clean(opened(log, data, systems), data)
    return rows


def _clean(site: PreciseSite, data: Path) -> list[Row]:
    out = []
    half = len(site.epochs) // 2
    for name, noise in (("calibrated", fitted(site.log, data, site.systems)), ("default", PPP)):
        updates = site.updates(noise)
        for monitor in precise_monitors(P_FA, noise):
            ratio = ratios(monitor, updates)[half:]
            worst = updates[half + int(np.nanargmax(ratio))]
            tested, alarms = int(np.isfinite(ratio).sum()), int((ratio > 1.0).sum())
            strict = name == "calibrated"
            note = f"of {tested} epochs; largest statistic {np.nanmax(ratio):.2f} of the threshold"
            factor = noise.factor(monitor.name)
            note += f", which the calibration raised by {factor:.2f}" if factor > 1.0 else ""
            note += f"; {_largest(worst)}" if alarms else ""
            quantity = f"{site.label}: alarms of exact {monitor.name} at p_fa {P_FA:g}, {name}"
            interval = binomial_interval(alarms, max(tested, 1))
            ok = alarms == 0 if strict else None
            must = "0" if strict else "stated"
            out.append(row("ppp-clean", quantity, must, alarms, ok, interval=interval, note=note))
        out += _whiteness(site, name, updates[half:])
    return out


def _largest(update: Update) -> str:
    """Say which row of an epoch stands out most."""
    each = np.abs(beside_others(update))
    i = int(each.argmax())
    return f"at {to_iso(update.t_ns)[11:19]} {update.keys[i]} is {each[i]:.0f} sigma off its neighbours"


def _whiteness(site: PreciseSite, name: str, updates: Sequence[Update]) -> list[Row]:
    found = whiteness(updates)
    out = []
    for kind in ("code", "carrier"):
        values = ", ".join(
            f"{v:.2f} at {lag:g} s"
            for lag, v in zip(found["lags_s"], found[kind]["autocorrelation"], strict=True)
            if v is not None
        )
        note = f"mean square {found[kind]['mean_square']:.2f}"
        quantity = f"{site.label}: autocorrelation of {kind} innovations, {name}"
        out.append(row("ppp-clean", quantity, "stated", values, note=note))
    return out


# --- speed --------------------------------------------------------------------------------------------------


def speed(data: Path) -> list[Row]:
    """Return the time of an epoch without monitors and with all, one thread."""
    missing = ESBC.missing(data)
    if missing:
        return skipped("ppp-speed", missing)
    site = opened(ESBC, data, "GRE")
    updates = site.updates()
    plain, watched = [], []
    for _ in range(5):
        with uncollected():  # as a run does
            start = time.perf_counter()
            updates = site.updates()
            plain.append((time.perf_counter() - start) / len(updates) * 1e3)
            start = time.perf_counter()
            for monitor in precise_monitors(P_FA, PPP):
                ratios(monitor, updates)
            watched.append(plain[-1] + (time.perf_counter() - start) / len(updates) * 1e3)
    size = f"{len(updates[len(updates) // 2].keys)} rows, {len(updates[len(updates) // 2].posterior)} states"
    values = ((min(plain), 1.0, "without monitors"), (min(watched), 5.0, "with all monitors"))
    return [
        row(
            "ppp-speed",
            f"{site.label}: time of an epoch {what}, ms",
            f"at most {must:g}",
            round(t, 2),
            t <= must,
            note=size,
        )
        for t, must, what in values
    ]
