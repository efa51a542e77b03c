"""CPU time of callables, and the ratios that a shared machine leaves meaningful."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

__all__ = ["cpu_each", "cpu_of", "markdown"]


def cpu_of(run: Callable[[], object], rounds: int = 3) -> float:
    """Return the CPU time of the fastest of some rounds, s."""
    best = float("inf")
    for _ in range(rounds):
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return best


def cpu_each(
    prepare: Callable[[int], Any], run: Callable[[Any], Any], epochs: Iterable[int], rounds: int = 3
) -> tuple[float, list[Any]]:
    """Return the mean CPU time of a call, s, in the fastest round, and what the last round returned.

    `prepare` is not timed, nor is a first call that warms caches.
    """
    chosen = list(epochs)
    best, results = float("inf"), list[Any]()
    run(prepare(chosen[0]))
    for _ in range(rounds):
        spent, results = 0.0, []
        for k in chosen:
            prepared = prepare(k)
            start = time.process_time()
            results.append(run(prepared))
            spent += time.process_time() - start
        best = min(best, spent / len(chosen))
    return best, results


def markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a Markdown table; all columns but the first are right-aligned."""
    rule = ("---", *("---:" for _ in head[1:]))
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows)) + "\n"
