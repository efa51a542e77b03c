"""The campaign behind docs/results.md: what the SPP monitors claim, checked on the 8-state simulation.

Ten satellites, code 1 m, range rate 0.1 m/s, 1 Hz (`simulate.linear.spp_model`). False-alarm rates at 1e-3 of
the exact and the published variants, power against its non-central prediction, and the delay of a 0.1 m/s
ramp on one pseudorange with all monitors at a real false-alarm rate of 1e-6.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.evaluate.audit import exact_tail
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.evaluate.montecarlo import Planned, Planner, count_alarms, plans
from pntegrity.evaluate.power import Probe, Reach, Shape
from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.windows import QuadraticTest
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import FloatArray, Update, group_of
from pntegrity.simulate.linear import gains, spp_model

__all__ = ["evidence"]

Row = dict[str, Any]
IntArray = npt.NDArray[np.int64]

P_FA = 1e-3
SETTLED = 100
"""Epochs after which faults begin: the filter and all windows are steady."""


def evidence(tests: int = 1_000_000, rng: np.random.Generator | None = None) -> list[Row]:
    """Return one row a figure: quantity, must, measured, interval (or None), ok (None: stated only).

    Parameters
    ----------
    tests : int
        Epoch-tests of each false-alarm rate (four times as many for the bank, whose tests overlap most).
    rng : numpy.random.Generator, optional
        That of seed 0 where not given.
    """
    from threadpoolctl import threadpool_limits

    rng = rng or np.random.default_rng(0)
    with threadpool_limits(1, user_api="blas"):
        updates = gains(spp_model(), 2 * SETTLED)
        rates = [row for m in _exact() for row in _exact_rate(updates, m, tests, rng)]
        rates += _bank_rate(updates, 4 * tests, rng)
        rates += [row for m in _published() for row in _published_rate(updates, m, tests, rng)]
        return rates + _power(updates, rng, tests // 50) + _delays(rng)


def _exact() -> tuple[Planner, ...]:
    return Rctm(P_FA), Srctm(P_FA), Aime(P_FA), Sraime(P_FA)


def _published() -> tuple[Planner, ...]:
    return Aime(P_FA, "published"), Sraime(P_FA, "published")


def _row(quantity: str, must: str, measured: Any, interval: Sequence[float] | None, ok: bool | None) -> Row:
    return {"quantity": quantity, "must": must, "measured": measured, "interval": interval, "ok": ok}


def _exact_rate(
    updates: Sequence[Update], monitor: Planner, tests: int, rng: np.random.Generator
) -> list[Row]:
    count = count_alarms(plans(updates, monitor), tests // len(updates) + 50, rng)
    low, high = count.interval(0.99)
    quantity = f"P_FA of exact {monitor.name}, {count.tests} tests"
    return [_row(quantity, "99 % interval holds 1e-3", count.rate, [low, high], low <= P_FA <= high)]


def _bank_rate(updates: Sequence[Update], tests: int, rng: np.random.Generator) -> list[Row]:
    monitor = Glr(P_FA)
    count = count_alarms(plans(updates, monitor), tests // len(updates), rng)
    low, high = count.interval(0.99)
    must = "99 % interval within 1e-3 / 3 and 1e-3"
    return [
        _row(
            f"P_FA of the GLR bank, {count.tests} tests",
            must,
            count.rate,
            [low, high],
            low >= P_FA / 3.0 and high <= P_FA,
        )
    ]


def _published_rate(
    updates: Sequence[Update], monitor: Planner, tests: int, rng: np.random.Generator
) -> list[Row]:
    planned = list(plans(updates, monitor))
    count = count_alarms(planned, tests // len(updates) + 50, rng)
    low, high = count.interval(0.99)
    exact = float(np.mean([exact_tail(p.test, p.test.threshold) for p in planned if not p.reason]))
    quantity = f"P_FA of published {monitor.name} at nominal 1e-3"
    return [
        _row(f"{quantity}, {count.tests} tests", "stated", count.rate, [low, high], None),
        _row(f"{quantity}, exact", "inside the interval of the tests", exact, None, low <= exact <= high),
    ]


def _power(updates: Sequence[Update], rng: np.random.Generator, runs: int) -> list[Row]:
    """Compare Monte Carlo power with its prediction, for ramps seen in half of all runs after 20 s."""
    monitors = (*_exact(), *_published(), Glr(P_FA))
    return [row for m in monitors for row in _power_of(updates, m, rng, runs)]


def _power_of(updates: Sequence[Update], monitor: Planner, rng: np.random.Generator, runs: int) -> list[Row]:
    planned = list(plans(updates, monitor))
    probe = Probe([Shape("G04:C1C", "ramp")], planned[SETTLED].update)
    seen = [probe.take(p) for p in planned[SETTLED : SETTLED + 31]]
    size = _known(seen[20]).size(0, 0.5)
    none = [np.zeros(len(p.update.keys)) for p in planned[:SETTLED]]
    count = count_alarms(
        planned[: SETTLED + 31], runs, rng, means=[*none, *(size * w[:, 0] for w in probe.white)]
    )
    bank = isinstance(monitor, Glr)
    out = []
    for delay in (15, 20, 25):
        predicted, alarms = _known(seen[delay]).power(0, size), int(count.alarms[SETTLED + delay])
        low, high = binomial_interval(alarms, runs, 0.999)
        quantity = (
            f"power of {monitor.variant} {monitor.name}, ramp {size:.3g} m/s after {delay} s, {runs} runs"
        )
        must = f"99.9 % interval {'not below the bound' if bank else 'holds'} {predicted:.4f}"
        out.append(
            _row(quantity, must, alarms / runs, [low, high], predicted <= high and (bank or low <= predicted))
        )
    return out


def _known(reach: Reach | None) -> Reach:
    if reach is None:
        raise ValueError("the monitor makes no test at an epoch of the campaign")
    return reach


def _delays(
    rng: np.random.Generator, rate_mps: float = 0.1, seeds: int = 200, longest: int = 150
) -> list[Row]:
    """Return median delays of a ramp on each pseudorange, `seeds` runs each, and whom the bank names."""
    updates = gains(spp_model(), SETTLED + longest)
    keys = [k for k in updates[0].keys if k.endswith("C1C")]
    monitors = (Glr(1e-6), Aime(1e-6), Rctm(1e-6), Sraime(1e-6))
    planned = {m.name: list(plans(updates, m)) for m in monitors}
    delays: dict[str, list[IntArray]] = {m.name: [] for m in monitors}
    right = 0
    for key in keys:
        white = _ramped(planned["rctm"], key, rate_mps, rng, seeds)
        for name, steps in planned.items():
            when, who = _first_alarms(steps, white)
            delays[name].append(when)
            right += sum(w == group_of(key) for w in who)
    return _delay_rows({n: np.concatenate(d) for n, d in delays.items()}, right, longest)


def _ramped(
    planned: Sequence[Planned], key: str, rate_mps: float, rng: np.random.Generator, runs: int
) -> FloatArray:
    """Return drawn whitened innovations of a ramp on one row, shape (epochs, m, runs)."""
    white = rng.standard_normal((len(planned), len(planned[0].update.keys), runs))
    probe = Probe([Shape(key, "ramp")], planned[SETTLED].update)
    for k, p in islice(enumerate(planned), SETTLED, None):
        probe.take(p)
        white[k] += rate_mps * probe.white[-1]
    return white


def _first_alarms(planned: Sequence[Planned], white: FloatArray) -> tuple[IntArray, list[str]]:
    """Return how many epochs after the onset each run first alarms (-1: never), and whom a bank blames."""
    runs = white.shape[2]
    when, who = np.full(runs, -1, dtype=np.int64), [""] * runs
    num = np.zeros((0, runs))
    for k, p in enumerate(planned):
        statistic: FloatArray = np.zeros(runs)
        if isinstance(p.test, MaximumTest):
            num = p.test.carry(num, white[k])
            explained = num * num * p.test.inverse[:, None]
            statistic = explained.max(axis=0, initial=0.0)
        elif isinstance(p.test, QuadraticTest) and k >= SETTLED:
            statistic = _square(p.test, white[: k + 1])
        if k < SETTLED:
            continue
        new = np.flatnonzero((statistic > p.test.threshold) & (when < 0))
        when[new] = k - SETTLED
        if isinstance(p.test, MaximumTest):
            for run in new:
                who[run] = "+".join(p.test.hypothesis(int(explained[:, run].argmax()))[0].groups)
    return when, who


def _square(test: QuadraticTest, white: FloatArray) -> FloatArray:
    form = test.form
    return np.zeros(white.shape[2]) if form is None else form.statistic(list(white[-len(form.maps) :]))


def _delay_rows(delays: dict[str, IntArray], right: int, longest: int) -> list[Row]:
    median = {n: float(np.median(np.where(d < 0, longest, d))) for n, d in delays.items()}
    must = {"glr": "at most 25 s"}
    ok: dict[str, bool] = {"glr": median["glr"] <= 25.0}
    out = []
    for name, d in delays.items():
        reached = np.where(d < 0, longest, d)
        spread = [float(np.quantile(reached, q)) for q in (0.05, 0.95)]
        never = int((d < 0).sum())
        quantity = f"median delay of {name}, 0.1 m/s code ramp, P_FA 1e-6, {len(d)} runs, s"
        measured = median[name] if median[name] < longest else f"more than {longest}"
        quantity = f"{quantity} ({never} never)"
        out.append(_row(quantity, must.get(name, "stated"), measured, spread, ok.get(name)))
    ratio = median["glr"] / median["aime"]
    seen = int((delays["glr"] >= 0).sum())
    return [
        *out,
        _row("median delay of glr against exact aime (m = 5)", "at most 0.7", ratio, None, ratio <= 0.7),
        _row(
            "glr names the right satellite",
            "stated",
            right / max(seen, 1),
            binomial_interval(right, seen),
            None,
        ),
    ]
