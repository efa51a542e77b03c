"""What is known of a position while somebody is left out who may be healthy: levels cover all candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from pntegrity.records import FloatArray
from pntegrity.scenarios._vessel_repairs import EARLIER, rows_of
from pntegrity.scenarios._vessel_runs import Detected, Study
from pntegrity.simulate.ensembles import Filtered, filtered

__all__ = ["DOUBT_S", "Doubtful", "doubtful"]

#: Seconds after somebody is left out in doubt for which errors are held against levels.
DOUBT_S = 5.0


@dataclass(frozen=True, eq=False)
class Doubtful:
    """Runs in which somebody is left out in doubt, shape (runs,).

    Parameters
    ----------
    level_m, alone_m : ndarray
        Horizontal level when somebody is left out: of all candidates, and of the one who is left out.
    ratio : ndarray
        The largest error in any direction over its level in the time after.
    """

    level_m: FloatArray
    alone_m: FloatArray
    ratio: FloatArray


def doubtful(study: Study, faults: FloatArray, found: Detected) -> Doubtful:
    """Return levels and errors of the runs in which others may be at fault as well.

    The position is of the filter without those who are left out, since before their fault's begin. Another
    candidate is at fault or not: where it is, a filter without it is right, and so the error is at most the
    separation of the two and what that filter may be wrong. The level is the largest over all candidates,
    each at the whole integrity risk of its direction: how likely each is has no part in it.
    """
    full, count = study.full(faults), 1 + round(DOUBT_S * study.facts["experiment"]["rate_hz"])
    parts: list[tuple[float, ...]] = []
    for r in np.flatnonzero([bool(rivals) for rivals in found.rivals]):
        first, k = max(int(found.onset[r]) - EARLIER, 1), int(found.named[r])
        last = min(k + count, len(study.updates))
        run = np.array([r], dtype=np.intp)
        own = _without(study, faults, full, found.sensors[r] or found.sources[r], (first, last), run)
        error, levels = own.error[k - first :, :3, 0], [_reach(study, own, k)]
        for names in found.rivals[r]:
            other = _without(study, faults, full, names, (first, last), run)
            levels.append(np.abs(error - other.error[k - first :, :3, 0]) + _reach(study, other, k))
        level = np.max(levels, axis=0)
        both = (float(np.hypot(*each[0, :2])) for each in (level, levels[0]))
        parts.append((*both, float((np.abs(error) / level).max())))
    return Doubtful(*np.array(parts).reshape(-1, 3).T)


def _without(
    study: Study, faults: FloatArray, full: Filtered, names: Sequence[str], span: tuple[int, int],
    run: npt.NDArray[np.intp],
) -> Filtered:  # fmt: skip
    first, last = span
    used = np.ones_like(faults, dtype=bool)
    used[first:, rows_of(study, names)] = False
    return filtered(study.model, study.noise, faults, used, after=full, first=first, runs=run, last=last)


def _reach(study: Study, one: Filtered, k: int) -> FloatArray:
    """Return how wrong a healthy filter may be from an epoch on, shape (epochs, 3)."""
    share = np.array(study.facts["levels"]["split"]) * study.facts["experiment"]["p_hmi"]
    sigma = np.sqrt(np.diagonal(one.P[k - one.first :, :3, :3], axis1=1, axis2=2))
    return np.asarray(-special.ndtri(0.5 * share) * sigma)
