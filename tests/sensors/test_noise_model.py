"""How large errors are said to be, and which models are refused."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from pntegrity.sensors.noise import WHITE, NoiseModel

UP = np.array([np.pi / 2])


def test_noise_grows_towards_the_horizon_and_with_a_weak_signal():
    noise = NoiseModel()
    el = np.deg2rad([90.0, 30.0, 10.0, 3.0, 1.0])
    strong = np.full(5, 45.0)
    scale = noise.scale(el, strong)
    assert scale[0] == pytest.approx(1.0)
    assert scale[1] == pytest.approx(2.0)
    assert np.all(np.diff(scale[:4]) > 0.0)
    assert scale[4] == scale[3]  # bounded at the horizon
    weak = noise.scale(UP, np.array([noise.cn0_ref_dbhz - 20.0]))
    assert weak[0] == pytest.approx(10.0)
    assert noise.scale(UP, np.array([np.nan]))[0] == pytest.approx(1.0)  # C/N0 unknown


def test_slow_errors_grow_with_the_atmosphere_up_to_three():
    slow = NoiseModel().obliquity(np.deg2rad([90.0, 30.0, 15.0, 5.0, -2.0]))
    np.testing.assert_allclose(slow, [1.0, 2.0, 3.0, 3.0, 3.0])


def test_families_and_calibrated_satellites_have_their_factors():
    noise = NoiseModel(satellites=(("G05", 3.0, 0.5),), glonass_factor=2.0, bds2_factor=4.0)
    keys = ("G05:C1C", "G06:C1C", "R01:C1C", "C06:C2I", "C19:C2I", "E01:C1C")
    np.testing.assert_allclose(noise.code_factor(keys), [3.0, 1.0, 2.0, 4.0, 1.0, 1.0])
    np.testing.assert_allclose(noise.rate_factor(keys), [0.5, 1.0, 1.0, 1.0, 1.0, 1.0])


def test_carriers_of_glonass_and_of_calibrated_satellites_are_noisier():
    noise = NoiseModel(satellites=(("G05", 3.0, 0.5), ("R02", 1.0, 2.0)), glonass_carrier_factor=1.5)
    np.testing.assert_allclose(
        noise.carrier_factor(("G05:L1C", "G06:L1C", "R01:L1C", "R02:L1C")), [0.5, 1.0, 1.5, 3.0]
    )


def test_the_snapshot_takes_everything_together():
    noise = NoiseModel(code_white_m=0.3, code_multipath_m=0.4, code_bias_m=1.2)
    assert noise.snapshot_sigma_m(np.ones(1), np.ones(1))[0] == pytest.approx(1.3)
    assert noise.snapshot_sigma_m(np.array([2.0]), np.array([1.0]))[0] == pytest.approx(np.hypot(1.0, 1.2))


def test_threshold_factors_are_one_where_nothing_was_calibrated():
    assert NoiseModel(factors=(("glr", 1.4),)).factor("glr") == 1.4
    assert NoiseModel().factor("glr") == 1.0


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(NoiseModel) if f.type == "float"])
@pytest.mark.parametrize("value", [-1, -0.5, float("nan"), float("inf"), "big", None])
def test_an_impossible_number_is_refused_by_its_name(field, value):
    with pytest.raises(ValueError, match=f"`{field}` must be"):
        NoiseModel(**{field: value})


@pytest.mark.parametrize("field", ["code_white_m", "doppler_mps", "code_multipath_tau_s", "code_bias_tau_s"])
def test_what_is_divided_by_must_not_be_zero(field):
    with pytest.raises(ValueError, match=field):
        NoiseModel(**{field: 0.0})


def test_smoothing_as_long_as_the_multipath_is_refused():
    with pytest.raises(ValueError, match="code_smoothing_tau_s"):
        NoiseModel(code_multipath_tau_s=6.0, code_smoothing_tau_s=6.0)


def test_a_model_is_a_frozen_value():
    assert pickle.loads(pickle.dumps(WHITE)) == WHITE
    assert hash(NoiseModel()) == hash(NoiseModel())
    with pytest.raises(dataclasses.FrozenInstanceError):
        WHITE.code_white_m = 2.0
