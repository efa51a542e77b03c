"""Are the sigmas of a vehicle's sources right? Fitted on the first part of its log, judged on the rest.

What a type of source names in ``fitted`` is fitted by the likelihood of the innovations (`likelihood`), with
the inertial unit in the filter, and raised where errors last: the filter has them white. The model of the
unit, and the states of sources, stay what they are. What the log cannot show stays what it was, and is named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, log, nan, sqrt
from typing import Any

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.evaluate.likelihood import Part, Values, cut_of, settling, walked
from pntegrity.evaluate.source_sigmas import (
    gives_position,
    parameters_of,
    raised,
    ratios,
    source_and_field,
    value_of,
    with_values,
)
from pntegrity.evaluate.whiteness import whiteness
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Pipeline, uncollected
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, Update, group_of
from pntegrity.sensors.noise import Fitted

__all__ = ["Judged", "Sigma", "SourceCalibration", "calibrate_sources"]

#: Factors by which a sigma is tried; between the stages the monitors look again for what is no noise.
STAGES = ((2.5, 1.6), (1.25,), (1.12, 1.05))
#: Whitened innovations beyond it count linearly: what no monitor has found must not decide.
CLIP_SIGMA = 4.0
#: Factor at which the likelihood of a sigma is asked how well the log shows it, and how unsure a fitted one
#: may be, relative.
ASIDE, UNSURE = 1.6, 0.3

#: What a position's innovations do not show.
SLOW = (
    "smaller than given, of errors from epoch to epoch: slow errors of a position move the filter with them "
    "and are not in it; keep the given one where levels rest on it"
)

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Sigma:
    """What was found of one sigma.

    Parameters
    ----------
    source, field : str
    given : float
    likely : float
        Of the largest likelihood; the given one where the log does not show it.
    error : float
        Its relative standard deviation, as far as errors are white; nan where the log does not show it.
    lasting : float
        By how much it is raised: means of errors over several epochs are larger than those of white ones.
    ratio_given, ratio_fitted : float
        On the validation part, without what the run with the fitted sigmas leaves out: how large errors are
        in units of this sigma. 1: it is right, nan: no rows.
    reason : str
        Why it stays as it was given.
    caution : str
        What to think of before it is used.
    """

    source: str
    field: str
    given: float
    likely: float
    error: float
    lasting: float
    ratio_given: float
    ratio_fitted: float
    reason: str = ""
    caution: str = ""

    @property
    def fitted(self) -> float:
        """What it should be."""
        return self.likely * self.lasting


@dataclass(frozen=True)
class Judged:
    """What a set of sigmas does on the validation part.

    Parameters
    ----------
    whiteness : dict
        Innovations by source: parts as `whiteness.whiteness` has them, each with its own ``lags_s``.
    alarms : dict of str to int
        Epochs in which each monitor alarms before anything is left out.
    left_out : dict of str to int
        Epochs that sources and sensors are left out of.
    """

    whiteness: dict[str, Any]
    alarms: dict[str, int]
    left_out: dict[str, int]


@dataclass(frozen=True)
class SourceCalibration:
    """What a calibration of a vehicle found.

    Parameters
    ----------
    sigmas : tuple of Sigma
    training, validation : int
        Epochs of the two parts.
    gain : float
        By how much the fit raised the log-likelihood of the training part, an epoch.
    left_out : dict of str to int
        Epochs of the training part that sources and sensors were left out of.
    given, fitted : Judged
    """

    sigmas: tuple[Sigma, ...]
    training: int
    validation: int
    gain: float
    left_out: dict[str, int]
    given: Judged
    fitted: Judged

    def tables(self) -> dict[str, dict[str, float]]:
        """Return the fitted fields by source, without those that stay."""
        out: dict[str, dict[str, float]] = {}
        for s in self.sigmas:
            if not s.reason:
                out.setdefault(s.source, {})[s.field] = float(f"{s.fitted:.4g}")
        return out


def calibrate_sources(
    epochs: Sequence[Epoch],
    options: GnssOptions,
    monitors: Sequence[Monitor],
    *,
    split: float = 0.5,
    p_fa: float = 1e-6,
    progress: Progress = lambda what, done: None,
) -> SourceCalibration:
    """Fit the sigmas of a vehicle's sources on the first part of a log and judge them on the rest.

    Parameters
    ----------
    epochs : sequence of Epoch
        With increments of the unit.
    options : GnssOptions
        Sources as they were given, and the unit.
    monitors : sequence of Monitor
    split : float
        Share of the epochs that is fitted.
    p_fa : float
        Of the exclusion policy.
    progress : callable
        Told what is being done and how far it is, 0 to 1.

    Raises
    ------
    InputError
        Where either part has fewer than 100 epochs, or no source has anything to fit.
    """
    cut = cut_of(len(epochs), split)
    parameters = parameters_of(options.sources)
    if not parameters:
        raise InputError("no source has a sigma that can be fitted", hint="See docs/noise.md")
    vessel = _Vessel(options, tuple(monitors), p_fa)
    given = {p.name: value_of(options.sources, p.name) for p in parameters}
    with uncollected():
        return _calibrated(vessel, epochs, cut, parameters, given, progress)


def _calibrated(
    vessel: _Vessel, epochs: Sequence[Epoch], cut: int, parameters: Sequence[Fitted], given: Values,
    progress: Progress,
) -> SourceCalibration:  # fmt: skip
    part = vessel.part(epochs[:cut])
    seen = ratios(part, given, parameters)
    values, part = _fit(vessel, part, [p for p in parameters if isfinite(seen[p.name])], given, progress)
    best = part.cost(values)
    errors = {p.name: _error(part, values, p, best) for p in parameters if isfinite(seen[p.name])}
    known = {n for n, e in errors.items() if e <= UNSURE}
    likely: Values = {n: values[n] if n in known else g for n, g in given.items()}
    if likely != values:  # the others must not make up for what was put back
        likely = _walked(part, [p for p in parameters if p.name in known], likely)
    grown = raised(part, likely, [p for p in parameters if p.name in known])
    fitted = {n: v * grown.get(n, 1.0) for n, v in likely.items()}
    progress("validation", 0.95)
    (told, _), (told_after, left_out) = (vessel.judge(epochs, cut, v) for v in (given, fitted))
    whole = vessel.part(epochs, left_out)
    before, after = (ratios(whole, v, parameters, cut) for v in (given, fitted))
    sigmas = tuple(
        Sigma(
            *source_and_field(n), given[n], likely[n], errors[n] if n in known else nan, grown.get(n, 1.0),
            before[n], after[n], "" if n in known else _reason(seen[n]),
            SLOW if fitted[n] < given[n] and gives_position(vessel.options.sources, n) else "",
        )
        for n in given
    )  # fmt: skip
    gain = 0.5 * (part.cost(given) - part.cost(likely)) / cut
    return SourceCalibration(
        sigmas, cut, len(epochs) - cut, gain, _counted(part.left_out), told, told_after
    )  # fmt: skip


def _reason(seen: float) -> str:
    """Return why a sigma stays as it was given."""
    if isfinite(seen):
        return "the likelihood hardly depends on it"
    return "no row depends on it: nothing of its kind was measured, or its file states sigmas"


@dataclass(frozen=True, eq=False)
class _Vessel:
    """A vehicle whose sigmas vary."""

    options: GnssOptions
    monitors: tuple[Monitor, ...]
    p_fa: float

    def made(self, values: Values) -> MultiSource:
        """Return the filter with some sigmas."""
        return MultiSource(replace(self.options, sources=with_values(self.options.sources, values)))

    def part(self, epochs: Sequence[Epoch], left_out: Sequence[frozenset[str]] = ()) -> Part[Values]:
        """Return epochs to fit to."""
        return Part(epochs, self.made, left_out, settling(epochs, MultiSource.settle_s), CLIP_SIGMA)

    def run(
        self, epochs: Sequence[Epoch], values: Values, monitors: Sequence[Monitor]
    ) -> tuple[list[frozenset[str]], list[frozenset[str]]]:
        """Return who is left out of each epoch in the end, past ones that were run again included, and which
        monitors alarm in it before anything is left out.
        """
        model = self.made(values)
        pipeline = Pipeline(model, monitors, Policy(**({"p_fa": self.p_fa} | dict(model.policy))))
        out: dict[int, frozenset[str]] = {}
        alarms = []
        for epoch in epochs:
            outcome = pipeline.push(epoch)
            out.update({u.t_ns: frozenset(u.excluded) for u in outcome.updates})
            alarms.append(frozenset(v.monitor for v in outcome.first if v.status == "alert"))
        return [out.get(e.t_ns, frozenset()) for e in epochs], alarms

    def gate(self, epochs: Sequence[Epoch], values: Values) -> list[frozenset[str]]:
        """Return who those monitors that identify sources leave out of each epoch."""
        naming = self.made(values).policy["identifying"]
        tests = [m for m in self.monitors if m.name in naming] or self.monitors
        return self.run(epochs, values, tests)[0]

    def judge(self, epochs: Sequence[Epoch], cut: int, values: Values) -> tuple[Judged, list[frozenset[str]]]:
        """Return what a run with some sigmas does after the cut, and who it leaves out of each epoch."""
        left_out, alarms = self.run(epochs, values, self.monitors)
        updates = self.part(epochs, left_out).updates(values)[cut:]
        told = {m.name: sum(m.name in names for names in alarms[cut:]) for m in self.monitors}
        return Judged(_by_source(updates), told, _counted(left_out[cut:])), left_out


def _fit(
    vessel: _Vessel, part: Part[Values], parameters: Sequence[Fitted], values: Values, progress: Progress
) -> tuple[Values, Part[Values]]:
    """Minimise the cost one sigma after the other; between the stages leave out what monitors find."""
    sweeps, done = sum(map(len, STAGES)), 0
    for i, steps in enumerate(STAGES):
        if i:
            progress("looking for what is no noise", 0.9 * done / sweeps)
            part = replace(part, left_out=vessel.gate(part.epochs, values))
        best = part.cost(values)
        for step in steps:
            for k, p in enumerate(parameters):
                share = (done + k / len(parameters)) / sweeps
                progress(f"{p.name} (sweep {done + 1} of {sweeps})", 0.9 * share)
                values, best = walked(values, best, part.cost, p, step)
            done += 1
    return values, part


def _walked(part: Part[Values], parameters: Sequence[Fitted], values: Values) -> Values:
    """Return values after the finer sweeps once more."""
    best = part.cost(values)
    for step in [step for steps in STAGES[1:] for step in steps]:
        for p in parameters:
            values, best = walked(values, best, part.cost, p, step)
    return values


def _error(part: Part[Values], values: Values, p: Fitted, best: float) -> float:
    """Return the relative standard deviation of a fitted sigma from the curvature of the likelihood; inf
    where it does not fall to both sides.
    """
    rises = [part.cost({**values, p.name: values[p.name] * f}) - best for f in (ASIDE, 1.0 / ASIDE)]
    if min(rises) <= (log(ASIDE) / UNSURE) ** 2:
        return inf
    return log(ASIDE) / sqrt(sum(rises) / 2.0)


def _by_source(updates: Sequence[Update]) -> dict[str, Any]:
    """Return how white the innovations of each source are, at lags that are multiples of its own interval."""
    out: dict[str, Any] = {}
    for name in dict.fromkeys(group_of(k) for u in updates for k in u.keys):
        found = whiteness([u for u in updates if name in map(group_of, u.keys)], part_of=group_of)
        out[name] = {"lags_s": found["lags_s"], **found[name]}
    return out


def _counted(left_out: Sequence[frozenset[str]]) -> dict[str, int]:
    """Return how many epochs each name is in."""
    return dict(Counter(name for names in left_out for name in sorted(names)))
