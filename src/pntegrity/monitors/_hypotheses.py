"""A bank of fault hypotheses as a monitor carries it: biases and ramps, since a thinned set of onsets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pntegrity.kernels.bank import (
    Bank,
    MaximumTest,
    Schedule,
    advance,
    empty_bank,
    parents,
    rearrange,
    stack_sources,
    step_of,
)  # fmt: skip
from pntegrity.kernels.signatures import Signature
from pntegrity.kernels.tails import max_threshold
from pntegrity.monitors._window import no_redundancy
from pntegrity.records import FloatArray, Update

__all__ = ["KINDS", "HypothesesMemory", "Looks", "plan", "schedules"]

KINDS: tuple[Literal["bias", "ramp"], ...] = ("bias", "ramp")
Looks = Callable[[Update, str], tuple[tuple[Signature, ...], tuple[FloatArray, FloatArray]]]
"""From an update and a kind: the faults that are looked for, and the rows (m, s) that grow and that jump."""


@dataclass(frozen=True, eq=False)
class HypothesesMemory:
    """What is kept: an epoch counter, the last time, one bank a kind, and the sums of the hypotheses
    (flat).
    """

    count: int
    last_ns: int
    banks: tuple[Bank, ...]
    num: FloatArray

    @staticmethod
    def empty() -> HypothesesMemory:
        """Return empty banks."""
        return HypothesesMemory(0, 0, tuple(empty_bank() for _ in KINDS), np.zeros(0))


def schedules(longest: int) -> tuple[Schedule, ...]:
    """Return which onsets are kept for biases and for ramps; `longest`: the oldest of a ramp, epochs."""
    return Schedule(1, 0, longest // 4), Schedule(4, 3, longest)


def plan(
    memory: HypothesesMemory, update: Update, looks: Looks, longest: int, p_fa: float, factor: float
) -> tuple[MaximumTest, HypothesesMemory]:
    """Return the test of `update`, without data, and the memory after it, but for its sums (`num`)."""
    if not update.keys:
        return MaximumTest.impossible(no_redundancy(update)), HypothesesMemory.empty()
    if update.is_start:
        memory = HypothesesMemory.empty()
    chosen = schedules(longest)
    start_ns = memory.last_ns if memory.count else update.t_ns
    banks, sources, responses = [], [], []
    step = step_of(update.F, update.H, update.L, update.K)
    for kind, schedule, bank in zip(KINDS, chosen, memory.banks, strict=True):
        signatures, touched = looks(update, kind)
        ready, source = rearrange(bank, signatures, schedule, memory.count, start_ns)
        after, response = advance(ready, update.t_ns, touched, step)
        banks.append(after)
        sources.append(source)
        responses.append(response)
    source = stack_sources(sources, [b.den.size for b in memory.banks])
    carried = HypothesesMemory(memory.count + 1, update.t_ns, tuple(banks), np.zeros(0))
    inverse, rho = _tested(carried, chosen)
    response = np.concatenate(responses)
    if len(update.keys) <= update.consumed or not len(rho):
        none = np.zeros_like(inverse)
        reason = no_redundancy(update)
        return MaximumTest(carried.banks, source, response, none, rho, reason=reason), carried
    threshold = factor * max_threshold(rho, p_fa) ** 2
    return MaximumTest(carried.banks, source, response, inverse, rho, threshold, p_fa), carried


def _tested(memory: HypothesesMemory, chosen: tuple[Schedule, ...]) -> tuple[FloatArray, FloatArray]:
    """Return ``1 / den`` of every hypothesis (0 where it is not tested) and the parent correlation of the
    tested.
    """
    inverse, rho = [], []
    for schedule, bank in zip(chosen, memory.banks, strict=True):
        linked = parents(bank.gram, schedule.tested(bank.onset, memory.count - 1)).ravel()
        tested = linked >= 0.0
        inverse.append(np.divide(1.0, bank.den.ravel(), out=np.zeros(len(linked)), where=tested))
        rho.append(linked[tested])
    return np.concatenate(inverse), np.concatenate(rho)
