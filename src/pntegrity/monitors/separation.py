"""Multiple-hypothesis solution separation: a bank of subfilters, and protection levels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import names_of
from pntegrity.bounds.sectors import Sectors, with_risen
from pntegrity.kernels.axes import local_axes, track_axes
from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.kernels.companions import Companions, accompany
from pntegrity.kernels.separation import Subfilters, advance, gains, predicted, replicate
from pntegrity.monitors._biases import with_nominal
from pntegrity.monitors._levels import (
    NO_MODES,
    Spread,
    beyond,
    bound_of,
    factors,
    silence,
    still_born,
    why_untested,
)
from pntegrity.monitors._members import Cast, Member, Sources, cast_of, in_order, nested, sources, used_rows
from pntegrity.monitors._options import check_test
from pntegrity.monitors._sectors import azimuths, why_unplaced
from pntegrity.monitors._suspects import suspects_of
from pntegrity.monitors._window import no_redundancy, unavailable
from pntegrity.records import FloatArray, Layout, State, Status, Update, Verdict, join_reasons
from pntegrity.states import source_of

BoolArray = npt.NDArray[np.bool_]
#: What a group that is out of view moves the position by, in standard deviations, to be remembered.
FORGOTTEN = 0.05
#: The same of a separation that nobody has tested: five times what is expected then.
UNTESTED = 0.25
#: A way has a course where it is this many standard deviations long, and this many metres.
COURSE_SIGMA, COURSE_M = 5.0, 0.5
NO_ALERTS = "levels are made of the separations observed: these give no alert"


@dataclass(frozen=True, eq=False)
class SeparationMemory:
    """What the separation monitor keeps: its subfilters in the states of `layout`, and whom they are without.

    `groups` are those in view or not yet forgotten, `where_m` the last position. Of each member `began_ns` is
    when what it is without was left out (or since ever, when the bank began), and `born_m2` the variance with
    which its position was born, where rows have not determined it since; `loose`: it is no part of the filter
    (see `Sources`). `ordered`: see `cast_of`. `biased`
    are the rows with a nominal bias that the bank carries, `sectors` who fails together with whom, `seen_ns`
    when there last were any rows (or the bank began).
    """

    t_ns: int = 0
    layout: Layout = field(default_factory=Layout)
    members: tuple[Member, ...] = ()
    bank: Subfilters | None = None
    groups: tuple[str, ...] = ()
    began_ns: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    born_m2: FloatArray = field(default_factory=lambda: np.zeros(0))
    where_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    loose: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    ordered: bool = False
    biased: tuple[str, ...] = ()
    beside: Companions | None = None
    sectors: Sectors = ()
    seen_ns: int = 0


@dataclass(frozen=True, eq=False)
class _Step:
    """How a bank goes into an epoch: where its members come from, and what is known of them."""

    bank: Subfilters
    F: FloatArray
    Q: FloatArray
    sources: Sources
    began_ns: npt.NDArray[np.int64]
    born_m2: FloatArray
    loose: BoolArray
    beside: Companions | None = None


@dataclass(frozen=True)
class Separation:
    """Solution separation of a filter and its subfilters, each without what one fault mode may have spoilt.

    Hypotheses: the fault modes of the integrity support message: satellites, atmosphere products,
    constellations, azimuth sectors and other groups that fail together, and several at once until the rest is
    improbable enough. Each has a subfilter that never used the rows it touches. Statistic: the largest
    separation of a subfilter's position from the filter's, east, north or up (and along and across the track,
    where there is a course), over its threshold.
    Threshold: 1; each separation is allowed ``K sigma_ss`` with ``sigma_ss^2 = P_i - P_0``, or the exact
    variance where the rows' errors are believed to differ from what the gains are made of
    (`Update.R_accuracy`). `p_fa` is that of all tests of an epoch together, by the sum over modes and
    directions. The verdict's `bound` holds the protection levels. It cannot see what moves the position less
    than the thresholds: that is what the levels are for. Nor a fault that began before the bank did.

    On an alert the suspects are events without which a subfilter agrees with those without yet another: the
    worst of these re-tests is the suspect's statistic, and the smallest is the best (`exact`). The largest
    normalised separation, which the paper has, names a healthy satellite in 12 to 28 % of cases
    (`published`). Where an exclusion follows, the filter goes on from that subfilter. Memory: mean and
    covariance of each subfilter; those without two events stand ready for a re-test.

    Parameters
    ----------
    p_fa : float
        Probability of a false alert, an epoch.
    variant : str
        ``"exact"`` or ``"published"``: levels only without an alert, no pairs.
    factor : float
        Multiplies the thresholds (from a calibration).
    ism : Ism
        The integrity support message.
    pairs : bool
        Whether subfilters without any two events are carried: they tell who is at fault, and make levels
        after an exclusion exact. They cost most of the time.
    levels : str
        ``"tested"``: levels hold where no alert is given. ``"observed"``: they are made of the separations as
        they are, so that they hold whatever these are, and grow where hypotheses disagree. There is no alert
        then for a large separation, only `unavailable` where a level is above its alert limit
        (`kernels.protection.observed_level` has the proof).

    References
    ----------
    Wang et al. (2022), Integrity monitoring of PPP-RTK based on multiple hypothesis solution separation, eqs
    (10)-(14). Blanch et al. (2015), Baseline advanced RAIM user algorithm and possible improvements.

    Examples
    --------
    >>> Separation(p_fa=1e-6).start().members
    ()
    """

    name: ClassVar[str] = "separation"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    ism: Ism = field(default_factory=Ism)
    pairs: bool = True
    levels: Literal["tested", "observed"] = "tested"

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        if not isinstance(self.ism, Ism):
            raise ValueError(f"`ism` must be an integrity support message, not {self.ism!r}")
        if not isinstance(self.pairs, bool):
            raise ValueError(f"`pairs` must be true or false, not {self.pairs!r}")
        if self.levels not in ("tested", "observed"):
            raise ValueError(f"`levels` must be 'tested' or 'observed', not {self.levels!r}")

    @property
    def resumes(self) -> bool:
        """Whether the bank goes on from before a fault where the past is run again: levels that need no alert
        then go on for faults since the same beginning.
        """
        return self.levels == "observed"

    def start(self) -> SeparationMemory:
        """Return the memory of a bank that has not begun."""
        return SeparationMemory()

    def subfilter(self, memory: SeparationMemory, state: State, groups: frozenset[str]) -> State:
        """Return the belief of the filter that never knew `groups`; see `protocols.Switching`."""
        if memory.bank is None or memory.t_ns != state.t_ns:
            return state
        without = self._events(memory, groups)
        chosen = sources(memory.members, ((),), without, memory.ordered).origin
        mean = state.mean + memory.bank.delta[chosen]
        return replace(state, mean=mean, P=memory.bank.P[chosen])

    def step(self, memory: SeparationMemory, update: Update) -> tuple[Verdict, SeparationMemory]:
        """Take the bank through `update` and compare positions."""
        if not len(update.prior):
            return unavailable(self.name, self.variant, update, no_redundancy(update)), self.start()
        cast, after = self.carried(memory, update)
        position = update.posterior.layout.block("pos")
        if not len(position) or (self.levels == "tested" and not update.keys):
            why = no_redundancy(update) if not update.keys else "there is no position among the states"
            return unavailable(self.name, self.variant, update, why), after
        spread = self._spread(memory, after, update)
        since_ns = int(after.began_ns[: 1 + len(cast.faults.monitored)].max())
        note = join_reasons([why_unplaced(self.ism, after.sectors, update), silence(update, after.seen_ns)])
        verdict = self._judge(spread, cast, update, since_ns, note)
        return verdict, replace(after, groups=self._remembered(after.groups, update, cast, spread))

    def plan(self, memory: SeparationMemory, update: Update) -> tuple[CarriedTest, SeparationMemory]:
        """Return the test of `update`, without data, and the memory after it; without pairs."""
        alone = replace(self, pairs=False)
        if not len(update.prior):
            return CarriedTest.impossible(no_redundancy(update)), self.start()
        cast, after = alone.carried(memory, update)
        position = update.posterior.layout.block("pos")
        if not len(position) or not update.keys:
            return CarriedTest.impossible(no_redundancy(update)), after
        spread = alone._spread(replace(memory, where_m=np.zeros(0)), after, update)
        allowed = self._allowed(spread, cast)
        step = alone._into(memory, update, cast)
        prior = predicted(step.bank.P[step.sources.member], step.F, step.Q)
        K = gains(prior, update.H, update.R, used_rows(cast, update.keys))
        axes = np.zeros((3, len(update.prior)))
        axes[:, position] = local_axes(after.where_m)
        inverse = np.zeros((len(cast.members), 3))
        inverse[1 : 1 + len(allowed)] = np.divide(
            1.0, allowed, out=np.zeros_like(allowed), where=allowed > 0.0
        )
        test = CarriedTest(
            step.sources.member, (np.eye(len(prior[0])) - K @ update.H) @ step.F, (K - update.K) @ update.L,
            axes,
            inverse, alone._factors(spread, cast), self.factor, self.p_fa,
            1 + round((update.t_ns - int(step.began_ns[0])) * 1e-9),
            self._untested(bool(inverse.any())),
        )  # fmt: skip
        after = replace(after, groups=self._remembered(after.groups, update, cast, spread))
        return test, after

    def _untested(self, modes: bool) -> str:
        if self.levels == "observed":
            return NO_ALERTS
        return "" if modes else NO_MODES

    def carried(self, memory: SeparationMemory, update: Update) -> tuple[Cast, SeparationMemory]:
        """Return the subfilters' cast for `update`, and the memory after it."""
        follows = _follows(memory, update)
        known = memory.groups if follows else ()
        groups = tuple(sorted({*names_of(self.ism, update.keys), *known}))
        ordered = follows and (memory.ordered or bool(update.switched))
        sectors = self._sectors(memory, update, follows)
        cast = cast_of(self.ism, groups, self.pairs and self.variant == "exact", ordered, sectors)
        step = self._into(memory, update, cast)
        used = used_rows(cast, update.keys)
        at = in_order(update.keys)  # the same sums whatever the order of the rows is
        old = memory.biased if follows else ()
        biased, before, biases = with_nominal(self.ism, step.bank, old, update.keys, groups)
        rows = update.H[at], update.R[np.ix_(at, at)], update.nu[at], used[:, at]
        bank = advance(before, step.F, step.Q, *rows, step.sources.member, step.sources.origin, biases[:, at])
        position = update.posterior.layout.block("pos")
        born = (
            still_born(bank.P[:, position[:, None], position], step.born_m2)
            if len(position)
            else step.born_m2
        )
        return cast, SeparationMemory(
            update.t_ns, update.posterior.layout, cast.members, bank, groups, step.began_ns, born,
            update.posterior.mean[position], step.loose, ordered, biased,
            self._beside(step, update, used[: 1 + len(cast.faults.monitored)]), sectors,
            memory.seen_ns if follows and not update.keys else update.t_ns,
        )  # fmt: skip

    def _sectors(self, memory: SeparationMemory, update: Update, follows: bool) -> Sectors:
        """Return who is in which sector: satellites that were not known take their places."""
        if not self.ism.sectors:
            return ()
        before, known = (memory.sectors, memory.groups) if follows else ((), ())
        return with_risen(self.ism, before, known, azimuths(update))

    def _into(self, memory: SeparationMemory, update: Update, cast: Cast) -> _Step:
        """Return the step into `update`."""
        if memory.bank is None or not _follows(memory, update):
            return _beginning(update, cast)
        without = self._events(memory, frozenset(update.switched))
        events = cast_of(self.ism, memory.groups, False, False, memory.sectors).events if without else ()
        found = sources(memory.members, cast.members, without, memory.ordered, *nested(events, without))
        began = np.where(found.whole, memory.began_ns[found.member], update.t_ns)
        born = _born(update, update.Q, memory.born_m2[found.member])
        few, beside = found.member[: 1 + len(cast.faults.monitored)], memory.beside
        known = beside is not None and few.max() < len(beside.own)  # that of a pair begins: one model
        beside = beside.take(few, found.origin) if beside is not None and known else None
        loose = memory.loose[found.member] | found.loose
        return _Step(memory.bank, update.F, update.Q, found, began, born, loose, beside)

    def _beside(self, step: _Step, update: Update, used: BoolArray) -> Companions | None:
        """Return what goes beside the filter and the monitored modes after `update`."""
        if step.beside is None and update.R_accuracy is None:
            return None
        few = step.bank.take(step.sources.member[: len(used)], step.sources.origin)
        return accompany(step.beside, few, step.F, step.Q, update.H, update.R, update.R_accuracy, used)

    def _events(self, memory: SeparationMemory, groups: frozenset[str]) -> Member:
        """Return the names of the events behind groups that are left out."""
        if not groups:
            return ()
        events = cast_of(self.ism, memory.groups, False, False, memory.sectors).events
        groups |= {g for g in memory.groups if source_of(g) in groups}
        whole = [e for e in events if frozenset(e.groups) == groups]
        chosen = whole[:1] or [e for e in events if e.groups and frozenset(e.groups) <= groups]
        return tuple(sorted(e.name for e in chosen))

    def _spread(self, memory: SeparationMemory, after: SeparationMemory, update: Update) -> Spread:
        position = after.layout.block("pos")
        axes = local_axes(after.where_m)
        bank = after.bank
        assert bank is not None
        P = bank.P[:, position[:, None], position]
        if len(memory.where_m) == len(after.where_m) and memory.bank is not None:
            sigma = float(np.sqrt(np.trace(P[0])))
            track = track_axes(axes, after.where_m - memory.where_m, max(COURSE_M, COURSE_SIGMA * sigma))
            axes = axes if track is None else np.concatenate([axes, track])
        bias = bank.bias[:, :, position]
        spread = Spread.of(axes, bank.delta[:, position], P, after.born_m2, bias, after.loose)
        return spread if after.beside is None else spread.refined(axes, after.beside, position)

    def _judge(self, spread: Spread, cast: Cast, update: Update, since_ns: int, note: str) -> Verdict:
        modes = slice(1, 1 + len(cast.faults.monitored))
        allowed, observed = self._allowed(spread, cast), self.levels == "observed"
        tested = allowed > 0.0
        bound = bound_of(spread, cast, self.ism, allowed, since_ns, observed)
        bound = replace(bound, reason=join_reasons([bound.reason, note]))
        over, level = beyond(bound, self.ism) if observed else ("", "")
        if not tested.any():
            why = join_reasons([level, why_untested(bound, cast, update)])
            return replace(unavailable(self.name, self.variant, update, why), bound=bound, beyond=over)
        ratio = np.abs(spread.apart[modes])[tested] / allowed[tested] * self.factor
        facts = (float(ratio.max()), self.factor, self.p_fa, int(tested.sum()))
        if observed:
            status: Status = "unavailable" if over else "ok"
            why = join_reasons([level, note])
            return Verdict(
                self.name, self.variant, update.t_ns, status, *facts, reason=why, bound=bound, beyond=over
            )
        if facts[0] <= self.factor:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts, bound=bound)
        with_pairs = self.variant == "exact" and bool(cast.pairs)
        suspects = suspects_of(spread, cast, update, self._factors(spread, cast), with_pairs)
        ambiguous = with_pairs and len(suspects) > 1 and suspects[1].statistic <= 1.0
        none = None if self.variant == "published" else bound
        return Verdict(self.name, self.variant, update.t_ns, "alert", *facts, suspects, ambiguous, bound=none)

    def _remembered(
        self, groups: tuple[str, ...], update: Update, cast: Cast, spread: Spread
    ) -> tuple[str, ...]:
        """Return the groups in view, and who still moves the position, alone or with who fails with it."""
        present = names_of(self.ism, update.keys)
        if len(groups) == len(present):
            return groups
        apart = UNTESTED if self.levels == "observed" else np.inf
        moves = spread.moves(FORGOTTEN, apart)
        gone = [
            e
            for e, i in zip(cast.events, cast.single, strict=True)
            if moves[i] and set(present).isdisjoint(e.groups)
        ]
        kept = {g for e in gone for g in e.groups}
        return tuple(g for g in groups if g in present or g in kept)

    def _factors(self, spread: Spread, cast: Cast) -> FloatArray:
        """Return the factor of the standard deviation in each direction."""
        modes, directions = len(cast.faults.monitored), spread.apart.shape[1]
        return self.factor * factors(self.ism, self.p_fa, modes, directions)

    def _allowed(self, spread: Spread, cast: Cast) -> FloatArray:
        """Return how far modes and the filter may be apart, m, shape (modes, directions); 0: not tested."""
        modes = slice(1, 1 + len(cast.faults.monitored))
        testable = spread.testable(modes)
        allowed = self._factors(spread, cast) * np.sqrt(np.where(testable, spread.separation[modes], 0.0))
        return np.where(testable & np.isfinite(allowed), allowed, 0.0)


def _follows(memory: SeparationMemory, update: Update) -> bool:
    """Tell whether an update goes on from what the memory holds."""
    fits = memory.bank is not None and update.F.shape[1] == len(memory.layout)
    return fits and not update.is_start and update.t_ns > memory.t_ns


def _beginning(update: Update, cast: Cast) -> _Step:
    """Return the step of a bank that begins: all members know what the filter knows before `update`."""
    n, count = len(update.prior), len(cast.members)
    nobody = np.zeros(count, dtype=bool)
    none = Sources(np.zeros(count, dtype=np.intp), ~nobody, nobody, 0)
    began = np.full(count, update.t_ns, dtype=np.int64)
    born = _born(update, update.prior.P, np.full(count, np.inf))
    return _Step(replicate(update.prior.P), np.eye(n), np.zeros((n, n)), none, began, born, nobody)


def _born(update: Update, P: FloatArray, before: FloatArray) -> FloatArray:
    """Return the variance with which the position of each member was born, now or before."""
    position = update.prior.layout.block("pos")
    if update.F[position].any() or not len(position):
        return before
    return np.full(len(before), float(np.diagonal(P)[position].min()))
