"""The cost of each of our stages on the real BRUX log and on the embedded demo, and the audit rates."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.stages import Stage, audit_stages, log_stages, monitor_variants
from pntegrity.estimators import discover
from pntegrity.scenarios.evidence_rtk_speed import SINGLES, WARM_PAIRS, bank_load

pytestmark = pytest.mark.benchmark(timer=time.process_time, warmup=True, min_rounds=3)

NAMES = [
    "read observations", "read navigation", "satellite states", "epochs, with satellite states",
    *(f"{name}: {step}" for name in discover() for step in ("predict", "correct")),
    *(f"{name}, {variant}: step" for name, variant in monitor_variants()),
    "push: spp_kf, five monitors", "push: the same while three satellites are 60 m off", "write all results",
]  # fmt: skip


@pytest.fixture(scope="module")
def stages(works: Callable[[str], Any]) -> Callable[[str, str], Stage | None]:
    made: dict[str, tuple[Iterator[Stage], dict[str, Stage]]] = {}

    def stage(log: str, name: str) -> Stage | None:
        if log not in made:
            made[log] = (log_stages(works(log)), {})
        source, known = made[log]
        while name not in known and (found := next(source, None)) is not None:
            known[found.name] = found
        return known.get(name)

    return stage


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("log", ["brux", "demo"])
def test_stage(benchmark: Any, stages: Any, noted: Any, log: str, name: str) -> None:
    stage = stages(log, name)
    if stage is None:
        pytest.skip("only on the log that these faults were chosen for")
    benchmark.group = log
    benchmark.pedantic(stage.run, rounds=3, warmup_rounds=1)
    if benchmark.stats is None:
        return
    each = benchmark.stats.stats.min / stage.units
    benchmark.extra_info["ms_an_epoch"] = each * 1e3
    noted(log, name, each)


AUDITS = [f"audit {name}, {variant}" for name, variant in monitor_variants()]


@pytest.mark.parametrize("name", AUDITS)
def test_audit_rate(benchmark: Any, noted: Any, name: str) -> None:
    stage = next(s for s in audit_stages() if s.name == name)
    benchmark.group = "audit"
    benchmark.pedantic(stage.run, rounds=3, warmup_rounds=1)
    if benchmark.stats is None:
        return
    each = benchmark.stats.stats.min / stage.units
    benchmark.extra_info["tests_a_cpu_second"] = 1.0 / each
    noted("audit", f"{name}: {1.0 / each:.3g} epoch-tests a CPU second", each)


BANKS = {"20 subfilters": SINGLES, "20 subfilters and 136 pairs": SINGLES + WARM_PAIRS}


@pytest.mark.parametrize("own", [3, 4])
@pytest.mark.parametrize("name", BANKS)
def test_bank(benchmark: Any, noted: Any, name: str, own: int) -> None:
    load = bank_load(BANKS[name], own, np.random.default_rng(4))
    benchmark.group = "bank"
    benchmark.pedantic(load.advanced, rounds=10, warmup_rounds=1)
    if benchmark.stats is None:
        return
    each = benchmark.stats.stats.min
    benchmark.extra_info["ms_an_epoch"] = each * 1e3
    noted("bank", f"{name}, {load.size}: {each * 1e3:.2f} ms an epoch", each)
