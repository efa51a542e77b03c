"""The smallest fault that a monitor sees in time, row by row: probes sent through a record."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pntegrity.evaluate.montecarlo import Planned
from pntegrity.evaluate.power import Probe, Reach, Shape
from pntegrity.records import FloatArray, Update

__all__ = ["CAP", "Visibility", "Watch"]

CAP = 1e4
"""Largest fault that is looked for, units of the row (or units per second)."""


@dataclass(frozen=True)
class Visibility:
    """The smallest fault on one row that is seen in time; sizes in units of the row (a ramp: per second).

    Parameters
    ----------
    key, kind : str
        The row; ``"bias"`` or ``"ramp"``.
    delay_s : float
        Time after the onset within which it is to be seen.
    median, worst : float or None
        Over the onsets; None: never, or not below 1e4.
    onsets : int
        Onsets looked at; 0 where the record is too short after each.
    note : str
        Why it is not seen, where it is not.
    """

    key: str
    kind: str
    delay_s: float
    median: float | None
    worst: float | None
    onsets: int
    note: str = ""


@dataclass(eq=False)
class _Watched:
    """A probe on its way, the best that a test has seen of each fault, and what is still to be noted."""

    probe: Probe
    best: list[tuple[float, Reach | None]]
    due: list[tuple[float, str]]


class Watch:
    """The search for the smallest faults: show it every epoch of a record in turn, then ask for the `result`.

    Parameters
    ----------
    updates : sequence of Update
        The record.
    power : float
        Probability with which a fault is to be seen.
    delays_s : sequence of float
        Delays of ramps, s; a bias is to be seen within one epoch after its onset.
    onsets : int
        Onsets spread over the record.
    """

    def __init__(
        self, updates: Sequence[Update], power: float, delays_s: Sequence[float], onsets: int
    ) -> None:
        self.power, self.interval_s = power, _interval_s(updates)
        self.wanted = sorted([(self.interval_s, "bias"), *((float(d), "ramp") for d in delays_s)])
        self.starts = _spread(updates, onsets, self.wanted[-1][0])
        self.keys = tuple(dict.fromkeys(k for i in self.starts for k in updates[i].keys))
        self.active: list[_Watched] = []
        self.sizes: dict[tuple[str, str, float], list[float]] = {}
        self.left: dict[tuple[str, str, float], float] = {}

    def take(self, k: int, planned: Planned) -> None:
        """Let every probe see epoch `k`; a start of the filter or a step back in time ends them all."""
        u = planned.update
        if u.is_start or any(u.t_ns <= w.probe.onset_ns for w in self.active):
            self.active = []
        if k in self.starts:
            shapes = [Shape(key, kind) for kind in ("bias", "ramp") for key in u.keys]
            self.active.append(_Watched(Probe(shapes, u), [(0.0, None)] * len(shapes), list(self.wanted)))
        for w in self.active:
            self._follow(w, planned)
        self.active = [w for w in self.active if w.due]

    def _follow(self, w: _Watched, planned: Planned) -> None:
        age = (planned.update.t_ns - w.probe.onset_ns) * 1e-9
        self._note(w, age - self.interval_s)  # what a gap has jumped over
        reach = w.probe.take(planned)
        if reach is not None:
            score = reach.score
            for i in np.flatnonzero(score > np.array([s for s, _ in w.best])):
                w.best[i] = (float(score[i]), reach)
        self._note(w, age)

    def _note(self, w: _Watched, age: float) -> None:
        """Note the smallest sizes for the delays that are over at `age`, to half an interval."""
        while w.due and w.due[0][0] <= age + 0.5 * self.interval_s:
            delay, kind = w.due.pop(0)
            for i, shape in enumerate(w.probe.shapes):
                if shape.kind == kind:
                    reach = w.best[i][1]
                    size = float("inf") if reach is None else reach.size(i, self.power)
                    self.sizes.setdefault((shape.key, kind, delay), []).append(size)
                    self.left[shape.key, kind, delay] = float(w.probe.left[i])

    def result(self) -> tuple[Visibility, ...]:
        """Return what was found for every row."""
        return tuple(self._one(key, kind, delay) for key in self.keys for delay, kind in self.wanted)

    def _one(self, key: str, kind: str, delay: float) -> Visibility:
        sizes = np.array(self.sizes.get((key, kind, delay), []))
        if not len(sizes):
            return Visibility(
                key, kind, delay, None, None, 0, "the record ends or starts anew before the delay is over"
            )
        median, worst = _below(float(np.median(sizes))), _below(float(sizes.max()))
        return Visibility(key, kind, delay, median, worst, len(sizes), self._why(key, kind, delay, sizes))

    def _why(self, key: str, kind: str, delay: float, sizes: FloatArray) -> str:
        unseen = int((sizes > CAP).sum())
        if not unseen:
            return ""
        left = 100.0 * self.left[key, kind, delay]
        return (
            f"not seen below {CAP:g} at {unseen} of {len(sizes)} onsets: after {delay:g} s {left:.2g} % of"
            " the fault is left in the innovations, the states absorb the rest or the test looks elsewhere"
        )


def _below(size: float) -> float | None:
    return size if size <= CAP else None


def _interval_s(updates: Iterable[Update]) -> float:
    t = np.array([u.t_ns for u in updates], dtype=np.int64)
    steps = np.diff(t)
    return float(np.median(steps[steps > 0])) * 1e-9 if (steps > 0).any() else 1.0


def _spread(updates: Sequence[Update], onsets: int, longest_s: float) -> tuple[int, ...]:
    """Return indices from a quarter of the record to the last from which the longest delay still fits."""
    left = np.array([(updates[-1].t_ns - u.t_ns) * 1e-9 for u in updates])
    fit = np.flatnonzero((left >= longest_s) & [bool(u.keys) and not u.is_start for u in updates])
    later = fit[len(fit) // 4 :] if len(fit) else np.arange(len(updates) // 4, len(updates))
    if not onsets or not len(later):
        return ()
    return tuple(int(i) for i in np.unique(later[np.linspace(0, len(later) - 1, onsets).astype(int)]))
