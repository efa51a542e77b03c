"""Campaign on the sigmas of a vehicle's sources: fitted on a part of a log, judged on the rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.evaluate.calibrate_sources import Judged, SourceCalibration, calibrate_sources
from pntegrity.evaluate.source_sigmas import value_of, with_values
from pntegrity.records import Epoch
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._vehicle_logs import missing, monitors, vessel
from pntegrity.scenarios._vessel_logs import estimator
from pntegrity.scenarios.vessel import simulated_vessel
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = ["CAMPAIGN", "simulated_ship", "vessel_noise"]

CAMPAIGN = "vessel-noise"
SIMULATED = "simulated ship"
#: The simulated ship: length s, epochs and increments a second, seed.
SHIP = (250.0, 1.0, 20.0, 2)
#: What it is given, in units of its true sigmas, and faults in the part that is fitted to.
WRONG = {
    "gnss.sigma_m": 3.0, "lbl.sigma_s": 0.3, "usbl.sigma_s": 4.0, "usbl.sigma_angle_deg": 0.3,
    "depth.sigma_m": 0.33,
}  # fmt: skip
FAULTS = ("lbl.AP1 ramp 0.8 ms/s 50:70", "usbl.bearing bias 6 deg 80:95")
#: Spans of the real logs, s after their first epoch: half is fitted to. Beside them where a receiver drifts.
SPANS = {"NCL1": (18000, 19500), "SAGA": (7000, 9200)}
ELSEWHERE = {"NCL1": (27600, 28020), "SAGA": (2000, 2420)}
DRIFT, WAYS, ONSET_S = "ramp 0.05 m/s", ("north", "up"), 300.0


def vessel_noise(data: Path) -> list[Row]:
    """Return what the calibration finds of a ship whose sigmas are known, and of two real vessels."""
    lost = missing(data)
    if lost:
        return skipped(CAMPAIGN, lost)
    epochs, truth = simulated_ship()
    given = replace(truth, sources=with_values(truth.sources, _wrong(truth)))
    log = apply_faults(epochs, [parse_fault(f) for f in FAULTS])
    found = calibrate_sources(log, given, monitors())
    rows = [*_true(found, truth), *_rows(SIMULATED, found)]
    for name, span in SPANS.items():
        one = vessel(name, data, span)
        found = calibrate_sources(one.epochs, one.options, monitors())
        rows += [*_rows(name, found), *_drifts(name, data, found)]
    return rows


def simulated_ship() -> tuple[Sequence[Epoch], GnssOptions]:
    """Return the epochs of the simulated ship, and the options of its filter with the true sigmas."""
    made = simulated_vessel(*SHIP)
    return made.log.epochs, estimator(made.log, made.ship.spec).options


def _wrong(truth: GnssOptions) -> Mapping[str, float]:
    return {n: f * value_of(truth.sources, n) for n, f in WRONG.items()}


def _true(found: SourceCalibration, truth: GnssOptions) -> Iterator[Row]:
    """Yield how far what is fitted is from the truth."""
    off = {}
    for s in found.sigmas:
        name = f"{s.source}.{s.field}"
        off[name] = abs(s.fitted / value_of(truth.sources, name) - 1.0)
    worst = max(off, key=lambda n: off[n])
    told = ", ".join(f"{n} times {f:g}" for n, f in WRONG.items())
    note = f"of {worst}; given: {told}; in the part that is fitted to {', '.join(FAULTS)}"
    what = f"{SIMULATED}: largest difference of a fitted sigma from the true one, relative"
    yield row(CAMPAIGN, what, "at most 0.2", round(off[worst], 3), off[worst] <= 0.2, note=note)


def _rows(what: str, found: SourceCalibration) -> Iterator[Row]:
    """Yield what was found, and how it does on the rest."""
    fitted = [s for s in found.sigmas if not s.reason]
    told = "; ".join(
        f"{s.source}.{s.field} {s.given:.3g} to {s.fitted:.3g}"
        + (f" (likelihood {s.likely:.3g}, errors that last times {s.lasting:.2f})" if s.lasting > 1.0 else "")
        for s in fitted
    )
    left = ", ".join(f"{n} {k}" for n, k in found.left_out.items())
    note = f"fitted on {found.training} epochs" + (f"; left out of them, epochs: {left}" if left else "")
    yield row(CAMPAIGN, f"{what}: sigmas, given and fitted", "stated", told, note=note)
    ratios = [(s.ratio_given, s.ratio_fitted) for s in fitted]
    names = ", ".join(f"{s.source}.{s.field}" for s in fitted)
    for which, column in (("given", 0), ("fitted", 1)):
        yield row(CAMPAIGN, f"{what}: errors on the rest in units of the sigmas, {which}", "stated",
                  [round(float(r[column]), 2) for r in ratios], note=f"1: right; of {names}")  # fmt: skip
    for which, judged in (("given", found.given), ("fitted", found.fitted)):
        alarms, out = _counts(judged)
        must = "0, 0" if which == "fitted" else "stated"
        yield row(CAMPAIGN, f"{what}: alarms and epochs with somebody left out on the rest, {which} sigmas",
                  must, f"{alarms}, {out}", not alarms + out if which == "fitted" else None,
                  note=f"of {found.validation} epochs; {_squares(judged)}")  # fmt: skip


def _drifts(name: str, data: Path, found: SourceCalibration) -> Iterator[Row]:
    """Yield how soon a drift of the receiver is found at another time, and what comes without it."""
    given = vessel(name, data, ELSEWHERE[name])
    values = {f"{s.source}.{s.field}": s.fitted for s in found.sigmas}
    fitted = replace(given, sources=with_values(given.sources, values))
    for way in WAYS:
        fault = f"gnss:{way} {DRIFT} {ONSET_S:g}:"
        rides = [one.ride([fault]) for one in (given, fitted)]
        first = [next(((s - ONSET_S, n) for s, n in r.left), None) for r in rides]
        early = [int(r.first_alarms[r.since_s < ONSET_S].sum()) for r in rides]
        told = [f"{f[1]} after {f[0]:.0f} s" if f else "nobody" for f in first]
        ok = not early[1] and first[1] is not None and first[1][0] >= 0.0 and first[1][1] == "gnss"
        yield row(
            CAMPAIGN, f"{name}: GNSS drift of 0.05 m/s ({way}) at another time: who is left out first, given "
            "and fitted sigmas", "gnss, no alarm before (fitted)", "; ".join(told), ok,
            note=f"alarms in the {ONSET_S:g} s before: {early[0]}, {early[1]}",
        )  # fmt: skip


def _counts(judged: Judged) -> tuple[int, int]:
    return sum(judged.alarms.values()), max(judged.left_out.values(), default=0)


def _squares(judged: Judged) -> str:
    squares = {n: w["mean_square"] for n, w in judged.whiteness.items() if w["mean_square"] is not None}
    return "mean squares of normalised innovations: " + ", ".join(
        f"{n} {np.round(v, 2)}" for n, v in squares.items()
    )
