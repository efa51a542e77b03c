"""Who explains a window alone: sets of sources, and sets of sensors within a source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from pntegrity.kernels.source_test import WithoutSource
from pntegrity.monitors._gains import Gains
from pntegrity.monitors._sources import Evidence, sensors_of
from pntegrity.records import FloatArray
from pntegrity.verdicts import stands_out

__all__ = ["Explanation", "explanations", "faulty_sensors", "first_of_all", "minimal"]

#: Twice the log-likelihood by which one explanation must beat another to be preferred.
MARGIN = 9.0
#: By which it must beat several sources, or several must beat others. Of 500 common drifts of two sources
#: out of three, watched for 20 s, one gave the third 21.
LEAD = 25.0
#: By which a fault of one source more must explain more to be as likely: it occurs a thousandth as often.
RARE = 14.0
#: Several sources are dismissed at so much of the probability of one: a healthy source would be blamed.
RARELY = 1e-2
#: Sensors of which several may be at fault, the most suspicious first.
AMONG_SENSORS = 5


@dataclass(frozen=True)
class Explanation:
    """Whether some sources, or sensors of a source, explain a window alone.

    Parameters
    ----------
    names : tuple of str
    worst, allowed : float
        What another fault explains of what is left without them, and what that may be.
    gained : float
        What their own simple faults explain, less 2 for each parameter beyond the first.
    old : bool
        Whether the best of these faults may have begun before the window.
    """

    names: tuple[str, ...]
    worst: float
    allowed: float
    gained: float = 0.0
    old: bool = False

    @property
    def holds(self) -> bool:
        """Whether nothing is left that they do not explain."""
        return self.worst <= self.allowed


def minimal(
    found: Sequence[Explanation], margin: float = MARGIN, lead: float = LEAD
) -> tuple[Explanation, ...]:
    """Return the explanations that hold and than which no other explains more by a margin; the most likely
    first.

    Where a part of one holds and explains as much, that is enough. Where the part explains less by the
    margin, the whole is what it must compete with: two sources may agree where each alone does not.
    Where one of the two is of several sources it must be a `lead`: a drift on which sources agree looks like
    a fault of another, but for what the motion model knows of it. Where the best may have begun before the
    window no margin counts: the state may have followed a fault of others until they look right.
    """
    holding = sorted((e for e in found if e.holds), key=lambda e: (len(e.names), -e.gained, e.names))
    least = [e for e in holding if not any(set(o.names) < set(e.names) for o in holding)]
    best = max(least, key=lambda e: e.gained, default=None)
    kept: list[Explanation] = []
    for e in holding:
        if best is None or best.old:
            behind = -np.inf
        else:
            behind = best.gained - (margin if len(e.names) == len(best.names) == 1 else lead)
        if e.gained > behind and not any(set(o.names) < set(e.names) for o in kept):
            kept.append(e)
    return tuple(sorted(kept, key=lambda e: (RARE * len(e.names) - e.gained, e.names)))


def first_of_all(found: Sequence[Explanation]) -> Explanation | None:
    """Return whom to leave out, perhaps for the time being; None: nobody (see `verdicts.stands_out`)."""
    return found[0] if stands_out([e.names for e in found]) else None


def explanations(gains: Gains, sets: Sequence[tuple[str, ...]], p: float) -> list[list[Explanation]]:
    """Return for each run whether sets of sources explain its whitened innovations.

    Whether something is left without them the last part of the window says; how much their own faults explain
    all of it: what tells a source from the others together is the motion before the fault.
    """
    evidence, recent = gains.evidence, gains.evidence.recent
    rests = [(recent.without_sources(names), gains.of_sources(names)) for names in sets]
    limits = [p if len(names) == 1 else p * RARELY for names in sets]
    out = _each_run(gains.white[-len(recent.keys) :], sets, rests, limits)
    return [
        [replace(e, old=evidence.is_old(evidence.best(gains.explained[:, r], e.names))) for e in tried]
        for r, tried in enumerate(out)
    ]


def faulty_sensors(
    whole: Evidence, white: FloatArray, source: str, p: float, most: int = 3
) -> list[tuple[tuple[str, ...], ...]]:
    """Return the smallest sets of sensors of a source that explain each run alone: one set, several where
    they cannot be told apart, none where no set of at most `most` does.
    """
    evidence = whole.recent
    white = white[-len(evidence.keys) :]
    sensors = sensors_of(evidence.keys).get(source, ())  # beacons may answer one at a time
    out: list[tuple[tuple[str, ...], ...]] = [()] * white.shape[1]
    left, suspicious = np.arange(white.shape[1]), sensors
    for size in range(1, min(most, len(sensors) - 1) + 1):
        if not len(left):
            break
        sets, gains = list(combinations(suspicious, size)), Gains(evidence, white[:, left])
        rests = [
            (
                evidence.without_sensors(source, names),
                gains.of_sensors(source, names),
            )
            for names in sets
        ]
        found = _each_run(white[:, left], sets, rests, [p] * len(sets))
        for r, tried in zip(left, found, strict=True):
            out[r] = tuple(e.names for e in minimal(tried, lead=MARGIN))
        left = np.array([r for r in left if not out[r]], dtype=np.intp)
        suspicious = _most_suspicious([t for r, t in zip(left, found, strict=False)], suspicious)
    return out


def _most_suspicious(found: list[list[Explanation]], sensors: tuple[str, ...]) -> tuple[str, ...]:
    """Return the sensors whose own faults explain most, in any run."""
    kept: set[str] = set()
    for tried in found:
        best = sorted(tried, key=lambda e: -e.gained)[:AMONG_SENSORS]
        kept.update(name for e in best for name in e.names)
    return tuple(s for s in sensors if s in kept)


def _each_run(
    white: FloatArray, sets: Sequence[tuple[str, ...]], rests: Sequence[tuple[WithoutSource, FloatArray]],
    limits: Sequence[float],
) -> list[list[Explanation]]:  # fmt: skip
    out: list[list[Explanation]] = [[] for _ in range(white.shape[1])]
    for names, (rest, gained), p in zip(sets, rests, limits, strict=True):
        worst, allowed = rest.explained(white).max(axis=0, initial=0.0), rest.allowed(p)
        for r, tried in enumerate(out):
            tried.append(Explanation(names, float(worst[r]), allowed, float(gained[r])))
    return out
