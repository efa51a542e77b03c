"""Which rows of a signal table to use: the interval, the systems, a signal (or two) a satellite and epoch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.physics._steady import Groups, steady
from pntegrity.physics.signals import (
    DEFAULT_PAIRS,
    DEFAULT_SIGNALS,
    PRECISE_CARRIERS,
    PRECISE_PAIRS,
    WORDS,
)
from pntegrity.physics.tables import SignalTable
from pntegrity.physics.time import to_iso

__all__ = ["Chosen", "check_systems", "choose", "systems_left_out", "window"]

Index = npt.NDArray[np.intp]
RANGE_M = (1.0e7, 6.0e7)
"""Pseudoranges outside cannot be: satellites are 1.9e7 to 4.2e7 m away, 10 ms of clock offset are 3e6 m."""
NEVER = 255
"""Rank of a signal that is not in the preference list."""
OTHER_SIGNALS = "other signals than in the rest of its pass"
Lists = dict[str, tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class Chosen:
    """One row a satellite and epoch: table rows of its codes and carriers (-1: none), why left out."""

    epoch: npt.NDArray[np.int64]
    sat: npt.NDArray[np.str_]
    first: Index
    second: Index
    reason: npt.NDArray[np.object_]
    carrier_first: Index
    carrier_second: Index

    def __len__(self) -> int:
        return len(self.sat)


def check_systems(systems: str) -> None:
    """Refuse letters of no known system."""
    if not systems or any(s not in DEFAULT_SIGNALS for s in systems):
        raise ValueError(f"`systems` must be letters of {''.join(DEFAULT_SIGNALS)}, not {systems!r}")


def window(
    table: SignalTable, systems: str, start_ns: int | None, end_ns: int | None
) -> tuple[npt.NDArray[np.int64], Index]:
    """Return the time tags of the interval and the table rows of `systems` in it."""
    first = 0 if start_ns is None else int(np.searchsorted(table.t_ns, start_ns, side="left"))
    last = len(table.t_ns) if end_ns is None else int(np.searchsorted(table.t_ns, end_ns, side="right"))
    if first >= last:
        span = f"{to_iso(int(table.t_ns[0]))} to {to_iso(int(table.t_ns[-1]))}"
        raise InputError(
            "no epoch in the interval asked for", path=table.source, hint=f"The file covers {span} (GPS time)"
        )
    lo, hi = np.searchsorted(table.epoch, (first, last))
    rows = lo + np.flatnonzero(np.isin(table.sat[lo:hi].astype("<U1"), list(systems)))
    if not len(rows):
        raise InputError(
            f"no satellite of the systems {systems} in this file",
            path=table.source,
            hint=f"It holds {table.systems}",
        )
    return table.t_ns[first:last], rows


def systems_left_out(table: SignalTable, systems: str) -> list[str]:
    """Return a note on the systems of the file that nobody asked for."""
    others = [WORDS.get(s, s) for s in table.systems if s not in systems]
    return [f"in the file but not asked for: {', '.join(others)}"] if others else []


def choose(
    table: SignalTable, rows: Index, signals: Mapping[str, tuple[str, ...]], pair: bool, precise: bool = False
) -> Chosen:
    """Choose for each epoch and satellite the first usable code of the list, and a second for a pair.

    Carriers are those of the codes; with `precise` see `_steadily`.
    """
    sat, epoch = table.sat[rows], table.epoch[rows].astype(np.int64)
    p = table.pseudorange_m[rows]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (epoch[1:] != epoch[:-1]) | (sat[1:] != sat[:-1])
    starts = np.flatnonzero(new)
    usable = (p >= RANGE_M[0]) & (p <= RANGE_M[1])
    lists = _lists(signals, pair, precise)
    rank = _ranks(table, rows, lists[0])
    first = _best(rank, usable, starts)
    reason = _reasons(sat[starts], first, _best(rank, np.ones_like(usable), starts), lists[0])
    second = np.full(len(starts), -1)
    if pair:
        second = _best(_ranks(table, rows, lists[1]), usable, starts)
        reason[(reason == "") & (second < 0)] = "no second frequency"
    to_table = np.append(rows, -1)
    if not precise:
        codes = to_table[first], to_table[second]
        return Chosen(epoch[starts], sat[starts], *codes, reason, *codes)
    groups = Groups(np.cumsum(new) - 1, sat[starts], table.t_ns[epoch[starts]])
    one, two = (_steadily(table, rows, groups, usable, n, signals) for n in lists)
    reason[(reason == "") & ((one[0] < 0) | (two[0] < 0))] = OTHER_SIGNALS
    found = [to_table[x] for x in (one[0], two[0], one[1], two[1])]
    return Chosen(epoch[starts], sat[starts], found[0], found[1], reason, found[2], found[3])


def _lists(signals: Mapping[str, tuple[str, ...]], pair: bool, precise: bool) -> tuple[Lists, Lists]:
    """Return the preferences for the first and the second signal of each system."""
    pairs = PRECISE_PAIRS if precise else DEFAULT_PAIRS
    first = {s: signals.get(s, pairs[s][0] if pair else DEFAULT_SIGNALS[s]) for s in DEFAULT_SIGNALS}
    return first, {s: signals.get(s + "2", pairs[s][1]) for s in DEFAULT_SIGNALS}


def _steadily(
    table: SignalTable, rows: Index, groups: Groups, usable: npt.NDArray[np.bool_], codes: Lists,
    signals: Mapping[str, tuple[str, ...]],
) -> tuple[Index, Index]:  # fmt: skip
    """Return for each group the rows of a code and of a carrier of the same band, -1 where there is none.

    They are the same ones from a satellite's rise to its setting, as a carrier that is another one has
    another ambiguity. Codes are preferably those that precise clocks refer to, carriers those that
    `PRECISE_CARRIERS` puts first; P(Y) code is often logged without a carrier of its own.
    """
    names = table.signal[rows]
    carriers = {s: c if signals.get(s) or signals.get(s + "2") else _carriers(s, c) for s, c in codes.items()}
    coded = usable & (_ranks(table, rows, codes) < NEVER)
    band = groups.of_row * 10 + _bands(names)
    there = np.isfinite(table.carrier_cycles[rows]) & np.isin(band, band[coded])
    carrier, meant = steady(groups, names, there, carriers)
    same = (meant[groups.of_row] == 0) | (meant[groups.of_row] == _bands(names))
    code, _ = steady(groups, names, usable & same, codes)
    return code, carrier


def _carriers(system: str, codes: tuple[str, ...]) -> tuple[str, ...]:
    bands = {c[0] for c in codes}
    return tuple(c for c in PRECISE_CARRIERS.get(system, codes) if c[0] in bands)


def _bands(names: npt.NDArray[np.str_]) -> npt.NDArray[np.int64]:
    return names.astype("<U1").astype(np.int64)


def _ranks(table: SignalTable, rows: Index, lists: Mapping[str, tuple[str, ...]]) -> npt.NDArray[np.int64]:
    names = np.char.add(table.sat[rows].astype("<U1"), table.signal[rows])
    kinds, inverse = np.unique(names, return_inverse=True)
    ranks = [lists[k[0]].index(k[1:]) if k[1:] in lists[k[0]] else NEVER for k in kinds.tolist()]
    return np.array(ranks, dtype=np.int64)[inverse]


def _best(rank: npt.NDArray[np.int64], usable: npt.NDArray[np.bool_], starts: Index) -> Index:
    """Return for each group of rows the row of the lowest rank, -1 where none is usable."""
    if not len(starts):
        return np.zeros(0, dtype=np.intp)
    packed = (np.where(usable, rank, NEVER) << 40) | np.arange(len(rank))
    lowest = np.minimum.reduceat(packed, starts)
    return np.where((lowest >> 40) < NEVER, lowest & ((1 << 40) - 1), -1)


def _reasons(
    sat: npt.NDArray[np.str_], usable: Index, present: Index, lists: Mapping[str, tuple[str, ...]]
) -> npt.NDArray[np.object_]:
    reason = np.full(len(sat), "", dtype=object)
    reason[usable < 0] = "pseudorange is zero, not a number or outside 10,000 to 60,000 km"
    for system, names in lists.items():
        absent = (present < 0) & (np.char.startswith(sat, system) if len(sat) else np.zeros(0, dtype=bool))
        reason[absent] = f"no signal among {', '.join(names)}"
    return reason
