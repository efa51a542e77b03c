"""Other tools on the same file; the page with ratios and accuracy is made by ``python -m
benchmarks.peers``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from benchmarks.peers import tools_for
from benchmarks.workload import FIRST, LAST

pytestmark = pytest.mark.benchmark(timer=time.process_time)


@pytest.fixture(scope="module")
def tools(works: Callable[[str], Any]) -> Any:
    return tools_for(works("brux"))


@pytest.mark.parametrize("tool", ["pntegrity", "RTKLIB", "sidereon", "gnss_lib_py"])
@pytest.mark.parametrize("work", ["read_observations", "read_navigation", "states", "fix", "fix_excluding"])
def test_tool(benchmark: Any, tools: Any, noted: Any, tool: str, work: str) -> None:
    found, absent = tools
    if tool in absent:
        pytest.skip(absent[tool])
    if not hasattr(found[tool], work):
        pytest.skip(f"{tool} has no such call on a file")
    benchmark.group = f"peers: {work}"
    call, epochs = getattr(found[tool], work), list(range(FIRST, LAST))
    if work.startswith("read"):
        units = call() if work == "read_observations" else 1
        benchmark.pedantic(call, rounds=3)
    else:
        units = len(epochs)
        prepared = [found[tool].prepare(k, False) for k in epochs]
        benchmark.pedantic(lambda: [call(p) for p in prepared], rounds=3, warmup_rounds=1)
    if benchmark.stats is not None:
        noted("brux", f"{tool}: {work.replace('_', ' ')}", benchmark.stats.stats.min / units)
