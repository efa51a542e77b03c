"""When those who were left out may come back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.exclusion import Policy, Standing
from pntegrity.kernels.signatures import is_carrier, is_rate
from pntegrity.proving import Past, Proof, is_due, left_out_rows, passes_now
from pntegrity.records import Update
from pntegrity.states import ANEW, group_of, is_left_out

__all__ = ["distrusting", "left_out", "mostly_out", "reacquired", "review"]

#: Share of what was learnt of a fault's persistence that is kept from epoch to epoch.
FORGETTING = 0.9
#: A group whose residuals are this many standard deviations off is at fault.
CONFIRMED = 5.0


def review(
    standing: dict[str, Standing],
    update: Update,
    present: frozenset[str],
    policy: Policy,
    step_s: float,
    trial: Callable[[str, Standing], Proof],
) -> tuple[dict[str, Standing], tuple[Proof, ...]]:
    """Return the exclusions that go on after an update, and what tests showed: groups that proved themselves,
    or are long gone, drop out.

    `step_s` is the time since the epoch before; `trial` makes a trial of who was left out, where the policy
    has that as its proof.
    """
    out, proofs = {}, []
    for group, s in standing.items():
        if policy.proof == "residuals":
            now, proof = _reviewed(s, update, group, group in present, policy, step_s), None
        else:
            now, proof = _tested(s, update, group, group in present, policy, trial)
        proofs += [proof] if proof is not None else []
        if now is not None:
            out[group] = now
    return out, tuple(proofs)


def _tested(
    s: Standing, update: Update, name: str, present: bool, policy: Policy,
    trial: Callable[[str, Standing], Proof],
) -> tuple[Standing | None, Proof | None]:  # fmt: skip
    """Return what goes on of an exclusion that a test may end, and the test."""
    t_ns, rows = update.t_ns, left_out_rows(update, name)
    if not len(rows):
        return _absent(s, t_ns, present, policy), None
    s = replace(s, seen_ns=t_ns, rows=_largest(s.rows, update, rows))
    if policy.proof == "passes":
        passed, largest, limit = passes_now(update, rows, policy.p_refuse)
        s = replace(s, count=s.count + 1 if passed else 0)
        back = s.count >= policy.passes
        return None if back else s, Proof(name, t_ns, s.count, back, largest, limit)
    if update.misfit(rows) > policy.proof_sigma:
        return _anew(s), None
    s = replace(
        s, clean_ns=s.clean_ns if s.count else t_ns, count=s.count + 1,
        quiet_ns=s.quiet_ns if s.quiet else t_ns, quiet=s.quiet + 1,
    )  # fmt: skip
    if not (is_due(s.count, s.times) or is_due(s.quiet, s.times)):
        return s, None
    proof = trial(name, s)
    if proof.passed:
        return None, proof
    if proof.of_end:
        return replace(s, clean_ns=None, count=0), proof
    return (s if proof.reason else _anew(s)), proof


def _anew(s: Standing) -> Standing:
    """Return the exclusion of who must prove itself from now on."""
    return replace(s, clean_ns=None, count=0, quiet_ns=None, quiet=0)


def _absent(s: Standing, t_ns: int, present: bool, policy: Policy) -> Standing | None:
    """Return the exclusion of who gave no rows; None: forgotten."""
    gone = (t_ns - s.seen_ns) * 1e-9 > policy.forget_s
    return None if gone else replace(s, seen_ns=t_ns if present else s.seen_ns)


def _largest(
    before: tuple[tuple[str, float], ...], update: Update, rows: npt.NDArray[np.intp]
) -> tuple[tuple[str, float], ...]:
    """Return by how much rows left out were off at most, as the filter without them saw it."""
    known = dict(before)
    for i in rows:
        key = update.spare_keys[i]
        known[key] = max(known.get(key, 0.0), abs(float(update.spare_nu[i])))
    return tuple(known.items())


def reacquired(
    standing: Mapping[str, Standing], update: Update, policy: Policy, history: Sequence[Past]
) -> frozenset[str]:
    """Return those in view that come back after `Policy.reacquire_s` in which nothing else told the position,
    or only sources most of whose own sensors were left out.

    Parameters
    ----------
    standing : mapping of str to Standing
    update : Update
    policy : Policy
    history : sequence of Past
        The oldest first, this epoch included.
    """
    since = {g: (update.t_ns - s.since_ns) * 1e-9 for g, s in standing.items() if s.seen_ns == update.t_ns}
    due = frozenset(g for g, seconds in since.items() if seconds >= policy.reacquire_s)
    if not due or not policy.trust_prior:
        return frozenset()
    first_ns = update.t_ns - policy.reacquire_s * 1e9
    lately = (p for p in reversed(history) if p.epoch.t_ns >= first_ns)
    return frozenset() if any(_was_told(p) for p in lately) else due


def _was_told(past: Past) -> bool:
    """Tell whether any group had most of its level rows in use."""
    keys = [k for o in past.epoch.observations for k in o.keys if not is_rate(k)]
    return not {group_of(k) for k in keys} <= mostly_out(keys, past.excluded)


def mostly_out(keys: Iterable[str], excluded: frozenset[str]) -> frozenset[str]:
    """Return the groups of whose level rows more than half are left out.

    Parameters
    ----------
    keys : iterable of str
    excluded : frozenset of str
        Groups and sensors.
    """
    levels = [k for k in keys if not is_rate(k)]
    out = Counter(group_of(k) for k in levels if is_left_out(k, excluded))
    return frozenset(g for g, count in Counter(map(group_of, levels)).items() if 2 * out[g] > count)


def distrusting(policy: Policy, reacquired_ns: int | None, t_ns: int) -> Policy:
    """Return the policy at a time: for `Policy.forget_s` after a group came back that had not proved itself
    the prior may be as wrong as the group, and is not trusted.
    """
    if reacquired_ns is None or (t_ns - reacquired_ns) * 1e-9 > policy.forget_s:
        return policy
    return replace(policy, trust_prior=False)


def left_out(standing: Mapping[str, Standing]) -> frozenset[str]:
    """Return what an estimator is told to leave out: groups, and those whose ambiguities begin anew."""
    return frozenset(standing) | {g + ANEW for g, s in standing.items() if s.anew}


def _levels(update: Update, rows: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return which of some rows left out are no carriers."""
    return np.array([i for i in rows if not is_carrier(update.spare_keys[i])], dtype=np.intp)


def _reviewed(
    s: Standing, update: Update, group: str, present: bool, policy: Policy, step_s: float
) -> Standing | None:
    t_ns, rows = update.t_ns, left_out_rows(update, group)
    levels = _levels(update, rows)
    if not len(rows):
        away = _absent(s, t_ns, present, policy)
        return None if away is None else replace(away, clean_ns=None, level_ns=None, anew=False)
    gain = _gain(s, update, levels)
    whole = update.misfit(rows)
    level = update.misfit(levels) if 0 < len(levels) < len(rows) else whole
    s = replace(s, doubtful=s.doubtful and whole <= CONFIRMED)
    needed = max(policy.proof_s, policy.proof_epochs * step_s) * 2.0 ** (min(s.times, 5) - 1)
    since = s.level_ns if s.level_ns is not None else t_ns
    level_ns = since if level <= policy.proof_sigma else None
    if whole > policy.proof_sigma:
        anew = level_ns is not None and (t_ns - level_ns) * 1e-9 >= needed and gain <= 0.0
        level_ns = None if anew else level_ns
        return replace(s, seen_ns=t_ns, clean_ns=None, level_ns=level_ns, anew=anew, gain=gain)
    clean = t_ns if s.clean_ns is None else s.clean_ns
    if (t_ns - clean) * 1e-9 >= needed and gain <= 0.0:
        return None
    return replace(s, seen_ns=t_ns, clean_ns=clean, level_ns=level_ns, anew=False, gain=gain)


def _gain(s: Standing, update: Update, rows: npt.NDArray[np.intp]) -> float:
    """Return by how much the residuals of rows favour the fault as it was to none, summed over the last
    epochs.
    """
    size = dict(s.rows)
    fault = np.array([size.get(update.spare_keys[i], 0.0) for i in rows])
    if not fault.any():
        return 0.0
    now = update.misfit_square(rows) - update.misfit_square(rows, fault)
    return FORGETTING * s.gain + now
