"""Campaigns on OPEC as kinematic PPP-RTK: accuracy, protection levels, faults of satellites and products.

The products are made of the station's own data, 30 s late, so their own errors are those of the receiver; the
errors that the paper states are added to them, Gauss-Markov over 1800 s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.evaluate.stanford import stanford
from pntegrity.pipeline import Checkpoint
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.scenarios._ppp_logs import OPEC
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._rtk_logs import (
    OPEC_NOISE,
    OPEC_TRUTH_M,
    SEEDS,
    Track,
    carried,
    opec,
    pipeline,
    run,
    tracked,
)
from pntegrity.scenarios._rtk_simulated import isms, updates_of
from pntegrity.sensors.noise import PPP_RTK, NoiseModel
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = ["clean", "faults"]

#: Cold starts, epochs of 30 s: every 10 min of 00:00-02:00, and after.
TRAINING, AFTER = range(0, 160, 20), range(240, 420, 20)
#: A run lasts 50 min, and counts after 10.
LASTS, SETTLED = 101, 20
#: The last epoch has codes of C25 that are 78 m off.
SPOILT = 439
RATIO = (0.7, 1.3)
#: Seeds of the four cases: levels hardly depend on data.
FEW = SEEDS[:2]


def clean(data: Path) -> list[Row]:
    """Return accuracy, alarms and protection levels without a fault."""
    missing = OPEC.missing(data)
    if missing:
        return skipped("rtk-opec", missing)
    runs = [run(e, OPEC_TRUTH_M, OPEC_NOISE) for s in SEEDS for e in _starts(opec(data, s), AFTER)]
    return [*_accuracy(data, runs), *_integrity(runs), *_levels(data, runs), *_settings(data)]


def _starts(epochs: Sequence[Epoch], starts: Sequence[int]) -> Iterator[Sequence[Epoch]]:
    for first in starts:
        yield epochs[first : first + LASTS]


# --- accuracy -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Errors:
    """Root mean squares of errors east, north, up, m, and of errors over sigmas."""

    size_m: FloatArray
    ratio: FloatArray

    @staticmethod
    def of(runs: Sequence[Track], first: int = SETTLED, last: int = LASTS) -> Errors:
        """Return those of epochs from `first` to before `last` after the starts."""
        error = np.concatenate([r.error_m[first:last] for r in runs])
        sigma = np.concatenate([r.sigma_m[first:last] for r in runs])
        square = np.nanmean(error**2, axis=0), np.nanmean((error / sigma) ** 2, axis=0)
        return Errors(np.sqrt(square[0]), np.sqrt(square[1]))

    @property
    def horizontal_m(self) -> float:
        """Horizontal error."""
        return float(np.hypot(*self.size_m[:2]))

    @property
    def text(self) -> str:
        """Horizontal and vertical error, and the ratios."""
        ratio = " / ".join(f"{r:.2f}" for r in self.ratio)
        return f"H {self.horizontal_m:.3f} V {self.size_m[2]:.3f} m, rms/sigma E N U {ratio}"


def _filtered(data: Path, noise: NoiseModel, starts: Sequence[int], seeds: Sequence[int | None]) -> Errors:
    """Return the errors of the filter alone; the spoilt epoch is left out."""
    logs = [opec(data, s)[:SPOILT] for s in seeds]
    updates = [updates_of(e, noise) for log in logs for e in _starts(log, starts)]
    return Errors.of([tracked(u, OPEC_TRUTH_M) for u in updates])


def _accuracy(data: Path, runs: Sequence[Track]) -> list[Row]:
    found, own = Errors.of(runs), _filtered(data, OPEC_NOISE, AFTER, [None])
    ratio = found.ratio
    over_time = ", ".join(
        f"{k // 2} min {Errors.of(runs, k, k + 10).horizontal_m:.2f}" for k in (20, 40, 60, 90)
    )
    added = np.sqrt(np.maximum(found.size_m**2 - own.size_m**2, 0.0))
    part = f"of it from the added errors of products {np.hypot(*added[:2]):.3f}"
    return [
        _row("horizontal error from 10 min after a cold start, rms, m", "below 0.1 (paper)",
             round(found.horizontal_m, 3), found.horizontal_m < 0.1,
             note=f"{part}; by time after the start: {over_time}"),
        _row("vertical error, rms, m", "below 0.2 (paper)", round(float(found.size_m[2]), 3),
             bool(found.size_m[2] < 0.2), note=f"of it from the added errors {added[2]:.3f}"),
        _row("rms of error over sigma, E N U", "0.7 to 1.3", _words(ratio),
             bool(((ratio >= RATIO[0]) & (ratio <= RATIO[1])).all()),
             note=f"errors E N U {_words(found.size_m)} m"),
        _row("horizontal error without added errors of products, rms, m", "below 0.1",
             round(own.horizontal_m, 3), own.horizontal_m < 0.1, note=own.text),
    ]  # fmt: skip


def _row(quantity: str, must: str, measured: Any, ok: bool | None = None, note: str = "") -> Row:
    return row("rtk-opec", quantity, must, measured, ok, note=note)


def _words(values: FloatArray) -> str:
    return " / ".join(f"{v:.2f}" for v in values)


def _settings(data: Path) -> list[Row]:
    """Return what the chosen model and the default one gave on the training part, the default also after."""
    out = []
    for name, noise in (("chosen", OPEC_NOISE), ("default", PPP_RTK)):
        found = _filtered(data, noise, TRAINING, SEEDS)
        out.append(_row(f"{name} noise model on 00:00-02:00", "stated", found.text))
    after = _filtered(data, PPP_RTK, AFTER, SEEDS)
    return [*out, _row("default noise model after 02:00", "stated", after.text)]


# --- integrity ----------------------------------------------------------------------------------------------


def _integrity(runs: Sequence[Track]) -> list[Row]:
    ends = {(AFTER[i % len(AFTER)] + len(r) - 1, i): r for i, r in enumerate(runs)}
    last = [r for (end, _), r in ends.items() if end == SPOILT]
    alarms = sum(int(r.alarm.sum()) for r in runs) - sum(int(r.alarm[-1]) for r in last)
    epochs = sum(map(len, runs)) - len(last)
    named = sum(r.left_out.get(len(r) - 1) == ("C25",) for r in last)
    silent = [float(np.abs(r.error_m[-1, :2]).max()) for r in last if not r.alarm[-1]]
    beyond = sum(r.beyond for r in runs)
    boxes = [stanford(np.hypot(*r.error_m[:, :2].T), r.hpl_m, np.inf, r.alert) for r in runs]
    return [
        _row("alerts without a fault", "at most 1 % of epochs", f"{alarms} of {epochs}",
             alarms <= 0.01 * epochs),
        _row("true fault: codes of C25 78 m off at 03:39:30, left out", "stated", f"{named} of {len(last)}",
             note=f"{len(silent)} without an alert, errors up to {max(silent):.2f} m" if silent else ""),
        _row("epochs with an error beyond its level, E, N or U", "0", f"{beyond} of {epochs + len(last)}",
             beyond == 0),
        _row("horizontal Stanford count: within, beyond, alert", "stated",
             f"{sum(b.normal + b.unavailable for b in boxes)}, {sum(b.exceeded for b in boxes)}, "
             f"{sum(b.alerted for b in boxes)}"),
    ]  # fmt: skip


def _levels(data: Path, runs: Sequence[Track]) -> list[Row]:
    out = []
    for case, ism in isms("even").items():
        same = case == "case4"
        found = runs if same else [
            run(e, OPEC_TRUTH_M, OPEC_NOISE, ism) for s in FEW for e in _starts(opec(data, s), AFTER)
        ]  # fmt: skip
        at = {f"{k / 2:g} min": _median(found, k) for k in (0, 2, SETTLED, LASTS - 1)}
        out.append(_row(f"median HPL/VPL, {case}, m", "stated", ", ".join(f"{k} {v}" for k, v in at.items())))
    return out


def _median(runs: Sequence[Track], k: int) -> str:
    there = [r for r in runs if len(r) > k]
    levels = np.array([(r.hpl_m[k], r.level_m[k, 2]) for r in there])
    return "{:.2f}/{:.2f}".format(*np.median(levels, axis=0))


# --- faults -------------------------------------------------------------------------------------------------

#: Start, and onsets 10 and 30 min later.
START, ONSETS = 240, (260, 300)
FAULTS = (
    ("5 m on code and carriers, 3 epochs", "{s}:* bias 5 m 0:89"),
    ("5 m on code and carriers, 10 epochs", "{s}:* bias 5 m 0:299"),
    ("2 m on code and carriers, 3 epochs", "{s}:* bias 2 m 0:89"),
    ("1 m on code and carriers, 3 epochs", "{s}:* bias 1 m 0:89"),
    ("0.5 m on code and carriers, 3 epochs", "{s}:* bias 0.5 m 0:89"),
    ("0.2 m on code and carriers, 3 epochs", "{s}:* bias 0.2 m 0:89"),
    ("0.5 m on the carriers, for good", "{s}:L bias 0.5 m 0:"),
    ("one cycle of the first carrier, for good", "{s}:L1 bias 0.19 m 0:"),
)
#: Epochs that are looked at after the onset: to the end of the longest fault; longer for a return.
LOOKED, RETURNS = 12, 30
FAULT_SEEDS = SEEDS[:2]


@dataclass(frozen=True, eq=False)
class Found:
    """What became of the faults of one kind, each satellite in turn."""

    satellite: str
    track: Track
    moved_m: float

    @property
    def at_once(self) -> bool:
        """Whether the first faulty epoch has an alert."""
        return self.track.first == 0

    @property
    def right(self) -> bool:
        """Whether the satellite and nobody else was left out."""
        return set(self.track.suspects) == {self.satellite}


def faults(data: Path) -> list[Row]:
    """Return what becomes of faults of satellites, each in turn, and of products."""
    missing = OPEC.missing(data)
    if missing:
        return skipped("rtk-opec-faults", missing)
    starts = [_Start.at(data, seed, onset) for seed in FAULT_SEEDS for onset in ONSETS]
    rows = []
    for name, text in FAULTS:
        found = [f for s in starts[: len(starts) if "5 m" in name else 2] for f in s.each(text)]
        rows += _fault_rows(name, found, strict=name.startswith("5 m"))
    return [*rows, *_product_rows(starts), _returned(starts[0])]


@dataclass(frozen=True, eq=False)
class _Start:
    """A run up to an onset, and what comes after."""

    checkpoint: Checkpoint
    span: tuple[Epoch, ...]
    clean: Track

    @staticmethod
    def at(data: Path, seed: int, onset: int) -> _Start:
        epochs = opec(data, seed)
        driver = pipeline(OPEC_NOISE)
        for epoch in epochs[START:onset]:
            driver.push(epoch)
        span = epochs[onset : onset + RETURNS]
        return _Start(
            driver.checkpoint, span, run(span, OPEC_TRUTH_M, OPEC_NOISE, checkpoint=driver.checkpoint)
        )

    def each(self, text: str) -> Iterator[Found]:
        """Yield what becomes of a fault of each satellite."""
        known = {n[4:7] for n in self.checkpoint.state.layout.names if n.startswith("amb:")}
        for satellite in sorted(known.intersection(carried(self.span[:3]))):
            fault = parse_fault(text.format(s=satellite))
            yield self.through(apply_faults(self.span[:LOOKED], [fault]), satellite)

    def through(self, span: Sequence[Epoch], name: str) -> Found:
        """Return what becomes of the epochs after the onset with a fault in them."""
        track = run(span, OPEC_TRUTH_M, OPEC_NOISE, pairs=True, checkpoint=self.checkpoint)
        moved = float(np.linalg.norm(track.error_m - self.clean.error_m[: len(span)], axis=1).max())
        return Found(name, track, moved)


def _fault_rows(name: str, found: Sequence[Found], strict: bool) -> list[Row]:
    n, alarmed = len(found), [f for f in found if f.track.first is not None]
    at_once, right = sum(f.at_once for f in found), sum(f.right for f in alarmed)
    beyond = sum(f.track.beyond for f in found)
    wrong = ", ".join(f"{f.satellite}: {'+'.join(f.track.suspects)}" for f in alarmed if not f.right)
    moved = max(f.moved_m for f in found)
    return [
        _fault(f"{name}: alarm at the first faulty epoch", "all" if strict else "stated", f"{at_once} of {n}",
               at_once == n if strict else None, f"{len(alarmed)} at any"),
        _fault(f"{name}: right satellite, of those with an alarm", "at least 99 %",
               f"{right} of {len(alarmed)}", right >= 0.99 * len(alarmed), wrong),
        _fault(f"{name}: epochs with an error beyond its level", "0", beyond, beyond == 0,
               f"largest distance from the run without the fault {moved:.2f} m"),
    ]  # fmt: skip


def _fault(quantity: str, must: str, measured: Any, ok: bool | None = None, note: str = "") -> Row:
    return row("rtk-opec-faults", quantity, must, measured, ok, note=note)


def _product_rows(starts: Sequence[_Start]) -> list[Row]:
    kinds = {
        "zenith product + 0.5 m": ("trop", lambda y: y + 0.5),
        "zenith product + 1 m": ("trop", lambda y: y + 1.0),
        "all slant products x 1.5": ("iono", lambda y: 1.5 * y),
        "all slant products x 3": ("iono", lambda y: 3.0 * y),
    }
    out = []
    for name, (group, change) in kinds.items():
        found = [s.through(_spoilt(s.span[:LOOKED], group, change), group) for s in starts]
        alarmed = [f for f in found if f.track.first is not None]
        beyond, moved = sum(f.track.beyond for f in found), max(f.moved_m for f in found)
        left = sorted({"+".join(f.track.suspects) or "none" for f in alarmed})
        note = f"{len(alarmed)} of {len(found)} alarm; left out: {', '.join(left) or 'none'}"
        note += f"; largest distance from the run without the fault {moved:.2f} m"
        quantity = f"{name}, for good: epochs with an error beyond its level"
        out.append(_fault(quantity, "0", beyond, beyond == 0, note))
    return out


def _spoilt(epochs: Sequence[Epoch], group: str, change: Callable[[FloatArray], FloatArray]) -> list[Epoch]:
    """Return epochs whose products of one group are changed."""

    def of(o: Observation) -> Observation:
        hit = np.array([k.startswith(f"{group}:") for k in o.keys], dtype=bool)
        return replace(o, y=np.where(hit, change(o.y), o.y)) if o.sensor == "atmosphere" else o

    return [replace(e, observations=tuple(map(of, e.observations))) for e in epochs]


def _returned(start: _Start) -> Row:
    """Return how many satellites are back within 15 min of a fault of 3 epochs."""
    fault = "{s}:* bias 5 m 0:89"
    names = [f.satellite for f in start.each(fault)]
    spoilt = ((s, apply_faults(start.span, [parse_fault(fault.format(s=s))])) for s in names)
    found = [start.through(span, s) for s, span in spoilt]
    back = sum(any(f.satellite in g for g in f.track.readmitted.values()) for f in found)
    away = ", ".join(f.satellite for f in found if f.satellite not in sum(f.track.readmitted.values(), ()))
    quantity = "5 m, 3 epochs: back within 15 min of the onset"
    return _fault(quantity, "stated", f"{back} of {len(found)}", note=away and f"not: {away}")
