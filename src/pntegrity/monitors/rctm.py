"""RCTM: the residual chi-square test of one epoch's innovations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.windows import Form, QuadraticTest
from pntegrity.monitors._options import check_test
from pntegrity.monitors._window import Window, judge_alone, quadratic_test
from pntegrity.records import Update, Verdict


@dataclass(frozen=True)
class Rctm:
    """Residual chi-square test: are this epoch's innovations as small as their covariance says?

    Hypothesis: no fault in this epoch, and none that still shows in the prior. Statistic: ``nu^T S^-1 nu``.
    Threshold: chi-square with as many degrees of freedom as rows, less the states initialised from this very
    epoch. Assumes white Gaussian innovations of covariance `S`. It cannot see a fault that grows slower than
    the filter follows. Memory: none. The published and the exact variant are the same.

    Parameters
    ----------
    p_fa : float
        Probability of a false alarm an epoch.
    variant : str
        ``"exact"`` or ``"published"``.
    factor : float
        Multiplies the threshold (from a calibration).

    References
    ----------
    Yu et al. (2023), SRAIME; Zhu et al. (2016).

    Examples
    --------
    >>> Rctm(p_fa=1e-6).name
    'rctm'
    """

    name: ClassVar[str] = "rctm"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)

    def start(self) -> Window:
        """Return an empty window."""
        return ()

    def form(self, window: Window) -> Form | None:
        """Return the linear form of the last update, or None where there are no rows."""
        if not window or not window[-1].keys:
            return None
        m = len(window[-1].keys)
        return Form((np.eye(m),), np.eye(m), m)

    def plan(self, memory: Window, update: Update) -> tuple[QuadraticTest, Window]:
        """Return the test of `update`, without data, and the memory after it."""
        form = self.form((update,))
        return quadratic_test(form, update, p_fa=self.p_fa, factor=self.factor, consumed=update.consumed), ()

    def step(self, memory: Window, update: Update) -> tuple[Verdict, Window]:
        """Test one update."""
        test, after = self.plan(memory, update)
        return judge_alone(self.name, self.variant, test, update), after
