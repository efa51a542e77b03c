"""What a monitor says of an epoch: its verdict, whom it suspects, and the protection levels it gives.

`pntegrity.records` gives these names on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pntegrity.kernels.screening import Screening

__all__ = ["SEPARATION", "Bound", "Screening", "Status", "Suspect", "Verdict", "join_reasons", "stands_out"]

Status = Literal["ok", "alert", "unavailable"]
SEPARATION = "separation"
"""Kind of the suspects of a monitor that carries subfilters: the filter goes over to theirs."""


@dataclass(frozen=True)
class Suspect:
    """Who may be at fault, and how: `kind` ``"bias"`` (size in units of the row) or ``"ramp"`` (units per
    second). `sensors`: which of the sensors of the first group (``"AP1"`` of ``"lbl:R.AP1"``), where known.
    """

    groups: tuple[str, ...]
    kind: str
    size: float
    onset_ns: int
    statistic: float
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bound:
    """Protection levels of one epoch, m; inf where none can be given, and `reason` tells why.

    Parameters
    ----------
    east_m, north_m, up_m : float
        The position error exceeds each with at most its share of the integrity risk, unless an alert is
        given.
    sigma_m : tuple of float
        Standard deviations of the position east, north and up.
    along_m, cross_m : float or None
        The same along and across the track, with the shares of east and north; None without a course.
    dominant : tuple of str
        The fault mode that contributes most to the risk east, north and up; ``""``: no fault.
    smallest_m : tuple of float
        The test of separations cannot keep the risk below these, east, north and up, whatever the formula.
    modes : int
        Fault modes that were monitored.
    unmonitored : float
        Probability of all others.
    since_ns : int
        Faults that began before are not covered.
    reason : str
    """

    east_m: float
    north_m: float
    up_m: float
    sigma_m: tuple[float, float, float]
    along_m: float | None = None
    cross_m: float | None = None
    dominant: tuple[str, str, str] = ("", "", "")
    smallest_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    modes: int = 0
    unmonitored: float = 0.0
    since_ns: int = 0
    reason: str = ""

    @property
    def hpl_m(self) -> float:
        """Horizontal protection level."""
        return float(np.hypot(self.east_m, self.north_m))

    @property
    def vpl_m(self) -> float:
        """Vertical protection level."""
        return self.up_m


@dataclass(frozen=True)
class Verdict:
    """What one monitor says of one epoch.

    `status` is three-valued: ``unavailable`` (no test possible, with the `reason`) is never ``ok``.
    `statistic` and `threshold` are finite where a test was made and 0 otherwise; `p_fa` is the probability of
    a false alarm that the threshold stands for; `suspects` are ordered, the most likely first; `ambiguous`
    tells that the data do not single out the first; `bound` holds the protection levels of monitors that give
    some; `beyond` tells which of them is above its alert limit and makes the position unfit for use, though
    nobody is at fault.
    """

    monitor: str
    variant: str
    t_ns: int
    status: Status
    statistic: float = 0.0
    threshold: float = 0.0
    p_fa: float = 0.0
    dof: int = 0
    suspects: tuple[Suspect, ...] = ()
    ambiguous: bool = False
    reason: str = ""
    bound: Bound | None = None
    beyond: str = ""

    @property
    def suspect_groups(self) -> tuple[str, ...]:
        """Groups of the first suspect."""
        return self.suspects[0].groups if self.suspects else ()

    @property
    def foremost(self) -> Suspect | None:
        """Whom to leave out, for the time being where it is `ambiguous`; None: nobody (see `stands_out`)."""
        if self.status != "alert" or (self.ambiguous and len(self.suspects) < 2):
            return None
        return self.suspects[0] if stands_out([s.groups for s in self.suspects]) else None


def stands_out(sets: Sequence[Sequence[str]]) -> bool:
    """Tell whether the first of several sets of groups, of which one is at fault, may be left out before it
    is known which: where all others have more members.

    More groups would then have to fail at once, which is rarer by orders of magnitude before anything is
    measured. To leave it out is not to say that it is at fault: the levels must cover the others, too.
    """
    return bool(sets) and all(len(other) > len(sets[0]) for other in sets[1:])


def join_reasons(reasons: Iterable[str]) -> str:
    """Return distinct non-empty reasons in order, joined by semicolons."""
    return "; ".join(dict.fromkeys(r for r in reasons if r))
