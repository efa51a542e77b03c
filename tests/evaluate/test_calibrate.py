"""A noise model is fitted for whatever an estimator says is to be fitted."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from io import StringIO
from typing import ClassVar

import numpy as np
import pytest
from rich.console import Console

from pntegrity.errors import InputError
from pntegrity.estimators import discover
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.evaluate.calibrate import Calibration, calibrate, updates_of, white_model
from pntegrity.evaluate.calibration_table import calibration_table
from pntegrity.monitors.rctm import Rctm
from pntegrity.records import Epoch, Layout, Observation, Prior, State, Update
from pntegrity.sensors.noise import Fitted, NoiseModel

SATELLITES = ("G01", "G02", "G03", "G04", "G05")
KEYS = tuple(f"{s}:C1C" for s in SATELLITES) + tuple(f"{s}:L1C" for s in SATELLITES)
LAYOUT = Layout(("pos:0", *(f"amb:{k}:1" for k in KEYS[5:])))
H = np.hstack([np.ones((10, 1)), np.vstack([np.zeros((5, 5)), np.eye(5)])])
CODE_M, CARRIER_M = 0.5, 0.01


@dataclass(frozen=True)
class Level:
    """One level that walks, measured by the code and carrier of five satellites, whose ambiguities are
    known.
    """

    default_noise: ClassVar[NoiseModel] = NoiseModel()
    settle_s: ClassVar[float] = 40.0
    clip_sigma: ClassVar[float] = np.inf
    policy: ClassVar[dict[str, float]] = {}
    fitted: ClassVar[tuple[Fitted, ...]] = (
        Fitted("code_white_m", 0.01, 30.0, 0.2, "white"),
        Fitted("carrier_m", 1e-3, 1.0, 0.03, "white"),
        Fitted("clock_m", 1e-4, 10.0, 0.3, "slow"),
    )
    options: GnssOptions

    def predict(self, state: State, epoch: Epoch) -> Prior:
        F, Q = np.zeros((6, len(state))), np.zeros((6, 6))
        if not len(state):
            Q[0, 0] = 100.0
            return Prior(State(epoch.t_ns, np.zeros(6), Q, LAYOUT), F, Q)
        Q[0, 0] = self.options.noise.clock_m**2
        return Prior(State(epoch.t_ns, state.mean, state.P + Q, LAYOUT), np.eye(6), Q)

    def relax(self, prior: Prior) -> Prior:
        return prior

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        noise, (rows,) = self.options.noise, epoch.observations
        sigma = np.concatenate([
            noise.code_white_m * noise.code_factor(KEYS[:5]), noise.carrier_m * noise.rate_factor(KEYS[5:])
        ])  # fmt: skip
        return Update.of(prior, KEYS, rows.y - H @ prior.state.mean, H, np.diag(sigma**2))


class Bounded(Level):
    """The same, with sizes that are raised to bound the tails."""

    fitted = (
        replace(Level.fitted[0], rows="code"), replace(Level.fitted[1], rows="carrier"), Level.fitted[2],
    )  # fmt: skip


def epochs_of(error: np.ndarray, walk: float = 0.1) -> list[Epoch]:
    level = np.cumsum(np.random.default_rng(5).normal(0.0, walk, len(error)))
    y = level[:, None] + error * np.repeat([CODE_M, CARRIER_M], 5)
    return [Epoch(k * 10**9, (Observation("code", k * 10**9, KEYS, v),)) for k, v in enumerate(y)]


def unit(n: int = 500) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(n, 10))


def fit(error: np.ndarray, estimator: type = Level) -> Calibration:
    def monitors(p_fa: float, noise: NoiseModel) -> list[Rctm]:
        return [Rctm(p_fa, factor=noise.factor("rctm"))]

    return calibrate(epochs_of(error), GnssOptions(), monitors, estimator=estimator)


@pytest.fixture(scope="module")
def plain() -> Calibration:
    return fit(unit())


def test_what_is_in_the_data_is_found(plain):
    assert plain.noise.code_white_m == pytest.approx(CODE_M, rel=0.1)
    assert plain.noise.carrier_m == pytest.approx(CARRIER_M, rel=0.1)
    assert plain.noise.clock_m == pytest.approx(0.1, rel=0.1)
    assert plain.gain > 1.0
    assert plain.alarms["rctm"]["1e-06"] == 0


def test_what_the_estimator_does_not_name_stays(plain):
    named = {p.name for p in Level.fitted} | {"name", "satellites", "factors"}
    for f in fields(NoiseModel):
        if f.name not in named:
            assert getattr(plain.noise, f.name) == getattr(NoiseModel(), f.name), f.name


def test_innovations_are_judged_kind_by_kind(plain):
    out = StringIO()
    Console(file=out, width=120).print(calibration_table(plain))
    text = out.getvalue()
    assert "lag 30 s" in text
    for model in ("white", "default", "calibrated"):
        for kind in ("code", "carrier"):
            assert re.search(rf"^{kind} +{model} ", text, re.MULTILINE)
    assert not re.search(r"^rate +", text, re.MULTILINE)
    assert plain.whiteness["calibrated"]["code"]["mean_square"] == pytest.approx(1.0, abs=0.15)


def test_a_worse_satellite_has_its_own_factors_of_code_and_of_carrier():
    error = unit()
    error[:, 1] *= 3.0  # code of G02
    error[:, 8] *= 2.5  # carrier of G04
    own = {sat: (code, second) for sat, code, second in fit(error).noise.satellites}
    assert own["G02"][0] > 2.0 * own["G01"][0]
    assert own["G04"][1] > 1.7 * own["G01"][1]
    assert own["G02"][1] < 1.5
    assert own["G04"][0] < 1.5


def test_sizes_are_raised_to_bound_the_tails_of_all_satellites():
    error = unit()
    quiet = fit(error, Bounded)
    assert quiet.noise.code_white_m == pytest.approx(CODE_M, rel=0.3)
    error[60::25, 1] = 8.0  # code of G02, now and then
    wild = fit(error, Bounded)
    assert wild.noise.satellites == ()
    assert wild.noise.code_white_m > 1.6 * quiet.noise.code_white_m
    assert wild.noise.carrier_m < 1.3 * quiet.noise.carrier_m
    assert wild.alarms["rctm"]["1e-06"] == 0


def test_a_white_model_has_no_errors_that_last():
    options, epochs = GnssOptions(), epochs_of(unit(200), walk=0.0)
    model = white_model(epochs, options, NoiseModel(clock_m=0.5), estimator=Level)
    assert model.clock_m == 0.0
    assert model.code_white_m == pytest.approx(CODE_M, rel=0.15)
    assert all(u.Q[0, 0] == 0.0 for u in updates_of(epochs, replace(options, noise=model), (), Level)[1:])


def test_too_short_a_log_is_refused():
    with pytest.raises(InputError, match="100 epochs"):
        fit(unit(199))


@pytest.mark.parametrize("name", sorted(discover()))
def test_every_estimator_says_what_can_be_fitted(name):
    estimator = discover()[name]
    sizes = {f.name for f in fields(NoiseModel) if f.type == "float"}
    for p in estimator.fitted:
        assert {p.name, p.size or p.name} <= sizes
        start = getattr(estimator.default_noise, p.name) if p.start is None else p.start
        assert 0.0 < p.low <= start <= p.high
    # one that has nothing is refused by the command
    assert not estimator.fitted or [p.name for p in estimator.fitted if p.kind == "white"]
    assert estimator.fitted or name in ("gnss_ins", "multi_source")
