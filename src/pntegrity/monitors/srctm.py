"""SRCTM: the state-domain chi-square test of one epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.extrapolation import initialised
from pntegrity.kernels.windows import Form, QuadraticTest, inverse_root, pivoted_root
from pntegrity.monitors._options import check_block, check_test
from pntegrity.monitors._window import (
    Window,
    block_of,
    judge_alone,
    quadratic_test,
    state_test_reason,
)
from pntegrity.records import Update, Verdict


@dataclass(frozen=True)
class Srctm:
    """State-domain chi-square test: did the rows move the state further than they should?

    Hypothesis: as RCTM. Statistic: ``d^T cov(d)^+ d`` with ``d = T (x - x') = T K nu`` over the states of
    `block`, and ``cov(d) = T (P' - P) T^T`` exactly. Threshold: chi-square; its degrees of freedom are the
    rank of the covariance (`exact`, which leaves out states that were initialised from this very epoch) or
    the number of states (`published`, as printed). It cannot see what the rows say beside the chosen states,
    nor a fault that grows slowly. Memory: none.

    Parameters
    ----------
    p_fa, variant, factor
        As for RCTM.
    block : str
        Name of the states that are tested, ``"pos"`` by default; several joined by ``+`` (``"pos+amb"``);
        ``""`` stands for all of them.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (34)-(36).

    Examples
    --------
    >>> Srctm(block="").block
    ''
    """

    name: ClassVar[str] = "srctm"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    block: str = "pos"

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_block(self.block)

    def start(self) -> Window:
        """Return an empty window."""
        return ()

    def form(self, window: Window) -> Form | None:
        """Return the linear form of the last update, or None where the chosen states are absent or only just
        born.
        """
        if not window or window[-1].is_start or not window[-1].keys:
            return None
        u = window[-1]
        b = block_of(u, self.block)
        if self.variant == "exact":
            b = b[~np.isin(b, initialised(u))]
        if not len(b):
            return None
        cov, maps = u.absorbed[np.ix_(b, b)], (u.K[b] @ u.L,)
        if self.variant == "published":
            return Form(maps, inverse_root(cov), len(b))
        metric = pivoted_root(cov)
        return Form(maps, metric, len(metric))

    def plan(self, memory: Window, update: Update) -> tuple[QuadraticTest, Window]:
        """Return the test of `update`, without data, and the memory after it."""
        form, reason = self.form((update,)), state_test_reason(update, self.block)
        return quadratic_test(form, update, p_fa=self.p_fa, factor=self.factor, reason=reason), ()

    def step(self, memory: Window, update: Update) -> tuple[Verdict, Window]:
        """Test one update."""
        test, after = self.plan(memory, update)
        return judge_alone(self.name, self.variant, test, update), after
