"""What a report has to say beside the outcomes: how the run was set up, and what is known about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pntegrity.states import FloatArray, frozen

__all__ = ["RunFacts"]


@dataclass(frozen=True, eq=False)
class RunFacts:
    """How a run was set up, and what is known about it.

    Parameters
    ----------
    estimator : str
        Name of the estimator.
    config : mapping
        Effective configuration; values that JSON can hold.
    noise_name : str
        What the noise model is called.
    blind_spots : tuple of str
        What this set-up cannot see, in words.
    truth_m : ndarray, shape (n_epochs, 3), optional
        True ECEF position at each epoch, nan where it is not known; None: no truth at all.
    notes : tuple of str
        What the readers dropped.
    faults : tuple of str
        Faults that were injected, in words.
    started : str
        GPS time of the first epoch, ISO format.
    interrupted : bool
        Whether the run was stopped before its end.
    """

    estimator: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)
    noise_name: str = ""
    blind_spots: tuple[str, ...] = ()
    truth_m: FloatArray | None = None
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    started: str = ""
    interrupted: bool = False

    def __post_init__(self) -> None:
        if self.truth_m is not None:
            truth = np.atleast_2d(np.asarray(self.truth_m, dtype=np.float64))
            if truth.ndim != 2 or truth.shape[1] != 3:
                raise ValueError(f"`truth_m` must have the shape (n_epochs, 3), not {truth.shape}")
            object.__setattr__(self, "truth_m", frozen(truth))

    def truth(self, n: int) -> FloatArray:
        """Return the truth of the first `n` epochs, shape (n, 3), nan where it is not known."""
        out = np.full((n, 3), np.nan)
        if self.truth_m is not None:
            known = min(n, len(self.truth_m))
            out[:known] = self.truth_m[:known]
        return out
