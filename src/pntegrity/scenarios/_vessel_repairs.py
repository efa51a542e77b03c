"""What follows a detection in the multi-level study: isolation, which sensor, and when who may come back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import cholesky, correct_covariance, gain, predict_covariance, whiten
from pntegrity.kernels.recovery import ChangeTrial, Trial, w_test
from pntegrity.kernels.sensor_window import expanded, sets_of
from pntegrity.kernels.source_test import Gains
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.records import FloatArray
from pntegrity.scenarios._vessel_runs import Detected, Study
from pntegrity.simulate.ensembles import Filtered, filtered
from pntegrity.states import group_of, sensor_of

__all__ = ["Recovery", "isolated_error", "recovery", "sensor_delays"]

IntArray = npt.NDArray[np.intp]
#: Epochs before the estimated onset from which on the buffer is run again.
EARLIER = 4
#: Standard deviations that each estimated bias must be allowed: nine in ten healthy rows pass.
ROOM = 1.645
#: The longest trial, and the longest time before a change that is looked at, epochs.
LONGEST = 40
#: How likely a trial that proves a change must be to see it.
LIKELY = 0.9


def rows_of(study: Study, sensors: Sequence[str]) -> IntArray:
    """Return the rows of sensors ``"lbl.AP1"``, or of whole sources ``"lbl"``."""
    wanted = set(sensors)
    return np.array(
        [
            i
            for i, key in enumerate(study.model.keys)
            if group_of(key) in wanted or f"{group_of(key)}.{sensor_of(key)}" in wanted
        ],
        dtype=np.intp,
    )


def isolated_error(
    study: Study, faults: FloatArray, found: Detected, back_s: float, again: bool = False
) -> FloatArray:
    """Return the position errors, shape (epochs, 3, runs), of runs that leave out what was isolated, from
    before its onset on, as soon as it is.

    Parameters
    ----------
    study : Study
    faults : ndarray, shape (epochs, m)
    found : Detected
    back_s : float
        When what was left out is back.
    again : bool
        Count the epochs before, too, as they are when run again.
    """
    full = study.full(faults)
    error = full.error[:, :3].copy()
    back = int(np.searchsorted(study.t_s, back_s))
    groups: dict[tuple[tuple[str, ...], int], list[int]] = {}
    for r in np.flatnonzero(np.isfinite(found.named_s)):
        names = found.sensors[r] or found.sources[r]
        groups.setdefault((names, max(int(found.onset[r]) - EARLIER, 1)), []).append(int(r))
    for (names, first), runs in groups.items():
        used = np.ones_like(faults, dtype=bool)
        used[first:back, rows_of(study, names)] = False
        one = filtered(
            study.model,
            study.noise,
            faults,
            used,
            after=full,
            first=first,
            runs=np.array(runs, dtype=np.intp),
        )
        for i, run in enumerate(runs):
            k = first if again else int(found.named[run])
            error[k:, :, run] = one.error[k - first :, :3, i]
    return error


@dataclass(frozen=True, eq=False)
class Recovery:
    """When rows that were left out come back, s after the fault's begin; inf: never; shape (runs,).

    Parameters
    ----------
    passes_s : ndarray
        By w-tests in a row.
    trial_s : ndarray
        By the windowed trial.
    window : int
        Epochs of the trial (of its end, where it proves a change).
    readmission : float
        The largest probability with which a trial passes rows that are off by what it must prove.
    change : bool
        Whether no window is long enough to prove a bias, so that its end is what is proved.
    shown : float
        How many standard deviations such a bias (or its end) moves what is estimated, of the worst row.
    """

    passes_s: FloatArray
    trial_s: FloatArray
    window: int
    readmission: float
    change: bool
    shown: float


def recovery(
    study: Study,
    faults: FloatArray,
    sensors: Sequence[str],
    span_s: tuple[float, float, float],
    size: FloatArray,
) -> Recovery:
    """Return when sensors come back that are left out from the fault's begin on.

    Parameters
    ----------
    sensors : sequence of str
    span_s : tuple of float
        From when they are left out, from when they are tested, and until when.
    size : ndarray
        What the trial must prove of each of their rows.
    """
    first, tested, last = (int(np.searchsorted(study.t_s, t)) for t in span_s)
    rows, used = rows_of(study, sensors), np.ones_like(faults, dtype=bool)
    used[first:, rows] = False
    without = filtered(
        study.model, study.noise, faults, used, after=study.full(faults), first=first - 1, last=last
    )
    passes = _by_passes(study, without, rows, tested, last)
    window, change = _long_enough(study, without, rows, tested, size)
    begin = tested if not change else max(tested, first + LONGEST // 4)
    trial, trials = _by_trials(study, faults, without, rows, (begin + window, last), (size, window, change))
    readmission = max(float(t.readmission.max()) for t in trials)
    shown = min(float(t.shown.min()) for t in trials)
    return Recovery(passes - span_s[0], trial - span_s[0], window, readmission, change, shown)


def _by_passes(study: Study, without: Filtered, rows: IntArray, first: int, last: int) -> FloatArray:
    needed, p_fa = study.facts["experiment"]["verification_passes"], study.facts["recovery"]["p_fa"]
    count, out = np.zeros(study.runs, dtype=np.intp), np.full(study.runs, np.inf)
    for k in range(first, last):
        H, R = study.model.at("H", k)[rows], study.model.at("R", k)[np.ix_(rows, rows)]
        cov = H @ without.prior(study.model, k) @ H.T + R
        w, limit = w_test(without.nu[k - without.first][rows], cov, p_fa)
        count = np.where((w <= limit).all(axis=0), count + 1, 0)
        out[(count == needed) & np.isinf(out)] = study.t_s[k]
    return out


def _by_trials(
    study: Study, faults: FloatArray, without: Filtered, rows: IntArray, span: tuple[int, int],
    kind: tuple[FloatArray, int, bool],
) -> tuple[FloatArray, list[Trial | ChangeTrial]]:  # fmt: skip
    """Return when a trial that ends at each epoch is first passed, and the trials."""
    size, window, change = kind
    out, trials = np.full(study.runs, np.inf), []
    everything = np.ones_like(faults, dtype=bool)
    for k in range(*span):
        begin = max(k + 1 - window - (LONGEST if change else 0), without.first + 1)
        found = window_gains(study, without.P[begin - 1 - without.first], begin, k + 1 - begin)
        trial = _change(study, found, rows, (size, window)) if change else _trial(study, found, rows, size)
        trials.append(trial)
        waiting = np.flatnonzero(np.isinf(out))
        if not len(waiting):
            break
        run = filtered(
            study.model, study.noise, faults, everything, after=without, first=begin, runs=waiting, last=k + 1
        )
        white = np.concatenate([whiten(L, nu) for (_, _, L, _), nu in zip(found, run.nu, strict=True)])
        out[waiting[trial.passed(white)]] = study.t_s[k]
    return out, trials


def _long_enough(
    study: Study, without: Filtered, rows: IntArray, first: int, size: FloatArray
) -> tuple[int, bool]:
    """Return the length of the shortest trial that nine in ten healthy rows pass, and whether it must prove a
    change.

    A state that follows a bias hides it in the end: where a window that is twice as long as a long one does
    not show enough, none does.
    """
    for window in range(4, 2 * LONGEST + 1, 2):
        found = window_gains(study, without.P[first - without.first], first + 1, window)
        if (_trial(study, found, rows, size).limits >= ROOM).all():
            return window, False
    for window in range(4, LONGEST + 1, 2):
        found = window_gains(study, without.P[0], without.first + 1, LONGEST + window)
        if (_change(study, found, rows, (size, window)).power >= LIKELY).all():
            break
    return window, True


def _trial(study: Study, found: list[Gains], rows: IntArray, size: FloatArray) -> Trial:
    p = study.facts["recovery"]
    return Trial(tuple(found), (rows,) * len(found), size, p["p_readmit"], p["p_fa"])


def _change(study: Study, found: list[Gains], rows: IntArray, kind: tuple[FloatArray, int]) -> ChangeTrial:
    p, (size, window) = study.facts["recovery"], kind
    before = len(found) - window
    return ChangeTrial(tuple(found), (rows,) * len(found), before, size, p["p_readmit"], p["p_fa"])


def window_gains(study: Study, P: FloatArray, first: int, count: int) -> list[Gains]:
    """Return the filter with all rows over some epochs, from a posterior covariance on."""
    out, model = [], study.model
    for k in range(first, first + count):
        F, H, R = model.at("F", k), model.at("H", k), model.at("R", k)
        P = predict_covariance(F, P, model.at("Q", k))
        L = cholesky(H @ P @ H.T + R)
        K = gain(P, H, L)
        P = correct_covariance(P, H, R, K)
        out.append((F, H, L, K))
    return out


def sensor_delays(
    study: Study, faults: FloatArray, source: str, from_s: float, to_s: float
) -> dict[str, FloatArray]:
    """Return when the sensors at fault are identified as published, s after the fault's begin, shape (runs,):
    ``"restarted"`` and ``"expanded"``; inf: never, or others are.
    """
    first, last = (int(np.searchsorted(study.t_s, t)) for t in (from_s, to_s))
    true = tuple(np.flatnonzero(faults[first + 2][rows_of(study, [source])]).tolist())
    return {
        growth: _identified(study, faults, source, (first, last), true, growth == "expanded") - from_s
        for growth in ("restarted", "expanded")
    }


def _identified(
    study: Study, faults: FloatArray, source: str, span: tuple[int, int], true: tuple[int, ...], expand: bool
) -> FloatArray:
    first, last = span
    rows, p = rows_of(study, [source]), study.facts["sensors"]
    window, n = p["window"], len(rows)
    out, settled = np.full(study.runs, np.inf), np.zeros(study.runs, dtype=bool)
    singles = sets_of(n, 1)
    past = _squares(study, faults, rows, singles, None, (first - window + 1, last))
    _, scores = _scores(past, singles, window, window - 1, p["p_fa"])
    passing = scores == 0
    for i in range(len(scores)):
        found = ~settled & (passing[i].sum(axis=0) == 1)
        right = np.array([singles[j] == true for j in passing[i].argmax(axis=0)])
        out[found & right] = study.t_s[first + i]
        settled |= found
        grow = ~settled & (passing[i].sum(axis=0) == 0)
        if grow.any():
            which = np.flatnonzero(grow)
            at = first + i
            out[which] = _pairs(
                study, faults, (rows, source), past[:, :, :, which], (at, first, last), true, which, expand
            )
            settled |= grow
    return out


def _pairs(
    study: Study, faults: FloatArray, where: tuple[IntArray, str], past: FloatArray,
    when: tuple[int, int, int], true: tuple[int, ...], runs: IntArray, expand: bool,
) -> FloatArray:  # fmt: skip
    """Return when two sensors are identified by subfilters that begin at an epoch."""
    (rows, _), (at, first, last), p = where, when, study.facts["sensors"]
    window = p["window"]
    pairs = sets_of(len(rows), 2)
    used = np.ones_like(faults, dtype=bool)
    used[first:, rows] = False
    main = filtered(study.model, study.noise, faults, used, after=study.full(faults), first=first, last=last)
    fresh = _squares(study, faults, rows, pairs, main, (at + 1, last))[:, :, :, runs]
    before = past[at - first : at - first + window]
    begun = expanded_runs(before, pairs) if expand else fresh[:0]
    whole = np.concatenate([begun, fresh])
    start = len(begun) - window + 1 if expand else 0
    _, scores = _scores(whole, pairs, window, window - 1, p["p_fa"])
    out = np.full(len(runs), np.inf)
    offset = (at + 1 - len(begun)) + window - 1
    for i in range(max(start, 0), len(scores)):
        k = offset + i
        if k <= at or k >= last:
            continue
        one = (scores[i] == 0).sum(axis=0) == 1
        right = np.array([pairs[j] == true for j in (scores[i] == 0).argmax(axis=0)])
        out[one & right & np.isinf(out)] = study.t_s[k]
    return out


def expanded_runs(window: FloatArray, pairs: tuple[tuple[int, ...], ...]) -> FloatArray:
    """Return the mean windows of the parents of pairs, shape (epochs, pairs, sensors, runs)."""
    singles = sets_of(window.shape[2], 1)
    return np.stack([expanded(window[..., r], singles, pairs) for r in range(window.shape[3])], axis=3)


def _squares(
    study: Study, faults: FloatArray, rows: IntArray, sets: tuple[tuple[int, ...], ...],
    main: Filtered | None, span: tuple[int, int],
) -> FloatArray:  # fmt: skip
    """Return the whitened squares of each sensor against each subfilter, shape (epochs, J, sensors, runs)."""
    out = np.zeros((span[1] - span[0], len(sets), len(rows), study.runs))
    for j, own in enumerate(sets):
        used = np.ones_like(faults, dtype=bool)
        used[:, rows[list(own)]] = False
        first = 0 if main is None else span[0]
        one = filtered(study.model, study.noise, faults, used, after=main, first=first, last=span[1])
        for k in range(*span):
            H, R = study.model.at("H", k)[rows], np.diagonal(study.model.at("R", k))[rows]
            start = main is not None and k == first
            P = main.prior(study.model, k) if start and main is not None else one.prior(study.model, k)
            var = np.einsum("ij,jk,ik->i", H, P, H) + R
            out[k - span[0], j] = one.nu[k - first][rows] ** 2 / var[:, None]
    return out


def _scores(
    past: FloatArray, sets: tuple[tuple[int, ...], ...], window: int, begin: int, p_fa: float
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return ratios and scores of full windows, the first one ending at entry `begin`."""
    total = np.cumsum(np.concatenate([np.zeros_like(past[:1]), past]), axis=0)
    ratio = (total[begin + 1 :] - total[begin + 1 - window : len(total) - window]) / chi2_threshold(
        p_fa, window
    )
    for j, own in enumerate(sets):
        ratio[:, j, list(own)] = 0.0
    return ratio, (ratio > 1.0).sum(axis=2)
