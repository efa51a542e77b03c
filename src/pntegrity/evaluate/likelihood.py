"""Innovation maximum likelihood: what is fitted are named positive numbers, walked one after the other.

The likelihood of a Kalman filter is that of its innovations, ``-2 log L = sum log det S_k + nu_k^T S_k^-1
nu_k``. It needs to know nothing of what the numbers are: a model, any value, makes an estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Generic, TypeVar

import numpy as np

from pntegrity.errors import InputError
from pntegrity.protocols import Estimator, stepped
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.noise import Fitted

__all__ = ["STEPS", "Part", "Values", "cut_of", "minus_twice_log", "settling", "stream", "walked"]

#: Factors by which a parameter is tried, sweep after sweep.
STEPS = (2.5, 1.6, 1.25, 1.12)
#: How far up or down one sweep walks a parameter.
STRIDES = 4
#: Epochs on either side of the split, at least.
PART = 100
#: Epochs before innovations count, at least; an estimator's `settle_s` may ask for more, up to a third.
SETTLE = 30

Model = TypeVar("Model")
Values = Mapping[str, float]


def cut_of(n: int, split: float) -> int:
    """Return how many of so many epochs are fitted to.

    Raises
    ------
    InputError
        Where either part has fewer than 100 epochs.
    """
    cut = int(n * split)
    if cut < PART or n - cut < PART:
        raise InputError(
            f"a calibration needs {PART} epochs on either side of the split; {cut} and {n - cut} given"
        )
    return cut


def stream(
    estimator: Estimator, epochs: Sequence[Epoch], left_out: Sequence[frozenset[str]] = ()
) -> Iterator[Update]:
    """Yield the updates of a filter over epochs with given exclusions, without monitors."""
    state = State.empty()
    for i, epoch in enumerate(epochs):
        exclude = left_out[i] if i < len(left_out) else frozenset()
        update = stepped(estimator, state, epoch, exclude)
        state = update.posterior
        yield update


@dataclass(frozen=True, eq=False)
class Part(Generic[Model]):
    """Epochs that a model is fitted to.

    Parameters
    ----------
    epochs : sequence of Epoch
    made : callable
        Makes the estimator of a model.
    left_out : sequence of frozenset of str
        Who is left out of each epoch.
    settle : int
        After how many epochs the filter has settled.
    clip_sigma : float
        Beyond it whitened innovations count linearly.
    """

    epochs: Sequence[Epoch]
    made: Callable[[Model], Estimator]
    left_out: Sequence[frozenset[str]]
    settle: int
    clip_sigma: float = np.inf

    def stream(self, model: Model) -> Iterator[Update]:
        """Yield the updates of a model."""
        return stream(self.made(model), self.epochs, self.left_out)

    def updates(self, model: Model) -> list[Update]:
        """Return the updates of a model."""
        return list(self.stream(model))

    def settled(self, model: Model) -> Iterator[Update]:
        """Yield the updates of a model after the filter has settled."""
        return islice(self.stream(model), self.settle, None)

    def cost(self, model: Model) -> float:
        """Return ``-2 log L`` of a model's innovations after the filter has settled."""
        try:
            total = sum(minus_twice_log(u, self.clip_sigma) for u in self.settled(model))
        except np.linalg.LinAlgError:
            return np.inf
        return total if np.isfinite(total) else np.inf


def minus_twice_log(update: Update, clip_sigma: float) -> float:
    """Return ``-2 log L`` of an epoch; beyond the limit whitened innovations count linearly (Huber's
    cost).
    """
    size = np.abs(update.white)
    inside = np.minimum(size, clip_sigma)
    beyond = 0.0 if np.isinf(clip_sigma) else 2.0 * clip_sigma * float((size - inside).sum())
    return float(inside @ inside) + beyond + 2.0 * float(np.log(np.diagonal(update.L)).sum())


def settling(epochs: Sequence[Epoch], settle_s: float) -> int:
    """Return after how many epochs innovations count."""
    end_ns = epochs[0].t_ns + round(settle_s * 1e9)
    before = sum(1 for e in epochs if e.t_ns < end_ns)
    return min(max(before, SETTLE), len(epochs) // 3)


def walked(
    values: Values, best: float, cost: Callable[[Values], float], p: Fitted, step: float
) -> tuple[Values, float]:
    """Walk one value up while that helps; where it does not help at all, down.

    Parameters
    ----------
    values : mapping of str to float
        At least those that `p` names.
    best : float
        Their cost.
    cost : callable
        ``-2 log L`` of values.
    p : Fitted
    step : float
        Factor of a stride.

    Returns
    -------
    values, best
    """
    for factor in (step, 1.0 / step):
        start = values
        for _ in range(STRIDES):
            trial = _scaled(values, p, factor)
            found = np.inf if trial == values else cost(trial)
            if found >= best - 1.0:
                break
            values, best = trial, found
        if values != start:
            break
    return values, best


def _scaled(values: Values, p: Fitted, factor: float) -> Values:
    """Return values with one of them scaled within its range; with a correlation time, its size at equal
    drive.
    """
    value = float(np.clip(values[p.name] * factor, p.low, p.high))
    out = {**values, p.name: value}
    if p.size:
        out[p.size] = float(values[p.size] * np.sqrt(value / values[p.name]))
    return out
