"""Protection levels of the multi-level study, and whether errors stay below them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pntegrity.bounds.risk_tree import RiskTree, risk_tree
from pntegrity.kernels.protection import false_alert_factor
from pntegrity.kernels.source_levels import bank_level, published_level, slope
from pntegrity.records import FloatArray
from pntegrity.scenarios._vessel_runs import Study
from pntegrity.simulate.ensembles import Ensemble, Filtered, draw_ensemble, filtered
from pntegrity.states import group_of

__all__ = ["Coverage", "Levels", "coverage", "levels"]

#: Seconds after which the filter has settled.
SETTLED_S = 30.0


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels of every epoch, shape (epochs, 3) north, east, down; of the bank, and as published.

    `sigma` are the standard deviations of all solutions, shape (members, epochs, 3), the full one first;
    `sets` what each is without.
    """

    tree: RiskTree
    sets: tuple[tuple[str, ...], ...]
    sigma: FloatArray
    bank: FloatArray
    published: FloatArray

    def horizontal(self, which: str) -> FloatArray:
        """Return HPL of every epoch."""
        level = getattr(self, which)
        return np.asarray(np.hypot(level[:, 0], level[:, 1]))


def _members(
    study: Study, noise: Ensemble, faults: FloatArray, sets: Iterable[tuple[str, ...]]
) -> list[Filtered]:
    out = []
    for names in sets:
        used = np.ones_like(faults, dtype=bool)
        used[:, [group_of(k) in names for k in study.model.keys]] = False
        out.append(filtered(study.model, noise, faults, used))
    return out


def _nothing(study: Study) -> Ensemble:
    n, m = len(study.model.layout), len(study.model.keys)
    return Ensemble(
        np.zeros((n, 1)), np.zeros((study.vessel.epochs, n, 1)), np.zeros((study.vessel.epochs, m, 1))
    )


def levels(study: Study) -> Levels:
    """Return the levels of the study's parameter set."""
    e, p = study.facts["experiment"], study.facts["levels"]
    tree = risk_tree(e["p_prior"], e["p_hmi"])
    sets = ((), *(m.events for m in tree.modes.monitored))
    quiet = np.zeros((study.vessel.epochs, len(study.model.keys)))
    members = _members(study, _nothing(study), quiet, sets)
    sigma = np.sqrt(np.stack([np.diagonal(m.P, axis1=1, axis2=2)[:, :3] for m in members]))
    prior = [m.probability for m in tree.modes.monitored]
    left = e["p_hmi"] - tree.modes.unmonitored
    bank, published = np.empty(sigma.shape[1:]), np.empty(sigma.shape[1:])
    rows = [np.array([i for i, k in enumerate(study.model.keys) if group_of(k) in s]) for s in sets[1:]]
    for k, u in enumerate(study.updates):
        for axis, share in enumerate(p["split"]):
            own = sigma[:, k, axis]
            bank[k, axis] = bank_level(share * left, own[0], prior, own[1:], share * p["p_fa"])
            slopes = [slope(u.K[axis], u.S, out) for out in rows]
            published[k, axis] = published_level(
                share * left, own[0], prior, own[1:], slopes, [len(out) for out in rows], p["p_fa"]
            )
    return Levels(tree, sets, sigma, bank, published)


@dataclass(frozen=True)
class Coverage:
    """Errors against levels: runs with a fault, those with an error beyond a level and no alert then, of the
    bank and as published (which has no alert of its own: the same separations), and the largest such ratio.
    """

    runs: int
    misleading: int
    misleading_published: int
    worst: float


def coverage(study: Study, found: Levels, faults: list[FloatArray], seed: int = 7) -> Coverage:
    """Return what becomes of some thousand runs with each of some faults, once the filter has settled."""
    runs, noise = study.facts["levels"]["runs"], np.zeros(())
    keep = study.t_s >= SETTLED_S
    p, K = study.facts["levels"], []
    for share in p["split"]:
        K.append(false_alert_factor(share * p["p_fa"], len(found.sets) - 1))
    allowed = np.sqrt(np.maximum(found.sigma[1:] ** 2 - found.sigma[:1] ** 2, 0.0))[:, keep] * np.array(K)
    moved = []
    for f in faults:
        members = _members(study, _nothing(study), f, found.sets)
        moved.append(np.stack([m.error[keep, :3, 0] for m in members]))
    counts, worst = np.zeros(2, dtype=np.intp), 0.0
    rng, size = np.random.default_rng(seed), 250
    quiet = np.zeros((study.vessel.epochs, len(study.model.keys)))
    for _ in range(0, runs, size):
        ensemble = draw_ensemble(study.model, study.vessel.epochs, size, rng)
        noise = np.stack([m.error[keep, :3] for m in _members(study, ensemble, quiet, found.sets)])
        for shift in moved:
            error = noise + shift[..., None]
            apart = np.abs(error[1:] - error[0])
            alert = (apart > allowed[..., None]).any(axis=(0, 2))
            for i, level in enumerate((found.bank, found.published)):
                beyond = (np.abs(error[0]) > level[keep][..., None]).any(axis=1) & ~alert
                counts[i] += int(beyond.any(axis=0).sum())
            ratio = np.abs(error[0]) / found.bank[keep][..., None]
            worst = max(worst, float(np.where(alert[:, None], 0.0, ratio).max()))
    return Coverage(runs * len(faults), int(counts[0]), int(counts[1]), worst)
