"""Specifications of inertial measurement units: names, files in the units of data sheets, what is refused."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.sensors.imu import LOW_COST, STIM300
from pntegrity.sensors.imu_spec import imu_spec_toml, read_imu_spec

LEAST = """
gyro_random_walk_deg_sqrt_h = 0.15
gyro_bias_instability_deg_h = 0.5
accel_random_walk_mps_sqrt_h = 0.06
accel_bias_instability_mg = 0.05
"""


@pytest.fixture
def spec(tmp_path):
    def read(text, name="mine.toml"):
        path = tmp_path / name
        path.write_text(text)
        return read_imu_spec(path)

    return read


def test_names_stand_for_specifications():
    assert read_imu_spec("stim300") is STIM300
    assert read_imu_spec("STIM300") is STIM300
    assert read_imu_spec("low-cost") is LOW_COST


@pytest.mark.parametrize("known", [STIM300, LOW_COST])
def test_what_is_written_is_read_again(spec, known):
    again = spec(imu_spec_toml(known))
    assert again.name == known.name
    np.testing.assert_allclose(astuple(again)[:-1], astuple(known)[:-1], rtol=1e-13)


def test_units_of_data_sheets(spec):
    found = spec(LEAST)
    assert found.name == "mine"
    assert found.gyro_noise_radps_rthz == pytest.approx(
        np.radians(0.15) / 60.0
    )  # 1 deg/sqrt(h) = 1/60 deg/sqrt(s)
    assert found.gyro_bias_radps == pytest.approx(np.radians(0.5) / 3600.0)
    assert found.accel_noise_mps2_rthz == pytest.approx(0.06 / 60.0)
    assert found.accel_bias_mps2 == pytest.approx(0.05e-3 * 9.80665)
    other = spec(
        "gyro_noise_deg_s_sqrt_hz = 0.0038\naccel_noise_ug_sqrt_hz = 70\ngyro_bias_instability_deg_h = 10\n"
        "accel_bias_instability_ug = 50\ngyro_turn_on_bias_deg_s = 0.2\naccel_scale_factor_ppm = 1000"
    )
    assert other.gyro_noise_radps_rthz == pytest.approx(np.radians(0.0038))
    assert other.accel_noise_mps2_rthz == pytest.approx(70e-6 * 9.80665)
    assert other.gyro_turn_on_radps == pytest.approx(np.radians(0.2))
    assert other.accel_scale == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gyro = ", "is not TOML"),
        (LEAST + "gyro_drift = 1", "unknown key 'gyro_drift'; known are"),
        (LEAST + "gyro_noise_deg_s_sqrt_hz = 0.1", "a second time"),
        (LEAST.replace("accel_bias", "# accel_bias"), "`accel_bias_instability_mg` is missing"),
        (LEAST.replace("0.15", "-0.15"), "gyro_noise_radps_rthz.*at least 0"),
        (LEAST.replace("0.15", '"0.15 deg"'), "must be a number"),
        (LEAST.replace("0.15", "nan"), "at least 0"),
        (LEAST.replace("0.15", "0.0"), "must be above 0"),
    ],
)
def test_files_that_cannot_be_used(spec, text, words):
    with pytest.raises(InputError, match=words) as caught:
        spec(text)
    assert caught.value.path.name == "mine.toml"
    assert "imu.md" in caught.value.hint


def test_no_such_name_and_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"'adis'.*stim300, low-cost"):
        read_imu_spec("adis")
    with pytest.raises(InputError, match="no such file"):
        read_imu_spec(tmp_path / "none.toml")
