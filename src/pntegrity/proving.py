"""Trials of who was left out: the filter with its rows, run again beside the one without them.

What is proved, and how sure that is, has `kernels.recovery.Trial`. A trial begins when residuals become small
and is made again as the window grows, each time half as long again: their number grows with the logarithm of
the time, and none is made while a fault shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.exclusion import Policy, Standing
from pntegrity.kernels.linear import inverse_definite
from pntegrity.kernels.recovery import ChangeTrial, Trial, w_test
from pntegrity.kernels.source_test import Gains
from pntegrity.protocols import Estimator, stepped
from pntegrity.records import Epoch, FloatArray, State, Update
from pntegrity.states import is_left_out, names_sensor

__all__ = ["Past", "Proof", "is_due", "left_out_rows", "passes_now", "prove"]

#: A row of a source that went as a whole is proved not to be off by so many standard deviations of its
#: residual at least: what can be seen of it.
LEAST_SIGMA = 6.0
#: A fault that is still there is at least so much of the largest that was seen.
STILL = 0.5
#: A trial is worth while where each estimated bias may be so many standard deviations.
ENOUGH = 2.0
#: The end of a fault is proved with so many epochs before it, and where it is seen with this probability.
LEAST_BEFORE, MOST_BEFORE, WORTH = 4, 20, 0.5
#: Each trial is this much longer than the one before.
LONGER = 1.5


@dataclass(frozen=True, eq=False)
class Past:
    """What a repair or a trial needs of one epoch: the state before it, the epoch, who was left out, whether
    its prior was relaxed, and the memories before it of monitors that resume (None: of others).
    """

    before: State
    epoch: Epoch
    excluded: frozenset[str]
    relaxed: bool = False
    memories: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Proof:
    """What came of a test of who is left out.

    Parameters
    ----------
    name : str
        A group, or ``"<source>.<sensor>"``.
    t_ns : int
    epochs : int
        Of the trial, or tests that have passed in a row.
    passed : bool
        Whether it may come back.
    statistic, limit : float
        The largest estimated bias of a row, or the largest w-statistic, in standard deviations; what that may
        be.
    readmission : float
        Probability with which a row passes this trial that is off by as much as must be proved (see
        `prove`); 1 where nothing is known of it.
    reason : str
        Why nothing can be said.
    of_end : bool
        Whether it was the end of a fault that should have shown: a healthy one has none to show.
    """

    name: str
    t_ns: int
    epochs: int
    passed: bool
    statistic: float = 0.0
    limit: float = 0.0
    readmission: float = 1.0
    reason: str = ""
    of_end: bool = False


def left_out_rows(update: Update, name: str) -> npt.NDArray[np.intp]:
    """Return which of the rows left out are those of a group or sensor, products about it included."""
    out = frozenset([name])
    return np.array([i for i, key in enumerate(update.spare_keys) if is_left_out(key, out)], dtype=np.intp)


def is_due(epochs: int, times: int) -> bool:
    """Tell whether a trial is made after so many epochs with small residuals: the first of 4, each half as
    long again; who was left out several times must go on for twice as long each time.
    """
    due = 4.0
    while round(due) < epochs:
        due *= LONGER
    return round(due) == epochs and epochs >= 4 * 2 ** (min(times, 5) - 1)


def prove(
    estimator: Estimator, history: Sequence[Past], name: str, standing: Standing, policy: Policy
) -> Proof:
    """Return what a trial shows of who was left out, over the epochs since its residuals were small.

    Proved is that no row is off by half of the largest residual that was seen of it; nor, of a sensor that
    was named, by its fault as it was when it was left out; nor, of a source that went as a whole, by 6
    standard deviations of the residual, where that is more. Where the state may have followed the fault of a
    sensor, so that no window shows its size, it is proved instead that a bias of that size has ended.

    Parameters
    ----------
    estimator : Estimator
    history : sequence of Past
        The oldest first, this epoch included.
    name : str
    standing : Standing
    policy : Policy
        `p_readmit` and `p_refuse`.
    """
    found = _by_size(estimator, _since(history, standing.quiet_ns), name, standing, policy)
    if not found.reason or not standing.size:
        return found
    window = _since(history, standing.clean_ns)
    before = _before(history[: len(history) - len(window)], name)
    both = _Run.of(estimator, [*before, *window], name, standing) if before else None
    return found if both is None else _by_change(both, len(before), policy, found)


def _since(history: Sequence[Past], t_ns: int | None) -> Sequence[Past]:
    """Return the epochs from a time on, the last one where there is none."""
    first = history[-1].epoch.t_ns if t_ns is None else t_ns
    return [p for p in history if p.epoch.t_ns >= first]


def _by_size(
    estimator: Estimator, window: Sequence[Past], name: str, standing: Standing, policy: Policy
) -> Proof:
    """Return what the rows of a window show of biases in them."""
    proof = Proof(name, window[-1].epoch.t_ns, len(window), False)
    run = _Run.of(estimator, window, name, standing)
    if run is None:
        return replace(proof, reason="nothing was measured")
    least = ENOUGH if len(window) >= policy.history else -np.inf
    trial = Trial(run.gains, run.rows, run.size, policy.p_readmit, policy.p_refuse, least)
    return _proof(trial, run.white, proof)


@dataclass(frozen=True, eq=False)
class _Run:
    """The filter with the rows of who was left out: gains, where these rows are, and what must be proved."""

    gains: tuple[Gains, ...]
    rows: tuple[npt.NDArray[np.intp], ...]
    size: FloatArray
    white: FloatArray

    @staticmethod
    def of(estimator: Estimator, window: Sequence[Past], name: str, standing: Standing) -> _Run | None:
        """Return the run over some epochs; None where nothing is measured, or the filter starts in them."""
        updates, out = _run_again(estimator, window, name), frozenset([name])
        keys = tuple(dict.fromkeys(k for u in updates for k in u.keys if is_left_out(k, out)))
        if not keys or any(u.is_start for u in updates):
            return None
        return _Run(
            tuple((u.F, u.H, u.L, u.K) for u in updates), tuple(_places(u, keys) for u in updates),
            _sizes(updates, keys, name, standing), np.concatenate([u.white for u in updates])[:, None],
        )  # fmt: skip


def _before(past: Sequence[Past], name: str) -> list[Past]:
    """Return the last epochs without somebody, as many as have `MOST_BEFORE` of their rows; none where they
    have fewer than `LEAST_BEFORE`.
    """
    out, kept, count = frozenset([name]), [], 0
    for p in reversed(past):
        if name not in p.excluded or count >= MOST_BEFORE:
            break
        kept.append(p)
        count += any(is_left_out(k, out) for o in p.epoch.observations for k in o.keys)
    return kept[::-1] if count >= LEAST_BEFORE else []


def _by_change(run: _Run, before: int, policy: Policy, proof: Proof) -> Proof:
    """Return what the end of a fault shows; as it was where that is no more."""
    trial = ChangeTrial(run.gains, run.rows, before, run.size, policy.p_readmit, policy.p_refuse)
    if trial.power.min() < WORTH:
        return proof
    return replace(
        proof, passed=bool(trial.passed(run.white)[0]), statistic=float(trial.estimates(run.white).max()),
        limit=trial.limit, readmission=float(trial.readmission.max()), reason="", of_end=True,
    )  # fmt: skip


def _run_again(estimator: Estimator, window: Sequence[Past], name: str) -> list[Update]:
    state, out = window[0].before, []
    for p in window:
        update = stepped(estimator, state, p.epoch, p.excluded - {name}, p.relaxed)
        out.append(update)
        state = update.posterior
    return out


def _places(update: Update, keys: Sequence[str]) -> npt.NDArray[np.intp]:
    at = {key: i for i, key in enumerate(update.keys)}
    return np.array([at.get(key, -1) for key in keys], dtype=np.intp)


def _sizes(updates: Sequence[Update], keys: Sequence[str], name: str, standing: Standing) -> FloatArray:
    """Return by how much each row must be proved not to be off."""
    seen: dict[str, float] = {}
    for u in (u for u in updates if u.keys):
        spread = (np.diagonal(inverse_definite(u.S)) ** -0.5).tolist()  # against all other rows
        seen = dict(zip(u.keys, spread, strict=True)) | seen
    largest, whole = dict(standing.rows), not names_sensor(name)
    least = (LEAST_SIGMA * seen[k] if whole or not standing.size else standing.size for k in keys)
    return np.array([max(STILL * largest.get(k, 0.0), low) for k, low in zip(keys, least, strict=True)])


def _proof(trial: Trial, white: FloatArray, proof: Proof) -> Proof:
    limits, each = trial.limits, trial.estimates(white)[:, 0]
    worst = int(np.argmax(each - limits))
    enough = bool(limits.min() >= ENOUGH)
    return replace(
        proof, passed=enough and bool(trial.passed(white)[0]), statistic=float(each[worst]),
        limit=max(float(limits[worst]), 0.0), readmission=float(trial.readmission.max()),
        reason="" if enough else "too short to tell",
    )  # fmt: skip


def passes_now(update: Update, rows: npt.NDArray[np.intp], p_fa: float) -> tuple[bool, float, float]:
    """Return whether all w-tests of an epoch's rows pass, the largest of them, and its limit.

    Parameters
    ----------
    update : Update
        With the rows left out.
    rows : ndarray of int
        Which of them.
    p_fa : float
        Probability that a healthy row fails.
    """
    cov = np.diag(update.spare_var) if update.spare_cov is None else update.spare_cov
    w, limit = w_test(update.spare_nu[rows], cov[np.ix_(rows, rows)], p_fa)
    return bool((w <= limit).all()), float(w.max()), limit
