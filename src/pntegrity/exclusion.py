"""Who is left out, and when they may come back: the decisions between a verdict and the next filter step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pntegrity.kernels.subsets import search
from pntegrity.records import Suspect, Update, Verdict, group_of

__all__ = ["Decision", "Exclusion", "Policy", "Standing", "decide", "review"]


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
    keep_rows : int
        Nothing is left out that would leave fewer level rows than this.
    proof_s : float
        An excluded group returns after its residuals were small for this long; doubled at every further exclusion.
    proof_sigma : float
        What small means, in standard deviations of the residual.
    forget_s : float
        An exclusion ends when its group was absent for this long.
    history : int
        How many epochs back a repair can go.
    restart_s : float
        The filter starts anew after this long an alert that nothing could resolve.
    """

    exclude: bool = True
    p_fa: float = 1e-6
    most: int = 8
    keep_rows: int = 4
    proof_s: float = 30.0
    proof_sigma: float = 2.6
    forget_s: float = 300.0
    history: int = 80
    restart_s: float = 30.0


@dataclass(frozen=True)
class Standing:
    """A group that is left out at present.

    Parameters
    ----------
    since_ns, seen_ns : int
        When it was excluded (the onset of its fault), when it was last in view.
    clean_ns : int or None
        Since when its residuals have been small.
    times : int
        How often it was excluded before, this one included.
    """

    since_ns: int
    seen_ns: int
    clean_ns: int | None = None
    times: int = 1


@dataclass(frozen=True)
class Exclusion:
    """One exclusion as reported: who, by which test, how large, since when."""

    t_ns: int
    group: str
    monitor: str
    statistic: float
    size: float
    kind: str
    onset_ns: int
    ambiguous: bool = False


@dataclass(frozen=True)
class Decision:
    """What to leave out next, and from when on (`onset_ns` of this epoch: no repair of the past is needed)."""

    exclusions: tuple[Exclusion, ...] = ()
    onset_ns: int = 0
    reason: str = ""
    alternatives: tuple[tuple[str, ...], ...] = field(default=())


def decide(update: Update, verdicts: Sequence[Verdict], policy: Policy, previous_ns: int) -> Decision:
    """Return what to leave out of an epoch that has an alert.

    An abrupt fault is found in this epoch's innovations by the smallest consistent subset. Where these are consistent,
    or a windowed monitor dates the fault before this epoch, its first suspect is followed back to its onset.
    """
    windowed = _windowed_suspect(verdicts)
    if windowed is not None and _is_old(windowed[1], update.t_ns, previous_ns):
        return _from_suspect(update, *windowed)
    found = _from_subsets(update, policy)
    if found.exclusions or windowed is None:
        return found
    return _from_suspect(update, *windowed)


def _is_old(suspect: Suspect, t_ns: int, previous_ns: int) -> bool:
    return suspect.onset_ns < previous_ns - (t_ns - previous_ns)


def _windowed_suspect(verdicts: Sequence[Verdict]) -> tuple[Verdict, Suspect] | None:
    alerts = [v for v in verdicts if v.status == "alert" and v.suspects]
    bank = [v for v in alerts if v.dof == 1]
    chosen = bank or sorted(alerts, key=lambda v: v.threshold - v.statistic)
    return (chosen[0], chosen[0].suspects[0]) if chosen else None


def _from_suspect(update: Update, verdict: Verdict, suspect: Suspect) -> Decision:
    remaining = [k for k in update.keys if group_of(k) not in suspect.groups]
    if len(remaining) < max(4, len(update.keys) // 2):
        return Decision(reason="the fault is common to most measurements: nothing can be left out")
    exclusions = tuple(
        Exclusion(
            update.t_ns, g, verdict.monitor, suspect.statistic, suspect.size, suspect.kind, suspect.onset_ns, verdict.ambiguous
        )
        for g in suspect.groups
    )
    return Decision(exclusions, suspect.onset_ns)


def _from_subsets(update: Update, policy: Policy) -> Decision:
    groups = update.groups()
    names = list(groups)
    result = search(update.nu, update.L, [r.astype(np.int64) for r in groups.values()], update.consumed, policy.p_fa)
    if not result.removed:
        return Decision(reason="" if result.passed else "no subset of the measurements is consistent")
    if len(names) - len(result.removed) < policy.keep_rows:
        return Decision(reason="too few measurements would be left")
    exclusions = tuple(
        Exclusion(
            update.t_ns, names[g], "subset", result.explained, _size(update, groups[names[g]]), "bias", update.t_ns,
            bool(result.alternatives),
        )
        for g in result.removed
    )  # fmt: skip
    others = tuple(tuple(names[g] for g in alternative) for alternative in result.alternatives)
    return Decision(exclusions, update.t_ns, alternatives=others)


def _size(update: Update, rows: np.ndarray) -> float:
    """Return the estimated bias of the group's first row, from the rows that are independent of it (w-test)."""
    inverse = np.linalg.solve(update.S, np.eye(len(update.keys))[:, rows])
    z = inverse.T @ update.nu
    return float(np.linalg.lstsq(inverse[rows], z, rcond=None)[0][0])


def review(standing: dict[str, Standing], update: Update, present: frozenset[str], policy: Policy) -> dict[str, Standing]:
    """Return the exclusions that go on after an update: groups that proved themselves, or are long gone, drop out."""
    residual = _worst_residual(update)
    out = {}
    for group, s in standing.items():
        now = _reviewed(s, update.t_ns, residual.get(group), group in present, policy)
        if now is not None:
            out[group] = now
    return out


def _worst_residual(update: Update) -> dict[str, float]:
    worst: dict[str, float] = {}
    for key, nu, var in zip(update.spare_keys, update.spare_nu, update.spare_var, strict=True):
        group = group_of(key)
        worst[group] = max(worst.get(group, 0.0), abs(float(nu)) / float(np.sqrt(var)))
    return worst


def _reviewed(s: Standing, t_ns: int, residual: float | None, present: bool, policy: Policy) -> Standing | None:
    if residual is None:
        gone = (t_ns - s.seen_ns) * 1e-9 > policy.forget_s
        return None if gone else replace(s, clean_ns=None, seen_ns=t_ns if present else s.seen_ns)
    if residual > policy.proof_sigma:
        return replace(s, seen_ns=t_ns, clean_ns=None)
    clean = t_ns if s.clean_ns is None else s.clean_ns
    needed = policy.proof_s * 2.0 ** (min(s.times, 5) - 1)
    return None if (t_ns - clean) * 1e-9 >= needed else replace(s, seen_ns=t_ns, clean_ns=clean)
