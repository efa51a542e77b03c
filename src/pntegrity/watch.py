"""Monitors beside a filter that runs elsewhere: hand over each update, get the verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pntegrity.protocols import Monitor, memory_for
from pntegrity.records import Update, Verdict

__all__ = ["Watch"]


class Watch:
    """Step monitors through the updates of a filter; nothing is excluded and nothing repaired (see `Pipeline`
    for that).

    Parameters
    ----------
    monitors : sequence of Monitor
    memories : sequence, optional
        Where to go on from: the `memories` of an earlier watch over the same monitors.

    Attributes
    ----------
    memories : tuple
        What the monitors remember, a value: keep it, pickle it, go on from it.

    Examples
    --------
    >>> import numpy as np
    >>> from pntegrity import Rctm, Update, Watch
    >>> one = np.eye(1)
    >>> update = Update.from_filter(0, F=one, Q=one, H=one, R=one, P_prior=one, nu=[12.0])
    >>> [v.status for v in Watch([Rctm()]).push(update)]
    ['alert']
    """

    def __init__(self, monitors: Sequence[Monitor], memories: Sequence[Any] | None = None) -> None:
        self.monitors = tuple(monitors)
        self.memories: tuple[Any, ...] = (
            tuple(m.start() for m in self.monitors) if memories is None else tuple(memories)
        )
        if len(self.memories) != len(self.monitors):
            raise ValueError(
                f"`memories` must be one a monitor: {len(self.memories)} for {len(self.monitors)} monitors"
            )

    def push(self, update: Update) -> list[Verdict]:
        """Return the verdict of each monitor on `update`, in the order of the monitors."""
        pairs = zip(self.monitors, self.memories, strict=True)
        steps = [m.step(memory_for(m, memory, update), update) for m, memory in pairs]
        self.memories = tuple(memory for _, memory in steps)
        return [verdict for verdict, _ in steps]
