"""Monte Carlo of a monitor on the geometry of a record: the gains once, then nothing but matrix products.

Neither the gains of a filter nor the thresholds of a monitor depend on data, so `plans` walks the record
once; whitened innovations are unit normals under the null hypothesis and are drawn as such, a block of runs
at a time. A quadratic monitor then costs one product with the rows of its window an epoch, a bank one product
with the rows of the epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.kernels.windows import QuadraticTest
from pntegrity.records import FloatArray, Update

IntArray = npt.NDArray[np.int64]
SingleArray = npt.NDArray[np.float32]
Test = QuadraticTest | MaximumTest | CarriedTest

__all__ = ["Count", "Planned", "Planner", "count_alarms", "plans"]


@runtime_checkable
class Planner(Protocol):
    """A monitor whose tests can be planned without data."""

    @property
    def name(self) -> str:
        """Short name."""
        ...

    @property
    def variant(self) -> str:
        """``"exact"`` or ``"published"``."""
        ...

    @property
    def p_fa(self) -> float:
        """The false-alarm probability an epoch that it claims."""
        ...

    def start(self) -> Any:
        """Return the memory of a monitor that has seen nothing."""
        ...

    def plan(self, memory: Any, update: Update) -> tuple[Any, Any]:
        """Return the test of `update` without its data, and the memory after it."""
        ...


@dataclass(frozen=True, eq=False)
class Planned:
    """An update, its data not looked at, and the test that the monitor makes of it.

    Parameters
    ----------
    update : Update
    test : QuadraticTest, MaximumTest or CarriedTest
    reason : str
        Why the epoch is not tested or not simulated, where it is not.
    """

    update: Update
    test: Test
    reason: str = ""


def plans(updates: Iterable[Update], monitor: Planner) -> Iterator[Planned]:
    """Return what a monitor tests on each update; where time goes back (a repair), it starts anew.

    An epoch whose states were initialised from its own rows is marked as not simulated: its innovations are
    not unit normals, the rows having been used before the filter saw them.
    """
    memory, last_ns = monitor.start(), None
    for update in updates:
        if last_ns is not None and update.t_ns <= last_ns:
            memory = monitor.start()
        last_ns = update.t_ns
        test, memory = monitor.plan(memory, update)
        own = "states initialised from this epoch's own rows: not simulated" if update.consumed else ""
        yield Planned(update, test, test.reason or own)


@dataclass(frozen=True, eq=False)
class Count:
    """How often a monitor alarmed.

    Parameters
    ----------
    alarms : ndarray of int, shape (epochs,)
        Runs that alarmed at each epoch; -1 where no test was made.
    by_run : ndarray of int, shape (runs,)
        Alarms of each run.
    overlap : int
        Epochs over which two tests of a run have rows in common.
    """

    alarms: IntArray
    by_run: IntArray
    overlap: int

    @property
    def total(self) -> int:
        """Alarms of all epochs and runs."""
        return int(self.by_run.sum())

    @property
    def tests(self) -> int:
        """Tests made."""
        return int((self.alarms >= 0).sum()) * len(self.by_run)

    @property
    def rate(self) -> float:
        """Alarms a test; 0 where none was made."""
        return self.total / self.tests if self.tests else 0.0

    @property
    def tests_an_independent_one(self) -> float:
        """How many tests weigh as much as one independent test, since the windows overlap: at least 1.

        The variance of the alarms of a run against that of independent tests; where too few runs alarmed to
        tell, the whole overlap is assumed.
        """
        if np.count_nonzero(self.by_run) < 10:
            return float(self.overlap)
        each = self.tests / len(self.by_run)
        return max(float(self.by_run.var(ddof=1)) / (each * self.rate * (1.0 - self.rate)), 1.0)

    def interval(self, confidence: float = 0.99) -> tuple[float, float]:
        """Return the binomial interval of the rate, for as many tests as are independently worth it."""
        weight = self.tests_an_independent_one
        return binomial_interval(round(self.total / weight), max(round(self.tests / weight), 1), confidence)


def count_alarms(
    planned: Iterable[Planned],
    runs: int,
    rng: np.random.Generator,
    *,
    means: Sequence[FloatArray] | None = None,
    threads: int = 2,
    block: int = 256,
) -> Count:
    """Return how often a monitor alarms on drawn innovations.

    The result depends on `rng`, `runs` and `block`, not on `threads`. The record is taken in stretches of at
    most 256 MB of matrices; each block of runs keeps what it needs (the last window, or the running sums)
    from one to the next.

    Parameters
    ----------
    planned : iterable of Planned
        Consecutive updates of one record.
    runs : int
        Runs through the record.
    rng : numpy.random.Generator
        Each block of runs draws from a child of it.
    means : sequence of ndarray, shapes (m_k,), optional
        Means of the whitened innovations of each epoch, as a fault gives them (see `power.shapes`).
    threads : int
    block : int
        Runs that are taken through the record together; chosen for the processor's cache.
    """
    from threadpoolctl import threadpool_limits

    sizes = [min(block, runs - at) for at in range(0, runs, block)]
    lanes = [_Lane(child, size) for child, size in zip(rng.spawn(len(sizes)), sizes, strict=True)]
    found: list[IntArray] = []
    done, overlap = 0, 1
    with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(threads) as pool:
        for stretch in _stretches(planned):
            shift = None if means is None else means[done : done + len(stretch)]
            alarms = sum(pool.map(_counter(stretch, shift), lanes), np.zeros(len(stretch), dtype=np.int64))
            found.append(np.where([step.tested for step in stretch], alarms, -1))
            done, overlap = done + len(stretch), max(overlap, *(step.overlap for step in stretch))
    by_run = np.concatenate([lane.alarms for lane in lanes])
    return Count(np.concatenate(found), by_run, overlap)


def _counter(stretch: list[_Step], means: Sequence[FloatArray] | None) -> Callable[[_Lane], IntArray]:
    def count(lane: _Lane) -> IntArray:
        out = np.zeros(len(stretch), dtype=np.int64)
        for k, statistic in lane.statistics(stretch, means):
            alarm = statistic > stretch[k].threshold
            lane.alarms += alarm
            out[k] = np.count_nonzero(alarm)
        return out

    return count


@dataclass(frozen=True, eq=False)
class _Step:
    """One epoch, ready for products: `matrix` (r, window rows) of a quadratic test, or a bank's three."""

    rows: int
    tested: bool
    threshold: float
    overlap: int = 1
    matrix: FloatArray | None = None
    source: IntArray | None = None
    response: SingleArray | None = None
    inverse: SingleArray | None = None
    carried: CarriedTest | None = None

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.matrix, self.response, self.carried) if a is not None)


def _stretches(planned: Iterable[Planned], most: int = 256_000_000) -> Iterator[list[_Step]]:
    stretch: list[_Step] = []
    held = 0
    for p in planned:
        step = _ready(p, stretch[-1] if stretch else None)
        held += 0 if stretch and step.matrix is stretch[-1].matrix is not None else step.nbytes
        stretch.append(step)
        if held > most:
            yield stretch
            stretch, held = [], 0
    if stretch:
        yield stretch


def _ready(p: Planned, before: _Step | None) -> _Step:
    rows, test = len(p.update.keys), p.test
    tested = not p.reason
    if isinstance(test, MaximumTest):
        single = (test.response.astype(np.float32), test.inverse.astype(np.float32))
        return _Step(rows, tested, test.threshold, test.overlap, None, test.source, *single)
    if isinstance(test, CarriedTest):
        return _Step(rows, tested, test.threshold, test.overlap, carried=test)
    if test.form is None:
        return _Step(rows, False, test.threshold)
    matrix = test.form.stacked()
    if before is not None and before.matrix is not None and np.array_equal(before.matrix, matrix):
        matrix = before.matrix
    return _Step(rows, tested, test.threshold, len(test.form.maps), matrix)


class _Lane:
    """A block of runs on its way through a record: its generator, and what it carries between epochs."""

    def __init__(self, rng: np.random.Generator, runs: int) -> None:
        self.rng, self.runs = rng, runs
        self.alarms = np.zeros(runs, dtype=np.int64)
        self.recent: FloatArray = np.zeros((0, runs))
        self.num: SingleArray = np.zeros((0, runs), dtype=np.float32)
        self.apart: FloatArray = np.zeros((0, 0, runs))

    def statistics(
        self, stretch: list[_Step], means: Sequence[FloatArray] | None
    ) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        """Yield the number of each tested epoch of a stretch and the statistic of every run."""
        if any(step.carried is not None for step in stretch):
            return self._separations(stretch, means)
        bank = any(step.source is not None for step in stretch)
        return self._maxima(stretch, means) if bank else self._squares(stretch, means)

    def _squares(
        self, stretch: list[_Step], means: Sequence[FloatArray] | None, most: int = 256
    ) -> Iterator[tuple[int, FloatArray]]:
        reach = max((s.matrix.shape[1] for s in stretch if s.matrix is not None), default=0)
        for first, last in _pieces([s.rows for s in stretch], most):
            kept = self.recent[-reach:] if reach else self.recent[:0]
            rows = np.concatenate(([len(kept)], [s.rows for s in stretch[first:last]])).cumsum()
            white = np.empty((rows[-1], self.runs))
            white[: len(kept)] = kept
            self.rng.standard_normal(out=white[len(kept) :])
            if means is not None:
                white[len(kept) :] += np.concatenate(means[first:last])[:, None]
            for k in range(first, last):
                matrix, end = stretch[k].matrix, rows[k - first + 1]
                if matrix is not None and stretch[k].tested:
                    y = matrix @ white[end - matrix.shape[1] : end]
                    yield k, np.einsum("ij,ij->j", y, y)
            self.recent = white

    def _maxima(
        self, stretch: list[_Step], means: Sequence[FloatArray] | None
    ) -> Iterator[tuple[int, SingleArray]]:
        # Single precision: a sum of at most 64 epochs of unit normals is rounded by some 1e-6 of itself,
        # which moves the rate of exceeding a threshold of 40 by less than 1e-4 of itself, far below the
        # binomial interval.
        best = np.empty(self.runs, dtype=np.float32)
        for k, step in enumerate(stretch):
            if step.source is None or step.response is None or step.inverse is None:
                continue
            white = self.rng.standard_normal((step.rows, self.runs), dtype=np.float32)
            if means is not None:
                white += means[k].astype(np.float32)[:, None]
            fresh = step.response @ white
            _carry_and_test(self.num, step.source, fresh, step.inverse, best)
            self.num = fresh
            if step.tested:
                yield k, best

    def _separations(
        self, stretch: list[_Step], means: Sequence[FloatArray] | None
    ) -> Iterator[tuple[int, FloatArray]]:
        for k, step in enumerate(stretch):
            if step.carried is None:
                continue
            white = self.rng.standard_normal((step.rows, self.runs))
            if means is not None:
                white += means[k][:, None]
            self.apart = step.carried.step(self.apart, white)
            if step.tested:
                yield k, step.carried.statistic(self.apart)


def _pieces(rows: list[int], most: int) -> Iterator[tuple[int, int]]:
    """Yield runs of epochs with about `most` rows together."""
    first, held = 0, 0
    for k, m in enumerate(rows):
        if k > first and held + m > most:
            yield first, k
            first, held = k, 0
        held += m
    if first < len(rows):
        yield first, len(rows)


@njit(cache=True, nogil=True, fastmath=True)
def _carry_and_test(
    num: SingleArray, source: IntArray, fresh: SingleArray, inverse: SingleArray, best: SingleArray
) -> None:
    """Add the earlier sums to `fresh`, and put the largest normalised square of each run into `best`."""
    best[:] = 0.0
    for i in range(fresh.shape[0]):
        if source[i] >= 0:
            for c in range(fresh.shape[1]):
                fresh[i, c] += num[source[i], c]
        if inverse[i] > 0.0:
            for c in range(fresh.shape[1]):
                best[c] = max(best[c], fresh[i, c] * fresh[i, c] * inverse[i])
