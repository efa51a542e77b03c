"""Who explains a window alone: sets of sources, and sets of sensors within a source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from pntegrity.kernels.source_test import WithoutSource
from pntegrity.monitors._sources import Evidence, sensors_of
from pntegrity.records import FloatArray

__all__ = ["Explanation", "explanations", "faulty_sensors", "minimal"]

#: Twice the log-likelihood by which one explanation must beat another to be preferred.
MARGIN = 9.0
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


def minimal(found: Sequence[Explanation], margin: float = MARGIN) -> tuple[Explanation, ...]:
    """Return the explanations that hold and than which no other explains more by a margin; the best first.

    Where a part of one holds and explains as much, that is enough. Where the part explains less by the
    margin, the whole is what it must compete with: two sources may agree where each alone does not.
    Where the best may have begun before the window no margin counts: the state may have followed a fault of
    others until they look right.
    """
    holding = sorted((e for e in found if e.holds), key=lambda e: (len(e.names), -e.gained, e.names))
    least = [e for e in holding if not any(set(o.names) < set(e.names) for o in holding)]
    best = max(least, key=lambda e: e.gained, default=None)
    limit = -np.inf if best is None or best.old else best.gained - margin
    kept: list[Explanation] = []
    for e in holding:
        if e.gained > limit and not any(set(o.names) < set(e.names) for o in kept):
            kept.append(e)
    return tuple(sorted(kept, key=lambda e: (-e.gained, e.names)))


def explanations(
    evidence: Evidence, white: FloatArray, sets: Sequence[tuple[str, ...]], p: float
) -> list[list[Explanation]]:
    """Return for each run whether sets of sources explain its whitened innovations, shape (D, runs)."""
    rests = [(evidence.without_sources(names), evidence.gained(white, names)) for names in sets]
    out, explained = _each_run(white, sets, rests, p), evidence.explained(white)
    return [
        [replace(e, old=evidence.is_old(evidence.best(explained[:, r], e.names))) for e in tried]
        for r, tried in enumerate(out)
    ]


def faulty_sensors(
    evidence: Evidence, white: FloatArray, source: str, p: float, most: int = 3
) -> list[tuple[tuple[str, ...], ...]]:
    """Return the smallest sets of sensors of a source that explain each run alone: one set, several where
    they cannot be told apart, none where no set of at most `most` does.
    """
    sensors = sensors_of(evidence.window[-1].keys).get(source, ())
    out: list[tuple[tuple[str, ...], ...]] = [()] * white.shape[1]
    left, suspicious = np.arange(white.shape[1]), sensors
    for size in range(1, min(most, len(sensors) - 1) + 1):
        if not len(left):
            break
        sets = list(combinations(suspicious, size))
        rests = [
            (
                evidence.without_sensors(source, names),
                evidence.gained_by_sensors(white[:, left], source, names),
            )
            for names in sets
        ]
        found = _each_run(white[:, left], sets, rests, p)
        for r, tried in zip(left, found, strict=True):
            out[r] = tuple(e.names for e in minimal(tried))
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
    p: float,
) -> list[list[Explanation]]:  # fmt: skip
    out: list[list[Explanation]] = [[] for _ in range(white.shape[1])]
    for names, (rest, gained) in zip(sets, rests, strict=True):
        worst, allowed = rest.explained(white).max(axis=0, initial=0.0), rest.allowed(p)
        for r, tried in enumerate(out):
            tried.append(Explanation(names, float(worst[r]), allowed, float(gained[r])))
    return out
