"""Fit a noise model to a receiver: innovation maximum likelihood on one part of a log, judged on another.

The likelihood of a Kalman filter is that of its innovations, ``-2 log L = sum log det S_k + nu_k^T S_k^-1
nu_k``. It is maximised over the logarithms of the parameters that the estimator names (``fitted``), one at a
time in turn. What a log cannot show stays where it is. A threshold factor then covers what is left in the
tails.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from scipy.special import ndtri

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.whiteness import judged, whiteness
from pntegrity.exclusion import Policy
from pntegrity.kernels.signatures import is_carrier, is_rate
from pntegrity.pipeline import Pipeline
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, FloatArray, State, Update
from pntegrity.sensors.noise import WHITE, Fitted, NoiseModel

__all__ = ["Calibration", "calibrate", "updates_of", "white_model"]

#: Factors by which a parameter is tried, sweep after sweep.
STEPS = (2.5, 1.6, 1.25, 1.12)
#: Before this sweep satellites get their own factors.
SATELLITES_AT = 2
#: How far up or down one sweep walks a parameter.
STRIDES = 4
#: Epochs on either side of the split, at least.
PART = 100
#: Epochs before innovations count, at least; an estimator's `settle_s` may ask for more, up to a third.
SETTLE = 30
#: Lengths of the means over which a satellite's innovations are compared with white ones, epochs, and how
#: many such means there must be.
SPANS, MEANS = (1, 5, 10, 20), 5
#: How much larger than the model's the white noise is taken when gross errors are looked for.
GATE = 4.0
#: Innovations that a row must have for a factor of its own.
ENOUGH = 60


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Parameters
    ----------
    noise : NoiseModel
        Fitted parameters and threshold factors.
    training, validation : int
        Epochs of the two parts.
    gain : float
        By how much the fit raised the log-likelihood of the training part, an epoch.
    whiteness : dict
        Innovation statistics of the validation part, for ``"white"``, ``"default"`` and ``"calibrated"``
        models.
    alarms : dict
        Alarms of each monitor on the validation part as ``{name: {p_fa: count}}``, calibrated thresholds.
    """

    noise: NoiseModel
    training: int
    validation: int
    gain: float
    whiteness: dict[str, dict[str, Any]]
    alarms: dict[str, dict[str, int]]


def calibrate(
    epochs: Sequence[Epoch],
    options: GnssOptions,
    monitors: Callable[[float, NoiseModel], Sequence[Monitor]],
    *,
    estimator: type[Any] = SppKf,
    split: float = 0.5,
    p_fa: float = 1e-6,
    progress: Callable[[str, float], None] = lambda what, done: None,
) -> Calibration:
    """Fit the noise model on the first part of a log and judge it on the rest.

    Parameters
    ----------
    epochs : sequence of Epoch
    options : GnssOptions
        Where the fit starts.
    monitors : callable
        Makes the monitors for a false-alarm probability and a noise model.
    estimator : type
        Class of an estimator that a run can choose: its `fitted` says what is fitted.
    split : float
        Share of the epochs that is fitted.
    p_fa : float
        Probability the threshold factors are made for.
    progress : callable
        Told what is being done and how far it is, 0 to 1.

    Raises
    ------
    InputError
        Where either part has fewer than 100 epochs.
    """
    cut = int(len(epochs) * split)
    if cut < PART or len(epochs) - cut < PART:
        raise InputError(
            f"a calibration needs {PART} epochs on either side of the split; {cut} and {len(epochs) - cut} "
            "given"
        )
    part = _Part.of(epochs[:cut], options, estimator, monitors(p_fa, options.noise))
    noise = _fit(part, progress)
    gain = 0.5 * (part.cost(options.noise) - part.cost(noise)) / cut
    progress("validation", 1.0)
    models = {"white": _white(part, noise), "default": estimator.default_noise, "calibrated": noise}
    whole = replace(part, epochs=epochs)
    runs = {name: whole.updates(m) for name, m in models.items()}
    factors, alarms = _thresholds(runs["calibrated"], part.settle, cut, monitors, noise, p_fa)
    whitened = {name: whiteness(run[cut:]) for name, run in runs.items()}
    return Calibration(replace(noise, factors=factors), cut, len(epochs) - cut, gain, whitened, alarms)


def white_model(
    epochs: Sequence[Epoch], options: GnssOptions, noise: NoiseModel,
    left_out: Sequence[frozenset[str]] = (), estimator: type[Any] = SppKf,
) -> NoiseModel:  # fmt: skip
    """Return the best model without correlated errors: motion and clock of `noise`, white noise fitted to the
    epochs.

    Parameters
    ----------
    epochs : sequence of Epoch
    options : GnssOptions
    noise : NoiseModel
        A fitted model.
    left_out : sequence of frozenset of str
        Groups left out of each epoch.
    estimator : type
        Class of the estimator: its `fitted` says which sizes are of white and which of lasting errors.
    """
    return _white(_Part(epochs, options, estimator, left_out, _settling(epochs, estimator)), noise)


def updates_of(
    epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]],
    estimator: type[Any] = SppKf,
) -> list[Update]:  # fmt: skip
    """Run the filter over epochs with given exclusions, without monitors."""
    return list(_stream(epochs, options, left_out, estimator))


def _stream(
    epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]], estimator: type[Any]
) -> Iterator[Update]:
    solver, state = estimator(options), State.empty()
    for i, epoch in enumerate(epochs):
        exclude = left_out[i] if i < len(left_out) else frozenset()
        update = solver.correct(solver.predict(state, epoch), epoch, exclude)
        state = update.posterior
        yield update


@dataclass(frozen=True, eq=False)
class _Part:
    """Epochs that a model is fitted to, who is left out, and after how many of them the filter has
    settled.
    """

    epochs: Sequence[Epoch]
    options: GnssOptions
    estimator: type[Any]
    left_out: Sequence[frozenset[str]]
    settle: int

    @staticmethod
    def of(
        epochs: Sequence[Epoch], options: GnssOptions, estimator: type[Any], monitors: Sequence[Monitor]
    ) -> _Part:
        """Leave out what a run of the model it starts from leaves out: gross errors must not become noise.

        Where the model is of a better receiver than this may be, its white noise is taken larger for that.
        """
        white = {
            p.name: GATE * getattr(options.noise, p.name)
            for p in estimator.fitted
            if p.rows and p.kind == "white"
        }
        gate = replace(options, noise=replace(options.noise, **white))
        tests = [m for m in monitors if m.name == "rctm"]
        pipeline = Pipeline(estimator(gate), tests, Policy(p_fa=1e-6, **estimator.policy))
        left_out = [frozenset(pipeline.push(e).update.excluded) for e in epochs]
        return _Part(epochs, options, estimator, left_out, _settling(epochs, estimator))

    def stream(self, noise: NoiseModel) -> Iterator[Update]:
        """Yield the updates of a model."""
        return _stream(self.epochs, replace(self.options, noise=noise), self.left_out, self.estimator)

    def updates(self, noise: NoiseModel) -> list[Update]:
        """Return the updates of a model."""
        return list(self.stream(noise))

    def cost(self, noise: NoiseModel) -> float:
        """Return ``-2 log L`` of a model's innovations after the filter has settled."""
        try:
            after, clip = islice(self.stream(noise), self.settle, None), self.estimator.clip_sigma
            total = sum(_minus_twice_log(u, clip) for u in after)
        except np.linalg.LinAlgError:
            return np.inf
        return total if np.isfinite(total) else np.inf


def _minus_twice_log(update: Update, clip_sigma: float) -> float:
    """Return ``-2 log L`` of an epoch; beyond the limit whitened innovations count linearly (Huber's
    cost).
    """
    size = np.abs(update.white)
    inside = np.minimum(size, clip_sigma)
    beyond = 0.0 if np.isinf(clip_sigma) else 2.0 * clip_sigma * float((size - inside).sum())
    return float(inside @ inside) + beyond + 2.0 * float(np.log(np.diagonal(update.L)).sum())


def _settling(epochs: Sequence[Epoch], estimator: type[Any]) -> int:
    """Return after how many epochs innovations count."""
    end_ns = epochs[0].t_ns + round(float(estimator.settle_s) * 1e9)
    before = sum(1 for e in epochs if e.t_ns < end_ns)
    return min(max(before, SETTLE), len(epochs) // 3)


def _white(part: _Part, noise: NoiseModel) -> NoiseModel:
    white = [p for p in part.estimator.fitted if p.kind == "white"]
    changed: dict[str, Any] = {p.name: 0.0 for p in part.estimator.fitted if p.kind == "slow"}
    changed |= {p.name: getattr(WHITE, p.name) for p in white}
    model = replace(noise, name="white", satellites=(), factors=(), **changed)
    best = part.cost(model)
    for step in STEPS:
        for parameter in white:
            model, best = _line(part, model, best, parameter, step)
    return model


def _fit(part: _Part, progress: Callable[[str, float], None]) -> NoiseModel:
    """Minimise the cost one parameter after the other, with ever finer steps."""
    parameters: tuple[Fitted, ...] = part.estimator.fitted
    bounded = any(p.rows for p in parameters)
    start: dict[str, Any] = {p.name: p.start for p in parameters if p.start is not None}
    noise = replace(part.options.noise, name="calibrated", factors=(), satellites=(), **start)
    best = part.cost(noise)
    for sweep, step in enumerate(STEPS):
        if sweep == SATELLITES_AT and not bounded:
            noise = replace(noise, satellites=_satellites(_series(part, noise)))
            best = part.cost(noise)
        for i, p in enumerate(parameters):
            done = (sweep + i / len(parameters)) / len(STEPS)
            progress(f"{p.name} (sweep {sweep + 1} of {len(STEPS)})", done)
            noise, best = _line(part, noise, best, p, step)
    return _bounding(part, noise) if bounded else noise


def _line(
    part: _Part, noise: NoiseModel, best: float, parameter: Fitted, step: float
) -> tuple[NoiseModel, float]:
    """Walk one parameter up while that helps; where it does not help at all, down."""
    for factor in (step, 1.0 / step):
        start = noise
        for _ in range(STRIDES):
            trial = _scaled(noise, parameter, factor)
            cost = np.inf if trial == noise else part.cost(trial)
            if cost >= best - 1.0:
                break
            noise, best = trial, cost
        if noise != start:
            break
    return noise, best


def _scaled(noise: NoiseModel, p: Fitted, factor: float) -> NoiseModel:
    """Return the model with a parameter scaled within its range; with a correlation time, its size at equal
    drive.
    """
    value = float(np.clip(getattr(noise, p.name) * factor, p.low, p.high))
    changed: dict[str, Any] = {p.name: value}
    if p.size:
        changed[p.size] = float(getattr(noise, p.size) * np.sqrt(value / getattr(noise, p.name)))
    return replace(noise, **changed)


def _series(part: _Part, noise: NoiseModel) -> dict[str, FloatArray]:
    """Return the unit innovations of each row after the filter has settled."""
    series: dict[str, list[float]] = {}
    for u in islice(part.stream(noise), part.settle, None):
        for key, value in zip(u.keys, judged(u), strict=True):
            if np.isfinite(value):
                series.setdefault(key, []).append(float(value))
    return {key: np.array(x) for key, x in series.items()}


def _satellites(series: dict[str, FloatArray]) -> tuple[tuple[str, float, float], ...]:
    """Return how much larger each satellite's errors are than the fit says: of code, and of range rate or
    carrier.

    Means of white unit innovations over ``L`` epochs have variance ``1 / L``; the largest ratio to that over
    several `L` also counts errors that are small but last.
    """
    found: dict[str, dict[bool, float]] = {}
    for key, x in series.items():
        if len(x) >= ENOUGH:
            of, second = found.setdefault(key[:3], {}), is_rate(key) or is_carrier(key)
            of[second] = max(of.get(second, 0.0), _excess(x))
    return tuple((sat, of.get(False, 1.0), of.get(True, 1.0)) for sat, of in found.items())


def _excess(x: FloatArray) -> float:
    ratios = [np.sqrt(np.mean(_means(x, n) ** 2)) for n in SPANS if len(x) >= MEANS * n]
    return float(np.clip(max(ratios), 0.7, 6.0))


def _means(x: FloatArray, n: int) -> FloatArray:
    """Return the means of each `n` values, scaled so that those of unit white noise are such again."""
    return np.asarray(np.sqrt(n) * x[: len(x) // n * n].reshape(-1, n).mean(axis=1))


def _bounding(part: _Part, noise: NoiseModel) -> NoiseModel:
    """Return the model with all sizes of code and of carrier errors raised until they bound the tails.

    Where an arc lasts for hours, the satellites of the next hours are others, or elsewhere in the sky:
    factors of single satellites would not hold for them.
    """
    series = _series(part, noise)
    carrier = _bound([x for key, x in series.items() if is_carrier(key)])
    code = _bound([x for key, x in series.items() if not is_carrier(key) and not is_rate(key)])
    factor = {"carrier": carrier, "code": code}
    changed: dict[str, Any] = {
        p.name: min(getattr(noise, p.name) * factor[p.rows], p.high) for p in part.estimator.fitted if p.rows
    }
    return replace(noise, **changed)


def _bound(series: Sequence[FloatArray]) -> float:
    """Return the least factor of a unit normal that bounds what is beyond one sigma, singly and in means.

    The outermost values, where a normal sample of that size is beyond 3 sigma, are left to the threshold
    factors: a single one would decide.
    """
    worst = 1.0
    for n in SPANS:
        pooled = np.concatenate([_means(x, n) for x in series if len(x) >= MEANS * n] or [np.zeros(0)])
        found = np.sort(np.abs(pooled))[::-1]
        normal = ndtri(1.0 - (np.arange(len(found)) + 0.5) / (2.0 * max(len(found), 1)))
        inner = (normal > 1.0) & (normal < 3.0)
        worst = max(worst, float((found / normal)[inner].max(initial=1.0)))
    return worst


def _thresholds(
    updates: Sequence[Update], settle: int, cut: int,
    monitors: Callable[[float, NoiseModel], Sequence[Monitor]], noise: NoiseModel, p_fa: float,
) -> tuple[tuple[tuple[str, float], ...], dict[str, dict[str, int]]]:  # fmt: skip
    """Return by how much thresholds must grow so that the training part stays below them by a tenth, and the
    alarms after it that are left at two probabilities.
    """
    factors: dict[str, float] = {}
    alarms: dict[str, dict[str, int]] = {}
    for p in (p_fa, 1e-3):
        for m in monitors(p, noise):
            ratio = _ratios(updates, m)
            factor = factors.setdefault(m.name, max(1.0, round(1.1 * float(ratio[settle:cut].max()), 3)))
            alarms.setdefault(m.name, {})[f"{p:g}"] = int((ratio[cut:] > factor).sum())
    return tuple(factors.items()), alarms


def _ratios(updates: Sequence[Update], monitor: Monitor) -> FloatArray:
    """Return statistic by threshold, zero where no test was possible."""
    memory, out = monitor.start(), np.zeros(len(updates))
    for k, update in enumerate(updates):
        verdict, memory = monitor.step(memory, update)
        if verdict.status != "unavailable":
            out[k] = verdict.statistic / verdict.threshold
    return out
