"""The logs, and a summary of milliseconds an epoch beside RTKLIB's `pntpos` on the same file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_limits

from benchmarks.timing import cpu_each
from benchmarks.workload import DEFAULT_DATA, Workload, brux, demo

ROWS = pytest.StashKey[list[tuple[str, str, float]]]()
BASE = pytest.StashKey[dict[str, float]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--bench-data", type=Path, default=DEFAULT_DATA, help="folder of the real logs")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[ROWS], config.stash[BASE] = [], {}


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def works(request: pytest.FixtureRequest) -> Iterator[Any]:
    made: dict[str, Workload] = {}

    def work(name: str) -> Workload:
        if name not in made:
            try:
                made[name] = demo() if name == "demo" else brux(request.config.getoption("--bench-data"))
            except FileNotFoundError as error:
                pytest.skip(str(error))
            request.config.stash[BASE][name] = _pntpos(made[name])
        return made[name]

    yield work
    for w in made.values():
        w.close()


def _pntpos(work: Workload) -> float:
    """Return the CPU time of RTKLIB's fix of an epoch, s; nan where it is not installed."""
    try:
        from benchmarks.tools.rtklib import Rtklib

        tool = Rtklib(work, work.loaded.klobuchar is not None)
    except ImportError:
        return float("nan")
    return cpu_each(lambda k: tool.prepare(k, False), tool.fix, range(0, len(work.loaded.epochs), 5))[0]


@pytest.fixture
def noted(request: pytest.FixtureRequest) -> Any:
    """Keep the seconds an epoch of a measurement for the summary."""

    def note(log: str, name: str, seconds: float) -> None:
        request.config.stash[ROWS].append((log, name, seconds))

    return note


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    rows, base = config.stash[ROWS], config.stash[BASE]
    if not rows:
        return
    terminalreporter.section("CPU ms an epoch, and in units of RTKLIB's pntpos on the same file")
    for log, name, seconds in rows:
        ratio = seconds / base.get(log, float("nan"))
        terminalreporter.write_line(f"{log:6} {name:58} {seconds * 1e3:10.4f} {ratio:9.2f}")
    for log, seconds in base.items():
        terminalreporter.write_line(
            f"{log:6} {'RTKLIB pntpos (the unit)':58} {seconds * 1e3:10.4f}      1.00"
        )
