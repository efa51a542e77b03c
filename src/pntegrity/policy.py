"""What is decided about groups and sensors: who is left out, since when, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

__all__ = ["Decision", "Exclusion", "Policy", "Standing"]


@dataclass(frozen=True)
class Policy:
    """How exclusion works.

    Parameters
    ----------
    exclude : bool
        False: monitors speak, nothing is left out.
    p_fa : float
        Probability at which the rest of an epoch is refused as inconsistent.
    most : int
        Largest number of groups left out within one epoch.
    most_excluded : float
        Where a larger share of the groups in view would be left out, the model is at fault and not they: all
        are kept, and the status is ``alert``.
    keep_rows : int
        Nothing is left out that would leave fewer level rows than this.
    proof_s, proof_epochs : float, int
        An excluded group returns after its residuals were small for this long and this many epochs; doubled
        at every further exclusion.
    proof_sigma : float
        What small means, in standard deviations of the residual.
    forget_s : float
        An exclusion ends when its group was absent for this long.
    history : int
        How many epochs back a repair can go.
    restart_s, restart_epochs : float, int
        The filter starts anew after this long an alert, and this many epochs, that nothing could resolve.
    trust_prior : bool
        True: rows that contradict the prior are at fault, also where all of them agree with each other: the
        prior is that of an inertial unit, whose errors are known, and not of a guess how the receiver moves.
    identifying : tuple of str
        Monitors whose word is final: who they name is left out, a source or its sensors where they tell
        these, and nobody where they say that others may be at fault as well.
    proof : str
        How who was left out proves itself: by ``"residuals"`` that were small for `proof_s`, by ``"passes"``
        (`passes` epochs in a row in which the w-tests of all its rows pass), or by a ``"trial"`` of the
        filter that uses it (`proving`).
    p_readmit, p_refuse : float
        A trial passes a row that is still off as it was with at most the first, and refuses who is healthy
        with at most the second, where it is long enough. Both tests of passes refuse with the second.
    passes : int
    reacquire_s : float
        With `trust_prior`: a group without which nothing was measured, or only by sources most of whose
        sensors are left out, returns after this long, whatever its residuals, and position and velocity start
        anew at it; the prior is then not trusted for `forget_s`.
    """

    exclude: bool = True
    p_fa: float = 1e-6
    most: int = 8
    most_excluded: float = 0.4
    keep_rows: int = 4
    proof_s: float = 30.0
    proof_epochs: int = 10
    proof_sigma: float = 3.5
    forget_s: float = 300.0
    history: int = 80
    restart_s: float = 30.0
    restart_epochs: int = 30
    trust_prior: bool = False
    identifying: tuple[str, ...] = ()
    proof: Literal["residuals", "passes", "trial"] = "residuals"
    p_readmit: float = 1e-3
    p_refuse: float = 1e-2
    passes: int = 5
    reacquire_s: float = float("inf")


@dataclass(frozen=True)
class Standing:
    """A group, or a sensor of a source (``"lbl.AP1"``), that is left out at present.

    Parameters
    ----------
    since_ns, seen_ns : int
        When it was excluded (the onset of its fault), when it was last in view.
    clean_ns : int or None
        Since when its residuals have been small.
    level_ns : int or None
        Since when those but of its carriers have been: a fault may be over and have left them another cycle.
    anew : bool
        Whether its ambiguities shall begin anew at the next epoch, and prove themselves.
    rows : tuple of (str, float)
        By how much its rows were off when it was excluded; where a trial is the proof, the most that was seen
        since.
    size : float
        Where it is a sensor that a monitor named: how large its fault was when it was excluded.
    doubtful : bool
        Whether others could be at fault as well: until its rows show that they are off.
    inherited : bool
        Whether that is so because others were out in doubt not long before, and the state may have followed
        who was at fault: as long as it is out.
    gain : float
        Twice the log-likelihood of those residuals against none, summed over the proof: above 0 the fault is
        still there, as far as anyone can tell.
    times : int
        How often it was excluded before, this one included.
    count : int
        Epochs with rows of its own in which its residuals were small, in a row; from a failed trial on anew.
    quiet_ns, quiet : int or None, int
        Since when they have been small, and for how many epochs, whatever came of trials of a fault's end.
    """

    since_ns: int
    seen_ns: int
    clean_ns: int | None = None
    times: int = 1
    level_ns: int | None = None
    anew: bool = False
    rows: tuple[tuple[str, float], ...] = ()
    doubtful: bool = False
    inherited: bool = False
    gain: float = 0.0
    count: int = 0
    quiet_ns: int | None = None
    quiet: int = 0
    size: float = 0.0


@dataclass(frozen=True)
class Exclusion:
    """One exclusion as reported: who, by which test, how large, since when.

    `switch`: the filter goes over to the subfilter that never knew the group. `doubtful`: others could be at
    fault as well, as long as it is left out. `rows`: by how much each of its
    rows was off, where that is known.
    """

    t_ns: int
    group: str
    monitor: str
    statistic: float
    size: float
    kind: str
    onset_ns: int
    ambiguous: bool = False
    switch: bool = False
    rows: tuple[tuple[str, float], ...] = ()
    doubtful: bool = False


@dataclass(frozen=True)
class Decision:
    """What to leave out next, and from when on (`onset_ns` of this epoch: no repair of the past is needed).

    `relax` instead: the measurements agree with each other and not with the prior, so the prior is what must
    go.
    """

    exclusions: tuple[Exclusion, ...] = ()
    onset_ns: int = 0
    relax: bool = False
    reason: str = ""
    alternatives: tuple[tuple[str, ...], ...] = field(default=())
