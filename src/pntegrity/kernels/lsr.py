"""Least-squares-residual RAIM, and no detection at all: what factor-set detection is compared with.

Same interface as `pntegrity.kernels.factor_set.screen_factor_set`; the memory goes through unchanged. With
the variant ``"published"`` least squares has no weights and every row ``sigma_m`` of the options; with
``"exact"`` both are the noise model's.

References
----------
Parkinson and Axelrad (1988), Autonomous GPS integrity monitoring using the pseudorange residual.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pntegrity.kernels.factor_set import FactorSet, Screened, Snapshot, remainder, screened, snapshot
from pntegrity.kernels.residual_window import FactorMemory
from pntegrity.kernels.snapshot_fix import Elimination, Pseudoranges

__all__ = ["screen_lsr", "screen_none"]


def screen_lsr(options: FactorSet, memory: FactorMemory, rows: Pseudoranges) -> Screened:
    """Test all rows once, and where they fail leave one out: a single fault is all that is thought of.

    The row is the one without which the statistic is smallest. Whether the rest is consistent, nobody asks;
    with several faults at once the fix stays wrong, which is why this method fails in cities.
    `Screening.reason` says where it is so.

    Parameters
    ----------
    options : FactorSet
        `variant`, `p_fa` and, for ``"published"``, `sigma_m`.
    memory : FactorMemory
        Not looked at.
    rows : Pseudoranges

    Returns
    -------
    screening, fix, kept, memory
        As of `screen_factor_set`; `used` is False only where there is no fix.
    """
    epoch = _believed(options, rows)
    return _concluded("lsr", epoch, memory, *_single(epoch))


def screen_none(options: FactorSet, memory: FactorMemory, rows: Pseudoranges) -> Screened:
    """Use all rows, untested; arguments and results as of `screen_lsr`."""
    return _concluded("none", _believed(options, rows), memory, None, "")


def _believed(options: FactorSet, rows: Pseudoranges) -> Snapshot:
    published = options.variant == "published"
    sigma = np.full(len(rows.keys), options.sigma_m) if published else np.asarray(rows.sigma_m)
    return snapshot(options, rows, sigma)


def _single(epoch: Snapshot) -> tuple[Elimination | None, str]:
    """Return the test, with at most one row left out, or None and why no test was possible."""
    projection, residual = epoch.tested()
    if projection is None or projection.dof < 1:
        return None, f"no redundancy: {len(epoch.rows.keys)} satellites"
    found = epoch.eliminated(projection, residual, 1)
    return found, "" if found.passed else "more than one fault: the rest is not consistent either"


def _concluded(
    method: str, epoch: Snapshot, memory: FactorMemory, found: Elimination | None, why: str
) -> Screened:
    rest = remainder(epoch, found)
    reason = why if rest.fix is not None else "too few satellites for a position"
    screening = replace(screened(method, epoch, rest, found), used=rest.fix is not None, reason=reason)
    return screening, rest.fix, rest.kept, memory
