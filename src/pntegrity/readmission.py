"""When those who were left out may come back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.exclusion import Policy, Standing, levels
from pntegrity.kernels.signatures import is_carrier
from pntegrity.records import Update
from pntegrity.states import ANEW, is_left_out

__all__ = ["distrusting", "left_out", "reacquired", "review"]

#: Share of what was learnt of a fault's persistence that is kept from epoch to epoch.
FORGETTING = 0.9
#: A group whose residuals are this many standard deviations off is at fault.
CONFIRMED = 5.0


def review(
    standing: dict[str, Standing],
    update: Update,
    present: frozenset[str],
    policy: Policy,
    step_s: float = 0.0,
) -> dict[str, Standing]:
    """Return the exclusions that go on after an update: groups that proved themselves, or are long gone, drop
    out.

    `step_s` is the time since the epoch before.
    """
    out = {}
    for group, s in standing.items():
        now = _reviewed(s, update, group, group in present, policy, step_s)
        if now is not None:
            out[group] = now
    return out


def reacquired(standing: Mapping[str, Standing], update: Update, policy: Policy) -> frozenset[str]:
    """Return the groups in view that come back after `Policy.reacquire_s` in which nothing else told the
    position.
    """
    if not policy.trust_prior or levels(update.keys):
        return frozenset()
    since = {g: (update.t_ns - s.since_ns) * 1e-9 for g, s in standing.items() if s.seen_ns == update.t_ns}
    return frozenset(g for g, seconds in since.items() if seconds >= policy.reacquire_s)


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


def _spare_rows(update: Update, group: str) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return which rows left out are those of a group, products about it included, and which of them are no
    carriers.
    """
    out = frozenset([group])
    rows = [i for i, key in enumerate(update.spare_keys) if is_left_out(key, out)]
    levels = [i for i in rows if not is_carrier(update.spare_keys[i])]
    return np.array(rows, dtype=np.intp), np.array(levels, dtype=np.intp)


def _reviewed(
    s: Standing, update: Update, group: str, present: bool, policy: Policy, step_s: float
) -> Standing | None:
    t_ns, (rows, levels) = update.t_ns, _spare_rows(update, group)
    if not len(rows):
        gone = (t_ns - s.seen_ns) * 1e-9 > policy.forget_s
        seen_ns = t_ns if present else s.seen_ns
        return None if gone else replace(s, clean_ns=None, level_ns=None, anew=False, seen_ns=seen_ns)
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
