"""Who is at fault: the event without which the subfilters agree."""

from __future__ import annotations

import numpy as np

from pntegrity.bounds.modes import Event
from pntegrity.monitors._levels import Spread
from pntegrity.monitors._members import Cast
from pntegrity.records import FloatArray, Suspect, Update
from pntegrity.states import group_of, sensor_of, source_of
from pntegrity.verdicts import SEPARATION

__all__ = ["suspects_of"]

MOST = 4


def suspects_of(
    spread: Spread, cast: Cast, update: Update, K: FloatArray, pairs: bool
) -> tuple[Suspect, ...]:
    """Return who may be at fault, the most likely first; `statistic` is small where an event explains much.

    With `pairs` it is the worst re-test: the largest separation of a solution without yet another event from
    that without this one, over what is allowed; at most 1 where the rest agrees. Without, it is what is
    allowed over the solution's own separation, the rule of the paper.
    """
    own = _own(spread, cast, K)
    statistic = _retests(spread, cast, K) if pairs else 1.0 / np.maximum(own, 1e-9)
    found = {}
    for i in np.lexsort((-own, statistic)).tolist():
        present = _present(cast.events[i], update)
        if present and np.isfinite(statistic[i]):
            size = float(np.abs(spread.apart[cast.single[i], :3]).max())
            groups = tuple(g for g in present if "." not in g or source_of(g) not in present)
            found[i] = Suspect(groups, SEPARATION, size, update.t_ns, float(statistic[i])), frozenset(present)
    explains = [parts for s, parts in found.values() if s.statistic <= 1.0]
    return tuple(s for s, parts in found.values() if not any(p < parts for p in explains))[:MOST]


def _present(event: Event, update: Update) -> tuple[str, ...]:
    """Return the groups and sensors of an event that the update has rows of."""
    groups = update.groups()
    sensors = {f"{group_of(k)}.{sensor_of(k)}" for k in update.keys}
    return tuple(g for g in event.groups if g in groups or g in sensors)


def _own(spread: Spread, cast: Cast, K: FloatArray) -> FloatArray:
    """Return each event's largest separation over what is allowed, shape (events,)."""
    at = np.array(cast.single, dtype=np.intp)
    return _ratios(spread.apart[at], spread.separation[at], spread, K)


def _retests(spread: Spread, cast: Cast, K: FloatArray) -> FloatArray:
    """Return the worst re-test of each event, inf where nothing can be tested without it, shape (events,)."""
    worst = np.zeros(len(cast.events))
    single = np.array(cast.single, dtype=np.intp)
    event, _, both = np.array(cast.pairs, dtype=np.intp).T
    base = single[event]
    undetermined = ~np.isfinite(spread.variance[base]) | ~np.isfinite(spread.variance[both])
    gap = np.where(undetermined, 0.0, spread.variance[both]) - np.where(
        undetermined, 0.0, spread.variance[base]
    )
    ratios = _ratios(spread.apart[both] - spread.apart[base], gap, spread, K)
    np.maximum.at(worst, event, ratios)
    return np.where(np.isfinite(spread.variance[single]).all(axis=1), worst, np.inf)


def _ratios(apart: FloatArray, variance: FloatArray, spread: Spread, K: FloatArray) -> FloatArray:
    testable = spread.tells(variance)
    allowed = K * np.sqrt(np.where(testable, variance, 1.0))
    return np.asarray(np.where(testable, np.abs(apart) / allowed, 0.0).max(axis=1))
