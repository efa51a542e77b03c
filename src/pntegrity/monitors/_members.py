"""Which subfilters a separation monitor carries, and where each comes from when groups come, go or fail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import Event, FaultModes, modes_of
from pntegrity.bounds.sectors import Sectors
from pntegrity.records import FloatArray
from pntegrity.states import group_of, rows_touched_by

Member = tuple[str, ...]
IntArray = npt.NDArray[np.intp]

__all__ = ["Cast", "Member", "Sources", "cast_of", "groups_of", "in_order", "nested", "sources", "used_rows"]


@dataclass(frozen=True, eq=False)
class Cast:
    """The subfilters for the groups that are there; `cast_of` makes each once.

    Parameters
    ----------
    events : tuple of Event
    faults : FaultModes
    members : tuple of tuple of str
        Names of the events that each member does without; the first is the whole filter, then come the modes
        in the order of `faults.monitored`, then whatever else identifies a fault.
    single : tuple of int
        The member of each event.
    pairs : tuple of (int, int, int)
        Two events and the member without both, for both orders.
    """

    events: tuple[Event, ...]
    faults: FaultModes
    members: tuple[Member, ...]
    single: tuple[int, ...]
    pairs: tuple[tuple[int, int, int], ...]

    @property
    def probability(self) -> FloatArray:
        """Probabilities of the monitored modes."""
        return np.array([m.probability for m in self.faults.monitored])


@lru_cache(maxsize=256)
def cast_of(
    ism: Ism, groups: tuple[str, ...], pairs: bool, ordered: bool = False, sectors: Sectors = ()
) -> Cast:
    """Return the subfilters for some groups; with `pairs` also those without any two events.

    `ordered`: those without two events are two members, each of which goes on from the member without the
    first and does without the second since a switch only. `sectors`: see `events_of`.
    """
    events, faults = modes_of(ism, groups, sectors)
    members = dict.fromkeys([(), *(tuple(sorted(m.events)) for m in faults.monitored)])
    members |= dict.fromkeys((e.name,) for e in events)
    both = _pairs(events, ordered) if pairs else {}
    members |= dict.fromkeys(both.values())
    at = {m: i for i, m in enumerate(members)}
    return Cast(
        events, faults, tuple(members), tuple(at[e.name,] for e in events),
        tuple((a, b, at[m]) for (a, b), m in both.items()),
    )  # fmt: skip


def _pairs(events: tuple[Event, ...], ordered: bool) -> dict[tuple[int, int], Member]:
    """Return the member without each two events, of which neither contains the other."""
    sets = [frozenset(e.groups) for e in events]
    return {
        (a, b): (events[a].name, events[b].name)
        if ordered or events[a].name < events[b].name
        else (events[b].name, events[a].name)
        for a in range(len(events))
        for b in range(len(events))
        if a != b and not sets[a] <= sets[b] and not sets[b] <= sets[a]
    }


@lru_cache(maxsize=256)
def used_rows(cast: Cast, keys: tuple[str, ...]) -> npt.NDArray[np.bool_]:
    """Return which rows each member uses, shape (members, rows), read-only."""
    out = np.ones((len(cast.members), len(keys)), dtype=bool)
    for i, key in enumerate(keys):
        out[:, i] = _uses(cast, key)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=16384)
def _uses(cast: Cast, key: str) -> npt.NDArray[np.bool_]:
    """Return which members use a row, shape (members,): in a street rows come and go all the time."""
    touched = {e.name for e in cast.events if rows_touched_by(e.patterns, (key,))[0]}
    return np.array([touched.isdisjoint(m) for m in cast.members])


@lru_cache(maxsize=256)
def groups_of(keys: tuple[str, ...]) -> Mapping[str, int]:
    """Return the groups of some rows, each with its first row."""
    first: dict[str, int] = {}
    for i, key in enumerate(keys):
        first.setdefault(group_of(key), i)
    return MappingProxyType(first)


@lru_cache(maxsize=256)
def in_order(keys: tuple[str, ...]) -> IntArray:
    """Return the rows in the order of their names, shape (len(keys),), read-only."""
    out = np.array(sorted(range(len(keys)), key=keys.__getitem__), dtype=np.intp)
    out.flags.writeable = False
    return out


def nested(events: tuple[Event, ...], without: Member) -> tuple[Member, Member]:
    """Return the other events that hold all groups of those in `without`, and those within them."""
    out = {g for e in events for g in e.groups if e.name in without}
    others = [e for e in events if out and e.groups and e.name not in without]
    within = tuple(e.name for e in others if out.issuperset(e.groups))
    return tuple(e.name for e in others if out < set(e.groups)), within


@dataclass(frozen=True, eq=False)
class Sources:
    """Where members come from.

    Parameters
    ----------
    member : ndarray of int, shape (M,)
        The member of the bank before that each goes on from.
    whole : ndarray of bool, shape (M,)
        Whether that one has been without all the same events; else what is missing is left out from now on.
    loose : ndarray of bool, shape (M,)
        Whether it knows what the filter, which goes over to another one, does not.
    origin : int
        The one that the filter goes on from.
    """

    member: IntArray
    whole: npt.NDArray[np.bool_]
    loose: npt.NDArray[np.bool_]
    origin: int


@lru_cache(maxsize=256)
def sources(
    old: tuple[Member, ...], new: tuple[Member, ...], without: Member = (), ordered: bool = False,
    holding: Member = (), within: Member = (),
) -> Sources:  # fmt: skip
    """Return where members come from, where the filter goes over to the member without the events `without`.

    The first choice is the member without the same events and without those. Where there is none, it is the
    one that has been without the same event, which is loose then; and of two events that without the first.
    The member without an event that holds all of those, as a sector holds its satellites, has been without
    them; what lies within those is left out with them.

    Parameters
    ----------
    old, new : tuple of tuple of str
    without : tuple of str
    ordered : bool
        Whether members of `old` without two events know what those without the second only do not.
    holding, within : tuple of str
        Events of which those in `without` are a part, and that are a part of those; see `nested`.
    """
    where = {m: i for i, m in enumerate(old)}
    known = {m[0] for m in old if len(m) == 1}  # what nobody has used yet, nobody needs to do without

    def exact(rest: Member) -> int | None:
        names = (first + rest for first in permutations(without))
        found = (where.get(n if ordered else tuple(sorted(n))) for n in names)
        return next((at for at in found if at is not None), None)

    def find(rest: Member) -> tuple[int, bool, bool]:
        at = exact(rest)
        late = (
            ordered and without and rest
        )  # then the second event of a pair was left out since a switch only
        if at is not None and not late:
            return at, True, False
        if len(rest) > 1:
            first, _, loose = find(rest[:1])
            return first, False, loose
        if rest and rest[0] in holding:
            return where[rest], True, False
        return (where[rest], True, True) if rest in where else (where.get(without[:1], 0), False, False)

    gone = {*without, *within}
    found = [find(tuple(e for e in m if e in known and e not in gone)) for m in new]
    member = np.array([f[0] for f in found], dtype=np.intp)
    whole, loose = (np.array([f[k] for f in found], dtype=bool) for k in (1, 2))
    for a in (member, whole, loose):
        a.flags.writeable = False
    return Sources(member, whole, loose, find(())[0])
