"""SRAIME: the state against an extrapolation of itself from before the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from pntegrity.kernels.extrapolation import Passage
from pntegrity.kernels.windows import inverse_root
from pntegrity.monitors._carried import States
from pntegrity.monitors._extrapolating import Extrapolating
from pntegrity.monitors._options import check_block, check_test, window_lengths
from pntegrity.monitors._window import Window, state_test_reason
from pntegrity.records import FloatArray, Update


@dataclass(frozen=True)
class Sraime(Extrapolating):
    """State-domain robust AIME: posterior states against a state propagated from before the window.

    Hypothesis: no fault within the window. Statistic: ``d_avg^T cov^+ d_avg`` with ``d_i`` the difference of
    posterior and propagated states in `block`, averaged with their inverse covariances (by singular values,
    so that a near singular covariance is harmless). `published` uses the inverse of the summed weights as
    covariance, as printed: its false-alarm rate is a hundred times the nominal one and more. `exact` uses the
    exact covariance, and leaves out what the window's epochs initialised from their own data. Tested are
    those states of `block` that live through the whole window; one that begins anew under its name does not.
    Threshold: chi-square with the number of these states (exact: the rank). Of several windows each has its
    share of `p_fa`, in equal parts: the false-alarm probability of all together is at most `p_fa`. The test
    cannot see what the states of `block` do not show: under a white-noise position model the position block
    is blind to slow faults, since every epoch forgets. Memory: the updates of the longest window, and what is
    carried of each window; until one is full the window is what there is (published: SRCTM).

    Parameters
    ----------
    p_fa, variant, factor
        As for RCTM.
    window : int or tuple of int
        Extrapolation cycle ``m``, epochs; or several: as for AIME.
    block : str
        Name of the states that are tested, ``"pos"`` by default; several joined by ``+`` (``"pos+amb"``);
        ``""`` stands for all of them.

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
    window: int | tuple[int, ...] = 5
    block: str = "pos"

    def __post_init__(self) -> None:
        check_test(self.p_fa, self.factor, self.variant)
        object.__setattr__(self, "window", window_lengths(self.window))
        check_block(self.block)

    @property
    def view(self) -> States:
        """The states of the block."""
        return States(self.block, blind=self.variant == "exact")

    def metric(self, passage: Passage, window: Window) -> tuple[FloatArray, int] | None:
        """Return the root of the window's inverse covariance and its degrees of freedom, or None where none
        of the chosen states lived through it.
        """
        if window[-1].is_start or not passage.names:
            return None
        if self.variant == "published":
            return inverse_root(passage.weight), len(passage.names)
        root = passage.root()
        return root, len(root)

    def reason(self, passage: Passage, update: Update) -> str:
        """Say why a window cannot be tested."""
        return state_test_reason(update, self.block)
