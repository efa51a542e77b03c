"""Factor-set fault detection: consistency of an epoch's pseudoranges, and checks of what was kept.

Numbers in brackets are equations of the reference.

`published` is the paper's way, read as follows where it is silent: sigma of a residual 1 m at the start and
at least 0.3 m, in the place of the measurement's; least squares without weights; as many degrees of freedom
as rows, less three and less the clocks. A test needs four satellites of each of two constellations; one alone
needs five, and of three or more two must have four. Exclusion ends where one degree of freedom is left: six
satellites of two constellations. Where it ends without consistency, or no test was possible, the false-alarm
check decides on the rest. The window moves on at epochs that were used; the others leave no trace.

`exact` differs: least squares is weighted; the sigmas are the noise model's times a ratio, whose square is
the window's sum of squares over its sum of redundancy, with the noise model counting as ``filled * window``
epochs; a test needs one degree of freedom, whatever the constellations. Then the statistic is chi-square, and
the chance that good rows begin, or go on, to be left out once the faulty ones are gone is at most `p_fa`: the
rest is one of the subsets, and the smallest statistic is no larger than its. Only consistent epochs feed the
window; however small their residuals, the ratio stays above ``sqrt(filled / (1 + filled))``.

References
----------
Chen, Sun, Cheng, Yang (2023), A factor set-based GNSS fault detection and exclusion for vehicle navigation in
urban environments, GPS Solutions 27:87. Foerstner (1979) for variances from redundancy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress
from math import comb
from typing import Literal

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.residual_window import FactorMemory
from pntegrity.kernels.screening import Screening
from pntegrity.kernels.snapshot_fix import (
    UNCHECKED,
    Elimination,
    Fix,
    Projection,
    Pseudoranges,
    design,
    eliminate,
    fix_of,
    pdop_of,
    project,
)
from pntegrity.kernels.tails import chi2_threshold, noncentrality_for

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Screened = tuple[Screening, Fix | None, BoolArray, FactorMemory]

__all__ = [
    "FactorMemory", "FactorSet", "Fix", "Pseudoranges", "Remainder", "Screened", "Snapshot", "araim_subsets",
    "limits_of", "missed_factor", "published_sigmas", "remainder", "screen_factor_set", "screened",
    "sigmas_of", "snapshot", "undetected", "weights_of",
]  # fmt: skip

METHOD = "factor-set"


@dataclass(frozen=True)
class FactorSet:
    """What factor-set detection is told.

    Parameters
    ----------
    variant : str
        ``"exact"`` or ``"published"``.
    p_fa, p_md : float
        Probability of a false alarm of the consistency check, and of a missed detection behind the
        missed-detection factor.
    sigma_m, sigma_min_m : float
        Residual sigma at the start (`published`), and the smallest that adaptation may give.
    window : int
        Epochs of residuals that sigma is made of.
    filled : float
        Share of the window that must be filled before it counts (`published`), or that the noise model counts
        for (`exact`).
    missed_limit_m, false_alarm_limit_m : float
        Thresholds of the two checks.

    Raises
    ------
    ValueError
        Naming the field and what it must be.
    """

    variant: Literal["exact", "published"] = "exact"
    p_fa: float = 1e-5
    p_md: float = 1e-5
    sigma_m: float = 1.0
    sigma_min_m: float = 0.3
    window: int = 1000
    filled: float = 0.8
    missed_limit_m: float = 18.0
    false_alarm_limit_m: float = 30.0

    def __post_init__(self) -> None:
        if self.variant not in ("exact", "published"):
            raise ValueError(f"`variant` must be 'exact' or 'published', not {self.variant!r}")
        for name in ("p_fa", "p_md"):
            if not 0.0 < getattr(self, name) < 0.5:
                raise ValueError(f"`{name}` must be above 0 and below 0.5, not {getattr(self, name)!r}")
        for name in ("sigma_m", "sigma_min_m", "missed_limit_m", "false_alarm_limit_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be above 0 m, not {getattr(self, name)!r}")
        if not (isinstance(self.window, int) and self.window >= 1):
            raise ValueError(f"`window` must be a whole number of epochs from 1, not {self.window!r}")
        if not 0.0 < self.filled <= 1.0:
            raise ValueError(f"`filled` must be above 0 and at most 1, not {self.filled!r}")


def screen_factor_set(options: FactorSet, memory: FactorMemory, rows: Pseudoranges) -> Screened:
    """Detect and leave out faulty pseudoranges, and check the fix of those that are kept.

    Parameters
    ----------
    options : FactorSet
    memory : FactorMemory
        From the epoch before; ``FactorMemory()`` at the start.
    rows : Pseudoranges
        Linearised at the antenna's position by the inertial mechanisation: the false-alarm factor (19) is the
        distance of the fix from it.

    Returns
    -------
    screening : Screening
        `used` tells whether the filter may be updated; statistics are squares of the paper's factors.
    fix : Fix or None
        Of the kept rows; None where they determine no position.
    kept : ndarray of bool, shape (n,)
    memory : FactorMemory
    """
    sigma = sigmas_of(options, memory, rows)
    epoch = snapshot(options, rows, sigma)
    found, why = _detected(epoch)
    rest = remainder(epoch, found)
    screening = screened(METHOD, epoch, rest, found)
    if rest.fix is None or rest.projection is None:
        why = why or "too few satellites for a position"
        return replace(screening, used=False, reason=why), None, rest.kept, memory
    consistent = found is not None and found.passed
    screening = replace(screening, false_alarm_m=float(np.linalg.norm(rest.fix.offset_m)))
    screening = _missed(epoch, rest, screening) if consistent else _false_alarm(epoch, screening, why)
    feeds = screening.used and (consistent or options.variant == "published")
    return screening, rest.fix, rest.kept, _learnt(epoch, rest, memory) if feeds else memory


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One epoch's rows with the sigmas that they are tested with, the roots of their weights, and their
    columns.
    """

    options: FactorSet
    rows: Pseudoranges
    sigma: FloatArray
    weights: FloatArray
    A: FloatArray
    numbers: tuple[int, ...]

    def tested(self) -> tuple[Projection | None, FloatArray]:
        """Return least squares of all rows, None where it determines no position, and whitened residuals."""
        projection = project(self.A, self.weights)
        if projection is None:
            return None, np.zeros(0)
        return projection, projection.project @ (self.rows.residual_m * self.weights)

    def eliminated(self, projection: Projection, residual: FloatArray, most: int) -> Elimination:
        """Leave out at most so many rows."""
        limits = limits_of(self.options.p_fa, projection.dof)
        ratio = 1.0 / (self.weights * self.sigma)
        return eliminate(projection.project, residual, ratio, limits, most)


def snapshot(options: FactorSet, rows: Pseudoranges, sigma: FloatArray) -> Snapshot:
    """Return an epoch's rows as they are tested with `sigma`."""
    A, numbers = design(rows)
    return Snapshot(options, rows, sigma, weights_of(options, sigma), A, numbers)


@dataclass(frozen=True, eq=False)
class Remainder:
    """The rows that were kept, their least squares and its fix; None where they determine no position."""

    kept: BoolArray
    projection: Projection | None
    fix: Fix | None


def remainder(epoch: Snapshot, found: Elimination | None) -> Remainder:
    """Return what is left after a detection; every clock still has rows, as a lone one is never left out."""
    kept = np.ones(len(epoch.rows.keys), dtype=bool)
    kept[list(found.order) if found else []] = False
    projection = project(epoch.A[kept], epoch.weights[kept])
    z, sigma = epoch.rows.residual_m[kept], epoch.sigma[kept]
    fix = None if projection is None else fix_of(projection, z, sigma, epoch.numbers)
    return Remainder(kept, projection, fix)


def sigmas_of(options: FactorSet, memory: FactorMemory, rows: Pseudoranges) -> FloatArray:
    """Return the sigma of each row that this epoch is tested with (15), shape (n,)."""
    if options.variant == "published":
        return memory.sigmas(rows.keys, options.sigma_m)
    scale = memory.sigmas(rows.keys, 1.0)
    return np.asarray(np.maximum(rows.sigma_m * scale, options.sigma_min_m))


def weights_of(options: FactorSet, sigma: FloatArray) -> FloatArray:
    """Return the square roots of the weights of least squares, shape (n,)."""
    return np.ones(len(sigma)) if options.variant == "published" else 1.0 / sigma


def _detected(epoch: Snapshot) -> tuple[Elimination | None, str]:
    """Return what the preliminary detection (1)-(6) left out, or None and why there was none."""
    projection, residual = epoch.tested()
    if projection is None:
        return None, "the satellites do not determine a position"
    if projection.dof < 1:
        return None, "no redundancy: {} satellites, {} states".format(*projection.design.shape)
    if epoch.options.variant == "published" and not _is_gate_open(epoch.rows):
        return None, "no two constellations with four satellites each"
    return epoch.eliminated(projection, residual, projection.dof - 1), ""


def _is_gate_open(rows: Pseudoranges) -> bool:
    """Tell whether the paper would test: four of each of two constellations, or five of one alone."""
    counts = np.sort(np.unique(rows.clock, return_counts=True)[1])
    return bool(counts[-2] >= 4 if len(counts) > 1 else counts[-1] >= 5)


@lru_cache(maxsize=256)
def limits_of(p_fa: float, dof: int) -> FloatArray:
    """Return the thresholds (4), squared, with 0 to `dof` degrees of freedom, shape (dof + 1,), read-only."""
    out = np.array([0.0, *(chi2_threshold(p_fa, d) for d in range(1, dof + 1))])
    out.flags.writeable = False
    return out


def screened(method: str, epoch: Snapshot, rest: Remainder, found: Elimination | None) -> Screening:
    """Return what is to be said of a detection, before any check of the fix."""
    A, before = epoch.A, pdop_of(epoch.A)
    after = before if rest.kept.all() else pdop_of(A[rest.kept])
    counts = len(rest.kept), int(rest.kept.sum())
    out = Screening(method, epoch.options.variant, satellites=counts, pdop=(before, after))
    if found is None:
        return out
    dof, p_fa = A.shape[0] - A.shape[1], epoch.options.p_fa
    dropped = tuple((epoch.rows.keys[i], at + 1) for at, i in enumerate(found.order))
    return replace(
        out, first=found.first, first_limit=chi2_threshold(p_fa, dof), last=found.last,
        last_limit=chi2_threshold(p_fa, dof - len(dropped)), dropped=dropped, tests=found.tests,
        dof=dof - len(dropped),
    )  # fmt: skip


def _missed(epoch: Snapshot, rest: Remainder, screening: Screening) -> Screening:
    """Return the screening of a consistent set after the missed-detection check."""
    factor, limit = missed_factor(epoch, rest), epoch.options.missed_limit_m
    over = factor > limit
    reason = "missed-detection factor above its threshold" if over else ""
    return replace(screening, missed_m=factor, missed_limit_m=limit, used=not over, reason=reason)


def _false_alarm(epoch: Snapshot, screening: Screening, why: str) -> Screening:
    """Return the screening of any other set after the false-alarm check (16)-(19)."""
    limit = epoch.options.false_alarm_limit_m
    over = screening.false_alarm_m > limit
    check = "false-alarm factor above its threshold" if over else "passed the false-alarm check"
    reason = f"{why or 'the satellites stay inconsistent'}; {check}"
    return replace(screening, false_alarm_limit_m=limit, used=not over, reason=reason)


def missed_factor(epoch: Snapshot, rest: Remainder) -> float:
    """Return the missed-detection factor (7)-(12), m; inf where a row that moves the fix is not checked.

    With the weights of the fix in slope and redundancy (`exact`), or without (`published`).
    """
    if rest.projection is None or rest.projection.dof < 1:
        return float("inf")
    lam = undetected(epoch.options.p_fa, epoch.options.p_md, rest.projection.dof)
    slopes = epoch.sigma[rest.kept] * _slopes(rest.projection, epoch.rows.enu)
    return float(slopes.max() * np.sqrt(lam))


def _slopes(projection: Projection, enu: FloatArray) -> FloatArray:
    """Return the horizontal error of each row's fault over its share of the statistic's root (11)."""
    across = np.linalg.norm((enu @ projection.gain[:3])[:2], axis=0)
    checked = projection.redundancy > UNCHECKED
    root = np.sqrt(np.where(checked, projection.redundancy, 1.0))
    return np.where(checked, across / root, np.where(across > UNCHECKED, np.inf, 0.0))


@lru_cache(maxsize=4096)
def undetected(p_fa: float, p_md: float, dof: int) -> float:
    """Return the non-centrality that the consistency check misses with probability `p_md` (7)."""
    return noncentrality_for(1.0 - p_md, chi2_threshold(p_fa, dof), dof)


def _learnt(epoch: Snapshot, rest: Remainder, memory: FactorMemory) -> FactorMemory:
    """Return the memory after an epoch that was used (14)-(15)."""
    assert rest.fix is not None
    assert rest.projection is not None
    keys = tuple(compress(epoch.rows.keys, rest.kept.tolist()))
    r, options = rest.fix.residuals, epoch.options
    if options.variant == "published":
        return published_sigmas(options, memory.pushed(keys, r * r, np.ones(len(r)), options.window))
    square = (r / epoch.rows.sigma_m[rest.kept]) ** 2
    share = np.maximum(rest.projection.redundancy, 0.0)
    return _exact_ratios(options, memory.pushed(keys, square, share, options.window))


def published_sigmas(options: FactorSet, memory: FactorMemory) -> FactorMemory:
    """Return the memory with sigma set to the root mean square (15) where enough of the window is filled."""
    full = memory.count > options.filled * options.window
    if not full.any():
        return memory
    rms = np.sqrt(memory.square / np.maximum(memory.count, 1.0))
    return replace(memory, present=np.where(full, np.maximum(rms, options.sigma_min_m), memory.present))


def _exact_ratios(options: FactorSet, memory: FactorMemory) -> FactorMemory:
    prior = options.filled * options.window
    return replace(memory, present=np.sqrt((prior + memory.square) / (prior + memory.count)))


def araim_subsets(satellites: int, faults: int) -> int:
    """Return how many subsets ARAIM tests against up to so many faults at once."""
    return sum(comb(satellites, k) for k in range(1, faults + 1))
