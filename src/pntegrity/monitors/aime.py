"""AIME: innovations against an extrapolation of the state from before the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from pntegrity.kernels.extrapolation import Passage
from pntegrity.kernels.windows import definite_inverse_root
from pntegrity.monitors._carried import Rows
from pntegrity.monitors._extrapolating import Extrapolating
from pntegrity.monitors._options import check_test, window_lengths
from pntegrity.monitors._window import Window
from pntegrity.records import FloatArray, Update


@dataclass(frozen=True)
class Aime(Extrapolating):
    """Autonomous integrity monitoring by extrapolation: a weighted mean of innovations against a coasting
    state.

    Hypothesis: no fault within the window. Statistic: ``e_avg^T cov^-1 e_avg``, where ``e_i`` are the
    innovations against the state of `window` epochs ago extrapolated without measurements, averaged with
    their inverse covariances. `published` uses the inverse of the summed weights as covariance, as printed,
    which treats the terms as independent: its false-alarm rate is many times the nominal one, and it needs
    the same rows in the whole window (else unavailable). `exact` uses the exact covariance of the same vector
    and takes any rows; what the epochs of the window took from their own data to initialise states is left
    out of it. Threshold: chi-square with as many degrees of freedom as rows (exact: as the rank, so without
    what was left out). Of several windows each has its share of `p_fa`, in equal parts: the false-alarm
    probability of all together is at most `p_fa`. It cannot see a fault older than its window that the state
    has absorbed. Memory: the updates of the longest window, and what is carried of each window; until one is
    full the window is what there is (published: RCTM).

    Parameters
    ----------
    p_fa, variant, factor
        As for RCTM.
    window : int or tuple of int
        Extrapolation cycle ``m``, epochs; or several, all tested at every epoch. From 10 on a window of the
        exact variant is between ``m`` and ``1.4 m`` long, so that only every fourth, eighth, ... is carried.

    References
    ----------
    Yu et al. (2023), SRAIME, eqs (25)-(33); Diesel and King (1995).

    Examples
    --------
    >>> Aime(window=[20, 5]).window
    (5, 20)
    """

    name: ClassVar[str] = "aime"
    p_fa: float = 1e-6
    variant: Literal["exact", "published"] = "exact"
    factor: float = 1.0
    window: int | tuple[int, ...] = 5

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        object.__setattr__(self, "window", window_lengths(self.window))

    @property
    def view(self) -> Rows:
        """All rows; those directions of them that were initialised from data only where published."""
        return Rows(blind=self.variant == "exact")

    def metric(self, passage: Passage, window: Window) -> tuple[FloatArray, int] | None:
        """Return the root of the window's inverse covariance and its degrees of freedom, or None where the
        published test does not apply.
        """
        if self.variant == "exact":
            root = passage.root()
            return root, len(root)
        if any(set(u.keys) != set(passage.names) for u in window):
            return None
        return definite_inverse_root(passage.weight), len(window[-1].keys)

    def reason(self, passage: Passage, update: Update) -> str:
        """Say why a window cannot be tested."""
        return "the rows changed within the window: the published test does not apply"
