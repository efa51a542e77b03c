"""Fit a noise model to a receiver: innovation maximum likelihood on one part of a log, judged on another.

The likelihood (`likelihood`) is maximised over the logarithms of the parameters that the estimator names
(``fitted``), one at a time in turn. What a log cannot show stays where it is. A threshold factor then covers
what is left in the tails.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.likelihood import STEPS, Part, Values, cut_of, settling, stream, walked
from pntegrity.evaluate.overbound import bound, excess, series_of
from pntegrity.evaluate.whiteness import whiteness
from pntegrity.exclusion import Policy
from pntegrity.kernels.signatures import is_carrier, is_rate
from pntegrity.pipeline import Pipeline
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, FloatArray, Update
from pntegrity.sensors.noise import WHITE, Fitted, NoiseModel

__all__ = ["Calibration", "calibrate", "updates_of", "white_model"]

#: Before this sweep satellites get their own factors.
SATELLITES_AT = 2
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
    cut = cut_of(len(epochs), split)
    left_out = _left_out(epochs[:cut], options, estimator, monitors(p_fa, options.noise))
    part = _part(epochs[:cut], options, estimator, left_out)
    noise = _fit(part, options.noise, estimator.fitted, progress)
    gain = 0.5 * (part.cost(options.noise) - part.cost(noise)) / cut
    progress("validation", 1.0)
    models = {
        "white": _white(part, noise, estimator.fitted),
        "default": estimator.default_noise,
        "calibrated": noise,
    }
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
    return _white(_part(epochs, options, estimator, left_out), noise, estimator.fitted)


def updates_of(
    epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]],
    estimator: type[Any] = SppKf,
) -> list[Update]:  # fmt: skip
    """Run the filter over epochs with given exclusions, without monitors."""
    return list(stream(estimator(options), epochs, left_out))


def _part(
    epochs: Sequence[Epoch], options: GnssOptions, estimator: type[Any], left_out: Sequence[frozenset[str]]
) -> Part[NoiseModel]:
    settle = settling(epochs, float(estimator.settle_s))

    def made(noise: NoiseModel) -> Any:
        return estimator(replace(options, noise=noise))

    return Part(epochs, made, left_out, settle, estimator.clip_sigma)


def _left_out(
    epochs: Sequence[Epoch], options: GnssOptions, estimator: type[Any], monitors: Sequence[Monitor]
) -> list[frozenset[str]]:
    """Return who a run of the model it starts from leaves out: gross errors must not become noise.

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
    return [frozenset(pipeline.push(e).update.excluded) for e in epochs]


def _white(part: Part[NoiseModel], noise: NoiseModel, parameters: Sequence[Fitted]) -> NoiseModel:
    white = [p for p in parameters if p.kind == "white"]
    changed: dict[str, Any] = {p.name: 0.0 for p in parameters if p.kind == "slow"}
    changed |= {p.name: getattr(WHITE, p.name) for p in white}
    model = replace(noise, name="white", satellites=(), factors=(), **changed)
    best = part.cost(model)
    for step in STEPS:
        for parameter in white:
            model, best = _line(part, model, best, parameter, step)
    return model


def _fit(
    part: Part[NoiseModel], start: NoiseModel, parameters: Sequence[Fitted],
    progress: Callable[[str, float], None],
) -> NoiseModel:  # fmt: skip
    """Minimise the cost one parameter after the other, with ever finer steps."""
    bounded = any(p.rows for p in parameters)
    given: dict[str, Any] = {p.name: p.start for p in parameters if p.start is not None}
    noise = replace(start, name="calibrated", factors=(), satellites=(), **given)
    best = part.cost(noise)
    for sweep, step in enumerate(STEPS):
        if sweep == SATELLITES_AT and not bounded:
            noise = replace(noise, satellites=_satellites(series_of(part.settled(noise))))
            best = part.cost(noise)
        for i, p in enumerate(parameters):
            done = (sweep + i / len(parameters)) / len(STEPS)
            progress(f"{p.name} (sweep {sweep + 1} of {len(STEPS)})", done)
            noise, best = _line(part, noise, best, p, step)
    return _bounding(part, noise, parameters) if bounded else noise


def _line(
    part: Part[NoiseModel], noise: NoiseModel, best: float, p: Fitted, step: float
) -> tuple[NoiseModel, float]:
    """Walk one parameter of a model."""
    start = {name: getattr(noise, name) for name in (p.name, p.size) if name}
    values, best = walked(start, best, lambda v: part.cost(_with(noise, v)), p, step)
    return _with(noise, values), best


def _with(noise: NoiseModel, values: Values) -> NoiseModel:
    changed: dict[str, Any] = dict(values)
    return replace(noise, **changed)


def _satellites(series: dict[str, FloatArray]) -> tuple[tuple[str, float, float], ...]:
    """Return how much larger each satellite's errors are than the fit says: of code, and of range rate or
    carrier.
    """
    found: dict[str, dict[bool, float]] = {}
    for key, x in series.items():
        if len(x) >= ENOUGH:
            of, second = found.setdefault(key[:3], {}), is_rate(key) or is_carrier(key)
            of[second] = max(of.get(second, 0.0), excess(x))
    return tuple((sat, of.get(False, 1.0), of.get(True, 1.0)) for sat, of in found.items())


def _bounding(part: Part[NoiseModel], noise: NoiseModel, parameters: Sequence[Fitted]) -> NoiseModel:
    """Return the model with all sizes of code and of carrier errors raised until they bound the tails.

    Where an arc lasts for hours, the satellites of the next hours are others, or elsewhere in the sky:
    factors of single satellites would not hold for them.
    """
    series = series_of(part.settled(noise))
    carrier = bound([x for key, x in series.items() if is_carrier(key)])
    code = bound([x for key, x in series.items() if not is_carrier(key) and not is_rate(key)])
    factor = {"carrier": carrier, "code": code}
    changed: dict[str, Any] = {
        p.name: min(getattr(noise, p.name) * factor[p.rows], p.high) for p in parameters if p.rows
    }
    return replace(noise, **changed)


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
