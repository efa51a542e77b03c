"""Factor-set detection: are the pseudoranges of one epoch consistent with one position?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.factor_set import FactorMemory, FactorSet, limits_of, published_sigmas
from pntegrity.kernels.snapshot_fix import UNCHECKED, Elimination, eliminate, eliminate_correlated
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.kernels.windows import Form, QuadraticTest
from pntegrity.monitors._options import check_epochs, check_test
from pntegrity.monitors._snapshot import code_rows, covariance, free_columns, parity, without_weights
from pntegrity.monitors._window import quadratic_test, unavailable
from pntegrity.records import FloatArray, Suspect, Update, Verdict, group_of
from pntegrity.verdicts import Screening, join_reasons

IntArray = npt.NDArray[np.intp]
MARGIN = 9.0
"""A suspect is ambiguous where another row takes nearly as much from the statistic."""


@dataclass(frozen=True)
class FactorSetTest:
    """Factor-set detection: one epoch's pseudoranges against one position, whatever the prior says.

    Hypothesis: no fault in this epoch's pseudoranges. Statistic: the weighted square of their residuals after
    least squares for position, clocks and inter-system biases, all of them free. Where the estimator screened
    its rows by such a test before it used them, that is reported: the statistic of the rows that it kept.
    Threshold: chi-square with the degrees of freedom of the residuals. `exact` weights with the filter's own
    covariance of the rows, given position and clocks, and keeps `p_fa`. `published` has no weights, divides
    residuals by a sigma of residuals that adapts to the last `window` epochs, and needs four satellites of
    each of two constellations, or five of one: its false-alarm rate is many times the nominal one. Suspects:
    the rows whose exclusion leaves the smallest statistic, one after the other, until the rest is consistent.
    It cannot see what one position explains (a fault with too few satellites beside it, several that agree),
    and nothing of Doppler and carrier. Memory: residuals of the window (`published`), none (`exact`).

    Parameters
    ----------
    p_fa : float
        Probability of a false alarm an epoch.
    variant : str
        ``"exact"`` or ``"published"``.
    factor : float
        Multiplies the threshold (from a calibration).
    window : int
        Epochs of residuals behind the sigmas (`published`).

    References
    ----------
    Chen, Sun, Cheng, Yang (2023), eqs (1)-(6), (14)-(15).

    Examples
    --------
    >>> FactorSetTest(p_fa=1e-6).name
    'factor_set'
    """

    name: ClassVar[str] = "factor_set"
    p_fa: float = 1e-5
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    window: int = 100

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_epochs("window", self.window, 1)

    def start(self) -> FactorMemory:
        """Return a memory without residuals."""
        return FactorMemory()

    def plan(self, memory: FactorMemory, update: Update) -> tuple[QuadraticTest, FactorMemory]:
        """Return the test of an update's own rows, without data, with the sigmas of the memory."""
        rows = code_rows(update)
        reason = _untestable(update, rows, self.variant)
        if reason:
            return QuadraticTest(None, reason=reason), memory
        form = self._form(memory, update, rows)
        return quadratic_test(form, update, p_fa=self.p_fa, factor=self.factor), memory

    def _form(self, memory: FactorMemory, update: Update, rows: IntArray) -> Form | None:
        A = free_columns(update, rows)
        if self.variant == "exact":
            metric = parity(A, covariance(update, rows))
            dof = len(metric)
        else:
            project, dof = without_weights(A)
            metric = project / self._sigmas(memory, update, rows)[:, None]
        return Form((update.L[rows],), metric, dof) if dof > 0 else None

    def _sigmas(self, memory: FactorMemory, update: Update, rows: IntArray) -> FloatArray:
        """Return the sigmas of residuals: ratios of the memory to what the filter believes at first."""
        believed = np.sqrt(np.diagonal(covariance(update, rows)))
        return np.asarray(believed * memory.sigmas(_keys(update, rows), 1.0))

    def step(self, memory: FactorMemory, update: Update) -> tuple[Verdict, FactorMemory]:
        """Test one update."""
        screening = update.screening
        if screening is not None and screening.dof > 0:
            return self._reported(update, screening), memory
        test, _ = self.plan(memory, update)
        if test.form is None:
            reason = join_reasons((screening.reason if screening else "", test.reason))
            return unavailable(self.name, self.variant, update, reason), memory
        found, V, share = self._left_out(test, memory, update)
        after = memory if self.variant == "exact" else self._learnt(memory, update, found)
        facts = (found.first, test.threshold, test.p_fa, test.dof)
        if found.first <= test.threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts), after
        suspects = _suspects(update, found, V, share)
        unsure = _is_ambiguous(update, V, share)
        return Verdict(self.name, self.variant, update.t_ns, "alert", *facts, suspects, unsure), after

    def _left_out(
        self, test: QuadraticTest, memory: FactorMemory, update: Update
    ) -> tuple[Elimination, FloatArray, FloatArray]:
        """Return which pseudoranges stand against the others; the matrix whose product with the innovations
        shows them, shape (n, n), and what their squares count in the statistic, shape (n,).
        """
        assert test.form is not None
        rows, limits = code_rows(update), self.factor * limits_of(self.p_fa, test.dof)
        nu, metric = update.nu[rows], test.form.metric
        if self.variant == "exact":
            V = metric.T @ metric
            return eliminate_correlated(V, nu, limits), V, np.ones(len(rows))
        sigma = self._sigmas(memory, update, rows)
        P = metric * sigma[:, None]
        return eliminate(P, P @ nu, 1.0 / sigma, limits, test.dof - 1), P, sigma**-2

    def _learnt(self, memory: FactorMemory, update: Update, found: Elimination) -> FactorMemory:
        """Return the memory with the residuals of the kept rows, as ratios to what the filter believes."""
        rows = np.delete(code_rows(update), found.order)
        project, _ = without_weights(free_columns(update, rows))
        square = (project @ update.nu[rows]) ** 2 / np.diagonal(covariance(update, rows))
        after = memory.pushed(_keys(update, rows), square, np.ones(len(rows)), self.window)
        return published_sigmas(FactorSet("published", window=self.window), after)

    def _reported(self, update: Update, screening: Screening) -> Verdict:
        """Return what the estimator's own test found of the rows that it kept."""
        threshold = self.factor * chi2_threshold(self.p_fa, screening.dof)
        left = ", ".join(f"{key} ({iteration})" for key, iteration in screening.dropped)
        said = f"tested by the estimator ({screening.method}, {screening.variant})"
        reason = join_reasons((said, left and f"left out: {left}", screening.reason))
        facts = (max(screening.last, 0.0), threshold, self.p_fa, screening.dof)
        if screening.last <= threshold:
            return Verdict(self.name, self.variant, update.t_ns, "ok", *facts, reason=reason)
        present = update.groups()
        groups = dict.fromkeys(group_of(key) for key, _ in screening.dropped if group_of(key) in present)
        suspects = tuple(Suspect((g,), "bias", 0.0, update.t_ns, 0.0) for g in groups)
        return Verdict(self.name, self.variant, update.t_ns, "alert", *facts, suspects, reason=reason)


def _keys(update: Update, rows: IntArray) -> tuple[str, ...]:
    return tuple(update.keys[i] for i in rows.tolist())


def _untestable(update: Update, rows: IntArray, variant: str) -> str:
    """Say why no test of the pseudoranges is possible; empty where one may be."""
    if not update.keys:
        return update.reason or "no measurements"
    if not len(rows):
        return "no pseudoranges"
    systems = [group_of(key)[:1] for key in _keys(update, rows)]
    counts = sorted(systems.count(s) for s in set(systems))
    closed = counts[-2] < 4 if len(counts) > 1 else counts[-1] < 5
    if variant == "published" and closed:
        return "no two constellations with four satellites each"
    return ""


def _suspects(update: Update, found: Elimination, V: FloatArray, share: FloatArray) -> tuple[Suspect, ...]:
    """Return who was left out, in this order; sizes are estimated together."""
    rows, out = code_rows(update), np.array(found.order, dtype=np.intp)
    if not len(out):
        return ()
    inverse = np.linalg.inv(V[np.ix_(out, out)])
    size = inverse @ (V[out] @ update.nu[rows])
    explained = size**2 / np.diagonal(inverse) * share[out]
    named: dict[str, Suspect] = {}
    for key, f, e in zip(_keys(update, rows[out]), size, explained, strict=True):
        group = group_of(key)
        named.setdefault(group, Suspect((group,), "bias", float(f), update.t_ns, float(e)))
    return tuple(named.values())


def _is_ambiguous(update: Update, V: FloatArray, share: FloatArray) -> bool:
    """Tell whether leaving out another group than the first would take nearly as much from the statistic."""
    rows = code_rows(update)
    pivots = np.diagonal(V)
    checked = pivots > UNCHECKED * pivots.max()
    explained = np.where(checked, (V @ update.nu[rows]) ** 2 / np.where(checked, pivots, 1.0) * share, 0.0)
    best: dict[str, float] = {}
    for key, e in zip(_keys(update, rows), explained.tolist(), strict=True):
        best[group_of(key)] = max(best.get(group_of(key), 0.0), e)
    first, *others = sorted(best.values(), reverse=True)
    return bool(others) and first - others[0] < MARGIN
