"""Campaigns on CLAS: real corrections with their stated accuracy, and a satellite that runs away."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.records import Epoch, FloatArray
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._rtk_logs import (
    CLAS_NOISE,
    CLAS_TRUTH_M,
    Track,
    carried,
    clas,
    clas_missing,
    pipeline,
    run,
    tracked,
)
from pntegrity.scenarios._rtk_simulated import isms, updates_of
from pntegrity.sensors.noise import PPP_RTK, NoiseModel
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = ["ramps", "whole"]

MODELS = {"chosen": CLAS_NOISE, "default": PPP_RTK}
#: The noise model is chosen before this epoch (1 Hz), and judged after it.
JUDGED = 300
#: Times at which levels are quoted, s after the first position.
TIMES_S = (0, 60, 300, 840)
#: Decimetres: below this, m.
DECIMETRES_M = 1.0


def whole(data: Path) -> list[Row]:
    """Return errors and protection levels over the file, without a fault."""
    missing = clas_missing(data)
    if missing:
        return skipped("rtk-clas", missing)
    epochs, rows = clas(data), []
    for name, noise in MODELS.items():
        runs = {case: run(epochs, CLAS_TRUTH_M, noise, ism) for case, ism in isms("even").items()}
        rows += [*_errors(name, runs["case4"]), *_clean(name, runs)]
        rows += [_level(name, case, track) for case, track in runs.items()]
    return rows


def _errors(name: str, track: Track) -> list[Row]:
    begin = int(np.isfinite(track.error_m[:, 0]).argmax())
    sizes = ", ".join(f"{m} min {_words(_rms(track.error_m[begin + 60 * m :]))}" for m in (1, 5, 10))
    part = track.error_m[JUDGED:], track.sigma_m[JUDGED:]
    return [
        _row(f"{name}: rms error E N U, m, from this long after the first position", "stated", sizes,
             note=f"largest after 1 min {_words(np.nanmax(np.abs(track.error_m[begin + 60 :]), axis=0))}"),
        _row(f"{name}: rms of error over sigma E N U, from 300 s on", "stated",
             _words(_rms(part[0] / part[1])), note="one run with lasting errors: few independent values"),
    ]  # fmt: skip


def _clean(name: str, runs: dict[str, Track]) -> list[Row]:
    beyond = sum(t.beyond for t in runs.values())
    alarms, n = sum(int(t.alarm.sum()) for t in runs.values()), sum(map(len, runs.values()))
    left = sorted({g for t in runs.values() for g in t.suspects})
    return [
        _row(f"{name}: epochs with an error beyond its level, four cases", "0", f"{beyond} of {n}",
             beyond == 0),
        _row(f"{name}: alerts without a fault, four cases", "stated", f"{alarms} of {n}",
             note=f"left out: {', '.join(left)}" if left else ""),
    ]  # fmt: skip


def _level(name: str, case: str, track: Track) -> Row:
    begin = int(np.isfinite(track.level_m[:, 0]).argmax())
    at = [f"{s} s {track.hpl_m[begin + s]:.2f}/{track.level_m[begin + s, 2]:.2f}" for s in TIMES_S]
    small = (track.hpl_m < DECIMETRES_M) & (track.level_m[:, 2] < DECIMETRES_M)
    since = (
        f"both below 1 m from {int(small.argmax()) - begin} s on" if small.any() else "never both below 1 m"
    )
    return _row(f"{name}: HPL/VPL, {case}, m", "decimetres", ", ".join(at), bool(small[-1]), note=since)


def _row(quantity: str, must: str, measured: Any, ok: bool | None = None, note: str = "") -> Row:
    return row("rtk-clas", quantity, must, measured, ok, note=note)


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))


def _words(values: FloatArray) -> str:
    return " / ".join(f"{v:.3f}" for v in values)


# --- a satellite that runs away -----------------------------------------------------------------------------

#: Growth of code and carriers; when it begins, and how long it is looked at, epochs of 1 s.
RATE, ONSETS, LOOKED = "2 cm/s", {"chosen": (300, 600), "default": (300,)}, 120
#: Fault-induced vertical error by which an alarm must come, m.
INDUCED_M = 0.5


@dataclass(frozen=True, eq=False)
class Ramp:
    """What became of the ramp of one satellite; `moved_m` are distances from the run without it."""

    satellite: str
    track: Track
    moved_m: FloatArray

    @property
    def alarm(self) -> int:
        """Epochs until the alarm; all that were looked at where there is none."""
        return len(self.track) if self.track.first is None else self.track.first

    @property
    def before_m(self) -> float:
        """Largest vertical error that the fault induced before the alarm."""
        return float(np.abs(self.moved_m[: self.alarm, 2]).max(initial=0.0))

    @property
    def after_m(self) -> float:
        """Largest error in any direction that it induced from the alarm on."""
        return float(np.abs(self.moved_m[self.alarm :]).max(initial=0.0))

    @property
    def right(self) -> bool:
        """Whether the satellite and nobody else was left out."""
        return set(self.track.suspects) == {self.satellite}


def ramps(data: Path) -> list[Row]:
    """Return what becomes of a ramp on code and carriers of each satellite."""
    missing = clas_missing(data)
    if missing:
        return skipped("rtk-clas-ramp", missing)
    rows = []
    for name, noise in MODELS.items():
        found = [r for onset in ONSETS[name] for r in _each(clas(data), noise, onset)]
        rows += _ramp_rows(name, found)
    return rows


def _each(epochs: Sequence[Epoch], noise: NoiseModel, onset: int) -> Iterator[Ramp]:
    driver = pipeline(noise)
    for epoch in epochs[:onset]:
        driver.push(epoch)
    before, span = driver.checkpoint, epochs[onset : onset + LOOKED]
    clean = tracked(updates_of(epochs[: onset + LOOKED], noise), CLAS_TRUTH_M).error_m[onset:]
    known = {n[4:7] for n in before.state.layout.names if n.startswith("amb:")}
    for satellite in sorted(known.intersection(carried(span[:60]))):
        spoilt = apply_faults(span, [parse_fault(f"{satellite}:* ramp {RATE} 0:")])
        track = run(spoilt, CLAS_TRUTH_M, noise, pairs=True, checkpoint=before)
        yield Ramp(satellite, track, track.error_m - clean)


def _ramp_rows(name: str, found: Sequence[Ramp]) -> list[Row]:
    n, alarmed = len(found), [r for r in found if r.track.first is not None]
    delays = np.array([r.alarm for r in found])
    worst, late = max(found, key=lambda r: r.before_m), max(found, key=lambda r: r.after_m)
    over = [f"{r.satellite} {r.before_m:.2f}" for r in found if r.before_m >= INDUCED_M]
    right, beyond = sum(r.right for r in alarmed), sum(r.track.beyond for r in found)
    wrong = ", ".join(f"{r.satellite}: {'+'.join(r.track.suspects)}" for r in found if not r.right)
    again = sum(bool(r.track.readmitted) for r in found)
    return [
        _ramp(f"{name}: alarm before 0.5 m of induced vertical error", "all", f"{n - len(over)} of {n}",
              not over and len(alarmed) == n, f"largest {worst.before_m:.2f} m ({worst.satellite})"
              + (f"; not: {', '.join(over)}" if over else "")),
        _ramp(f"{name}: time to the alarm, s", "stated", {"median": float(np.median(delays)),
              "largest": float(delays.max())}, note=f"{len(alarmed)} of {n} alarm"),
        _ramp(f"{name}: right satellite out, and nobody else", "all", f"{right} of {n}", right == n, wrong),
        _ramp(f"{name}: induced error from the alarm on, any direction, m", "below 0.5",
              round(late.after_m, 2), late.after_m < INDUCED_M,
              f"largest of {late.satellite}; {again} came back while the error went on, and went again"),
        _ramp(f"{name}: epochs with an error beyond its level", "0", beyond, beyond == 0),
    ]  # fmt: skip


def _ramp(quantity: str, must: str, measured: Any, ok: bool | None = None, note: str = "") -> Row:
    return row("rtk-clas-ramp", quantity, must, measured, ok, note=note)
