"""The risk tree of a vehicle's sources: which combinations may fail together, and which must be monitored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from math import comb, prod

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import Event, FaultModes, count_probabilities, fault_modes, modes_of
from pntegrity.bounds.sectors import Sectors

__all__ = ["Branch", "RiskTree", "risk_tree", "tree_of"]

#: Of more simultaneous faults than can be listed with this many branches, only those monitored are.
MOST_BRANCHES = 512


@dataclass(frozen=True)
class Branch:
    """One hypothesis: the sources (and sensors) that are at fault, and no others.

    Parameters
    ----------
    sources : tuple of str
        None: no fault.
    probability : float
        That exactly these are at fault.
    monitored : bool
        Whether a combination without them is compared with the others.
    """

    sources: tuple[str, ...]
    probability: float
    monitored: bool


@dataclass(frozen=True)
class RiskTree:
    """What may fail, how probable it is, and what of it is monitored.

    Parameters
    ----------
    branches : tuple of Branch
        By the number of faults, the most probable first: all, or of numbers with too many the monitored ones.
    together : int
        How many simultaneous faults are monitored, in one mode at least.
    unmonitored : float
        Bound of the probability of all that is not: what comes off the integrity risk.
    modes : FaultModes
        The monitored ones, for protection levels.
    at_once : tuple of float
        Probability of exactly 0, 1, 2, ... faults.
    """

    branches: tuple[Branch, ...]
    together: int
    unmonitored: float
    modes: FaultModes
    at_once: tuple[float, ...]

    def beyond(self, together: int) -> float:
        """Return the probability of more faults than that at once, eq. (22) for any priors."""
        return sum(self.at_once[together + 1 :])


def risk_tree(prior: Mapping[str, float], p_hmi: float, share: float = 0.8) -> RiskTree:
    """Return the tree of the sources that are there now: it is built anew when they change.

    Parameters
    ----------
    prior : mapping of str to float
        Fault probability of each source.
    p_hmi : float
        The integrity risk.
    share : float
        What of it may be left to what is not monitored.

    Raises
    ------
    ValueError
        Where a prior is no probability.

    References
    ----------
    Chen and Zhao (2023), eqs (20)-(24), figure 4.
    """
    for name, p in prior.items():
        if not 0.0 < p < 1.0:
            raise ValueError(f"`prior.{name}` must be a probability above 0 and below 1, not {p!r}")
    events = tuple(Event(name, (f"{name}:*",), p, (name,)) for name, p in sorted(prior.items()))
    return _tree(events, fault_modes(events, p_hmi, share * p_hmi))


def tree_of(ism: Ism, groups: tuple[str, ...], sectors: Sectors = ()) -> RiskTree:
    """Return the tree of what is there now, as the separation monitor has it: the same events and modes.

    Parameters
    ----------
    ism : Ism
        Its priors, its risk and what of it may be left unmonitored.
    groups : tuple of str
        `modes.names_of` gives those of an update's rows, with the sensors that may fail by themselves.
    sectors : tuple of (str, tuple of str)
        Azimuth sectors and their satellites.

    Examples
    --------
    >>> tree = tree_of(Ism(sources=(("lbl", 1e-4), ("usbl", 1e-5))), ("lbl", "usbl"))
    >>> [b.sources for b in tree.branches if b.monitored]
    [(), ('lbl',), ('usbl',)]
    """
    return _tree(*modes_of(ism, groups, sectors))


def _tree(events: tuple[Event, ...], modes: FaultModes) -> RiskTree:
    together = max((len(m.events) for m in modes.monitored), default=0)
    at_once = tuple(count_probabilities(events))
    return RiskTree(tuple(_branches(events, modes)), together, modes.unmonitored, modes, at_once)


def _branches(events: tuple[Event, ...], modes: FaultModes) -> Iterator[Branch]:
    """Yield the branches, by size and then by probability."""
    watched = {frozenset(m.events) for m in modes.monitored}
    left = MOST_BRANCHES
    for size in range(len(events) + 1):
        left -= comb(len(events), size)
        whole = size < 2 or left >= 0
        sets = combinations(events, size) if whole else _of(events, watched, size)
        found = [
            Branch(tuple(e.name for e in s), _exactly(s, events), not s or _largest(s) in watched)
            for s in sets
        ]
        yield from sorted(found, key=lambda b: -b.probability)


def _of(events: tuple[Event, ...], watched: set[frozenset[str]], size: int) -> Iterator[tuple[Event, ...]]:
    """Yield the monitored sets of a size."""
    for names in watched:
        if len(names) == size:
            yield tuple(e for e in events if e.name in names)


def _exactly(chosen: tuple[Event, ...], events: tuple[Event, ...]) -> float:
    """Return the probability of some events and no others."""
    return prod(e.probability if e in chosen else 1.0 - e.probability for e in events)


def _largest(chosen: tuple[Event, ...]) -> frozenset[str]:
    """Return the names without those of events that another one holds, as a source its sensors."""
    return frozenset(e.name for e in chosen if not any(set(e.groups) < set(other.groups) for other in chosen))
