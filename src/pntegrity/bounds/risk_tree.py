"""The risk tree of a vehicle's sources: which combinations may fail together, and which must be monitored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from math import prod

from pntegrity.bounds.modes import Event, FaultModes, fault_modes

__all__ = ["Branch", "RiskTree", "risk_tree"]


@dataclass(frozen=True)
class Branch:
    """One hypothesis: the sources that are at fault, and no others.

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
        All, by the number of sources at fault, the most probable first.
    together : int
        How many simultaneous faults are monitored at least.
    unmonitored : float
        Probability of all that is not.
    modes : FaultModes
        The monitored ones, for protection levels.
    """

    branches: tuple[Branch, ...]
    together: int
    unmonitored: float
    modes: FaultModes

    def beyond(self, together: int) -> float:
        """Return the probability of more faults than that at once, eq. (22) for any priors."""
        return sum(b.probability for b in self.branches if len(b.sources) > together)


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
    modes = fault_modes(events, p_hmi, share * p_hmi)
    watched = {frozenset(m.events) for m in modes.monitored}
    branches = tuple(
        Branch(names, p, not names or frozenset(names) in watched)
        for size in range(len(prior) + 1)
        for names, p in _by_probability(prior, size)
    )
    together = max((len(m.events) for m in modes.monitored), default=0)
    return RiskTree(branches, together, sum(b.probability for b in branches if not b.monitored), modes)


def _by_probability(prior: Mapping[str, float], size: int) -> list[tuple[tuple[str, ...], float]]:
    found = [
        (names, prod(p if name in names else 1.0 - p for name, p in prior.items()))
        for names in combinations(sorted(prior), size)
    ]
    return sorted(found, key=lambda one: -one[1])
