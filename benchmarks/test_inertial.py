"""The inertial filter at 125 Hz with ten epochs a second, and beside python-ins, in the same run."""

from __future__ import annotations

import time
from typing import Any

import pytest

from benchmarks.timing import cpu_of
from pntegrity.scenarios._python_ins import available
from pntegrity.scenarios.evidence_ins_speed import (
    FastLog,
    fast_log,
    filter_of,
    fixes_only,
    python_ins,
    updates,
)

pytestmark = pytest.mark.benchmark(timer=time.process_time, warmup=True, min_rounds=3)

SECONDS = 30.0


@pytest.fixture(scope="module")
def fast(request: pytest.FixtureRequest) -> FastLog:
    try:
        return fast_log(request.config.getoption("--bench-data"), SECONDS)
    except FileNotFoundError as error:
        pytest.skip(str(error))


def _noted(benchmark: Any, noted: Any, name: str, log: FastLog) -> None:
    if benchmark.stats is None:
        return
    spent = benchmark.stats.stats.min
    benchmark.extra_info["times_real_time"] = log.seconds / spent
    noted("nagoya", f"{name}: {log.seconds / spent:.0f} times real time", spent / len(log.epochs))


@pytest.mark.parametrize(
    ("coupling", "fde"), [("tight", "ours"), ("tight", "none"), ("loose", "factor-set"), ("loose", "none")]
)
def test_rows(benchmark: Any, noted: Any, fast: FastLog, coupling: str, fde: str) -> None:
    estimator = filter_of(fast, coupling, fde)
    benchmark.group = "inertial"
    benchmark.pedantic(lambda: updates(estimator, fast.epochs), rounds=3, warmup_rounds=1)
    _noted(benchmark, noted, f"gnss_ins, {coupling}, {fde}", fast)


@pytest.mark.filterwarnings("ignore:The copy keyword")  # python-ins on a new pandas
def test_fixes_beside_python_ins(benchmark: Any, noted: Any, fast: FastLog) -> None:
    estimator, epochs = filter_of(fast, "loose", "none"), fixes_only(fast)
    first = updates(estimator, epochs[:1])[0].posterior
    benchmark.group = "inertial"
    benchmark.pedantic(lambda: updates(estimator, epochs), rounds=3, warmup_rounds=1)
    _noted(benchmark, noted, "gnss_ins, fixes", fast)
    if benchmark.stats is None or not available():
        return
    python_ins(fast, epochs, first)
    theirs = cpu_of(lambda: python_ins(fast, epochs, first), rounds=1)
    benchmark.extra_info["times_as_fast_as_python_ins"] = theirs / benchmark.stats.stats.min
    noted("nagoya", f"python-ins, fixes: {fast.seconds / theirs:.0f} times real time", theirs / len(epochs))
