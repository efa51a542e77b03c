"""What AIME and SRAIME share: their windows, the tests of them, and the verdict of several together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from pntegrity.kernels.extrapolation import Passage
from pntegrity.kernels.windows import Form, QuadraticTest
from pntegrity.monitors._carried import LazyMaps, Lengths, Trail, View, carry
from pntegrity.monitors._window import Window, judge, no_redundancy, quadratic_test, unavailable
from pntegrity.records import FloatArray, Update, Verdict

SEVERAL = "several window lengths are several tests: plan one length at a time"


@dataclass(frozen=True, eq=False)
class _Tested:
    """The test of one window, and its statistic."""

    test: QuadraticTest
    window: Window
    statistic: float = 0.0

    @property
    def ratio(self) -> float:
        """Statistic over threshold; below all others where there is no test."""
        return self.statistic / self.test.threshold if self.test.form is not None else -1.0


class Extrapolating(ABC):
    """A monitor of windows that are carried forward; its class adds what it looks at and the metric."""

    name: ClassVar[str]
    p_fa: float
    variant: str
    factor: float
    window: int | tuple[int, ...]

    @property
    @abstractmethod
    def view(self) -> View:
        """What is looked at."""

    @abstractmethod
    def metric(self, passage: Passage, window: Window) -> tuple[FloatArray, int] | None:
        """Return the root of a window's inverse covariance and its degrees of freedom; None: no test."""

    @abstractmethod
    def reason(self, passage: Passage, update: Update) -> str:
        """Say why a window that ends with `update` cannot be tested."""

    @property
    def lengths(self) -> Lengths:
        """The window lengths, and how their windows are thinned."""
        each = (self.window,) if isinstance(self.window, int) else self.window
        return Lengths(each, thin=self.variant == "exact")

    def start(self) -> Trail:
        """Return the memory before the first update."""
        return Trail()

    def form(self, window: Window) -> Form | None:
        """Return the linear form over just these updates, or None where no test applies to them."""
        if not window:
            return None
        return self._form(self.view.course(window)[0], window)

    def plan(self, memory: Trail, update: Update) -> tuple[QuadraticTest, Trail]:
        """Return the test of the window that ends with `update`, without data, and the memory after it.

        Of several lengths none is returned, with the reason: each is a test of its own.
        """
        now, after = carry(memory, update, self.view, self.lengths)
        if len(self.lengths.lengths) > 1:
            return QuadraticTest(None, reason=SEVERAL), after
        return next(self._tests(now, update)).test, after

    def step(self, memory: Trail, update: Update) -> tuple[Verdict, Trail]:
        """Test all windows that end with `update`; the verdict is of the one furthest up to its threshold."""
        now, after = carry(memory, update, self.view, self.lengths)
        found = max(self._tests(now, update), key=lambda t: t.ratio)
        if found.test.form is None:
            return unavailable(self.name, self.variant, update, found.test.reason), after
        verdict = judge(self.name, self.variant, found.test, found.window, found.statistic, self.p_fa)
        return verdict, after

    def _tests(self, now: Trail, update: Update) -> Iterator[_Tested]:
        if not now.passages:
            yield _Tested(QuadraticTest(None, reason=no_redundancy(update)), ())
            return
        lengths = self.lengths
        for length in lengths.lengths:
            passage = lengths.window(now.passages, length)
            yield self._tested(passage, now.window[-passage.length :], self.p_fa / len(lengths.lengths))

    def _tested(self, passage: Passage, window: Window, p_fa: float) -> _Tested:
        form, update = self._form(passage, window), window[-1]
        consumed = update.consumed if update.is_start and self.variant == "published" else 0
        test = quadratic_test(
            form, update, p_fa=p_fa, factor=self.factor, consumed=consumed,
            reason=self.reason(passage, update),
        )  # fmt: skip
        if test.form is None:
            return _Tested(test, window)
        y = test.form.metric @ passage.eta
        return _Tested(test, window, float(y @ y))

    def _form(self, passage: Passage, window: Window) -> Form | None:
        found = self.metric(passage, window)
        return None if found is None else Form(LazyMaps(self.view, window), *found)
