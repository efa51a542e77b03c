"""SRAIME: the state against an extrapolation of itself from before the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pntegrity.kernels.extrapolation import state_maps
from pntegrity.kernels.windows import Form, QuadraticTest, inverse_root
from pntegrity.monitors._options import check_block, check_epochs, check_test
from pntegrity.monitors._window import (
    Window,
    block_of,
    judge,
    quadratic_test,
    slide,
    state_test_reason,
)
from pntegrity.records import Update, Verdict


@dataclass(frozen=True)
class Sraime:
    """State-domain robust AIME: posterior states against a state propagated from before the window.

    Hypothesis: no fault within the window. Statistic: ``d_avg^T cov^+ d_avg`` with ``d_i`` the difference of
    posterior and propagated states in `block`, averaged with their inverse covariances (by singular values,
    so that a near singular covariance is harmless). `published` uses the inverse of the summed weights as
    covariance, as printed: its false-alarm rate is a hundred times the nominal one and more. `exact` uses the
    exact covariance. Threshold: chi-square with the dimension of the block (exact: the rank). It cannot see
    what the states of `block` do not show: under a white-noise position model the position block is blind to
    slow faults, since every epoch forgets. Memory: `window` updates; the states of `block` must live through
    it.

    Parameters
    ----------
    p_fa, variant, factor
        As for RCTM.
    window : int
        Extrapolation cycle ``m``, epochs.
    block : str
        Name of the states that are tested, ``"pos"`` by default.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (37)-(42).

    Examples
    --------
    >>> Sraime().block
    'pos'
    """

    name: ClassVar[str] = "sraime"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    window: int = 5
    block: str = "pos"

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_epochs("window", self.window, 1)
        check_block(self.block)

    def start(self) -> Window:
        """Return an empty window."""
        return ()

    def form(self, window: Window) -> Form | None:
        """Return the linear form over the window, or None where the chosen states did not live through it."""
        if not window or window[-1].is_start:
            return None
        blocks = [block_of(u, self.block) for u in window]
        if not len(blocks[-1]) or any(len(b) != len(blocks[-1]) for b in blocks):
            return None
        maps, believed = state_maps(window, blocks)
        if self.variant == "published":
            return Form(maps, inverse_root(believed), len(blocks[-1]))
        metric = inverse_root(np.asarray(sum(M @ M.T for M in maps)))
        return Form(maps, metric, metric.shape[0])

    def plan(self, memory: Window, update: Update) -> tuple[QuadraticTest, Window]:
        """Return the test of the window that ends with `update`, without data, and the memory after it."""
        window = slide(memory, update, self.window)
        short = self.variant == "published" and len(window) < self.window
        form, reason = self.form(window[-1:] if short else window), state_test_reason(update)
        return quadratic_test(form, update, p_fa=self.p_fa, factor=self.factor, reason=reason), window

    def step(self, memory: Window, update: Update) -> tuple[Verdict, Window]:
        """Test the window that ends with `update`."""
        test, after = self.plan(memory, update)
        return judge(self.name, self.variant, test, memory, update), after
