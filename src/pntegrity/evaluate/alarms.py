"""Alarms against known faults: how often without cause, how often not at all, how late, and who was blamed.

Definitions, used everywhere:

- An epoch is *faulty* for a fault from its onset to before its end, and *recovering* for `recovery_s` after
  it: the fault is then still in the filter and in the windows, and an alarm counts neither for nor against
  anything.
- An epoch is *clean* where no fault is present or recovering; only tested epochs count (not: unavailable).
- P_FA: alarms in clean epochs over clean epochs.
- A fault is *missed* where no epoch of it has an alarm or leaves out one of its groups; P_MD: missed over all
  faults that had at least one tested epoch.
- Delay: from the onset to that first epoch; 0 for an alarm at the onset itself. Of faults that overlap an
  alarm counts for each, since it does not say for which it is.
- An exclusion is *wrong* where a group comes to be left out that no present or recovering fault is on.
- The *right satellite*: a fault was found, and its groups are among what came to be left out in it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.simulate.faults import Fault

__all__ = ["AlarmScore", "evaluate"]

BoolArray = npt.NDArray[np.bool_]
Interval = tuple[float, float]


@dataclass(frozen=True)
class AlarmScore:
    """What an evaluation found; None where there was nothing to count.

    Parameters
    ----------
    p_fa, p_md : float or None
        False alarms an epoch, missed detections a fault.
    p_fa_interval, p_md_interval : pair of float or None
        Exact binomial intervals; that of P_FA takes the epochs as independent, which windowed tests are not.
    clean_epochs, false_alarms, tested_faults : int
        What the rates were counted from.
    delays_s : tuple of float or None
        One a fault, in the order given; None where it was missed or never tested.
    right_satellite : tuple of bool or None
        One a fault; None where no exclusions were given or the fault was missed.
    wrong_exclusions : tuple of (int, str), or None
        Time and group of each exclusion of a healthy group; None where no exclusions were given.
    """

    p_fa: float | None
    p_fa_interval: Interval | None
    p_md: float | None
    p_md_interval: Interval | None
    clean_epochs: int
    false_alarms: int
    tested_faults: int
    delays_s: tuple[float | None, ...]
    right_satellite: tuple[bool | None, ...]
    wrong_exclusions: tuple[tuple[int, str], ...] | None

    @property
    def median_delay_s(self) -> float | None:
        """Median delay of the faults that were found."""
        found = [d for d in self.delays_s if d is not None]
        return float(np.median(found)) if found else None


@dataclass(frozen=True)
class _Log:
    """The epochs as arrays: times, tested, alarmed, and the groups left out (None: not known)."""

    t_ns: npt.NDArray[np.int64]
    tested: BoolArray
    alarm: BoolArray
    excluded: tuple[frozenset[str], ...] | None

    def began(self, k: int) -> frozenset[str]:
        """Return the groups that came to be left out at epoch `k`."""
        if self.excluded is None:
            return frozenset()
        return self.excluded[k] - (self.excluded[k - 1] if k else frozenset())


def evaluate(
    t_ns: Sequence[int] | npt.NDArray[np.int64],
    alarms: Sequence[bool | None],
    faults: Sequence[Fault],
    *,
    excluded: Sequence[Collection[str]] | None = None,
    recovery_s: float = 10.0,
    confidence: float = 0.99,
    first_ns: int | None = None,
) -> AlarmScore:
    """Compare alarms and exclusions with the faults that were there; the module's text defines every word.

    Parameters
    ----------
    t_ns : sequence of int, length n
        Times of the epochs, rising.
    alarms : sequence of bool or None, length n
        True: alarm (before any exclusion); None: no test was possible.
    faults : sequence of Fault
    excluded : sequence of collections of str, length n, optional
        Groups left out of each epoch.
    recovery_s : float
        How long after a fault alarms and exclusions of its groups are not held against the monitor.
    confidence : float
        Of the intervals.
    first_ns : int, optional
        Where the faults' seconds are counted from; the first epoch where not given.
    """
    times = np.asarray(t_ns, dtype=np.int64)
    if len(alarms) != len(times) or (excluded is not None and len(excluded) != len(times)):
        raise ValueError("`t_ns`, `alarms` and `excluded` must have the same length")
    left_out = None if excluded is None else tuple(frozenset(e) for e in excluded)
    log = _Log(
        times,
        np.array([a is not None for a in alarms], bool),
        np.array([bool(a) for a in alarms], bool),
        left_out,
    )
    origin = first_ns if first_ns is not None else int(times[0]) if len(times) else 0
    spans = [_span(log, f, origin, recovery_s) for f in faults]
    clean = log.tested & ~np.any([span[1] for span in spans], axis=0) if spans else log.tested
    count, false = int(clean.sum()), int((clean & log.alarm).sum())
    found = [_found(log, f, span[0]) for f, span in zip(faults, spans, strict=True)]
    tested = [bool((log.tested & span[0]).any()) for span in spans]
    missed = sum(t and k is None for t, k in zip(tested, found, strict=True))
    return AlarmScore(
        p_fa=false / count if count else None,
        p_fa_interval=binomial_interval(false, count, confidence) if count else None,
        p_md=missed / sum(tested) if any(tested) else None,
        p_md_interval=binomial_interval(missed, sum(tested), confidence) if any(tested) else None,
        clean_epochs=count,
        false_alarms=false,
        tested_faults=sum(tested),
        delays_s=tuple(_delay(log, f, k, origin) for f, k in zip(faults, found, strict=True)),
        right_satellite=tuple(_right(log, f, s[0], k) for f, s, k in zip(faults, spans, found, strict=True)),
        wrong_exclusions=None if left_out is None else tuple(_wrong(log, faults, spans)),
    )


def _span(log: _Log, fault: Fault, first_ns: int, recovery_s: float) -> tuple[BoolArray, BoolArray]:
    """Return where a fault is present, and where it is present or recovering."""
    onset, end = fault.onset_ns(first_ns), fault.end_ns(first_ns)
    begun = log.t_ns >= onset
    if end is None:
        return begun, begun
    return begun & (log.t_ns < end), begun & (log.t_ns < end + round(recovery_s * 1e9))


def _found(log: _Log, fault: Fault, present: BoolArray) -> int | None:
    """Return the first epoch of a fault with an alarm, or from which on one of its groups is left out."""
    for k in np.flatnonzero(present).tolist():
        if log.alarm[k] or fault.hits(log.began(k)):
            return int(k)
    return None


def _delay(log: _Log, fault: Fault, k: int | None, first_ns: int) -> float | None:
    return None if k is None else (int(log.t_ns[k]) - fault.onset_ns(first_ns)) * 1e-9


def _right(log: _Log, fault: Fault, present: BoolArray, k: int | None) -> bool | None:
    if k is None or log.excluded is None:
        return None
    return any(fault.hits(log.began(i)) for i in np.flatnonzero(present).tolist())


def _wrong(
    log: _Log, faults: Sequence[Fault], spans: Sequence[tuple[BoolArray, BoolArray]]
) -> list[tuple[int, str]]:
    wrong = []
    for k in range(len(log.t_ns)):
        began = log.began(k)
        guilty = frozenset(g for f, s in zip(faults, spans, strict=True) if s[1][k] for g in f.hits(began))
        wrong += [(int(log.t_ns[k]), g) for g in sorted(began - guilty)]
    return wrong
