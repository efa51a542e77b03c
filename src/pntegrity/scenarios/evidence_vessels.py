"""Campaign on real vessels as vehicles: GNSS, ranges to beacons and a simulated unit, with faults."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._vehicle_logs import Ride, Vessel, missing, vessel, vessels
from pntegrity.states import source_of

__all__ = ["CAMPAIGN", "Case", "cases", "evidence"]

CAMPAIGN = "vessels"
#: Travel times there and back become ranges one way with this, m/s.
REFERENCE_MPS = 1490.0
#: Of each span this much is used with faults, s; onset and end of a fault.
LENGTH_S, ONSET_S, END_S = 1500.0, 300.0, 600.0
BIAS, DRIFT = "bias 5 ms", "ramp 0.05 m/s"
#: How a receiver drifts, in turn.
TOWARDS = ("north", "east", "up", "south", "west", "down")
SIDES = tuple(way for way in TOWARDS if way not in ("up", "down"))
#: How long a drift at another time is looked at, s.
SHORT_S = 120.0
#: Settling of the filter, which no figure counts, s.
SETTLED_S = 100.0


@dataclass(frozen=True, eq=False)
class Case:
    """A run with one fault.

    Parameters
    ----------
    name : str
        Who is at fault: ``"gnss"``, ``"lbl.T1"``.
    ride : Ride
    unguarded : Ride
        The filter alone, with the same fault.
    """

    name: str
    ride: Ride
    unguarded: Ride

    @property
    def source(self) -> str:
        """The source at fault."""
        return source_of(self.name)

    @property
    def first(self) -> tuple[float, str] | None:
        """When somebody was first left out, and who."""
        return next(((s, n) for s, n in self.ride.left if s >= ONSET_S), None)

    @property
    def delay_s(self) -> float | None:
        """From the onset until the source at fault, or a part of it, is left out; None: never."""
        found = (s for s, n in self.ride.left if source_of(n) == self.source and s >= ONSET_S)
        return next((s - ONSET_S for s in found if s < END_S), None)

    @property
    def alert_s(self) -> float | None:
        """From the onset until a monitor alarms."""
        at = self.ride.since_s[self.ride.first_alarms & (self.ride.since_s >= ONSET_S)]
        return float(at[0]) - ONSET_S if len(at) else None

    @property
    def named(self) -> bool:
        """Whether what is left out first is what is at fault, by its own name."""
        return self.first is not None and self.first[1] == self.name

    @cached_property
    def healthy_out(self) -> bool:
        """Whether a healthy source, or a sensor of one, was ever left out."""
        return any(source_of(n) != self.source for _, n in self.ride.left)

    @cached_property
    def early(self) -> bool:
        """Whether it came back while the fault was there."""
        return any(source_of(n) == self.source and ONSET_S < s < END_S for s, n in self.ride.back)

    @property
    def back_s(self) -> float | None:
        """From the end of the fault until it came back for good."""
        after = [s for s, n in self.ride.back if source_of(n) == self.source and s >= END_S]
        return after[-1] - END_S if after and self._is_whole else None

    @property
    def _is_whole(self) -> bool:
        return not self.ride.outcomes[-1].update.excluded

    def worst_m(self, ride: Ride) -> float:
        """Return the largest error of the position from the onset on."""
        size = np.linalg.norm(ride.errors_m, axis=1)
        return float(np.nanmax(size[ride.since_s >= ONSET_S]))


def evidence(data: Path) -> list[Row]:
    """Return what comes of both real vessels, without and with faults."""
    lost = missing(data)
    if lost:
        return skipped(CAMPAIGN, lost)
    with threadpool_limits(1, user_api="blas"):
        return [
            r
            for name in vessels()
            for r in (*_clean(name, data), *_faulty(name, data), *_elsewhere(name, data))
        ]


def _clean(name: str, data: Path) -> list[Row]:
    spans = vessels()[name]["spans"]
    rides = [vessel(name, data, span).ride() for span in spans]
    epochs = sum(len(r.outcomes) for r in rides)
    rms = (
        np.sqrt(np.mean(np.concatenate([r.innovations("lbl")[0] for r in rides]) ** 2)) * REFERENCE_MPS / 2.0
    )
    alarms = sum(int(r.first_alarms.sum()) for r in rides)
    outs = sum(len(r.left) for r in rides)
    worst = max(float(np.nanmax(np.linalg.norm(r.errors_m[r.since_s > SETTLED_S], axis=1))) for r in rides)
    nis = "; ".join(f"{s} {np.mean([r.nis(s) for r in rides]):.2f}" for s in ("gnss", "lbl"))
    span = sum(b - a for a, b in spans)
    cpu = sum(r.cpu_s for r in rides)
    return [
        row(CAMPAIGN, f"{name}: innovations of ranges in the filter, RMS, m one way", "about 0.2",
            round(float(rms), 3), bool(rms <= 0.25), note=f"{epochs} epochs; mean squares of normalised "
            f"innovations: {nis}; correlated errors of the sound speed are inside the stated 0.15 m"),
        row(CAMPAIGN, f"{name}: alarms and exclusions without a fault", "0", f"{alarms}, {outs}", alarms == 0,
            interval=binomial_interval(alarms, epochs), note=f"{span} s"),
        row(CAMPAIGN, f"{name}: largest error of the position without a fault, m", "stated", round(worst, 2),
            note="against the track that the unit was simulated on, which is that of the receiver, smoothed"),
        row(CAMPAIGN, f"{name}: speed, times real time", "at least 20", round(span / cpu), span / cpu >= 20.0,
            note="all monitors, 100 Hz, one core"),
    ]  # fmt: skip


def _faulty(name: str, data: Path) -> list[Row]:
    ready = [vessel(name, data, (a, min(a + LENGTH_S, b))) for a, b in vessels()[name]["spans"]]
    found = cases(ready)
    biases, drifts = ([c for c in found if (c.source == "lbl") == is_lbl] for is_lbl in (True, False))
    level = [c for c in drifts if _way(c) in SIDES]
    upright = [c for c in drifts if c not in level]
    return [
        *_rows(name, f"{BIAS} of each beacon", biases),
        *_rows(name, "GNSS drift of 0.05 m/s up or down", upright),
        *_rows(name, "GNSS drift of 0.05 m/s to a side", level),
    ]


def _elsewhere(name: str, data: Path) -> list[Row]:
    """Return who is left out first where a receiver drifts to a side, at other times than those looked at."""
    begins = vessels()[name]["others"]
    ready = [vessel(name, data, (a, a + ONSET_S + SHORT_S)) for a in begins]
    first = [
        next((n for _, n in one.ride([f"gnss:{way} {DRIFT} {ONSET_S:g}:"]).left), "nobody")
        for one in ready
        for way in SIDES
    ]
    n, right, nobody = len(first), first.count("gnss"), first.count("nobody")
    wrong = n - right - nobody
    return [
        row(CAMPAIGN, f"{name}: GNSS drift to a side at other times: runs with a healthy source left out",
            "at most 2 %", f"{wrong} of {n}", wrong <= 0.02 * n, interval=binomial_interval(wrong, n),
            note=f"GNSS {right}, nobody {nobody} within {SHORT_S:g} s; onsets {ONSET_S:g} s after "
            f"{', '.join(f'{a:g}' for a in begins)} s, four directions; errors of real ranges last, "
            "the filter has them white"),
    ]  # fmt: skip


def _way(case: Case) -> str:
    return case.ride.faults[0].partition(":")[2].split()[0]


def cases(ready: Sequence[Vessel]) -> list[Case]:
    """Return runs with a bias of each beacon, and with drifts of the receiver in turn.

    Parameters
    ----------
    ready : sequence of Vessel
        Spans; each beacon has its bias in each, and each span every so many of the directions.
    """
    out = []
    for i, one in enumerate(ready):
        faults = [(f"lbl.{b}", f"lbl.{b} {BIAS}") for b in one.beacons]
        faults += [("gnss", f"gnss:{way} {DRIFT}") for way in TOWARDS[i :: len(ready)]]
        for name, fault in faults:
            texts = [f"{fault} {ONSET_S:g}:{END_S:g}"]
            out.append(Case(name, one.ride(texts), one.ride(texts, monitored=False)))
    return out


def _rows(name: str, what: str, found: Sequence[Case]) -> list[Row]:
    n, head = len(found), f"{name}: {what}"
    right = sum(c.named for c in found)
    healthy = sum(c.healthy_out for c in found)
    early = sum(c.early for c in found)
    back = [c.back_s for c in found]
    told = "; ".join(f"{c.ride.faults[0].rpartition(' ')[0]}: {_story(c)}" for c in found)
    return [
        row(CAMPAIGN, f"{head}: who is at fault is left out first, by name", "all",
            f"{right} of {n}", right == n,
            interval=binomial_interval(right, n), note=told),
        row(CAMPAIGN, f"{head}: delay until it is left out, s", "stated", _spread(c.delay_s for c in found),
            note=f"first alarm after {_spread(c.alert_s for c in found)} s"),
        row(CAMPAIGN, f"{head}: runs in which a healthy source is left out", "0",
            f"{healthy} of {n}", healthy == 0,
            interval=binomial_interval(healthy, n)),
        row(CAMPAIGN, f"{head}: back while the fault lasts", "0", f"{early} of {n}", early == 0),
        row(CAMPAIGN, f"{head}: back after the fault's end, s", "all within the run", _spread(back),
            None not in back, note=f"{sum(b is not None for b in back)} of {n}; "
            f"{LENGTH_S - END_S:g} s were left"),
        row(CAMPAIGN, f"{head}: largest error with exclusions, and of the filter alone, m", "stated",
            f"{_spread(c.worst_m(c.ride) for c in found)}; {_spread(c.worst_m(c.unguarded) for c in found)}"),
    ]  # fmt: skip


def _story(case: Case) -> str:
    left = ", ".join(f"{n} at {s - ONSET_S:.0f} s" for s, n in case.ride.left[:3])
    alerts = int((case.ride.alerts & (case.ride.since_s >= ONSET_S)).sum())
    return f"{left or 'nobody left out'}, {alerts} epochs in alert"


def _spread(values: Iterable[float | None]) -> str:
    known = sorted(v for v in values if v is not None)
    if not known:
        return "never"
    if len(known) == 1:
        return f"{known[0]:.3g}"
    return f"{known[0]:.3g} to {known[-1]:.3g}, median {np.median(known):.3g}"
