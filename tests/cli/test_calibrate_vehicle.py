"""The sigmas of a vehicle's sources are fitted by a command, and its file is what a run takes."""

from __future__ import annotations

import tomllib
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest

from gnss_logs import PLACE, START
from pntegrity.cli._shared import build_config
from pntegrity.cli.calibrate import command
from pntegrity.config import load_toml, make_config
from pntegrity.errors import InputError
from pntegrity.kernels.axes import local_axes
from pntegrity.physics.time import to_week_tow

HEAD = "gps_week,tow_s,gyr_x_rps,gyr_y_rps,gyr_z_rps,acc_x_mps2,acc_y_mps2,acc_z_mps2"
SECONDS, STATED_M = 210, 0.2
#: Errors of the two receivers, east, north and up, m; both state 0.2 m.
TRUE_M = {"bow": (0.2, 0.2, 0.6), "stern": (0.5, 0.5, 0.5)}


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    """A vehicle at rest: its IMU, two receivers that state less than their errors, and its description."""
    folder = tmp_path_factory.mktemp("vehicle")
    week, tow = to_week_tow(START)
    rng = np.random.default_rng(8)
    lines = [HEAD]
    for k in range(1, 20 * (SECONDS + 5)):
        gyro, force = 1e-4 * rng.normal(size=3), np.array([0.0, 0.0, -9.81]) + 2e-3 * rng.normal(size=3)
        lines.append(f"{week},{tow - 2.0 + k / 20:.4f}," + ",".join(f"{v:.6f}" for v in [*gyro, *force]))
    (folder / "imu.csv").write_text("\n".join(lines) + "\n")
    text = f'estimator = "multi_source"\nimu = "{folder / "imu.csv"}"\n'
    text += 'heading_deg = 20.0\nimu_spec = "low-cost"\n'
    for name, sigma in TRUE_M.items():
        rows = ["gps_week,tow_s,x_m,y_m,z_m,pos_std_e_m,pos_std_n_m,pos_std_u_m"]
        for k in range(SECONDS):
            x = PLACE + local_axes(PLACE).T @ (np.array(sigma) * rng.normal(size=3))
            rows.append(f"{week},{tow + k:.1f}," + ",".join(f"{v:.4f}" for v in x) + f",{STATED_M}" * 3)
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
        text += f'[[source]]\ntype = "fix"\nname = "{name}"\nfile = "{folder / name}.csv"\n'
    (folder / "vehicle.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def fitted(vehicle):
    """The command's output, and the file that it left."""
    path, out = vehicle / "noise.toml", StringIO()
    with redirect_stdout(out):
        argv = ["--config", str(vehicle / "vehicle.toml"), "--out", str(path)]
        assert command.main(argv, standalone_mode=False) == 0
    return out.getvalue(), path


def test_sigmas_are_fitted_told_and_written(fitted):
    told, path = fitted
    assert "fitted on 105 epochs, judged on the next 105" in told
    assert "bow velocity_factor stays" in told
    noise = tomllib.loads(path.read_text())["noise"]["sources"]
    for name, (east, _, up) in TRUE_M.items():
        assert noise[name]["horizontal_factor"] == pytest.approx(east / STATED_M, rel=0.2)
        assert noise[name]["vertical_factor"] == pytest.approx(up / STATED_M, rel=0.2)
        assert set(noise[name]) == {"horizontal_factor", "vertical_factor"}
    facts = tomllib.loads(path.read_text())["calibration"]
    assert facts["sigma"]["stern.horizontal_factor"]["given"] == 1.0
    assert set(facts["sigma"]["bow.velocity_factor"]) == {"given", "likely", "lasting", "fitted", "reason"}
    assert "nan" not in path.read_text()
    assert facts["validation_fitted"]["alarms"]["source_separation"] == 0


def test_a_run_takes_the_file(vehicle, fitted, pnt):
    out = vehicle / "out"
    called = pnt(
        "run", "--config", vehicle / "vehicle.toml", "--noise", fitted[1], "--monitors", "sensor_window",
        "--end", "30", "--out", out,
    )  # fmt: skip
    assert called.code == 0, called
    told = load_toml(out / "config.toml")
    stern = next(s for s in told["source"] if s["name"] == "stern")
    assert stern["horizontal_factor"] == pytest.approx(2.5, rel=0.2)
    # AND what it was made of makes the same run
    config = make_config(told)
    values = {
        "config": vehicle / "vehicle.toml",
        "noise": fitted[1],
        "monitors": "sensor_window",
        "end": "30",
    }
    assert config.source == build_config(values).source


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[noise.sources.keel]\nsigma_m = 1.0\n", r"'keel', which is no source; there are bow, stern"),
        ("[noise.sources.bow]\nloudness = 1.0\n", r"bow.*no `loudness`.*horizontal_factor"),
        ("[noise.sources.bow]\nhorizontal_factor = -1.0\n", r"bow.*`horizontal_factor` must be above 0"),
        ("[noise.sources]\nbow = 2.0\n", r"must hold a table for each source, not 2\.0"),
        ("[noise]\nsources = 3\n", r"must hold a table for each source, not 3"),
    ],
)
def test_a_file_that_does_not_suit_the_vehicle_is_refused(vehicle, tmp_path, text, words):
    path = tmp_path / "noise.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        build_config({"config": vehicle / "vehicle.toml", "noise": path})


def test_sigmas_of_sources_go_with_sources_only(files, tmp_path, pnt):
    path = tmp_path / "noise.toml"
    path.write_text("[noise.sources.bow]\nsigma_m = 1.0\n")
    out = ("--noise", path, "--out", tmp_path / "out")
    assert pnt("run", "--obs", files.obs, "--nav", files.nav, *out).refused("bow", "no [[source]] tables")


def test_an_inertial_filter_of_satellites_is_refused_with_what_to_do(vehicle, files, tmp_path, pnt):
    data = ("--obs", files.obs, "--nav", files.nav, "--imu", vehicle / "imu.csv")
    called = pnt("calibrate", "--estimator", "gnss_ins", *data, "--out", tmp_path / "noise.toml")
    assert called.refused("gnss_ins", "nothing to fit", "[[source]]", "multi_source")


def test_a_log_that_is_too_short_is_refused(vehicle, tmp_path, pnt):
    short = ("--config", vehicle / "vehicle.toml", "--end", "100", "--out", tmp_path / "noise.toml")
    assert pnt("calibrate", *short).refused("100 epochs", "50 and 51")
    assert not (tmp_path / "noise.toml").exists()
