"""Which signal of a satellite to take where it must be the same one for as long as possible."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.physics.time import SECOND_NS

__all__ = ["Groups", "steady"]

Index = npt.NDArray[np.intp]
PASS_NS = 600 * SECOND_NS
"""A satellite that was away for longer rises anew."""
HOLE_NS = 300 * SECOND_NS
"""Where the signal of a pass is missing for longer, another takes its place there."""
ENOUGH = 0.5
"""The first signal of the list is taken that is there this often, compared with the most frequent one. Above,
codes for which the clocks do not hold pull ambiguities off (by 2 cm of position on a log without biases)."""


@dataclass(frozen=True, eq=False)
class Groups:
    """Rows that belong together: those of a satellite at an epoch.

    Parameters
    ----------
    of_row : ndarray, shape (n,)
        Group of each row.
    sat, t_ns : ndarray, shape (n_groups,)
        Satellite and time of each group; times do not fall.
    """

    of_row: Index
    sat: npt.NDArray[np.str_]
    t_ns: npt.NDArray[np.int64]


def steady(
    groups: Groups, names: npt.NDArray[np.str_], there: npt.NDArray[np.bool_],
    lists: Mapping[str, tuple[str, ...]],
) -> tuple[Index, npt.NDArray[np.int64]]:  # fmt: skip
    """Return for each group the row of the signal of its pass, and the band of that signal.

    Parameters
    ----------
    groups : Groups
    names : ndarray of str, shape (n,)
        Signals, ``"1C"``.
    there : ndarray of bool, shape (n,)
        Which rows can be used.
    lists : mapping of str to tuple of str
        Signals in order of preference by system letter.

    Returns
    -------
    row : ndarray, shape (n_groups,)
        -1 where the signal of the pass is missing.
    band : ndarray of int64, shape (n_groups,)
        Also where it is missing; 0 where a pass has none.
    """
    row = np.full(len(groups.sat), -1)
    band = np.zeros(len(groups.sat), dtype=np.int64)
    sats, of_group = np.unique(groups.sat, return_inverse=True)
    for k, sat in enumerate(sats.tolist()):
        mine = np.flatnonzero(of_group == k)
        listed = lists.get(sat[0], ())
        rows = np.full((len(listed), len(groups.sat)), -1)
        own = np.flatnonzero(there & (of_group[groups.of_row] == k))
        for i, name in enumerate(listed):
            found = own[names[own] == name]
            rows[i, groups.of_row[found]] = found
        for part in np.split(mine, np.flatnonzero(np.diff(groups.t_ns[mine]) > PASS_NS) + 1):
            choice = _covered(rows[:, part] >= 0, groups.t_ns[part])
            named = choice >= 0
            row[part[named]] = rows[choice[named], part[named]]
            band[part[named]] = np.array([int(n[0]) for n in listed], dtype=np.int64)[choice[named]]
    return row, band


def _covered(there: npt.NDArray[np.bool_], t_ns: npt.NDArray[np.int64]) -> Index:
    """Return which of the signals (rows of `there`) is meant at each time, -1: none is ever there."""
    count = there.sum(axis=1)
    if not count.any():
        return np.full(len(t_ns), -1)
    best = int(np.argmax(count >= ENOUGH * count.max()))
    out = np.full(len(t_ns), best)
    missing = np.flatnonzero(~there[best])
    for hole in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
        if len(hole) and t_ns[hole[-1]] - t_ns[hole[0]] >= HOLE_NS and there[:, hole].any():
            out[hole] = _covered(there[:, hole], t_ns[hole])
    return out
