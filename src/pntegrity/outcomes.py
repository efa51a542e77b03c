"""What a run gives and keeps: outcomes of epochs, checkpoints, and attempts at an epoch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pntegrity.policy import Exclusion, Standing
from pntegrity.proving import Past, Proof
from pntegrity.records import State, Status, Update, Verdict

__all__ = ["Attempt", "Checkpoint", "Outcome", "Reviewed"]


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """All that a pipeline remembers; `reacquired_ns`: when a group came back that had not proved itself;
    `doubt_ns`: when somebody was last out in doubt.
    """

    state: State = field(default_factory=State.empty)
    memories: tuple[Any, ...] = ()
    history: tuple[Past, ...] = ()
    standing: Mapping[str, Standing] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    alert_since_ns: int | None = None
    reacquired_ns: int | None = None
    doubt_ns: int | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What happened at one epoch.

    Parameters
    ----------
    status : str
        ``alert`` where a monitor still alarms after exclusion, or a protection level is above its alert limit
        (`Verdict.beyond`: nobody is at fault then, and nobody is left out); ``unavailable`` where none could
        test, else ``ok``.
    updates : tuple of Update
        What was committed: the epoch's update, after those of the past that a repair made anew.
    rewound : int
        How many earlier updates the first `len(updates) - 1` replace.
    verdicts, first : tuple of Verdict
        After the last exclusion, and before any (the same where nothing was excluded).
    exclusions : tuple of Exclusion
    readmitted : tuple of str
    reason : str
    proofs : tuple of Proof
        Tests of those who are left out.
    """

    t_ns: int
    status: Status
    updates: tuple[Update, ...]
    rewound: int
    verdicts: tuple[Verdict, ...]
    first: tuple[Verdict, ...]
    exclusions: tuple[Exclusion, ...] = ()
    readmitted: tuple[str, ...] = ()
    reason: str = ""
    proofs: tuple[Proof, ...] = ()

    @property
    def update(self) -> Update:
        """The update of this epoch."""
        return self.updates[-1]


@dataclass(frozen=True, eq=False)
class Attempt:
    """One way through the epoch: everything that would be committed."""

    updates: tuple[Update, ...]
    rewound: int
    verdicts: tuple[Verdict, ...]
    memories: tuple[Any, ...]
    history: tuple[Past, ...]

    @property
    def excluded(self) -> frozenset[str]:
        """Who is left out of this epoch."""
        return self.history[-1].excluded


@dataclass(frozen=True, eq=False)
class Reviewed:
    """Who stays out after an epoch, what tests showed, and whether anybody was re-acquired."""

    standing: Mapping[str, Standing]
    proofs: tuple[Proof, ...]
    reacquired: bool
