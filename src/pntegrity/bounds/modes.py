"""Fault events and the modes to monitor: the baseline method of advanced RAIM, for any groups of rows.

An event spoils the rows that its patterns match; events happen independently. A mode is a set of events that
happen together. Modes are monitored, the most probable first, until the probability of all others is small
enough.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import prod

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.sectors import Sectors
from pntegrity.errors import InputError
from pntegrity.states import group_of, is_satellite, sensor_of, source_of

__all__ = [
    "Event",
    "FaultModes",
    "Mode",
    "count_probabilities",
    "events_of",
    "fault_modes",
    "modes_of",
    "names_of",
]

#: Sets of faults inside one event are counted as that event up to this share of its probability (ADD v4.2).
CONSOLIDATED = 0.01
MAX_MODES = 300


@dataclass(frozen=True)
class Event:
    """Something that may fail: its name, the rows it spoils, its probability and the groups of those rows.

    `groups` also has the sensors (``"lbl.AP1"``) of which the message says something.
    """

    name: str
    patterns: tuple[str, ...]
    probability: float
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Mode:
    """Events that happen together.

    Parameters
    ----------
    name : str
        Names of the events, joined by ``+``: ``"G05"``, ``"G05+trop"``.
    events : tuple of str
    patterns : tuple of str
        Of all rows that are left out (`pntegrity.states.rows_touched_by`).
    probability : float
        Bound of the probability, with that of the sets of faults that are counted as this one.
    """

    name: str
    events: tuple[str, ...]
    patterns: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class FaultModes:
    """The modes to monitor, the most probable first; `unmonitored` bounds the probability of all others.

    `reason` tells why no protection level can be given: the others take the whole budget.
    """

    monitored: tuple[Mode, ...]
    unmonitored: float
    reason: str = ""


@lru_cache(maxsize=256)
def names_of(ism: Ism, keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return who can fail among some rows: their groups, and the sensors of sources (``"lbl.AP1"``) of which
    the message says something; sorted.

    Parameters
    ----------
    ism : Ism
    keys : tuple of str
        Of rows, as ``"lbl:R.AP1"``.

    Examples
    --------
    >>> names_of(Ism(sources=(("lbl.AP1", 1e-5),)), ("lbl:R.AP1", "lbl:R.AP2", "usbl:R.range"))
    ('lbl', 'lbl.AP1', 'usbl')
    """
    names = {group_of(k) for k in keys}
    if ism.tells_of_sensors:
        said = {g for _, own, _ in ism.together for g in own}
        sensors = {f"{group_of(k)}.{sensor_of(k)}" for k in keys if sensor_of(k)}
        names |= {s for s in sensors if s in said or ism.sensor(s) is not None}
    return tuple(sorted(names))


@lru_cache(maxsize=1024)
def events_of(ism: Ism, groups: tuple[str, ...], sectors: Sectors = ()) -> tuple[Event, ...]:
    """Return the events of non-zero probability for the groups that are there, sorted by name.

    A sector of one satellite is an event beside that of the satellite: both add to the risk, and who has
    known its first satellite never counts as without the sector.

    Parameters
    ----------
    ism : Ism
    groups : tuple of str
        ``"G05"`` (a satellite: a letter and two digits), ``"trop"``, ``"iono"``, any other, or a sensor of
        one (``"lbl.AP1"``); see `names_of`.
    sectors : tuple of (str, tuple of str)
        Azimuth sectors and their satellites (`sectors.with_risen`); those that are not there do not count.

    Raises
    ------
    InputError
        Where a group has the name of groups that fail together.
    """
    groups = tuple(sorted(set(groups)))
    satellites = tuple(g for g in groups if is_satellite(g))
    events = [_event(ism, g, groups) for g in groups]
    events += [_constellation(ism, c, satellites) for c in sorted({s[0] for s in satellites})]
    together = [*((name, own, ism.p_sector) for name, own in sectors), *ism.together]
    events += [_joint(name, own, p, groups) for name, own, p in together if not set(own).isdisjoint(groups)]
    return tuple(sorted((e for e in events if e.probability > 0.0), key=lambda e: e.name))


def _event(ism: Ism, group: str, groups: tuple[str, ...]) -> Event:
    if is_satellite(group):
        return Event(group, _patterns(group), ism.satellite(group, "iono" in groups), (group,))
    return Event(group, _patterns(group), _of_source(ism, group, groups), _within((group,), groups))


def _of_source(ism: Ism, group: str, groups: tuple[str, ...]) -> float:
    """Return the probability of a product, a source, or a sensor; 0 for one that fails with others only."""
    own = ism.sensor(group) if "." in group else None
    if own is not None:
        return own
    if source_of(group) in groups and "." in group:
        return 0.0
    return {"trop": ism.p_trop, "iono": ism.p_iono}.get(group, ism.source(group))


def _within(own: tuple[str, ...], groups: tuple[str, ...]) -> tuple[str, ...]:
    """Return the groups among `own`, and the sensors of sources among them."""
    return tuple(g for g in groups if g in own or source_of(g) in own)


def _patterns(group: str) -> tuple[str, ...]:
    if is_satellite(group):
        return (f"{group}:*", f"*:{group}")
    source, dot, sensor = group.partition(".")
    return (f"{group}:*", f"{source}:*.{sensor}") if dot else (f"{group}:*",)


def _joint(name: str, own: tuple[str, ...], probability: float, groups: tuple[str, ...]) -> Event:
    """Return the event of groups that fail together; those that are not there yet are in its patterns."""
    if name in groups:
        raise InputError(
            f"`together` of the integrity support message has the name of a group of rows, {name!r}",
            hint="give it another name",
        )
    patterns = tuple(p for g in own for p in _patterns(g))
    return Event(name, patterns, probability, _within(own, groups))


def _constellation(ism: Ism, letter: str, satellites: tuple[str, ...]) -> Event:
    patterns = (f"{letter}[0-9][0-9]:*", f"*:{letter}[0-9][0-9]")  # `G05:C1C` is no row of BeiDou
    own = tuple(s for s in satellites if s[0] == letter)
    return Event(letter, patterns, ism.constellation(letter)[1], own)


def modes_of(
    ism: Ism, groups: tuple[str, ...], sectors: Sectors = ()
) -> tuple[tuple[Event, ...], FaultModes]:
    """Return the events of the groups that are there, and the modes to monitor; see `events_of`.

    What the separation monitor carries and what the risk tree shows is both made here.

    Parameters
    ----------
    ism : Ism
    groups : tuple of str
        Groups and sensors, as `names_of` returns them.
    sectors : Sectors
        Who fails together with whom, see `bounds.sectors`.
    """
    events = events_of(ism, groups, sectors)
    return events, fault_modes(events, ism.p_hmi, ism.p_unmonitored, ism.max_modes)


@lru_cache(maxsize=1024)
def fault_modes(
    events: tuple[Event, ...], budget: float, threshold: float, most: int = MAX_MODES
) -> FaultModes:
    """Return the modes to monitor: single events, then pairs, ... until the others are improbable enough.

    The probability of more than ``r`` events at once is that of independent events, and a set of ``r`` events
    that is not monitored adds the product of its probabilities: a bound that holds for any probabilities.
    Within ``r`` the most probable sets come first, and it ends as soon as the bound is at most `threshold`.
    A set in which one event contains another (a satellite and its constellation) is the mode of the larger
    one. A set inside one monitored event (two satellites of a constellation that may fail) is counted as
    that event, up to a hundredth of its probability.

    Parameters
    ----------
    events : tuple of Event
    budget : float
        Integrity risk over the exposure time.
    threshold : float
        Largest probability of all modes that are not monitored.
    most : int
        No more modes than these.

    References
    ----------
    Blanch et al. (2015), IEEE Trans. Aerosp. Electron. Syst. 51, 713-732, section III. WG-C, ADD v3.0 and
    v3.1 (the bound), v4.2 (order, consolidation).
    """
    events = tuple(sorted((e for e in events if e.probability > 0.0), key=lambda e: -e.probability))
    counts = count_probabilities(events)
    found = _Found({}, {e.name: CONSOLIDATED * e.probability for e in events}, most)
    unmonitored = sum(counts[1:])
    for r in range(1, len(events) + 1):
        if unmonitored <= threshold or found.full:
            break
        unmonitored = _monitor(events, r, sum(counts[r + 1 :]), threshold, found)
    modes = tuple(sorted(found.modes.values(), key=lambda m: -m.probability))
    return FaultModes(modes, unmonitored, _too_much(unmonitored, budget, len(modes)))


def _too_much(unmonitored: float, budget: float, modes: int) -> str:
    if unmonitored < budget:
        return ""
    return (
        f"faults beyond the {modes} modes monitored have a probability of {min(unmonitored, 1.0):.2g}, "
        f"no less than the integrity risk of {budget:.2g}"
    )


def count_probabilities(events: tuple[Event, ...]) -> list[float]:
    """Return the probability that exactly 0, 1, 2, ... of the events happen."""
    out = [1.0]
    for e in events:
        p = e.probability
        out = [a * (1.0 - p) + b * p for a, b in zip([*out, 0.0], [0.0, *out], strict=True)]
    return out


def _symmetric(events: tuple[Event, ...], r: int) -> float:
    """Return the sum of the probabilities of all sets of `r` events."""
    sums = [1.0] + [0.0] * r
    for e in events:
        for k in range(r, 0, -1):
            sums[k] += e.probability * sums[k - 1]
    return sums[r]


@dataclass
class _Found:
    """Modes by name, what single ones may still take on, and how many there may be."""

    modes: dict[str, Mode]
    spare: dict[str, float]
    most: int

    @property
    def full(self) -> bool:
        return len(self.modes) >= self.most

    def add(self, chosen: tuple[Event, ...], events: tuple[Event, ...]) -> None:
        """Take a set of events as a mode of its own, or count it as one that is there."""
        if any(set(a.groups) <= set(b.groups) for a in chosen for b in chosen if a is not b):
            return
        probability = prod(e.probability for e in chosen)
        home = self._home(chosen, probability, events) if len(chosen) > 1 else ""
        if home:
            mode = self.modes[home]
            self.spare[home] -= probability
            self.modes[home] = replace(mode, probability=mode.probability + probability)
            return
        names = tuple(sorted(e.name for e in chosen))
        patterns = tuple(dict.fromkeys(p for e in chosen for p in e.patterns))
        self.modes["+".join(names)] = Mode("+".join(names), names, patterns, probability)

    def _home(self, chosen: tuple[Event, ...], probability: float, events: tuple[Event, ...]) -> str:
        touched = {g for e in chosen for g in e.groups}
        for e in events:
            if e.name in self.modes and touched <= set(e.groups) and probability <= self.spare[e.name]:
                return e.name
        return ""


def _monitor(events: tuple[Event, ...], r: int, beyond: float, threshold: float, found: _Found) -> float:
    """Add modes of `r` events, and return what is left unmonitored."""
    left = _symmetric(events, r)
    for chosen in _most_probable(events, r):
        if beyond + left <= threshold or found.full:
            return beyond + left
        found.add(chosen, events)
        left = max(left - prod(e.probability for e in chosen), 0.0)
    return beyond


def _most_probable(events: tuple[Event, ...], r: int) -> Iterator[tuple[Event, ...]]:
    """Yield the sets of `r` events, the most probable first; `events` are sorted by probability.

    Each set is followed by those in which one event gives way to the next less probable one.
    """

    def entry(index: tuple[int, ...]) -> tuple[float, tuple[int, ...]]:
        return -prod(events[i].probability for i in index), index

    heap, known = [entry(tuple(range(r)))], {tuple(range(r))}
    while heap:
        _, index = heapq.heappop(heap)
        yield tuple(events[i] for i in index)
        for k, bound in enumerate((*index[1:], len(events))):
            after = (*index[:k], index[k] + 1, *index[k + 1 :])
            if after[k] < bound and after not in known:
                known.add(after)
                heapq.heappush(heap, entry(after))
