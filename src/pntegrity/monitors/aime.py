"""AIME: innovations against an extrapolation of the state from before the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from pntegrity.kernels.extrapolation import innovation_maps
from pntegrity.kernels.windows import Form, QuadraticTest, definite_inverse_root, exact_form
from pntegrity.monitors._options import check_epochs, check_test
from pntegrity.monitors._window import Window, judge, quadratic_test, slide
from pntegrity.records import Update, Verdict


@dataclass(frozen=True)
class Aime:
    """Autonomous integrity monitoring by extrapolation: a weighted mean of innovations against a coasting
    state.

    Hypothesis: no fault within the window. Statistic: ``e_avg^T cov^-1 e_avg``, where ``e_i`` are the
    innovations against the state of `window` epochs ago extrapolated without measurements, averaged with
    their inverse covariances. `published` uses the inverse of the summed weights as covariance, as printed,
    which treats the terms as independent: its false-alarm rate is many times the nominal one, and it needs
    the same rows in the whole window (else unavailable). `exact` uses the exact covariance of the same vector
    and takes any rows. Threshold: chi-square with as many degrees of freedom as rows (exact: as the rank). It
    cannot see a fault older than its window that the state has absorbed. Memory: `window` updates; until it
    is full the window is what there is (published: RCTM).

    Parameters
    ----------
    p_fa, variant, factor
        As for RCTM.
    window : int
        Extrapolation cycle ``m``, epochs.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (25)-(33); Diesel and King (1995).

    Examples
    --------
    >>> Aime(window=5).start()
    ()
    """

    name: ClassVar[str] = "aime"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    window: int = 5

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        check_epochs("window", self.window, 1)

    def start(self) -> Window:
        """Return an empty window."""
        return ()

    def form(self, window: Window) -> Form | None:
        """Return the linear form over the window, or None where the published one does not apply."""
        if not window:
            return None
        used = self._published_window(window)
        if not used:
            return None
        maps, believed = innovation_maps(used)
        if self.variant == "exact":
            return exact_form(maps)
        return Form(maps, definite_inverse_root(believed), len(used[-1].keys))

    def _published_window(self, window: Window) -> Window:
        if self.variant == "exact" or len(window) == 1:
            return window
        rows = set(window[-1].keys)
        return window if all(set(u.keys) == rows for u in window) else ()

    def plan(self, memory: Window, update: Update) -> tuple[QuadraticTest, Window]:
        """Return the test of the window that ends with `update`, without data, and the memory after it."""
        window = slide(memory, update, self.window)
        short = self.variant == "published" and len(window) < self.window
        form = self.form(window[-1:] if short else window)
        reason = "the rows changed within the window: the published test does not apply" if window else ""
        consumed = update.consumed if update.is_start else 0
        test = quadratic_test(
            form, update, p_fa=self.p_fa, factor=self.factor, consumed=consumed, reason=reason
        )
        return test, window

    def step(self, memory: Window, update: Update) -> tuple[Verdict, Window]:
        """Test the window that ends with `update`."""
        test, after = self.plan(memory, update)
        return judge(self.name, self.variant, test, memory, update), after
