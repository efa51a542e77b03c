"""The runs behind the reproduction of SRAIME's SPP experiment: a model, its monitors, alarms."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.quadratic_tail import quadratic_tail, quadratic_threshold
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.kernels.windows import Form
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import FloatArray, Update
from pntegrity.simulate.linear import (
    Disturbance,
    LinearModel,
    draw,
    filter_drift_fault,
    gains,
    receiver_drift_fault,
    shifts,
    spp_model,
)

C_MPNS = 0.299792458
#: Epochs before this belong to the start of the filter and are not tested, s.
SETTLED_S = 100

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Experiment:
    """The experiment as data; see ``sraime_spp.toml``."""

    facts: dict[str, dict[str, Any]]

    @staticmethod
    def load() -> Experiment:
        """Return the experiment that ships with the package."""
        text = files("pntegrity.scenarios").joinpath("sraime_spp.toml").read_text(encoding="utf-8")
        return Experiment(tomllib.loads(text))

    def __getitem__(self, name: str) -> Any:
        return next(table[name] for table in self.facts.values() if name in table)

    def model(self, accel_mps2: float, clock_drift_mps: float) -> LinearModel:
        """Return the filter with a process noise."""
        e, a = self.facts["experiment"], self.facts["assumed"]
        return spp_model(
            e["satellites"],
            code_m=e["code_m"],
            rate_mps=e["rate_mps"],
            accel_mps2=accel_mps2,
            clock_m=a["clock_m"],
            clock_drift_mps=clock_drift_mps,
            rng=np.random.default_rng(a["geometry_seed"]),
        )

    @property
    def drift_mps(self) -> FloatArray:
        """The fault's course, m/s, one value an epoch."""
        e = self.facts["experiment"]
        k = np.arange(e["epochs"], dtype=np.float64)
        return np.where(
            (k >= e["onset_s"]) & (k <= e["end_s"]), e["slope_nsps2"] * C_MPNS * (k - e["onset_s"]), 0.0
        )

    def monitors(self, variant: Any) -> dict[str, Rctm | Srctm | Aime | Sraime]:
        """Return the paper's four monitors in a variant."""
        p, m = self["p_fa"], self["window"]
        return {
            "RCTM": Rctm(p, variant),
            "SRCTM": Srctm(p, variant),
            "AIME": Aime(p, variant, window=m),
            "SRAIME": Sraime(p, variant, window=m),
        }


@dataclass(frozen=True, eq=False)
class Case:
    """The experiment under one process noise: the gains, and what each reading of the fault does."""

    experiment: Experiment
    updates: tuple[Update, ...]
    disturbances: dict[str, Disturbance]

    @staticmethod
    def of(experiment: Experiment, accel_mps2: float, clock_drift_mps: float) -> Case:
        """Return the case of a process noise."""
        model = experiment.model(accel_mps2, clock_drift_mps)
        drift = experiment.drift_mps
        faults = {"receiver": receiver_drift_fault(model, drift), "filter": filter_drift_fault(model, drift)}
        return Case(experiment, gains(model, len(drift)), faults)

    @cached_property
    def means(self) -> dict[str, FloatArray]:
        """Mean of the whitened innovations by reading, shapes (epochs, m)."""
        out = {}
        for reading, disturbance in self.disturbances.items():
            g, _ = shifts(self.updates, disturbance)
            out[reading] = np.stack([np.linalg.solve(u.L, s) for u, s in zip(self.updates, g, strict=True)])
        return out

    def forms(self, monitor: Any) -> list[Form]:
        """Return the monitor's linear form at every epoch from `SETTLED_S` on."""
        length = getattr(monitor, "window", 1)
        return [
            monitor.form(self.updates[k + 1 - length : k + 1]) for k in range(SETTLED_S, len(self.updates))
        ]

    def bound_s(self, reading: str) -> int | None:
        """Return when the best test of that P_FA sees the fault with probability 0.5, None: never.

        Known onset and signature: the matched filter (Neyman-Pearson). Its distance is the root of the summed
        squares of the whitened means, its power 0.5 where that reaches the one-sided normal quantile of the
        P_FA.
        """
        from scipy.special import ndtri

        distance = np.sqrt(np.cumsum((self.means[reading] ** 2).sum(axis=1)))
        seen = np.flatnonzero(distance >= -ndtri(self.experiment["p_fa"]))
        return int(seen[0]) if len(seen) else None

    def glr_alarms(self, reading: str, noise: FloatArray) -> BoolArray:
        """Return the alarms of the GLR bank, shape (epochs, runs)."""
        monitor = Glr(self.experiment["p_fa"])
        out = np.zeros((len(self.updates), noise.shape[2]), dtype=bool)
        for run in range(noise.shape[2]):
            memory = monitor.start()
            for k, u in enumerate(draw(self.updates, noise[:, :, run] + self.means[reading])):
                verdict, memory = monitor.step(memory, u)
                out[k, run] = verdict.status == "alert"
        return out


def nominal_threshold(form: Form, p_fa: float) -> float:
    """Return the threshold that the monitor uses: chi-square."""
    return chi2_threshold(p_fa, form.dof)


def honest_threshold(form: Form, p_fa: float) -> float:
    """Return the threshold at which the form's real false-alarm rate is `p_fa`, from its distribution."""
    return quadratic_threshold(p_fa, weights(form))


def weights(form: Form) -> FloatArray:
    """Return the weights of the form as a sum of squared unit normals."""
    values = np.linalg.eigvalsh(form.covariance())
    return np.asarray(values[values > 1e-12 * values[-1]])


def real_p_fa(form: Form, p_fa: float) -> float:
    """Return the form's exact false-alarm rate at the nominal threshold."""
    return quadratic_tail(nominal_threshold(form, p_fa), weights(form))


def alarms(forms: Sequence[Form], white: FloatArray, thresholds: Sequence[float]) -> BoolArray:
    """Return alarms, shape (epochs, runs); False before `SETTLED_S`."""
    out = np.zeros((white.shape[0], white.shape[2]), dtype=bool)
    for k, (form, threshold) in enumerate(zip(forms, thresholds, strict=True), SETTLED_S):
        out[k] = form.statistic(list(white[k + 1 - len(form.maps) : k + 1])) > threshold
    return out


@dataclass(frozen=True)
class Interval:
    """First and last alarm from the onset on, over many runs.

    Parameters
    ----------
    first_s, last_s : int or None
        Medians over the runs that alarmed; None where fewer than half did.
    share : float
        Share of runs that alarmed.
    spread_s : pair of pairs of int
        5 % and 95 % quantiles of the first and of the last alarm.
    """

    first_s: int | None
    last_s: int | None
    share: float
    spread_s: tuple[tuple[int, int], tuple[int, int]] = ((0, 0), (0, 0))

    @staticmethod
    def of(alarm: BoolArray, onset_s: int) -> Interval:
        """Summarise alarms (epochs, runs)."""
        after = alarm[onset_s:]
        hit = after.any(axis=0)
        share = float(hit.mean())
        if share < 0.5:
            return Interval(None, None, share)
        times = onset_s + after[:, hit].argmax(axis=0), len(alarm) - 1 - after[::-1][:, hit].argmax(axis=0)
        low, middle, high = ([round(float(np.quantile(t, q))) for t in times] for q in (0.05, 0.5, 0.95))
        return Interval(middle[0], middle[1], share, ((low[0], high[0]), (low[1], high[1])))

    @property
    def as_list(self) -> list[int]:
        """First and last alarm, empty where there is none."""
        return [] if self.first_s is None or self.last_s is None else [self.first_s, self.last_s]

    def reproduces(self, published: list[int], tolerance_s: float) -> bool:
        """Tell whether both medians are near the published times (or there is neither)."""
        measured = self.as_list
        near = (abs(p - m) <= tolerance_s for p, m in zip(published, measured, strict=False))
        return len(published) == len(measured) and all(near)

    def words(self) -> str:
        """Return share and spread in words."""
        text = f"{100.0 * self.share:.0f} % of the runs alarm"
        if self.first_s is None:
            return text
        (a, b), (c, d) = self.spread_s
        return f"{text}, 90 % of them first at {a}-{b}, last at {c}-{d}"


def monte_carlo(
    form: Form, threshold: float, tests: int, rng: np.random.Generator, chunk: int = 20_000
) -> int:
    """Return how many of `tests` fault-free windows exceed the threshold."""
    joined = np.hstack([form.metric @ M for M in form.maps])
    count = 0
    for start in range(0, tests, chunk):
        y = joined @ rng.standard_normal((joined.shape[1], min(chunk, tests - start)))
        count += int(np.count_nonzero(np.einsum("ij,ij->j", y, y) > threshold))
    return count
