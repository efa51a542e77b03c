"""Inject faults into a real record by superposition, and see which monitor finds them, when, and whom it
blames.

A filter is linear: a fault on its rows adds ``g`` to the innovations (`kernels.windows.respond`) whatever the
data are. So one clean record serves for every satellite, size and onset, and a monitor goes on from what it
remembered of the clean epochs before the onset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pntegrity.kernels.windows import respond
from pntegrity.protocols import Monitor
from pntegrity.records import FloatArray, Update, group_of

__all__ = ["Trial", "carried", "faulted", "trials"]


@dataclass(frozen=True)
class Trial:
    """One injected fault and what a monitor made of it.

    `delay_s` is None where it did not alarm within the time looked at; `named` tells whether its first
    suspect was the satellite at fault.
    """

    monitor: str
    key: str
    kind: str
    size: float
    onset_ns: int
    delay_s: float | None
    named: bool


def faulted(updates: Sequence[Update], key: str, kind: str, size: float) -> Iterator[Update]:
    """Yield updates with a fault on one row since the first of them.

    Parameters
    ----------
    updates : sequence of Update
        Clean; the fault begins with the first.
    key : str
        The row.
    kind : str
        ``"bias"`` (constant) or ``"ramp"`` (zero at the first update, then growing).
    size : float
        Units of the row, or units per second.
    """
    for u, _ in carried(updates, key, kind, size):
        yield u


def carried(
    updates: Sequence[Update], key: str, kind: str, size: float
) -> Iterator[tuple[Update, FloatArray]]:
    """Yield what `faulted` yields, and the error of the state that the fault has made, shape (n,)."""
    e = np.zeros((updates[0].F.shape[1], 1))
    for u in updates:
        tau = (u.t_ns - updates[0].t_ns) * 1e-9
        f = np.array([[size * (tau if kind == "ramp" else 1.0) * (k == key)] for k in u.keys])
        g, e = respond(e, u.F, u.H, u.K, f)
        yield u.altered(nu=u.nu + g[:, 0]), e[:, 0]


def trials(
    updates: Sequence[Update],
    monitor: Monitor,
    onsets: Sequence[int],
    faults: Sequence[tuple[str, float]],
    longest: int = 90,
) -> list[Trial]:
    """Return one trial a code row, fault and onset.

    Parameters
    ----------
    updates : sequence of Update
        A clean record.
    monitor : Monitor
    onsets : sequence of int
        Indices of `updates` at which faults begin, ascending.
    faults : sequence of (kind, size)
    longest : int
        How many epochs after the onset are looked at.
    """
    out, memory, at = [], monitor.start(), 0
    for onset in onsets:
        for u in updates[at:onset]:
            _, memory = monitor.step(memory, u)
        at = onset
        span = updates[onset : onset + longest]
        keys = [k for k in span[0].keys if not k.partition(":")[2].startswith("D")]
        lasting = [k for k in keys if all(k in u.keys for u in span)]
        out += [_trial(span, monitor, memory, k, kind, size) for k in lasting for kind, size in faults]
    return out


def _trial(
    span: Sequence[Update], monitor: Monitor, memory: object, key: str, kind: str, size: float
) -> Trial:
    for u in faulted(span, key, kind, size):
        verdict, memory = monitor.step(memory, u)
        if verdict.status == "alert":
            delay = (u.t_ns - span[0].t_ns) * 1e-9
            return Trial(
                monitor.name, key, kind, size, span[0].t_ns, delay, verdict.suspect_groups == (group_of(key),)
            )
    return Trial(monitor.name, key, kind, size, span[0].t_ns, None, False)
