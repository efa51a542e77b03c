"""Who is left out: the decisions between a verdict and the next filter step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import whiten
from pntegrity.kernels.signatures import is_rate
from pntegrity.kernels.subsets import search
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.policy import Decision, Exclusion, Policy, Standing
from pntegrity.records import FloatArray, Suspect, Update, Verdict, group_of
from pntegrity.states import sensor_of
from pntegrity.verdicts import SEPARATION

#: First parts of the names of the states that all rows of an epoch share.
COMMON = ("pos", "vel", "clk", "drift")
#: Twice the log-likelihood by which one explanation must beat another to be preferred.
MARGIN = 9.0
TOO_FEW = "too few measurements would be left"

__all__ = [
    "SEPARATION",
    "Decision",
    "Exclusion",
    "Policy",
    "Standing",
    "decide",
    "dynamics_failed",
    "levels",
]


def decide(update: Update, verdicts: Sequence[Verdict], policy: Policy, previous_ns: int) -> Decision:
    """Return what to leave out of an epoch that has an alert.

    Where the rows contradict the prior and not each other, the motion or clock model is at fault: nothing is
    left out. An abrupt fault is found in this epoch's innovations by the smallest consistent subset. Where
    these are consistent, or a windowed monitor dates the fault before this epoch, its first suspect is
    followed back to its onset. The suspects of a monitor that carries subfilters come first: one whose own
    subfilter passes its tests, else the smallest consistent subset, else the best of them. Where the policy
    trusts the prior, the only group of an epoch can be at fault as well. Before all others
    come monitors that identify, where there are any.
    """
    level = [v for name in policy.identifying for v in verdicts if v.monitor == name]
    alarmed = [v for v in level if v.status == "alert"]
    if alarmed and alarmed[0] is level[0] and level[0].suspects:
        if not policy.trust_prior and _most_are_named(update, level[0]):
            return Decision(relax=True)
        return _from_names(update, [v for v in alarmed if v.suspects])
    if alarmed and not update.excluded and policy.trust_prior:
        return Decision(reason=_untold(alarmed[0], level[0]))
    if policy.trust_prior and len(update.groups()) == 1:
        return _from_prior(update, verdicts, policy, previous_ns)
    if not policy.trust_prior and dynamics_failed(update, policy.p_fa):
        return Decision(relax=True)
    carried = next((v for v in verdicts if v.status == "alert" and _is_separation(v)), None)
    if carried is not None:
        return _from_subfilters(update, carried, policy)
    windowed = _windowed_suspect(verdicts)
    if windowed is not None and _is_old(windowed[1], update.t_ns, previous_ns):
        return _from_suspect(update, *windowed, policy)
    found = _from_subsets(update, policy)
    if found.exclusions or windowed is None:
        return found
    return _from_suspect(update, *windowed, policy)


def _from_prior(update: Update, verdicts: Sequence[Verdict], policy: Policy, previous_ns: int) -> Decision:
    """Return the exclusion of the only group of an epoch: since the onset that a windowed monitor names, else
    now.
    """
    (group,) = update.groups()
    windowed = _windowed_suspect(verdicts)
    rows = _row_biases(update, group)
    if windowed is not None and _is_old(windowed[1], update.t_ns, previous_ns):
        found = _from_suspect(update, *windowed, policy)
        return replace(found, exclusions=tuple(replace(e, rows=rows) for e in found.exclusions))
    verdict = max((v for v in verdicts if v.status == "alert"), key=lambda v: v.statistic / v.threshold)
    size = _sizes(update, [update.groups()[group]])[0]
    only = Exclusion(
        update.t_ns, group, verdict.monitor, verdict.statistic, size, "bias", update.t_ns, rows=rows
    )
    return Decision((only,), update.t_ns)


def _from_names(update: Update, alerts: Sequence[Verdict]) -> Decision:
    """Return who is named: whole sources, or sensors where a monitor names these and their source has others.

    The first has the word on sources, the others on their sensors. Where others may be at fault
    as well, and all of these would need more sources at fault at once, the first suspect is left out in
    doubt; where not, nobody is.
    """
    chosen = alerts[0]
    suspect, doubtful = chosen.foremost, chosen.ambiguous or len(chosen.suspects) > 1
    if suspect is None:
        return Decision(reason=_unclear(chosen))
    clear = (v for v in alerts[::-1] if not v.ambiguous and len(v.suspects) == 1)
    told = [v.suspects[0].sensors for v in (*clear, chosen) if v.suspects[0].groups == suspect.groups]
    names = _names(update, suspect.groups, next((s for s in told if s), ()))
    made = (
        Exclusion(
            update.t_ns, n, chosen.monitor, suspect.statistic, suspect.size, suspect.kind, suspect.onset_ns,
            doubtful, doubtful=doubtful,
        )
        for n in names
    )  # fmt: skip
    others = tuple(dict.fromkeys(s.groups for s in chosen.suspects[1:]))
    return Decision(tuple(made), suspect.onset_ns, alternatives=others if doubtful else ())


def _most_are_named(update: Update, verdict: Verdict) -> bool:
    """Tell whether most sources of an epoch would be at fault: then they may be right, and the prior not."""
    first = verdict.foremost
    return first is not None and 2 * len(first.groups) > len(update.groups())


def _names(update: Update, groups: tuple[str, ...], sensors: tuple[str, ...]) -> tuple[str, ...]:
    """Return what is left out: sensors (``"lbl.AP1"``) where a part of one source is at fault."""
    there = {sensor_of(k) for k in update.keys if group_of(k) in groups}
    if len(groups) == 1 and sensors and (there - set(sensors) or len(there) == 1):
        return tuple(f"{groups[0]}.{s}" for s in sensors)
    return groups


def _untold(alarmed: Verdict, first: Verdict) -> str:
    """Say why an alarm names no source."""
    if alarmed is first:
        return "nobody who may be at fault is measured now; nothing is left out"
    return f"{alarmed.monitor} alarms, and {first.monitor} tells no source at fault; nothing is left out"


def _unclear(verdict: Verdict) -> str:
    """Say who may be at fault, and that nobody is left out."""
    sets = dict.fromkeys("+".join(s.groups) for s in verdict.suspects)
    return f"ambiguous: at fault may be {' or '.join(sets)}; nothing is left out"


def _is_separation(verdict: Verdict) -> bool:
    return bool(verdict.suspects) and verdict.suspects[0].kind == SEPARATION


def _from_subfilters(update: Update, verdict: Verdict, policy: Policy) -> Decision:
    """Return the suspect whose subfilter contradicts the others' least; where it fails its own tests, several
    may be at fault at once, which this epoch's innovations show. Where these name a suspect that passes, it
    is that one, as both kinds of evidence agree, and they tell the size.
    """
    found = _from_subsets(update, policy)
    named = {e.group for e in found.exclusions}
    passing = (s for s in verdict.suspects if s.statistic <= 1.0 and set(s.groups) == named)
    suspect = next(passing, verdict.suspects[0])
    same = named == set(suspect.groups)
    if not (found.exclusions and (same or suspect.statistic > 1.0)):
        others = tuple(s.groups for s in verdict.suspects[1:]) if verdict.ambiguous else ()
        found = replace(_from_suspect(update, verdict, suspect, policy), alternatives=others)
    exclusions = tuple(replace(e, switch=True, rows=_row_biases(update, e.group)) for e in found.exclusions)
    return replace(found, exclusions=exclusions)


def dynamics_failed(update: Update, p_fa: float, block: tuple[str, ...] = COMMON) -> bool:
    """Tell whether an inconsistent epoch becomes consistent when the states common to all rows are free.

    With the columns ``A`` of those states whitened, the free fit takes ``|proj_A n|^2`` from the statistic. A
    fault of a single group explains as much with fewer unknowns, so the free fit must do clearly better than
    the best group.
    """
    total, dof = float(update.white @ update.white), len(update.keys) - update.consumed
    if dof <= 0 or total <= chi2_threshold(p_fa, dof):
        return False
    columns = [i for i, name in enumerate(update.prior.layout.names) if name.partition(":")[0] in block]
    A = whiten(update.L, np.ascontiguousarray(update.H[:, columns]))
    basis, values, _ = np.linalg.svd(A, full_matrices=False)
    basis = basis[:, values > 1e-9 * max(float(values[0]), 1e-300)] if len(values) else basis
    free = float(np.sum((basis.T @ update.white) ** 2))
    rest = dof - basis.shape[1]
    if rest <= 0 or total - free > chi2_threshold(p_fa, rest):
        return False
    single = search(update.nu, update.L, _rows(update), update.consumed, p_fa, largest=1)
    return not single.passed or free > single.explained + MARGIN


def levels(keys: Iterable[str]) -> int:
    """Return how many rows measure levels, not rates."""
    return sum(not is_rate(k) for k in keys)


def _rows(update: Update) -> list[npt.NDArray[np.int64]]:
    return [r.astype(np.int64) for r in update.groups().values()]


def _is_old(suspect: Suspect, t_ns: int, previous_ns: int) -> bool:
    return suspect.onset_ns < previous_ns - (t_ns - previous_ns)


def _windowed_suspect(verdicts: Sequence[Verdict]) -> tuple[Verdict, Suspect] | None:
    """Return the suspect that explains most (all explain in the same unit, twice a log-likelihood), and who
    names it.
    """
    alerts = [v for v in verdicts if v.status == "alert" and v.suspects and not _is_separation(v)]
    chosen = max(alerts, key=lambda v: v.suspects[0].statistic, default=None)
    return (chosen, chosen.suspects[0]) if chosen is not None else None


def _from_suspect(update: Update, verdict: Verdict, suspect: Suspect, policy: Policy) -> Decision:
    remaining = [k for k in update.keys if group_of(k) not in suspect.groups]
    if 2 * len(remaining) < len(update.keys) and not policy.trust_prior:
        return Decision(reason="the fault is common to most measurements: nothing can be left out")
    if levels(remaining) < policy.keep_rows:
        return Decision(reason=TOO_FEW)
    exclusions = tuple(
        Exclusion(
            update.t_ns,
            g,
            verdict.monitor,
            suspect.statistic,
            suspect.size,
            suspect.kind,
            suspect.onset_ns,
            verdict.ambiguous,
        )
        for g in suspect.groups
    )
    return Decision(exclusions, suspect.onset_ns)


def _from_subsets(update: Update, policy: Policy) -> Decision:
    groups = update.groups()
    names = list(groups)
    result = search(update.nu, update.L, _rows(update), update.consumed, policy.p_fa)
    if not result.removed:
        return Decision(reason="" if result.passed else "no subset of the measurements is consistent")
    removed = {names[g] for g in result.removed}
    if levels(k for k in update.keys if group_of(k) not in removed) < policy.keep_rows:
        return Decision(reason=TOO_FEW)
    sizes = _sizes(update, [groups[names[g]] for g in result.removed])
    exclusions = tuple(
        Exclusion(
            update.t_ns,
            names[g],
            "subset",
            result.explained,
            size,
            "bias",
            update.t_ns,
            bool(result.alternatives),
        )
        for g, size in zip(result.removed, sizes, strict=True)
    )
    others = tuple(tuple(names[g] for g in alternative) for alternative in result.alternatives)
    return Decision(exclusions, update.t_ns, alternatives=others)


def _biases(update: Update, rows: npt.NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Return the biases of rows, all estimated together, ``(V_JJ)^-1 z_J``, and their covariance."""
    columns = np.linalg.solve(update.S, np.eye(len(update.keys))[:, rows])
    spread = np.linalg.pinv(columns[rows], hermitian=True)
    return spread @ columns.T @ update.nu, spread


def _row_biases(update: Update, group: str) -> tuple[tuple[str, float], ...]:
    rows = update.groups().get(group)
    if rows is None:
        return ()
    return tuple(zip((update.keys[i] for i in rows), _biases(update, rows)[0].tolist(), strict=True))


def _sizes(update: Update, rows: list[npt.NDArray[np.intp]]) -> list[float]:
    """Return the bias of each group's most significant row, all rows of these groups estimated together."""
    bias, spread = _biases(update, np.concatenate(rows))
    size = np.abs(bias) / np.sqrt(np.maximum(np.diagonal(spread), 1e-30))
    ends = np.cumsum([len(r) for r in rows])
    return [
        float(bias[e - len(r) + int(size[e - len(r) : e].argmax())]) for r, e in zip(rows, ends, strict=True)
    ]
