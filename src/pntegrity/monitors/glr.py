"""GLR: a windowed bank of generalised likelihood ratios over fault signatures and onsets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.bank import MaximumTest, Schedule
from pntegrity.kernels.signatures import Signature, catalogue, rows_touched
from pntegrity.monitors import _hypotheses
from pntegrity.monitors._hypotheses import HypothesesMemory
from pntegrity.monitors._options import check_epochs, check_test
from pntegrity.monitors._window import best_of_groups, is_ambiguous, unavailable
from pntegrity.records import FloatArray, Suspect, Update, Verdict


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
        return _hypotheses.schedules(self.longest)

    def start(self) -> HypothesesMemory:
        """Return empty banks."""
        return HypothesesMemory.empty()

    def plan(self, memory: HypothesesMemory, update: Update) -> tuple[MaximumTest, HypothesesMemory]:
        """Return the test of `update`, without data, and the memory after it, but for its sums (`num`)."""
        return _hypotheses.plan(memory, update, _looks, self.longest, self.p_fa, self.factor)

    def step(self, memory: HypothesesMemory, update: Update) -> tuple[Verdict, HypothesesMemory]:
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


def _looks(update: Update, kind: str) -> tuple[tuple[Signature, ...], tuple[FloatArray, FloatArray]]:
    return catalogue(update.keys, kind), rows_touched(update.keys, kind)


def _suspects(test: MaximumTest, num: FloatArray) -> tuple[Suspect, ...]:
    tested = np.flatnonzero(test.inverse)
    named = [test.hypothesis(int(i)) for i in tested]
    size = num[tested] * test.inverse[tested]
    return best_of_groups(tuple(s for s, _ in named), num[tested] * size, size, [t for _, t in named], most=4)
