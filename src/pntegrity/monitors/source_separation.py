"""Which source of navigation is at fault: combinations that leave some out, and who explains the rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.bank import MaximumTest
from pntegrity.kernels.source_test import left_out
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.monitors import _hypotheses
from pntegrity.monitors._explanations import Explanation, explanations, minimal
from pntegrity.monitors._gains import Gains
from pntegrity.monitors._hypotheses import HypothesesMemory
from pntegrity.monitors._members import in_order
from pntegrity.monitors._options import check_epochs, check_sets, check_test
from pntegrity.monitors._sources import Evidence, looks, sensors_in, sensors_of, sources_in
from pntegrity.monitors._window import no_redundancy, unavailable
from pntegrity.records import FloatArray, Suspect, Update, Verdict, group_of

__all__ = ["SourceMemory", "SourceSeparation"]

#: Sources that are tried alone, and among which two or three are, the most suspicious first.
ALONE, AMONG = 6, 4
UNEXPLAINED = "no set of sources explains the data alone"


@dataclass(frozen=True, eq=False)
class SourceMemory:
    """What is kept: the bank of hypotheses and the updates that it can date a fault to (`exact`); each
    source's statistic over its threshold in the epoch before (`published`).
    """

    bank: HypothesesMemory
    window: tuple[Update, ...] = ()
    before: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class SourceSeparation:
    """Source separation: which source of navigation is at fault, or which several, or who cannot be told.

    Hypotheses: a bias or a ramp of any sensor, of several sensors of a source at once, or of a source as if
    the position were elsewhere, since any of a thinned set of onsets. Statistic: the largest that one of them
    explains of the window (`exact`; a generalised likelihood ratio). Threshold: the false-alarm
    probability of all together is at most `p_fa` an epoch, by Hunter's bound over their exact correlations.
    Then the window is looked at without each source, and without several: those without which nothing is left
    that has another explanation (at a probability of `p_identify`) explain it. One such set is named; are
    there several, and none whose own faults explain more by a margin, the verdict is `ambiguous` and holds
    all of them, the most likely first. The margin is larger where either set is of several sources: a drift
    on which these agree looks like a fault of another. Where all other candidates need more sources at fault
    at once, the first may be left out in doubt (`Verdict.foremost`). Left-out rows of one epoch alone would
    blame a healthy source once the prior has followed a ramp.

    `published` is that test of left-out rows, each source's against the others and the prior they share; a
    source is isolated after two exceedances in a row, which the statistic has as the smaller of both. `p_fa`
    is then that of one source and epoch.

    It cannot see a fault that the state follows as fast as it grows, nor, `exact`, tell the source of one
    that began before the window. Memory: the window's updates and the sums of the hypotheses.

    Parameters
    ----------
    p_fa : float
        Probability of a false alarm, an epoch.
    variant : str
        ``"exact"`` or ``"published"``.
    factor : float
        Multiplies the threshold (from a calibration).
    longest : int
        Oldest onset, epochs.
    together : int
        How many sources may be at fault at once; see `bounds.risk_tree` for how many that must be.
    p_identify : float
        Probability with which the sources at fault are not found to explain the data alone.

    References
    ----------
    Chen and Zhao (2023), Multi-level autonomous integrity monitoring method for multi-source PNT resilient
    fusion navigation, eqs (1)-(4), Table 1.

    Examples
    --------
    >>> SourceSeparation(p_fa=1e-6).name
    'source_separation'
    """

    name: ClassVar[str] = "source_separation"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    longest: int = 40
    together: int = 2
    p_identify: float = 1e-3

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_epochs("longest", self.longest, 8)
        check_sets("together", self.together, self.p_identify)

    @property
    def kept(self) -> int:
        """Epochs of the window: half as many again as the oldest onset, for what was before it."""
        return self.longest + self.longest // 2

    def start(self) -> SourceMemory:
        """Return the memory of a monitor that has seen nothing."""
        return SourceMemory(HypothesesMemory.empty())

    def plan(self, memory: SourceMemory, update: Update) -> tuple[MaximumTest, SourceMemory]:
        """Return the test of `update` (`exact`), without data, and the memory after it, but for its sums."""
        test, bank = _hypotheses.plan(memory.bank, update, looks, self.longest, self.p_fa, self.factor)
        window = () if update.is_start or not update.keys else memory.window
        return test, SourceMemory(bank, (*window, update)[-self.kept :] if update.keys else ())

    def step(self, memory: SourceMemory, update: Update) -> tuple[Verdict, SourceMemory]:
        """Test the sources after `update`."""
        if self.variant == "published":
            return self._published(memory, update)
        test, after = self._taken(memory, update)
        if test.reason or not update.keys:
            return unavailable(self.name, self.variant, update, test.reason), after
        statistic = float((after.bank.num**2 * test.inverse).max())
        facts = (statistic, test.threshold, self.p_fa, 1)
        if statistic <= test.threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts), after
        return self._named(
            after.window, Verdict(self.name, self.variant, update.t_ns, "alert", *facts)
        ), after

    def carry(self, memory: SourceMemory, update: Update) -> SourceMemory:
        """Return the memory after `update`, whose verdict nobody wants."""
        if self.variant == "published":
            return self._published(memory, update)[1]
        return self._taken(memory, update)[1]

    def _taken(self, memory: SourceMemory, update: Update) -> tuple[MaximumTest, SourceMemory]:
        test, after = self.plan(memory, update)
        if not update.keys:
            return test, after
        num = test.carry(memory.bank.num, update.white)
        return test, replace(after, bank=replace(after.bank, num=num))

    def _named(self, window: tuple[Update, ...], verdict: Verdict) -> Verdict:
        evidence = Evidence.of(tuple(map(_ordered, window)))  # rounding must not choose between equals
        found = Identification.of(evidence, evidence.white, self.together, self.p_identify)
        present = {group for u in window for group in u.groups()}  # sources may measure in turn
        suspects = tuple(s for s in found.suspects() if present.issuperset(s.groups))
        ambiguous = len(found.candidates) != 1
        return replace(verdict, suspects=suspects, ambiguous=ambiguous, reason=found.reason)

    def _published(self, memory: SourceMemory, update: Update) -> tuple[Verdict, SourceMemory]:
        if len(update.keys) <= update.consumed:
            return unavailable(self.name, self.variant, update, no_redundancy(update)), self.start()
        at = in_order(update.keys)  # whatever the order of the rows
        nu, S = update.nu[at], update.S[np.ix_(at, at)]
        groups = np.array([group_of(update.keys[i]) for i in at])
        found = {g: left_out(nu, S, np.flatnonzero(groups == g)) for g in sorted(set(groups.tolist()))}
        now = {g: one.ratio(self.p_fa) for g, one in found.items()}
        before = dict(memory.before)
        both = {g: min(ratio, before.get(g, 0.0)) for g, ratio in now.items()}
        worst = max(both, key=lambda g: both[g])
        dof = len(found[worst].residual)
        threshold = self.factor * chi2_threshold(self.p_fa, dof)
        statistic = both[worst] * chi2_threshold(self.p_fa, dof)
        after = replace(memory, before=tuple(now.items()))
        facts = (statistic, threshold, self.p_fa, dof)
        if statistic <= threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts), after
        isolated = sorted((g for g in both if both[g] > self.factor), key=lambda g: -both[g])
        suspects = tuple(
            Suspect((g,), "bias", float(np.abs(found[g].residual).max()), update.t_ns, found[g].square)
            for g in isolated
        )
        return Verdict(self.name, self.variant, update.t_ns, "alert", *facts, suspects), after


@dataclass(frozen=True, eq=False)
class Identification:
    """Who explains a window: the sets of sources that were tried, and those that do.

    Parameters
    ----------
    evidence : Evidence
    explained : ndarray
        What each fault explains.
    tried : tuple of Explanation
    """

    evidence: Evidence
    explained: FloatArray
    tried: tuple[Explanation, ...] = field(default=())

    @staticmethod
    def of(evidence: Evidence, white: FloatArray, together: int, p: float) -> Identification:
        """Return who explains whitened innovations, shape (D,).

        Parameters
        ----------
        together : int
            The largest set that is tried.
        p : float
            Probability with which those who are at fault are not found.
        """
        gains = Gains(evidence, white[:, None])
        first = Identification(evidence, gains.explained[:, 0])
        ranked = evidence.ranked(first.explained)
        sets = [
            names
            for size in range(1, together + 1)
            for names in combinations(ranked[: ALONE if size == 1 else AMONG], size)
            if size < len(ranked) or size == 1
        ]
        tried = explanations(gains, sets, p)[0]
        return replace(first, tried=tuple(tried))

    @property
    def candidates(self) -> tuple[Explanation, ...]:
        """The smallest sets that explain the data alone."""
        return minimal(self.tried)

    @property
    def reason(self) -> str:
        """In words, where not one set is named."""
        if not self.candidates:
            return UNEXPLAINED
        if len(self.candidates) == 1:
            return ""
        return "at fault may be " + " or ".join("+".join(c.names) for c in self.candidates)

    def suspects(self) -> tuple[Suspect, ...]:
        """Return the candidates, the most likely first; where there are none, the most suspicious sources."""
        sets: Sequence[Iterable[str]] = [c.names for c in self.candidates] or [
            (g,) for g in self.evidence.ranked(self.explained)[:4]
        ]
        found = (self._suspect(tuple(names)) for names in sets)
        return tuple(s for s in found if s is not None)

    def _suspect(self, names: tuple[str, ...]) -> Suspect | None:
        i = self.evidence.best(self.explained, names)
        if i < 0:
            return None
        named, faults = self.evidence.faults
        kind, signature = named[faults.signature[i]]
        mean = faults.means[:, i]
        size = float(mean @ self.evidence.white / (mean @ mean)) if mean.any() else 0.0
        onset_ns = self.evidence.window[int(faults.onset[i])].t_ns
        first = sorted(names, key=lambda g: g not in sources_in(signature))
        sensors = sensors_in(signature) if len(first) == 1 else ()
        if set(sensors) == set(sensors_of(self.evidence.keys).get(first[0], ())):
            sensors = ()  # all that the source has
        return Suspect(tuple(first), kind, size, onset_ns, float(self.explained[i]), sensors)


@lru_cache(maxsize=256)
def _ordered(update: Update) -> Update:
    """Return the update with its rows in the order of their names."""
    at = in_order(update.keys)
    if np.array_equal(at, np.arange(len(at))):
        return update
    aux = {name: values[at] for name, values in update.aux.items()}
    keys = tuple(update.keys[i] for i in at)
    return replace(update, keys=keys, nu=update.nu[at], H=update.H[at], R=update.R[np.ix_(at, at)], aux=aux)
