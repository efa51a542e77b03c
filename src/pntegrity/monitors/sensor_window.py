"""Which sensor within a source is at fault: subfilters that do without some, over a sliding window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.sensor_window import SensorTests, Sets, expanded, sets_of, squares, used_rows
from pntegrity.kernels.separation import Subfilters, advance, predicted, replicate
from pntegrity.kernels.windows import Form, QuadraticTest
from pntegrity.monitors._explanations import explanations, faulty_sensors, minimal
from pntegrity.monitors._gains import Gains
from pntegrity.monitors._options import check_epochs, check_sets, check_test
from pntegrity.monitors._sources import Evidence, sensors_of
from pntegrity.monitors._window import Window, no_redundancy, quadratic_test, unavailable
from pntegrity.records import FloatArray, Suspect, Update, Verdict
from pntegrity.states import group_of, sensor_of

__all__ = ["SensorMemory", "SensorWindow", "Watched"]

ALONE = "no source has redundant sensors"
#: Sources that may have brought an alarm about, the most suspicious first.
SUSPICIOUS = 4


@dataclass(frozen=True, eq=False)
class Watched:
    """The subfilters of one source: sensors, the sets they do without, and their window (epochs, J, N)."""

    source: str
    sensors: tuple[str, ...]
    sets: Sets
    bank: Subfilters
    window: FloatArray


@dataclass(frozen=True, eq=False)
class SensorMemory:
    """What is kept: the last updates (`exact`); the subfilters of each source (`published`)."""

    window: Window = ()
    watched: tuple[Watched, ...] = ()


@dataclass(frozen=True)
class SensorWindow:
    """Sensor window: which of the redundant sensors of a source is at fault, or which several.

    Hypotheses: faults of one sensor of a source, of two, of three. Statistic: the sum of squares of the
    window's whitened innovations (`exact`). Threshold: chi-square with as many degrees of freedom as rows.
    Where it is exceeded, the window is run again without each sensor of the source at fault, then without
    each two, three, from before the fault began; the smallest set without which nothing is left that has
    another explanation is named, several are `ambiguous`.

    `published`: a subfilter without each sensor runs beside the filter; each sensor's squared innovations
    against it are summed over the window and held against a chi-square (`p_fa` for each). A sensor is at
    fault where the subfilter without it is the only one all of whose tests pass; where none passes, one more
    is assumed to be at fault, and the larger subfilters begin from the filter, with empty windows
    (`growth` ``"restarted"``, Jurado et al.) or with the mean of their parents' (``"expanded"``). Those are
    spoilt: the delay is most of a window either way. The statistic is the largest over its threshold.

    It cannot see a fault that the window does not hold, nor tell sensors apart that nothing else measures.
    Memory: the window's updates, or mean and covariance of each subfilter.

    Parameters
    ----------
    p_fa : float
        Probability of a false alarm, an epoch.
    variant : str
        ``"exact"`` or ``"published"``.
    factor : float
        Multiplies the threshold (from a calibration).
    window : int
        Epochs.
    most : int
        How many sensors of a source may be at fault at once.
    growth : str
        ``"expanded"`` or ``"restarted"`` (`published`).
    p_identify : float
        Probability with which the sensors at fault are not found to explain the data alone.

    References
    ----------
    Chen and Zhao (2023), eqs (8)-(15). Jurado et al. (2020), Navigation 67, 493-509.

    Examples
    --------
    >>> SensorWindow(p_fa=1e-6).name
    'sensor_window'
    """

    name: ClassVar[str] = "sensor_window"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    window: int = 20
    most: int = 3
    growth: Literal["expanded", "restarted"] = "expanded"
    p_identify: float = 1e-3

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_epochs("window", self.window, 1)
        check_sets("most", self.most, self.p_identify)
        if self.growth not in ("expanded", "restarted"):
            raise ValueError(f"`growth` must be 'expanded' or 'restarted', not {self.growth!r}")

    def start(self) -> SensorMemory:
        """Return the memory of a monitor that has seen nothing."""
        return SensorMemory()

    def plan(self, memory: SensorMemory, update: Update) -> tuple[QuadraticTest, SensorMemory]:
        """Return the test of `update` (`exact`), without data, and the memory after it."""
        if not update.keys:
            return QuadraticTest(None, reason=no_redundancy(update)), self.start()
        before = () if update.is_start or update.consumed else memory.window
        window = (*before, update)[-self.window :]
        consumed = sum(u.consumed for u in window)
        test = quadratic_test(_sum(window), update, p_fa=self.p_fa, factor=self.factor, consumed=consumed)
        return test, SensorMemory(window)

    def step(self, memory: SensorMemory, update: Update) -> tuple[Verdict, SensorMemory]:
        """Test the sensors after `update`."""
        if self.variant == "published":
            return self._published(memory, update)
        test, after = self.plan(memory, update)
        if test.form is None:
            return unavailable(self.name, self.variant, update, test.reason), after
        statistic = float(sum(u.white @ u.white for u in after.window))
        facts = (statistic, test.threshold, self.p_fa, test.dof)
        if statistic <= test.threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts), after
        verdict = Verdict(self.name, self.variant, update.t_ns, "alert", *facts)
        return self._named(after.window, verdict), after

    def carry(self, memory: SensorMemory, update: Update) -> SensorMemory:
        """Return the memory after `update`, whose verdict nobody wants."""
        return (
            self._published(memory, update)[1]
            if self.variant == "published"
            else self.plan(memory, update)[1]
        )

    def _named(self, window: Window, verdict: Verdict) -> Verdict:
        evidence = Evidence.of(window)
        y = evidence.white[:, None]
        gains = Gains(evidence, y)
        sources = evidence.ranked(gains.explained[:, 0])[:SUSPICIOUS]
        tried = explanations(gains, [(s,) for s in sources], self.p_identify)[0]
        found = minimal(tried) or tuple(tried[:1])
        suspects, unsure = [], len(found) != 1
        for one in found:
            sets = faulty_sensors(evidence, y, one.names[0], self.p_identify, self.most)[0]
            unsure |= len(sets) > 1
            for sensors in sets or ((),):
                named = tuple(s for s in sensors if s)
                onset_ns = window[0].t_ns
                suspects.append(Suspect(one.names, "bias", 0.0, onset_ns, one.gained, named))
        present = {group for u in window for group in u.groups()}  # sources may measure in turn
        kept = tuple(s for s in suspects if present.issuperset(s.groups))
        return replace(verdict, suspects=kept, ambiguous=unsure)

    def _published(self, memory: SensorMemory, update: Update) -> tuple[Verdict, SensorMemory]:
        if not update.keys or len(update.keys) <= update.consumed:
            return unavailable(self.name, self.variant, update, no_redundancy(update)), self.start()
        watched = tuple(self._watched(memory, update))
        if not watched:
            return unavailable(self.name, self.variant, update, ALONE), self.start()
        tests = [self._tests(w, update) for w in watched]
        worst = max(float(t.ratio.max()) for t in tests)
        grown = tuple(self._grown(w, t, update) for w, t in zip(watched, tests, strict=True))
        after = SensorMemory((), grown)
        facts = (worst, self.factor, self.p_fa, 1)
        if worst <= self.factor:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts), after
        suspects = tuple(s for w, t in zip(watched, tests, strict=True) for s in _suspects(w, t, update))
        verdict = Verdict(self.name, self.variant, update.t_ns, "alert", *facts, suspects, not suspects)
        return verdict, after

    def _watched(self, memory: SensorMemory, update: Update) -> Iterator[Watched]:
        """Yield the subfilters of each source after `update`; where its sensors change they begin anew."""
        known = {w.source: w for w in memory.watched}
        for source, sensors in sensors_of(update.keys).items():
            if len(sensors) < 2:
                continue
            before = known.get(source)
            follows = before is not None and before.sensors == sensors and not update.is_start
            if before is None or not follows or update.F.shape[1] != before.bank.P.shape[1]:
                yield _begun(source, sensors, update)
                continue
            yield self._taken(before, update)

    def _taken(self, before: Watched, update: Update) -> Watched:
        sensor = _sensor_of_rows(update, before.source, before.sensors)
        used = np.concatenate([np.ones((1, len(sensor)), dtype=bool), used_rows(before.sets, sensor)])
        prior = predicted(before.bank.P[1:], update.F, update.Q)
        nu = update.nu - before.bank.delta[1:] @ update.F.T @ update.H.T
        now = np.zeros((len(before.sets), len(before.sensors)))
        for i in range(len(before.sensors)):
            rows = np.flatnonzero(sensor == i)
            now[:, i] = squares(nu[:, rows], update.H[rows], update.R[np.ix_(rows, rows)], prior)
        bank = advance(before.bank, update.F, update.Q, update.H, update.R, update.nu, used)
        window = np.concatenate([before.window, now[None]])[-self.window :]
        return replace(before, bank=bank, window=window)

    def _tests(self, watched: Watched, update: Update) -> SensorTests:
        sensor = _sensor_of_rows(update, watched.source, watched.sensors)
        rows = [int((sensor == i).sum()) for i in range(len(watched.sensors))]
        if not len(watched.window):
            return SensorTests(watched.sets, np.zeros((len(watched.sets), len(rows))))
        return SensorTests.of(watched.sets, watched.window, rows, self.p_fa)

    def _grown(self, watched: Watched, tests: SensorTests, update: Update) -> Watched:
        """Return the subfilters with one more sensor at fault where none passes, or one where all do."""
        level, outcome = len(watched.sets[0]), tests.outcome
        if outcome.clear and level > 1:
            return _begun(watched.source, watched.sensors, update)
        if not outcome.grow or level >= min(self.most, len(watched.sensors) - 1):
            return watched
        sets = sets_of(len(watched.sensors), level + 1)
        window = expanded(watched.window, watched.sets, sets)
        window = window if self.growth == "expanded" else window[:0]
        return replace(watched, sets=sets, bank=_from_filter(update, len(sets)), window=window)


def _sum(window: Window) -> Form:
    """Return the form whose square is the sum of squares of a window."""
    sizes = [len(u.keys) for u in window]
    whole = np.eye(sum(sizes))
    maps = np.split(whole, np.cumsum(sizes)[:-1], axis=1)
    return Form(tuple(maps), whole, len(whole))


def _sensor_of_rows(update: Update, source: str, sensors: tuple[str, ...]) -> npt.NDArray[np.intp]:
    at = {name: i for i, name in enumerate(sensors)}
    return np.array([at[sensor_of(k)] if group_of(k) == source else -1 for k in update.keys], dtype=np.intp)


def _from_filter(update: Update, members: int) -> Subfilters:
    """Return subfilters that know what the filter knows; the first stays the filter."""
    return replicate(update.posterior.P).take(np.zeros(members + 1, dtype=np.intp))


def _begun(source: str, sensors: tuple[str, ...], update: Update) -> Watched:
    sets = sets_of(len(sensors), 1)
    return Watched(
        source, sensors, sets, _from_filter(update, len(sets)), np.zeros((0, len(sets), len(sensors)))
    )


def _suspects(watched: Watched, tests: SensorTests, update: Update) -> Iterator[Suspect]:
    faulty = tests.outcome.faulty
    if faulty:
        names = tuple(watched.sensors[i] for i in faulty)
        yield Suspect((watched.source,), "bias", 0.0, update.t_ns, float(tests.ratio.max()), names)
