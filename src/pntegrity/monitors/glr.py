"""GLR: a windowed bank of generalised likelihood ratios over fault signatures and onsets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.bank import Bank, Schedule, advance, empty_bank, parents, rearrange
from pntegrity.kernels.signatures import Signature, catalogue
from pntegrity.kernels.tails import max_threshold
from pntegrity.monitors._window import best_of_groups, is_ambiguous, is_start, no_redundancy, unavailable
from pntegrity.records import FloatArray, Update, Verdict

KINDS: tuple[Literal["bias", "ramp"], ...] = ("bias", "ramp")


@dataclass(frozen=True, eq=False)
class GlrMemory:
    """What the GLR keeps: an epoch counter, the last time, one bank a kind."""

    count: int
    last_ns: int
    banks: tuple[Bank, ...]


@dataclass(frozen=True)
class Glr:
    """Windowed generalised likelihood ratio: which fault, since when, how large?

    Hypotheses: a bias or a ramp on any row, on all rows of a group (satellite), or of a family (constellation clock),
    since any of a thinned set of onsets. Each signature is taken through the filter (what the state absorbs of it, the
    test does not expect to see). Statistic: the largest ``num^2 / den`` of the bank. Threshold: the false-alarm
    probability of the whole bank is at most `p_fa` an epoch, by Hunter's bound over the exact correlations of the
    hypotheses. Assumes white innovations. It cannot see a fault that was there when the filter or the satellite's
    states started, nor one that the states follow as fast as it grows. Memory: running sums, nothing is recomputed.
    Ours; it has no published variant.

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
    Willsky and Jones (1976), A generalized likelihood ratio approach to the detection and estimation of jumps.

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
        if self.longest < 8:
            raise ValueError(f"`longest` must be at least 8 epochs, not {self.longest}")

    @property
    def schedules(self) -> tuple[Schedule, ...]:
        """Which onsets are kept for biases and for ramps."""
        return Schedule(1, 0, self.longest // 4), Schedule(4, 3, self.longest)

    def start(self) -> GlrMemory:
        """Return empty banks."""
        return GlrMemory(0, 0, tuple(empty_bank() for _ in KINDS))

    def advance(self, memory: GlrMemory, update: Update) -> GlrMemory:
        """Return the banks after `update`."""
        if is_start(update):
            memory = self.start()
        start_ns = memory.last_ns if memory.count else update.t_ns
        banks = []
        for kind, schedule, bank in zip(KINDS, self.schedules, memory.banks, strict=True):
            ready = rearrange(bank, catalogue(update.keys, kind), schedule, memory.count, start_ns)
            banks.append(advance(ready, update.t_ns, update.keys, update.F, update.H, update.L, update.K, update.white))
        return GlrMemory(memory.count + 1, update.t_ns, tuple(banks))

    def step(self, memory: GlrMemory, update: Update) -> tuple[Verdict, GlrMemory]:
        """Test the bank after `update`."""
        if not update.keys:
            return unavailable(self.name, self.variant, update, no_redundancy(update)), self.start()
        after = self.advance(memory, update)
        signatures, onset_ns, num, den, rho = self._candidates(after)
        if len(update.keys) <= update.consumed or not len(num):
            return unavailable(self.name, self.variant, update, no_redundancy(update)), after
        threshold = self.factor * max_threshold(rho, self.p_fa) ** 2
        explained = num * num / den
        statistic = float(explained.max())
        status: Literal["ok", "alert"] = "alert" if statistic > threshold else "ok"
        suspects = ()
        if status == "alert":
            suspects = best_of_groups(signatures, explained, num / den, list(onset_ns), most=4)
        return (
            Verdict(
                self.name, self.variant, update.t_ns, status, statistic, threshold, self.p_fa, 1, suspects, is_ambiguous(suspects)
            ),
            after,
        )

    def _candidates(
        self, memory: GlrMemory
    ) -> tuple[tuple[Signature, ...], FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return signature, onset, sums and parent correlation of every hypothesis that is tested now."""
        signatures: list[Signature] = []
        onset, num, den, rho = [], [], [], []
        for schedule, bank in zip(self.schedules, memory.banks, strict=True):
            linked = parents(bank.gram, schedule.tested(bank.onset, memory.count - 1))
            s, o = np.nonzero((linked >= 0.0) & (bank.den > 1e-9))
            signatures += [bank.signatures[i] for i in s]
            onset.append(bank.onset_ns[o])
            num.append(bank.num[s, o])
            den.append(bank.den[s, o])
            rho.append(linked[s, o])
        return tuple(signatures), np.concatenate(onset), np.concatenate(num), np.concatenate(den), np.concatenate(rho)
