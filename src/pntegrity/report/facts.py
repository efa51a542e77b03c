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
    protection : mapping
        What the protection levels assume and promise, plain values as an integrity support message gives
        them: ``p_hmi``, ``independent_epochs``, ``split``, ``p_fa``, ``p_sat``, ... and the alert limits
        ``hal_m`` and ``val_m``.
    products : tuple of str
        Which atmosphere products were used, and whether they are self-derived, a line each.
    truth_velocity_mps, truth_attitude_rad : ndarray, shape (n_epochs, 3), optional
        True ECEF velocity, and true roll, pitch and heading, as `truth_m`.
    sources : tuple of str
        Names of the sources of a vehicle, also of those that never said anything.
    sections : tuple of str
        What each epoch's surroundings are called (``"open"``, ``"challenging"``, ``"denied"``); empty: they
        are told from what the receiver saw.

    Raises
    ------
    ValueError
        Where the truth has another shape, or an alert limit is not a positive number.
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
    protection: Mapping[str, Any] = field(default_factory=dict)
    products: tuple[str, ...] = ()
    truth_velocity_mps: FloatArray | None = None
    truth_attitude_rad: FloatArray | None = None
    sections: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("truth_m", "truth_velocity_mps", "truth_attitude_rad"):
            if getattr(self, name) is not None:
                self._keep(name)
        for name in ("hal_m", "val_m"):
            if not self.alert_limit(name) > 0.0:
                raise ValueError(f"`protection`: {name} must be positive, not {self.protection[name]}")

    def alert_limit(self, name: str) -> float:
        """Return the alert limit ``hal_m`` or ``val_m``, inf where there is none."""
        limit = self.protection.get(name)
        return float("inf") if limit is None else float(limit)

    def _keep(self, name: str) -> None:
        truth = np.atleast_2d(np.asarray(getattr(self, name), dtype=np.float64))
        if truth.ndim != 2 or truth.shape[1] != 3:
            raise ValueError(f"`{name}` must have the shape (n_epochs, 3), not {truth.shape}")
        object.__setattr__(self, name, frozen(truth))

    def truth(self, n: int) -> FloatArray:
        """Return the true position at the first `n` epochs, shape (n, 3), nan where it is not known."""
        return _first(self.truth_m, n)

    def truth_velocity(self, n: int) -> FloatArray:
        """Return the true ECEF velocity, the same."""
        return _first(self.truth_velocity_mps, n)

    def truth_attitude(self, n: int) -> FloatArray:
        """Return the true roll, pitch and heading, the same."""
        return _first(self.truth_attitude_rad, n)


def _first(truth: FloatArray | None, n: int) -> FloatArray:
    """Return the first `n` rows (n, 3), nan where there is none."""
    out = np.full((n, 3), np.nan)
    if truth is not None:
        known = min(n, len(truth))
        out[:known] = truth[:known]
    return out
