"""The risk tree of a vehicle's sources in numbers: which may fail together, and what of it is monitored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import names_of
from pntegrity.bounds.risk_tree import Branch, RiskTree, tree_of
from pntegrity.physics.time import to_iso
from pntegrity.pipeline import Outcome
from pntegrity.report.columns import HELD, groups_in
from pntegrity.report.facts import RunFacts
from pntegrity.states import group_of

__all__ = ["risk_numbers"]

SETS, BRANCHES = 12, 64
"""How many sets of sources, and branches of the last tree, the numbers hold."""
FIELDS = frozenset(f.name for f in fields(Ism))


def risk_numbers(outcomes: Sequence[Outcome], facts: RunFacts) -> dict[str, Any] | None:
    """Return the risk tree in numbers, null where no integrity risk is stated.

    =========== ===========================================================================================
    key         value
    =========== ===========================================================================================
    p_hmi       the integrity risk
    allowed     how much of it may be left to what is not monitored
    sets        which sources and sensors were used together, in order of appearance, the 12 most frequent:
                ``names``, ``epochs``, ``from``, ``branches``, ``modes`` (monitored), ``together`` (how many
                faults at once are), ``unmonitored`` (probability of the rest)
    names       who was used last
    at_once     probability of exactly 0, 1, 2, ... faults among these
    branches    of their tree, by the number of faults and then by probability, the first 64: ``names``,
                ``probability`` (that exactly these are at fault), ``monitored``
    =========== ===========================================================================================
    """
    if "p_hmi" not in facts.protection:
        return None
    ism = Ism.from_table({k: v for k, v in facts.protection.items() if k in FIELDS})
    there = [names_of(ism, keys) for keys in _used_lately(outcomes)]
    trees = {names: tree_of(ism, names) for names in dict.fromkeys(there) if names}
    if not trees:
        return None
    names = next(n for n in there[::-1] if n)
    last = trees[names]
    return {
        "p_hmi": ism.p_hmi,
        "allowed": ism.p_unmonitored,
        "sets": _sets(outcomes, there, trees),
        "names": list(names),
        "at_once": list(last.at_once),
        "branches": [_branch(b) for b in last.branches[:BRANCHES]],
    }


def _sets(
    outcomes: Sequence[Outcome], there: Sequence[tuple[str, ...]], trees: Mapping[tuple[str, ...], RiskTree]
) -> list[dict[str, Any]]:
    """Return the sets of who was there, with their trees."""
    found: dict[tuple[str, ...], dict[str, Any]] = {}
    for o, names in zip(outcomes, there, strict=True):
        if names and names not in found:
            tree = trees[names]
            found[names] = {
                "names": list(names), "epochs": 0, "from": to_iso(o.t_ns), "branches": len(tree.branches),
                "modes": len(tree.modes.monitored), "together": tree.together,
                "unmonitored": tree.unmonitored,
            }  # fmt: skip
        if names:
            found[names]["epochs"] += 1
    kept = sorted(found.values(), key=lambda s: -s["epochs"])[:SETS]
    return [s for s in found.values() if any(s is k for k in kept)]


def _branch(b: Branch) -> dict[str, Any]:
    return {"names": list(b.sources), "probability": b.probability, "monitored": b.monitored}


def _used_lately(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return at each epoch the rows of its sources, and of those that measure less often; not of those that
    are left out.
    """
    usual = _usual_ns(outcomes)
    last: dict[str, tuple[int, tuple[str, ...]]] = {}
    out = []
    for o in outcomes:
        now: dict[str, list[str]] = {}
        for key in o.update.keys:
            now.setdefault(group_of(key), []).append(key)
        last = {g: one for g, one in last.items() if o.t_ns - one[0] < HELD * usual[g]}
        last = {g: one for g, one in last.items() if g not in groups_in(o.update.spare_keys)}
        last |= {g: (o.t_ns, tuple(keys)) for g, keys in now.items()}
        out.append(tuple(key for g in sorted(last) for key in last[g][1]))
    return out


def _usual_ns(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the usual time between two measurements of each source."""
    at: dict[str, list[int]] = {}
    for o in outcomes:
        for group in groups_in(o.update.keys):
            at.setdefault(group, []).append(o.t_ns)
    return {g: float(np.median(np.diff(t))) if len(t) > 1 else 0.0 for g, t in at.items()}
