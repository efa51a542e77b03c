"""Runs of the multi-level study: one draw of noise, every fault, every monitor on the same runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.linear import whiten
from pntegrity.kernels.signatures import Signature, masks
from pntegrity.monitors import _hypotheses
from pntegrity.monitors._explanations import Explanation, explanations, faulty_sensors, first_of_all, minimal
from pntegrity.monitors._gains import Gains
from pntegrity.monitors._hypotheses import HypothesesMemory
from pntegrity.monitors._sources import Evidence, sensors_of
from pntegrity.monitors.source_separation import SourceSeparation
from pntegrity.records import FloatArray, Update
from pntegrity.scenarios._vessel_logs import facts
from pntegrity.simulate.ensembles import Ensemble, Filtered, draw_ensemble, filtered
from pntegrity.simulate.linear import LinearModel, gains
from pntegrity.simulate.vessel import Vessel, vessel_model
from pntegrity.states import group_of, sensor_of

__all__ = ["Case", "Detected", "Study"]

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Case:
    """A fault of some rows: `size` in units of the row (a second for ramps), from and to, s."""

    name: str
    rows: tuple[str, ...]
    kind: str
    size: tuple[float, ...]
    from_s: float
    to_s: float

    @staticmethod
    def of(table: Mapping[str, Any], which: str, vessel: Vessel) -> Case:
        """Return the case of a table with the sizes of one parameter set."""
        rows = tuple(table["rows"])
        size = table[which] * vessel.unit(table["unit"])
        return Case(str(table["case"]), rows, table["kind"], (size,) * len(rows), *table["from_to_s"])

    @property
    def sources(self) -> frozenset[str]:
        """Sources at fault."""
        return frozenset(map(group_of, self.rows))

    @property
    def sensors(self) -> frozenset[tuple[str, str]]:
        """Sources and sensors at fault."""
        return frozenset((group_of(k), sensor_of(k)) for k in self.rows)


@dataclass(frozen=True, eq=False)
class Detected:
    """What became of the runs of a case.

    Parameters
    ----------
    alarm_s, named_s : ndarray, shape (runs,)
        Time of the first alarm and of the first epoch at which a set of sources is isolated, after the
        fault's begin; inf: never. Isolated is who is named, or left out for the time being.
    sources, sensors : tuple of tuple of str
        What was isolated, and which sensors of it.
    ambiguous : ndarray of bool
        Whether the first alarm could not be told.
    onset : ndarray of int
        Epoch from which the fault is said to have been there.
    named : ndarray of int
        Epoch of `named_s`.
    rivals : tuple of tuple of tuple of str
        Who else may be at fault when somebody is isolated; none: it is named.
    certain : tuple of tuple of str
        What is named with certainty, perhaps later in the fault's time.
    """

    alarm_s: FloatArray
    named_s: FloatArray
    sources: tuple[tuple[str, ...], ...]
    sensors: tuple[tuple[str, ...], ...]
    ambiguous: BoolArray
    onset: IntArray
    named: IntArray
    rivals: tuple[tuple[tuple[str, ...], ...], ...]
    certain: tuple[tuple[str, ...], ...]


class _Told:
    """What has become of each run so far: the fields of `Detected`."""

    def __init__(self, runs: int) -> None:
        self.alarm_s, self.named_s = np.full(runs, np.inf), np.full(runs, np.inf)
        self.sources: list[tuple[str, ...]] = [()] * runs
        self.sensors: list[tuple[str, ...]] = [()] * runs
        self.ambiguous, self.onset = np.zeros(runs, dtype=bool), np.zeros(runs, dtype=np.intp)
        self.rivals: list[tuple[tuple[str, ...], ...]] = [()] * runs
        self.certain: list[tuple[str, ...]] = [()] * runs

    @property
    def open(self) -> BoolArray:
        """Runs in which nobody is named with certainty."""
        return np.array([not names for names in self.certain])

    def hear(self, r: int, since_s: float, candidates: Sequence[Explanation]) -> None:
        """Take the candidates of a run at a time after the fault's begin."""
        first = first_of_all(candidates)
        if np.isinf(self.alarm_s[r]):
            self.alarm_s[r], self.ambiguous[r] = since_s, len(candidates) != 1
        if first is not None and np.isinf(self.named_s[r]):
            self.named_s[r], self.sources[r] = since_s, first.names
            self.rivals[r] = tuple(e.names for e in candidates[1:])
        if len(candidates) == 1:
            self.certain[r] = candidates[0].names

    def detected(self, named: IntArray) -> Detected:
        """Return it; `named`: the epochs of `named_s`."""
        return Detected(
            self.alarm_s, self.named_s, tuple(self.sources), tuple(self.sensors), self.ambiguous, self.onset,
            named, tuple(self.rivals), tuple(self.certain),
        )  # fmt: skip


class Study:
    """The linear study with one parameter set.

    Parameters
    ----------
    which : str
        ``"printed"`` or ``"consistent"``.
    runs : int
    seed : int
    """

    def __init__(self, which: str, runs: int, seed: int = 1) -> None:
        self.facts = facts()
        f, e = self.facts, self.facts["experiment"]
        self.which = which
        self.vessel = Vessel(
            f["geometry"], f["start"], f["clock"], f["ins"], f["noise"][which], e["rate_hz"], e["duration_s"]
        )
        self.model: LinearModel = vessel_model(self.vessel)
        self.noise: Ensemble = draw_ensemble(
            self.model, self.vessel.epochs, runs, np.random.default_rng(seed)
        )
        self.runs = runs

    @cached_property
    def updates(self) -> tuple[Update, ...]:
        """The filter's updates, without data."""
        return gains(self.model, self.vessel.epochs)

    @property
    def t_s(self) -> FloatArray:
        """Times of the epochs."""
        return self.vessel.course.t_s

    @cached_property
    def monitor(self) -> SourceSeparation:
        """The exact source level at the study's false-alarm probability."""
        return SourceSeparation(p_fa=self.facts["experiment"]["p_fa"])

    @cached_property
    def tests(self) -> tuple[MaximumTest, ...]:
        """Its tests, without data."""
        memory, out = self.monitor.start(), []
        for u in self.updates:
            test, memory = self.monitor.plan(memory, u)
            out.append(test)
        return tuple(out)

    def cases(self) -> Iterator[Case]:
        """Yield the six cases with the sizes of this parameter set."""
        for table in self.facts["cases"]:
            yield Case.of(table, self.which, self.vessel)

    def faults(self, *cases: Case) -> FloatArray:
        """Return what some cases add to the rows, shape (epochs, m)."""
        out = np.zeros((self.vessel.epochs, len(self.model.keys)))
        for case in cases:
            on = (self.t_s >= case.from_s) & (self.t_s < case.to_s)
            course = self.t_s[on] - case.from_s if case.kind == "ramp" else np.ones(int(on.sum()))
            for key, size in zip(case.rows, case.size, strict=True):
                out[on, self.model.keys.index(key)] += size * course
        return out

    def shifted(self, sources: Sequence[str], mps: Sequence[float], from_s: float, to_s: float) -> FloatArray:
        """Return what sources add to their rows that agree on a position which drifts, shape (epochs, m)."""
        out = np.zeros((self.vessel.epochs, len(self.model.keys)))
        own = [i for i, key in enumerate(self.model.keys) if group_of(key) in sources]
        for k in np.flatnonzero((self.t_s >= from_s) & (self.t_s < to_s)):
            away = (self.t_s[k] - from_s) * np.asarray(mps)
            out[k, own] = self.model.at("H", int(k))[own, :3] @ away
        return out

    def full(self, faults: FloatArray) -> Filtered:
        """Return the filter that uses all rows."""
        return filtered(self.model, self.noise, faults, np.ones_like(faults, dtype=bool))

    def white(self, nu: FloatArray) -> FloatArray:
        """Return the whitened innovations of the filter with all rows, shape (epochs, m, runs)."""
        return np.stack([whiten(u.L, own) for u, own in zip(self.updates, nu, strict=True)])

    def statistic(self, white: FloatArray, tests: Sequence[MaximumTest] | None = None) -> FloatArray:
        """Return the statistic of the source level over its threshold, shape (epochs, runs); with other
        tests, their statistic.
        """
        out, num = np.zeros((len(white), white.shape[2])), np.zeros((0, white.shape[2]))
        for k, (test, w) in enumerate(zip(tests or self.tests, white, strict=True)):
            num = test.carry(num, w)
            best = (num * num * test.inverse[:, None]).max(axis=0, initial=0.0)
            out[k] = best if tests else best / test.threshold
        return out

    def known(self, case: Case) -> tuple[MaximumTest, ...]:
        """Return the tests of somebody who knows which rows fail and how, but neither since when nor how
        much.
        """
        one = (Signature(("fault",), case.kind, case.rows),)
        memory, out = HypothesesMemory.empty(), []

        def look(update: Update, kind: str) -> tuple[tuple[Signature, ...], tuple[FloatArray, FloatArray]]:
            own = one if kind == case.kind else ()
            return own, masks(own, update.keys)

        for u in self.updates:
            test, memory = _hypotheses.plan(memory, u, look, self.monitor.longest, self.monitor.p_fa, 1.0)
            out.append(test)
        return tuple(out)

    @cached_property
    def evidence(self) -> dict[int, Evidence]:
        """Windows that were looked at, by their last epoch."""
        return {}

    def evidence_at(self, k: int) -> Evidence:
        """Return the window that ends with an epoch."""
        if k not in self.evidence:
            self.evidence.clear()
            self.evidence[k] = Evidence.of(self.updates[max(0, k + 1 - self.monitor.kept) : k + 1])
        return self.evidence[k]

    def identified(self, k: int, white: FloatArray) -> list[tuple[Explanation, ...]]:
        """Return the candidates of each run at an epoch; `white`: whitened innovations, (epochs, m, runs)."""
        evidence = self.evidence_at(k)
        y = _window(evidence, k, white)
        sources = list(sensors_of(self.model.keys))
        sets = [names for size in (1, 2) for names in combinations(sources, size)]
        return [minimal(tried) for tried in explanations(Gains(evidence, y), sets, self.monitor.p_identify)]

    def sensors(self, k: int, white: FloatArray, source: str) -> list[tuple[str, ...]]:
        """Return the sensors at fault of each run at an epoch, none where they cannot be told."""
        evidence = self.evidence_at(k)
        y = _window(evidence, k, white)
        found = faulty_sensors(evidence, y, source, self.monitor.p_identify)
        return [sets[0] if len(sets) == 1 else () for sets in found]

    def detect(self, faults: FloatArray, from_s: float, to_s: float) -> Detected:
        """Return what becomes of the runs of a fault: alarms count until it ends, others are false."""
        full = self.full(faults)
        white = self.white(full.nu)
        alarm, told = self.statistic(white) > 1.0, _Told(self.runs)
        for k in np.flatnonzero((self.t_s >= from_s) & (self.t_s < to_s)):
            since_s, runs = self.t_s[k] - from_s, np.flatnonzero(alarm[k] & told.open)
            if not len(runs):
                continue
            for r, candidates in zip(runs, self.identified(int(k), white[:, :, runs]), strict=True):
                told.hear(int(r), since_s, candidates)
            self._locate(int(k), white, told, np.flatnonzero(told.named_s == since_s))
        named_s = np.where(np.isfinite(told.named_s), from_s + told.named_s, 0.0)
        return told.detected(np.searchsorted(self.t_s, named_s - 1e-6))

    def named_within(self, faults: FloatArray, from_s: float, within_s: float) -> list[list[tuple[str, ...]]]:
        """Return all sets of sources that are named in each run until some time after a fault's begin."""
        white = self.white(self.full(faults).nu)
        alarm = self.statistic(white) > 1.0
        out: list[list[tuple[str, ...]]] = [[] for _ in range(self.runs)]
        for k in np.flatnonzero((self.t_s >= from_s) & (self.t_s <= from_s + within_s)):
            runs = np.flatnonzero(alarm[k])
            for r, found in zip(runs, self.identified(int(k), white[:, :, runs]), strict=True):
                out[r] += [found[0].names] if len(found) == 1 else []
        return out

    def _locate(self, k: int, white: FloatArray, told: _Told, now: IntArray) -> None:
        """Fill in sensors and onset of the runs in which somebody was isolated now."""
        evidence = self.evidence_at(k)
        for names in sorted({told.sources[r] for r in now}):
            own = np.array([r for r in now if told.sources[r] == names], dtype=np.intp)
            y = _window(evidence, k, white[:, :, own])
            explained = Gains(evidence, y).explained
            for i, r in enumerate(own):
                best = evidence.best(explained[:, i], names)
                told.onset[r] = k + 1 - len(evidence.window) + int(evidence.faults[1].onset[best])
            for source in names:
                for r, found in zip(own, self.sensors(k, white[:, :, own], source), strict=True):
                    told.sensors[r] += tuple(f"{source}.{s}" for s in found)


def _window(evidence: Evidence, k: int, white: FloatArray) -> FloatArray:
    first = k + 1 - len(evidence.window)
    return white[first : k + 1].reshape(-1, white.shape[2])
