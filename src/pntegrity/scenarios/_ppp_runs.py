"""The runs behind the reproduction of SRAIME's PPP experiment: geometry, gains, alarms of many runs at
once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp import Ppp
from pntegrity.formats.sp3 import read_orbits
from pntegrity.formats.truth import read_truth
from pntegrity.kernels.linear import whiten
from pntegrity.kernels.windows import Form, respond
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.physics.orbits import satellite_states
from pntegrity.physics.precise import precise_states
from pntegrity.physics.time import from_iso
from pntegrity.records import Epoch, FloatArray, State, Update
from pntegrity.scenarios._spp_runs import BoolArray, honest_threshold, nominal_threshold, real_p_fa
from pntegrity.sensors.noise import PPP, NoiseModel
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.precise import PreciseReceiver, States, simulate_precise
from pntegrity.simulate.trajectory import car

__all__ = ["Case", "Drive", "Experiment", "monitors_of", "real_drive", "simulated_drive"]

VAN = "cpt-van-2019087"
START = "2019-03-28T03:17:33"
PLACE_M = (-2408694.474, 4698106.45, 3566698.365)


@dataclass(frozen=True)
class Experiment:
    """The experiment as data; see ``sraime_ppp.toml``."""

    facts: dict[str, Any]

    @staticmethod
    def load() -> Experiment:
        """Return the experiment that ships with the package."""
        text = files("pntegrity.scenarios").joinpath("sraime_ppp.toml").read_text(encoding="utf-8")
        return Experiment(tomllib.loads(text))

    def __getitem__(self, name: str) -> Any:
        return next(self.facts[t][name] for t in ("experiment", "span", "tolerance") if name in self.facts[t])

    def noise(self, noise: str, motion: str) -> tuple[NoiseModel, str]:
        """Return a noise model and a motion model."""
        how = dict(self.facts["motion"][motion])
        name = how.pop("motion")
        return replace(PPP, **(self.facts["noise"][noise] | how)), name


@dataclass(frozen=True, eq=False)
class Drive:
    """Where a receiver drives and under which satellites; `label` says how real that is."""

    label: str
    states: States
    sats: tuple[str, ...]
    t_ns: np.ndarray[Any, np.dtype[np.int64]]
    track_m: FloatArray

    def epochs(self, receiver: PreciseReceiver, rng: np.random.Generator, last: int) -> tuple[Epoch, ...]:
        """Return what the receiver observes up to an epoch."""
        return simulate_precise(self.states, self.sats, self.t_ns[:last], self.track_m[:last], receiver, rng)


def real_drive(data: Path, systems: str) -> Drive:
    """Return the van run of 2019-03-28: its true track, with that day's precise orbits and clocks."""
    orbits = read_orbits([data / VAN / "wum20464.sp3.gz"])
    truth = read_truth(data / VAN / "cpt_pva_ref.csv.gz")
    sats = tuple(s for s in orbits.sats if s[0] in systems)
    return Drive(
        "real van track, real orbits and clocks",
        lambda n, t, r: precise_states(orbits, orbits.clocks, n, t, r), sats, truth.t_ns, truth.position_m,
    )  # fmt: skip


def simulated_drive(seconds: int, systems: str) -> Drive:
    """Return a simulated drive of the same length at the same place and day, under nominal constellations."""
    t_ns = from_iso(START) + np.arange(seconds, dtype=np.int64) * 10**9
    nav = nominal_navigation(int(t_ns[0]), int(t_ns[-1]), systems)
    sats = tuple(sorted({r.satellite for r in (*nav.kepler, *nav.glonass)}))
    track = car(np.array(PLACE_M))
    place = np.array([track(float(k))[0] for k in range(seconds)])

    def states(names: Any, times: Any, range_m: FloatArray) -> Any:
        return satellite_states(nav, names, times, range_m, ["1C"] * len(names))

    return Drive("simulated drive, nominal constellations", states, sats, t_ns, place)


def monitors_of(e: Experiment) -> dict[str, Any]:
    """Return the monitors that are run, by the names of the tables."""
    p, m = e["p_fa"], e["window"]
    return {
        "RCTM": Rctm(p),
        "SRCTM": Srctm(p, "published"),
        "SRAIME (published), position": Sraime(p, "published", window=m),
        "SRAIME (published), ambiguities": Sraime(p, "published", window=m, block="amb"),
        "SRAIME (exact), position": Sraime(p, window=m),
        "SRAIME (exact), ambiguities": Sraime(p, window=m, block="amb"),
        "SRAIME (exact), both": Sraime(p, window=m, block="pos+amb"),
        "AIME (exact)": Aime(p, window=m),
    }


@dataclass(frozen=True, eq=False)
class Case:
    """The experiment under one noise and motion model: its gains, which do not depend on data."""

    experiment: Experiment
    updates: tuple[Update, ...]

    @staticmethod
    def of(experiment: Experiment, drive: Drive, noise: str, motion: str) -> Case:
        """Run the filter from the beginning to the last epoch looked at."""
        model, name = experiment.noise(noise, motion)
        options = GnssOptions(
            noise=model, mask_rad=float(np.deg2rad(experiment["mask_deg"])), motion=name,  # type: ignore[arg-type]
            max_gap_s=Ppp.max_gap_s,
        )  # fmt: skip
        estimator, state, kept = Ppp(options), State.empty(), []
        first = experiment["first_s"]
        receiver = PreciseReceiver(model, mask_rad=options.mask_rad)
        epochs = drive.epochs(receiver, np.random.default_rng(0), experiment["last_s"] + 1)
        for k, epoch in enumerate(epochs):
            update = estimator.correct(estimator.predict(state, epoch), epoch)
            state = _placed(update.posterior, drive.track_m[k])
            kept += [update] if k >= first else []
        return Case(experiment, tuple(kept))

    def at(self, time_s: int) -> int:
        """Return the index of the update of a time."""
        return time_s - int(self.experiment["first_s"])

    @cached_property
    def carriers(self) -> tuple[str, ...]:
        """Carrier rows that live through the whole time looked at."""
        seen = self.updates[self.at(self.experiment["quiet_s"]) :]
        return tuple(
            k for k in seen[0].keys if k.partition(":")[2][0] == "L" and all(k in u.keys for u in seen)
        )

    def means(self, key: str) -> list[FloatArray]:
        """Return the means of the whitened innovations under the fault on a row, shapes (m,)."""
        e = np.zeros((self.updates[0].F.shape[1], 1))
        out = []
        x = self.experiment
        for time_s, u in enumerate(self.updates, x["first_s"]):
            size = x["slope_m"] * (time_s - x["onset_s"]) if x["onset_s"] <= time_s <= x["end_s"] else 0.0
            g, e = respond(e, u.F, u.H, u.K, size * np.array([[k == key] for k in u.keys]))
            out.append(whiten(u.L, g)[:, 0])
        return out

    def noise(self, runs: int, rng: np.random.Generator) -> list[FloatArray]:
        """Return white innovations, shapes (m, runs)."""
        return [rng.standard_normal((len(u.keys), runs)) for u in self.updates]

    def alarms(self, monitor: Any, white: Sequence[FloatArray], *, honest: bool = False) -> BoolArray:
        """Return alarms (times from `quiet_s` on, runs); with `honest` thresholds, at the real P_FA."""
        p, length = self.experiment["p_fa"], getattr(monitor, "window", 1)
        first = self.at(self.experiment["quiet_s"])
        out = np.zeros((len(self.updates) - first, white[0].shape[1]), dtype=bool)
        raised = self._raised(monitor) if honest else 1.0
        for k in range(first, len(self.updates)):
            form = monitor.form(self.updates[k + 1 - length : k + 1])
            if form is not None:
                limit = raised * nominal_threshold(form, p)
                out[k - first] = form.statistic(white[k + 1 - length : k + 1]) > limit
        return out

    def _raised(self, monitor: Any) -> float:
        """Return by how much the threshold must rise for the real P_FA to be the nominal; gains have
        settled.
        """
        form, p = self._before_onset(monitor), self.experiment["p_fa"]
        return 1.0 if form is None else honest_threshold(form, p) / nominal_threshold(form, p)

    def _before_onset(self, monitor: Any) -> Form | None:
        end = self.at(self.experiment["onset_s"])
        found: Form | None = monitor.form(self.updates[end - getattr(monitor, "window", 1) : end])
        return found

    def real_p_fa(self, monitor: Any) -> float:
        """Return the monitor's exact false-alarm rate just before the fault; nan where it has no test."""
        form = self._before_onset(monitor)
        return float("nan") if form is None else real_p_fa(form, self.experiment["p_fa"])

    def glr_alarms(self, white: Sequence[FloatArray]) -> BoolArray:
        """Return the alarms of the GLR bank, shape as of `alarms`."""
        monitor, first = Glr(self.experiment["p_fa"]), self.at(self.experiment["quiet_s"])
        memory, num = monitor.start(), np.zeros((0, white[0].shape[1]))
        out = np.zeros((len(self.updates) - first, white[0].shape[1]), dtype=bool)
        begin = self.at(self.experiment["onset_s"]) - 150
        for k in range(begin, len(self.updates)):
            test, memory = monitor.plan(memory, self.updates[k])
            num = test.carry(num, white[k])
            if k >= first and not test.reason:
                out[k - first] = (num * num * test.inverse[:, None]).max(axis=0) > test.threshold
        return out

    def bound_s(self, key: str) -> int | None:
        """Return when the best test of that P_FA sees the fault with probability 0.5; None: never.

        As for the SPP experiment: the matched filter over the innovations, onset and signature known.
        """
        from scipy.special import ndtri

        distance = np.sqrt(np.cumsum([float(m @ m) for m in self.means(key)]))
        seen = np.flatnonzero(distance >= -ndtri(self.experiment["p_fa"]))
        return int(seen[0]) + int(self.experiment["first_s"]) if len(seen) else None


def _placed(state: State, place_m: FloatArray) -> State:
    """Return the state at the true place: gains do not depend on the data, where they are linearised
    matters.
    """
    if not len(state):
        return state
    mean = state.mean.copy()
    mean[:3] = place_m
    return State(state.t_ns, mean, state.P, state.layout)
