"""Thresholds of the two checks of factor-set detection, from screenings of logs without faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pntegrity.errors import InputError
from pntegrity.kernels.factor_set import FactorSet
from pntegrity.verdicts import Screening

__all__ = ["LEAST", "Spread", "Training", "train_factors", "training_tables", "without_limits"]

LEAST = 30
"""Epochs below which a standard deviation means too little."""


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation of a factor, m."""

    mean_m: float
    sigma_m: float

    def limit_m(self, times: float) -> float:
        """Return the mean plus so many standard deviations, m."""
        return self.mean_m + times * self.sigma_m


@dataclass(frozen=True)
class Training:
    """What was learnt.

    Parameters
    ----------
    factors : FactorSet
        With the trained thresholds.
    missed, false_alarm : Spread
        Of the two factors over the accepted epochs.
    alpha, gamma : float
        Standard deviations above the mean.
    accepted, epochs : int
        Epochs whose rows were found consistent, and all that were screened.
    """

    factors: FactorSet
    missed: Spread
    false_alarm: Spread
    alpha: float
    gamma: float
    accepted: int
    epochs: int


def without_limits(factors: FactorSet) -> FactorSet:
    """Return the options to train with: neither check stops an epoch, which would cut the factors off."""
    return replace(factors, missed_limit_m=float("inf"), false_alarm_limit_m=float("inf"))


def train_factors(
    screenings: Sequence[Screening], factors: FactorSet, *, alpha: float = 3.0, gamma: float = 3.0
) -> Training:
    """Return the thresholds (13) and (20) from the factors of accepted epochs.

    Accepted are epochs with a consistent set, whose missed-detection factor is finite. Those in which nothing
    was tested have no such factor; where the set stayed inconsistent, the fix is not trusted.

    Parameters
    ----------
    screenings : sequence of Screening
        Of runs with the limits of `without_limits`.
    factors : FactorSet
        Options of these runs; all but the limits is kept.
    alpha, gamma : float
        Standard deviations above the mean, of missed detection and of false alarm.

    Raises
    ------
    InputError
        Fewer than `LEAST` accepted epochs.

    References
    ----------
    Chen et al. (2023), eqs (13) and (20).
    """
    values = np.array([(s.missed_m, s.false_alarm_m) for s in screenings], dtype=np.float64).reshape(-1, 2)
    accepted = values[np.isfinite(values).all(axis=1)]
    if len(accepted) < LEAST:
        raise InputError(
            f"only {len(accepted)} of {len(values)} epochs were found consistent; {LEAST} are needed",
            hint="Train on logs under an open sky",
        )
    missed, false_alarm = (
        Spread(float(np.mean(column)), float(np.std(column, ddof=1))) for column in accepted.T
    )
    trained = replace(
        factors, missed_limit_m=missed.limit_m(alpha), false_alarm_limit_m=false_alarm.limit_m(gamma)
    )
    return Training(trained, missed, false_alarm, alpha, gamma, len(accepted), len(values))


def training_tables(training: Training, logs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the file for ``run --factors``: the table ``factors``, and ``trained``, what it was made of."""
    return {
        "factors": asdict(training.factors),
        "trained": {
            "mu_missed_m": training.missed.mean_m,
            "sigma_missed_m": training.missed.sigma_m,
            "alpha": training.alpha,
            "mu_false_alarm_m": training.false_alarm.mean_m,
            "sigma_false_alarm_m": training.false_alarm.sigma_m,
            "gamma": training.gamma,
            "accepted": training.accepted,
            "epochs": training.epochs,
            "logs": list(logs),
        },
    }
