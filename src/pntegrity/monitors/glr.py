"""GLR: a windowed bank of generalised likelihood ratios over fault signatures and onsets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.bank import (
    Bank,
    IntArray,
    MaximumTest,
    Schedule,
    advance,
    empty_bank,
    parents,
    rearrange,
    stack_sources,
    step_of,
)  # fmt: skip
from pntegrity.kernels.signatures import catalogue, rows_touched
from pntegrity.kernels.tails import max_threshold
from pntegrity.monitors._options import check_epochs, check_test
from pntegrity.monitors._window import best_of_groups, is_ambiguous, no_redundancy, unavailable
from pntegrity.records import FloatArray, Suspect, Update, Verdict

KINDS: tuple[Literal["bias", "ramp"], ...] = ("bias", "ramp")


@dataclass(frozen=True, eq=False)
class GlrMemory:
    """What the GLR keeps: an epoch counter, the last time, one bank a kind, and the sums of the hypotheses
    (flat).
    """

    count: int
    last_ns: int
    banks: tuple[Bank, ...]
    num: FloatArray


@dataclass(frozen=True)
class Glr:
    """Windowed generalised likelihood ratio: which fault, since when, how large?

    Hypotheses: a bias or a ramp on any row, on all rows of a group (satellite), or of a family (constellation
    clock), since any of a thinned set of onsets; where a group has code and carrier, biases of its rows and
    ramps of the whole, since beside a float ambiguity the other kinds cannot be told from these: believe the
    satellite that is named, not the kind. Each signature is taken through the filter (what the state absorbs
    of it, the test does not expect to see). Statistic: the largest ``num^2 / den`` of the bank. Threshold:
    the false-alarm probability of the whole bank is at most `p_fa` an epoch, by Hunter's bound over the exact
    correlations of the hypotheses. Assumes white innovations. It cannot see a fault that was there when the
    filter or the satellite's states started, nor one that the states follow as fast as it grows. Memory:
    running sums, nothing is recomputed. Ours; it has no published variant.

    Parameters
    ----------
    p_fa : float
        Probability of a false alarm of the bank, an epoch.
    factor : float
        Multiplies the threshold (from a calibration).
    longest : int
        Oldest onset of a ramp, epochs; biases are followed for a quarter of it.
    variant : str
        ``"exact"``.

    References
    ----------
    Willsky and Jones (1976), A generalized likelihood ratio approach to the detection and estimation of
    jumps.

    Examples
    --------
    >>> Glr(p_fa=1e-6).start().count
    0
    """

    name: ClassVar[str] = "glr"
    p_fa: float = 1e-6
    factor: float = 1.0
    longest: int = 64
    variant: Literal["exact"] = "exact"

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant, ("exact",))
        check_epochs("longest", self.longest, 8)

    @property
    def schedules(self) -> tuple[Schedule, ...]:
        """Which onsets are kept for biases and for ramps."""
        return Schedule(1, 0, self.longest // 4), Schedule(4, 3, self.longest)

    def start(self) -> GlrMemory:
        """Return empty banks."""
        return GlrMemory(0, 0, tuple(empty_bank() for _ in KINDS), np.zeros(0))

    def plan(self, memory: GlrMemory, update: Update) -> tuple[MaximumTest, GlrMemory]:
        """Return the test of `update`, without data, and the memory after it, but for its sums (`num`)."""
        if not update.keys:
            return MaximumTest.impossible(no_redundancy(update)), self.start()
        if update.is_start:
            memory = self.start()
        banks, source, response = self._carried(memory, update)
        after = GlrMemory(memory.count + 1, update.t_ns, banks, np.zeros(0))
        inverse, rho = self._tested(after)
        if len(update.keys) <= update.consumed or not len(rho):
            none = np.zeros_like(inverse)
            return MaximumTest(banks, source, response, none, rho, reason=no_redundancy(update)), after
        threshold = self.factor * max_threshold(rho, self.p_fa) ** 2
        return MaximumTest(banks, source, response, inverse, rho, threshold, self.p_fa), after

    def step(self, memory: GlrMemory, update: Update) -> tuple[Verdict, GlrMemory]:
        """Test the bank after `update`."""
        test, after = self.plan(memory, update)
        if not update.keys:
            return unavailable(self.name, self.variant, update, test.reason), after
        num = test.carry(memory.num, update.white)
        return self._judge(test, num, update), replace(after, num=num)

    def _judge(self, test: MaximumTest, num: FloatArray, update: Update) -> Verdict:
        if test.reason:
            return unavailable(self.name, self.variant, update, test.reason)
        statistic = float((num * num * test.inverse).max())
        facts = (statistic, test.threshold, self.p_fa, 1)
        if statistic <= test.threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts)
        suspects = _suspects(test, num)
        return Verdict(
            self.name, self.variant, update.t_ns, "alert", *facts, suspects, is_ambiguous(suspects)
        )

    def _carried(self, memory: GlrMemory, update: Update) -> tuple[tuple[Bank, ...], IntArray, FloatArray]:
        """Return the banks after `update`, where their hypotheses stood before, and their whitened
        responses.
        """
        start_ns = memory.last_ns if memory.count else update.t_ns
        banks, sources, responses = [], [], []
        step = step_of(update.F, update.H, update.L, update.K)
        for kind, schedule, bank in zip(KINDS, self.schedules, memory.banks, strict=True):
            ready, source = rearrange(bank, catalogue(update.keys, kind), schedule, memory.count, start_ns)
            after, response = advance(ready, update.t_ns, rows_touched(update.keys, kind), step)
            banks.append(after)
            sources.append(source)
            responses.append(response)
        sizes = [b.den.size for b in memory.banks]
        return tuple(banks), stack_sources(sources, sizes), np.concatenate(responses)

    def _tested(self, memory: GlrMemory) -> tuple[FloatArray, FloatArray]:
        """Return ``1 / den`` of every hypothesis (0 where it is not tested) and the parent correlation of the
        tested.
        """
        inverse, rho = [], []
        for schedule, bank in zip(self.schedules, memory.banks, strict=True):
            linked = parents(bank.gram, schedule.tested(bank.onset, memory.count - 1)).ravel()
            tested = linked >= 0.0
            inverse.append(np.divide(1.0, bank.den.ravel(), out=np.zeros(len(linked)), where=tested))
            rho.append(linked[tested])
        return np.concatenate(inverse), np.concatenate(rho)


def _suspects(test: MaximumTest, num: FloatArray) -> tuple[Suspect, ...]:
    tested = np.flatnonzero(test.inverse)
    named = [test.hypothesis(int(i)) for i in tested]
    size = num[tested] * test.inverse[tested]
    return best_of_groups(tuple(s for s, _ in named), num[tested] * size, size, [t for _, t in named], most=4)
