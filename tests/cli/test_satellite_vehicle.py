"""A vehicle whose source is a receiver's satellites: a RINEX log beside an IMU, in a TOML file."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gnss_logs import START
from pntegrity.physics.time import to_week_tow

HEAD = "gps_week,tow_s,gyr_x_rps,gyr_y_rps,gyr_z_rps,acc_x_mps2,acc_y_mps2,acc_z_mps2"


@pytest.fixture
def vehicle(files, tmp_path):
    """Write a vehicle at rest and its description; `changes` are fields of its source, as TOML."""
    week, tow = to_week_tow(START)
    rng = np.random.default_rng(5)
    lines = [HEAD]
    for k in range(1, 50 * 70):
        gyro, force = 1e-4 * rng.normal(size=3), np.array([0.0, 0.0, -9.81]) + 2e-3 * rng.normal(size=3)
        lines.append(f"{week},{tow - 5.0 + k / 50:.4f}," + ",".join(f"{v:.6f}" for v in [*gyro, *force]))
    (tmp_path / "imu.csv").write_text("\n".join(lines) + "\n")

    def write(**changes: str):
        source = {"type": '"gnss"', "obs": f'"{files.obs}"', "nav": f'["{files.nav}"]'} | changes
        lines = [f"{k} = {v}" for k, v in source.items() if v]
        head = f'estimator = "multi_source"\nimu = "{tmp_path / "imu.csv"}"\nimu_spec = "low-cost"\n'
        path = tmp_path / "vehicle.toml"
        path.write_text(head + "heading_deg = 20.0\n[[source]]\n" + "\n".join(lines) + "\n")
        return path

    return write


def test_satellites_run_as_a_source_and_the_false_one_is_left_out(vehicle, pnt, tmp_path):
    table = vehicle(sigma_m="0.5", slow_sigma_m="0.5")
    first = pnt("run", "--config", table, "--monitors", "sensor_window", "--out", tmp_path / "out")
    assert first.code == 0, first
    assert "gnss.G07" in (tmp_path / "out" / "exclusions.csv").read_text()
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert pnt("run", "--config", tmp_path / "out" / "config.toml", "--out", tmp_path / "again").code == 0
    assert json.loads((tmp_path / "again" / "summary.json").read_text()) == told


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"obs": ""}, ("source gnss", "obs")),
        ({"nav": ""}, ("source gnss", "nav")),
        ({"obs": '"nowhere.rnx"'}, ("source gnss", "nowhere.rnx")),
        ({"systems": '"XY"'}, ("source gnss", "XY")),
        ({"sigma_m": "0.0"}, ("source gnss", "sigma_m")),
        ({"mask_deg": "100"}, ("source gnss", "mask_deg")),
        ({"colour": "3"}, ("source gnss", "colour", "sigma_mps")),
        ({"name": '"rover"', "lever_arm_m": "[1.0]"}, ("source rover", "lever_arm_m")),
    ],
)
def test_a_source_that_is_not_right_is_refused(vehicle, pnt, tmp_path, changes, words):
    refused = pnt("run", "--config", vehicle(**changes), "--out", tmp_path / "out")
    assert refused.code == 2, refused
    assert all(word in refused.err for word in words), refused.err
