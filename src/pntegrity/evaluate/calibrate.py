"""Fit a noise model to a receiver: innovation maximum likelihood on one part of a log, judged on another.

The likelihood of a Kalman filter is that of its innovations, ``-2 log L = sum log det S_k + nu_k^T S_k^-1
nu_k``. It is maximised over the logarithms of the noise model's parameters, one at a time in turn. What a log
cannot show stays at its default (the correlation time of the satellite biases). A threshold factor then
covers what is left in the tails.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.whiteness import whiteness
from pntegrity.exclusion import Policy
from pntegrity.kernels.signatures import is_rate
from pntegrity.pipeline import Pipeline
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, FloatArray, State, Update
from pntegrity.sensors.noise import WHITE, NoiseModel

#: Fitted parameters with the range they may take.
RANGES: dict[str, tuple[float, float]] = {
    "doppler_mps": (1e-3, 5.0),
    "code_multipath_m": (0.01, 30.0),
    "code_white_m": (0.005, 30.0),
    "code_multipath_tau_s": (1.5, 300.0),
    "code_smoothing_tau_s": (0.1, 1.0),
    "accel_mps2": (1e-3, 10.0),
    "clock_drift_mps": (1e-4, 10.0),
    "clock_m": (1e-4, 10.0),
    "code_bias_m": (0.3, 20.0),
    "glonass_factor": (1.0, 6.0),
    "bds2_factor": (1.0, 6.0),
}
#: Where the fit starts: a geodetic receiver. A far start ends in a random walk of the biases that explains
#: everything.
TYPICAL = {
    "code_white_m": 0.02, "code_multipath_m": 0.08, "code_multipath_tau_s": 4.0, "code_smoothing_tau_s": 0.4,
    "code_bias_m": 1.0, "doppler_mps": 0.01,
}  # fmt: skip
#: Factors by which a parameter is tried, sweep after sweep.
STEPS = (2.5, 1.6, 1.25, 1.12)
#: Before this sweep satellites get their own factors.
SATELLITES_AT = 2
#: How far up or down one sweep walks a parameter.
STRIDES = 4
SETTLE = 30
#: Lengths of the means over which a satellite's innovations are compared with white ones, epochs.
SPANS = (1, 5, 10, 20)


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
    whiteness: dict[str, dict[str, object]]
    alarms: dict[str, dict[str, int]]


def calibrate(
    epochs: Sequence[Epoch],
    options: GnssOptions,
    monitors: Callable[[float, NoiseModel], Sequence[Monitor]],
    *,
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
    split : float
        Share of the epochs that is fitted.
    p_fa : float
        Probability the threshold factors are made for.
    progress : callable
        Told what is being done and how far it is, 0 to 1.

    Raises
    ------
    ValueError
        Where either part has fewer than 100 epochs.
    """
    cut = int(len(epochs) * split)
    if cut < 100 or len(epochs) - cut < 100:
        raise InputError(
            f"a calibration needs 100 epochs on either side of the split; {cut} and {len(epochs) - cut} given"
        )
    left_out = _outliers(epochs[:cut], options, monitors(p_fa, options.noise))
    start = _cost(epochs[:cut], options, left_out)
    noise, cost = _fit(epochs[:cut], options, left_out, progress)
    fitted = replace(options, noise=noise)
    noise = replace(
        noise, factors=_factors(updates_of(epochs[:cut], fitted, left_out), monitors(p_fa, noise))
    )
    progress("validation", 1.0)
    rest = epochs[cut:]
    white = white_model(epochs[:cut], options, noise, left_out)
    models = {"white": white, "default": NoiseModel(), "calibrated": noise}
    runs = {name: updates_of(rest, replace(options, noise=m), ()) for name, m in models.items()}
    alarms: dict[str, dict[str, int]] = {}
    for p in (p_fa, 1e-3):
        for m in monitors(p, noise):
            alarms.setdefault(m.name, {})[f"{p:g}"] = _alarms(runs["calibrated"], m)
    whitened = {name: whiteness(run[SETTLE:]) for name, run in runs.items()}
    return Calibration(noise, cut, len(rest), 0.5 * (start - cost) / cut, whitened, alarms)


def white_model(
    epochs: Sequence[Epoch], options: GnssOptions, noise: NoiseModel, left_out: Sequence[frozenset[str]] = ()
) -> NoiseModel:
    """Return the best model without correlated errors: motion and clock of `noise`, white code noise fitted
    to the epochs.

    Parameters
    ----------
    epochs : sequence of Epoch
    options : GnssOptions
    noise : NoiseModel
        A fitted model.
    left_out : sequence of frozenset of str
        Groups left out of each epoch.
    """
    model = replace(
        noise,
        name="white",
        code_white_m=WHITE.code_white_m,
        code_multipath_m=0.0,
        code_bias_m=0.0,
        satellites=(),
        factors=(),
    )
    best = _cost(epochs, replace(options, noise=model), left_out)
    for step in STEPS:
        model, best = _line(epochs, options, left_out, model, best, "code_white_m", step)
    return model


def updates_of(
    epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]]
) -> list[Update]:
    """Run the filter over epochs with given exclusions, without monitors."""
    estimator, state, out = SppKf(options), State.empty(), []
    for i, epoch in enumerate(epochs):
        exclude = left_out[i] if i < len(left_out) else frozenset()
        update = estimator.correct(estimator.predict(state, epoch), epoch, exclude)
        state = update.posterior
        out.append(update)
    return out


def _outliers(
    epochs: Sequence[Epoch], options: GnssOptions, monitors: Sequence[Monitor]
) -> list[frozenset[str]]:
    """Return who the default run leaves out: gross errors must not become noise."""
    pipeline = Pipeline(SppKf(options), [m for m in monitors if m.name == "rctm"], Policy(p_fa=1e-6))
    return [frozenset(pipeline.push(e).update.excluded) for e in epochs]


def _cost(epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]]) -> float:
    """Return ``-2 log L`` of the innovations after the filter has settled."""
    try:
        run = updates_of(epochs, options, left_out)[SETTLE:]
    except np.linalg.LinAlgError:
        return np.inf
    return float(sum(u.white @ u.white + 2.0 * np.log(np.diagonal(u.L)).sum() for u in run))


def _fit(
    epochs: Sequence[Epoch],
    options: GnssOptions,
    left_out: Sequence[frozenset[str]],
    progress: Callable[[str, float], None],
) -> tuple[NoiseModel, float]:
    """Minimise the cost one parameter after the other, with ever finer steps."""
    noise = replace(options.noise, name="calibrated", factors=(), satellites=(), **TYPICAL)
    best = _cost(epochs, replace(options, noise=noise), left_out)
    for sweep, step in enumerate(STEPS):
        if sweep == SATELLITES_AT:
            noise = replace(
                noise, satellites=_satellites(updates_of(epochs, replace(options, noise=noise), left_out))
            )
            best = _cost(epochs, replace(options, noise=noise), left_out)
        for i, name in enumerate(RANGES):
            progress(f"{name} (sweep {sweep + 1} of {len(STEPS)})", (sweep + i / len(RANGES)) / len(STEPS))
            noise, best = _line(epochs, options, left_out, noise, best, name, step)
    return noise, best


def _line(
    epochs: Sequence[Epoch], options: GnssOptions, left_out: Sequence[frozenset[str]], noise: NoiseModel,
    best: float,
    name: str, step: float,
) -> tuple[NoiseModel, float]:  # fmt: skip
    """Walk one parameter up while that helps; where it does not help at all, down."""
    for factor in (step, 1.0 / step):
        start = noise
        for _ in range(STRIDES):
            trial = _scaled(noise, name, factor)
            cost = np.inf if trial == noise else _cost(epochs, replace(options, noise=trial), left_out)
            if cost >= best - 1.0:
                break
            noise, best = trial, cost
        if noise != start:
            break
    return noise, best


def _scaled(noise: NoiseModel, name: str, factor: float) -> NoiseModel:
    """Return the model with a parameter scaled within its range; with a correlation time, its size at equal
    drive.
    """
    value = float(np.clip(getattr(noise, name) * factor, *RANGES[name]))
    if name != "code_multipath_tau_s":
        changed: dict[str, Any] = {name: value}
        return replace(noise, **changed)
    size = noise.code_multipath_m * np.sqrt(value / noise.code_multipath_tau_s)
    return replace(noise, code_multipath_tau_s=value, code_multipath_m=float(size))


def _satellites(updates: Sequence[Update]) -> tuple[tuple[str, float, float], ...]:
    """Return how much larger each satellite's errors are than the fit says, code and range rate.

    Means of white unit innovations over ``L`` epochs have variance ``1 / L``; the largest ratio to that over
    several `L` also counts errors that are small but last.
    """
    series: dict[str, list[float]] = {}
    for u in updates[SETTLE:]:
        for key, value in zip(u.keys, u.nu / np.sqrt(np.diagonal(u.S)), strict=True):
            series.setdefault(key, []).append(float(value))
    excess = {key: _excess(np.array(x)) for key, x in series.items() if len(x) >= 100}
    sats = dict.fromkeys(key[:3] for key in excess)
    return tuple(
        (
            sat,
            max((v for k, v in excess.items() if k.startswith(sat) and not is_rate(k)), default=1.0),
            max((v for k, v in excess.items() if k.startswith(sat) and is_rate(k)), default=1.0),
        )
        for sat in sats
    )


def _excess(x: FloatArray) -> float:
    ratios = [np.sqrt(n * np.mean(x[: len(x) // n * n].reshape(-1, n).mean(axis=1) ** 2)) for n in SPANS]
    return float(np.clip(max(ratios), 0.7, 6.0))


def _factors(updates: Sequence[Update], monitors: Sequence[Monitor]) -> tuple[tuple[str, float], ...]:
    """Return by how much thresholds must grow so that the training part stays below them by a tenth."""
    out = []
    for m in monitors:
        worst, memory = 0.0, m.start()
        for k, update in enumerate(updates):
            verdict, memory = m.step(memory, update)
            if k >= SETTLE and verdict.status != "unavailable":
                worst = max(worst, verdict.statistic / verdict.threshold)
        out.append((m.name, max(1.0, round(1.1 * worst, 3))))
    return tuple(out)


def _alarms(updates: Sequence[Update], monitor: Monitor) -> int:
    memory, count = monitor.start(), 0
    for k, update in enumerate(updates):
        verdict, memory = monitor.step(memory, update)
        count += k >= SETTLE and verdict.status == "alert"
    return count
