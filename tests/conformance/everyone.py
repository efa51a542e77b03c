"""Every monitor (and variant), every estimator: found by existing, run over eventful logs."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from gnss_logs import PLACE, SECOND, START, LinearFilter, log, navigation, only, options, with_imu, without
from pntegrity import estimators, monitors
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.protocols import Estimator, Monitor
from pntegrity.records import Epoch, Observation, Update
from pntegrity.sensors.fix import Fix
from pntegrity.simulate.linear import Disturbance, linear_epochs, spp_model

LINEAR = "linear"
SOURCES = (LINEAR, *sorted(estimators.discover()))
#: Everything of a run that decides what can be told apart: bad enough that satellites go and come back.
POLICY = Policy(p_fa=1e-5, proof_s=8.0, proof_epochs=8, restart_s=15.0, restart_epochs=15, history=25)


def variants(cls: type[Any]) -> tuple[str, ...]:
    """Return the variants that a monitor's class declares."""
    return get_args(get_type_hints(cls)["variant"])


MONITORS = [(name, v) for name, cls in sorted(monitors.discover().items()) for v in variants(cls)]
EXACT = [name for name, v in MONITORS if v == "exact"]


#: Windows that do for what all monitors must keep: identification takes time with the square of the window.
SHORT: dict[str, dict[str, int]] = {
    "source_separation": {"longest": 8, "together": 1}, "sensor_window": {"window": 8},
}  # fmt: skip


def build(name: str, variant: str = "exact", p_fa: float = 1e-5) -> Monitor:
    return monitors.discover()[name](p_fa=p_fa, variant=variant, **SHORT.get(name, {}))


@dataclass(frozen=True)
class Source:
    """An estimator and the log it runs on."""

    estimator: Estimator
    epochs: tuple[Epoch, ...]


@lru_cache(maxsize=8)
def source(name: str) -> Source:
    made = {LINEAR: linear_source, "multi_source": vessel_source}.get(name)
    return gnss_source(name) if made is None else made()


def gnss_source(name: str) -> Source:
    """GPS and Galileo: a jump, a ramp, two satellites at once, a fault of all, an outage, a gap, risings and
    settings.
    """
    epochs = log(
        95, "G07 bias 30 m 12:20", "E19 ramp 0.15 m/s 30:48", "G10 bias 50 m 52:58", "E16 bias -60 m 52:58",
        "G* bias 25 m 66:70",
    )  # fmt: skip
    shown = []
    for k, e in enumerate(epochs):
        e = without(e, ["G05"]) if k < 8 else e  # rises late
        e = without(e, ["E21"]) if k > 48 else e  # sets
        e = (
            without(e, [g for g in all_groups(e) if g[0] == "E"]) if k < 3 else e
        )  # a whole constellation comes
        e = only(e, ["G05", "G24", "E16"] if k < 76 else []) if 73 <= k < 77 else e
        if k not in (82, 83, 84):
            shown.append(e)
    cls = estimators.discover()[name]
    return Source(cls(options(navigation(), ins=InsOptions(heading_rad=0.3, fde="none"))), with_imu(shown))


def all_groups(epoch: Epoch) -> set[str]:
    return {k.partition(":")[0] for o in epoch.observations for k in o.keys}


def linear_source() -> Source:
    """The 8-state filter: a jump, a ramp, two satellites at once, an epoch without rows, two satellites that
    come late.
    """
    model = spp_model(9)
    rows = np.zeros((90, 18))
    rows[12:20, 2] = 40.0
    rows[30:50, 5] = 0.5 * np.arange(20)
    rows[60:66, [1, 6]] = 60.0, -80.0
    epochs, _ = linear_epochs(model, 90, np.random.default_rng(5), Disturbance(rows=rows))
    shown = [without(e, ["G08", "G09"]) if k < 9 else e for k, e in enumerate(epochs)]
    shown[75] = only(shown[75], [])
    shown[76] = only(shown[76], ["G01", "G02", "G03"])
    return Source(LinearFilter(model), tuple(shown))


def vessel_source() -> Source:
    """Four sources of fixes beside an IMU that stands: a jump, a ramp, two at once, silence, one that comes
    late.
    """
    rng = np.random.default_rng(8)
    names = ("alpha", "beta", "delta", "gamma")
    sigma = np.repeat([0.5, 0.05], 3)
    epochs = []
    for k in range(95):
        said = []
        for name in names:
            y = np.concatenate([PLACE, np.zeros(3)]) + sigma * rng.standard_normal(6)
            jump = {"alpha": 12 <= k < 20 or 52 <= k < 58, "gamma": 52 <= k < 58}.get(name, False)
            y[:3] += 20.0 * jump + (0.4 * (k - 30) if name == "beta" and 30 <= k < 48 else 0.0)
            keys = tuple(f"{name}:{s}" for s in ("RX", "RY", "RZ", "DX", "DY", "DZ"))
            given = slice(3 if name == "gamma" and k < 10 else 6)
            if not (73 <= k < 77 or (name == "delta" and k < 8)):
                cov = {"cov": np.diag(sigma**2)[given]}
                said.append(Observation(name, START + k * SECOND, keys[given], y[given], aux=cov))
        if k not in (82, 83, 84):
            epochs.append(Epoch(START + k * SECOND, tuple(said)))
    given = options(navigation(), ins=InsOptions(heading_rad=0.3), sources=tuple(Fix(n) for n in names))
    return Source(estimators.discover()["multi_source"](given), with_imu(epochs))


@lru_cache(maxsize=64)
def outcomes(name: str, variant: str, where: str) -> tuple[Outcome, ...]:
    """Return a run of one monitor over a source's log, in one go."""
    s = source(where)
    pipeline = Pipeline(s.estimator, [build(name, variant)], POLICY)
    return tuple(pipeline.push(e) for e in s.epochs)


@lru_cache(maxsize=8)
def updates(where: str) -> tuple[Update, ...]:
    """Return all updates of a run that RCTM watched, those that a repair replaced among them."""
    return tuple(u for o in outcomes("rctm", "exact", where) for u in o.updates)


def label(value: Any) -> str:
    return "-".join(value) if isinstance(value, tuple) else str(value)


every_monitor = pytest.mark.parametrize("which", MONITORS, ids=label)
every_source = pytest.mark.parametrize("where", SOURCES)


def option_names(cls: type[Any]) -> set[str]:
    return {f.name for f in fields(cls)}
