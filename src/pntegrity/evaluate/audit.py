"""Does a monitor keep its false-alarm rate on the geometry of a record, and what would it see? Without data.

Three answers, each from the record's F, Q, H, R and keys alone. The exact rate: the tail of the true
distribution of the monitor's own statistic at its own threshold. The Monte Carlo rate of the same, with its
interval. And for each row the smallest bias and ramp that it sees with a stated probability within a stated
delay.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pntegrity.evaluate.montecarlo import Planner, Test, count_alarms, plans
from pntegrity.evaluate.power import spectrum
from pntegrity.evaluate.visibility import Visibility, Watch
from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.kernels.quadratic_tail import quadratic_tail
from pntegrity.kernels.tails import chi2_tail, effective_tests, two_sided_tail
from pntegrity.records import Update

__all__ = ["AuditResult", "ExactRate", "MonteCarloRate", "Visibility", "audit", "exact_rate", "exact_tail"]


@dataclass(frozen=True)
class ExactRate:
    """The false-alarm probability of an epoch, from the distribution of the statistic: no simulation.

    `lowest`, `median` and `highest` are over the epochs. A bank has no exact value (`bounds` is true):
    `highest` and `median` are then of Hunter's upper bound, which its threshold stands for, and `lowest` of
    the largest single hypothesis, a lower bound that is far too low for a bank of many.
    """

    lowest: float
    median: float
    highest: float
    bounds: bool


@dataclass(frozen=True)
class MonteCarloRate:
    """The false-alarm rate of drawn innovations.

    `low` and `high` are its binomial interval (Clopper and Pearson) of probability `confidence`, for as many
    tests as the overlapping windows are independently worth: one in `tests_an_independent_one`.
    """

    tests: int
    alarms: int
    rate: float
    low: float
    high: float
    confidence: float
    tests_an_independent_one: float


@dataclass(frozen=True)
class AuditResult:
    """What an audit found.

    Parameters
    ----------
    monitor, variant : str
    p_fa : float
        The probability an epoch that the monitor claims.
    epochs, tested : int
        Epochs of the record, and those that were audited.
    skipped : mapping of str to int
        Reasons for the others, and how many.
    exact : ExactRate or None
    monte_carlo : MonteCarloRate or None
        None where no epoch can be tested.
    power : float
        Probability with which a fault counts as seen.
    visibility : tuple of Visibility
    """

    monitor: str
    variant: str
    p_fa: float
    epochs: int
    tested: int
    skipped: Mapping[str, int]
    exact: ExactRate | None
    monte_carlo: MonteCarloRate | None
    power: float
    visibility: tuple[Visibility, ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return one flat row a figure: `quantity`, `value`, `low`, `high`, `note` (for a table or JSON)."""
        return [*self._rate_rows(), *(self._visibility_row(v) for v in self.visibility)]

    def _rate_rows(self) -> list[dict[str, Any]]:
        out = [_row("P_FA, nominal", self.p_fa)]
        if self.exact is not None:
            e, kind = self.exact, "bound" if self.exact.bounds else "exact"
            out.append(
                _row(f"P_FA, {kind} (median, lowest, highest of epochs)", e.median, e.lowest, e.highest)
            )
        if self.monte_carlo is not None:
            m = self.monte_carlo
            note = f"{m.alarms} alarms in {m.tests} tests, {100 * m.confidence:g} % interval"
            out.append(_row("P_FA, Monte Carlo", m.rate, m.low, m.high, note))
        return out

    def _visibility_row(self, v: Visibility) -> dict[str, Any]:
        quantity = f"{v.key}: smallest {v.kind} seen within {v.delay_s:g} s with probability {self.power:g}"
        return _row(quantity, v.median, v.median, v.worst, v.note)


def _row(
    quantity: str, value: float | None, low: float | None = None, high: float | None = None, note: str = ""
) -> dict[str, Any]:
    return {"quantity": quantity, "value": value, "low": low, "high": high, "note": note}


def audit(
    record_updates: Sequence[Update],
    monitor: Planner,
    *,
    rng: np.random.Generator,
    tests: int = 1_000_000,
    power: float = 0.999,
    delays_s: Sequence[float] = (10.0, 30.0, 60.0),
    onsets: int = 5,
    confidence: float = 0.99,
    threads: int = 2,
) -> AuditResult:
    """Audit a monitor on the geometry of a record.

    Parameters
    ----------
    record_updates : sequence of Update
        Consecutive updates; starts, gaps, changing satellites and repairs (time goes back) are what they
        were.
    monitor : Planner
        A monitor with a `plan`.
    rng : numpy.random.Generator
    tests : int
        Epoch-tests of the Monte Carlo, at least (whole runs through the record); 0: none.
    power : float
        Probability with which a fault is to be seen.
    delays_s : sequence of float
        Delays of ramps, s; a bias is to be seen within one epoch after its onset.
    onsets : int
        Onsets spread over the record; 0: no search for the smallest faults.
    confidence : float
        Of the Monte Carlo interval.
    threads : int
        Of the Monte Carlo.

    Raises
    ------
    ValueError
        Where the record is empty.
    """
    if not record_updates:
        raise ValueError("`record_updates` must hold at least one update")
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        watch = Watch(record_updates, power, sorted(delays_s), onsets)
        rates, skipped = _walk(record_updates, monitor, watch)
        runs = -(-tests // len(rates)) if rates else 0
        drawn = _simulated(record_updates, monitor, runs, rng, confidence, threads)
        return AuditResult(
            monitor.name, monitor.variant, monitor.p_fa, len(record_updates), len(rates), skipped,
            _over_epochs(rates), drawn, power, watch.result(),
        )  # fmt: skip


def _walk(
    updates: Sequence[Update], monitor: Planner, watch: Watch
) -> tuple[list[tuple[float, float]], dict[str, int]]:
    """Return the exact rate (or its bounds) of every epoch that is tested, and why the others are not."""
    skipped: Counter[str] = Counter()
    rates = []
    for k, p in enumerate(plans(updates, monitor)):
        watch.take(k, p)
        if p.reason:
            skipped[p.reason] += 1
        else:
            rates.append(exact_rate(p.test))
    return rates, dict(skipped)


def exact_rate(test: Test) -> tuple[float, float]:
    """Return lower and upper bound of a test's false-alarm probability; equal where it is known exactly."""
    if isinstance(test, MaximumTest):
        single = float(two_sided_tail(np.sqrt(test.threshold)))
        return single, min(single * effective_tests(test.rho, float(np.sqrt(test.threshold))), 1.0)
    if isinstance(test, CarriedTest):
        tails = two_sided_tail(test.deviations) * (test.inverse > 0.0)
        return float(tails.max(initial=0.0)), float(tails.sum())
    if test.form is None:
        return 0.0, 0.0
    exact = exact_tail(test, test.threshold)
    return exact, exact


def exact_tail(test: Any, value: float) -> float:
    """Return the probability that a quadratic test's statistic exceeds `value` without a fault."""
    found = spectrum(test)
    if found is not None:
        return quadratic_tail(value, found[0])
    return float(chi2_tail(value, test.form.metric.shape[0]))


def _over_epochs(rates: Sequence[tuple[float, float]]) -> ExactRate | None:
    if not rates:
        return None
    low, high = np.array(rates).T
    return ExactRate(float(low.min()), float(np.median(high)), float(high.max()), bool((low < high).any()))


def _simulated(
    updates: Sequence[Update],
    monitor: Planner,
    runs: int,
    rng: np.random.Generator,
    confidence: float,
    threads: int,
) -> MonteCarloRate | None:
    if not runs:
        return None
    count = count_alarms(plans(updates, monitor), runs, rng, threads=threads)
    low, high = count.interval(confidence)
    weight = count.tests_an_independent_one
    return MonteCarloRate(count.tests, count.total, count.rate, low, high, confidence, weight)
