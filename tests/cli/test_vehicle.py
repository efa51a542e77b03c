"""A vehicle as a TOML file: an IMU and sources of any type."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gnss_logs import PLACE, START
from pntegrity.config import load_toml, make_config
from pntegrity.errors import InputError
from pntegrity.physics.time import to_week_tow
from pntegrity.run import load_epochs

HEAD = "gps_week,tow_s,gyr_x_rps,gyr_y_rps,gyr_z_rps,acc_x_mps2,acc_y_mps2,acc_z_mps2"


@pytest.fixture
def vehicle(tmp_path):
    """Write a vehicle at rest: its IMU, two receivers' fixes a second, and its description."""
    week, tow = to_week_tow(START)
    rng = np.random.default_rng(5)
    lines = [HEAD]
    for k in range(1, 50 * 60):
        gyro, force = 1e-4 * rng.normal(size=3), np.array([0.0, 0.0, -9.81]) + 2e-3 * rng.normal(size=3)
        lines.append(f"{week},{tow - 2.0 + k / 50:.4f}," + ",".join(f"{v:.6f}" for v in [*gyro, *force]))
    (tmp_path / "imu.csv").write_text("\n".join(lines) + "\n")
    for name in ("bow", "stern"):
        rows = ["gps_week,tow_s,x_m,y_m,z_m,pos_std_e_m,pos_std_n_m,pos_std_u_m"]
        for k in range(45):
            x = PLACE + 0.3 * rng.normal(size=3) + (20.0 if name == "stern" and 20 <= k < 25 else 0.0)
            rows.append(f"{week},{tow + k:.1f}," + ",".join(f"{v:.3f}" for v in x) + ",0.3,0.3,0.3")
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n")

    def write(text: str | None = None, **changes: str):
        sources = "".join(
            f'[[source]]\ntype = "fix"\nname = "{n}"\nfile = "{tmp_path / n}.csv"\n' for n in ("bow", "stern")
        )
        head = {"estimator": '"multi_source"', "imu": f'"{tmp_path / "imu.csv"}"', "heading_deg": "20.0"}
        lines = [f"{k} = {v}" for k, v in (head | {"imu_spec": '"low-cost"'} | changes).items() if v]
        path = tmp_path / "vehicle.toml"
        path.write_text("\n".join(lines) + "\n" + (sources if text is None else text))
        return path

    return write


def test_a_vehicle_runs_and_runs_again_from_its_own_configuration(vehicle, pnt, tmp_path):
    first = pnt("run", "--config", vehicle(), "--monitors", "rctm", "--out", tmp_path / "out")
    assert first.code == 0, first
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    exclusions = (tmp_path / "out" / "exclusions.csv").read_text()
    assert "stern" in exclusions
    assert "bow" not in exclusions
    assert pnt("run", "--config", tmp_path / "out" / "config.toml", "--out", tmp_path / "again").code == 0
    assert json.loads((tmp_path / "again" / "summary.json").read_text()) == told


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("[[source]]",)),
        ('[[source]]\ntype = "sonar"\n', ("sonar", "fix", "lbl")),
        ('[[source]]\ntype = "fix"\ncolour = 3\n', ("fix", "colour")),
        ('[[source]]\ntype = "fix"\nname = "a b"\n', ("a b",)),
        ('[[source]]\ntype = "fix"\n[[source]]\ntype = "fix"\n', ("two sources", "fix")),
        ('[[source]]\ntype = "lbl"\n', ("lbl", "beacons")),
        ('[[source]]\ntype = "lbl"\n[source.beacons.AP1]\ndelay_s = 0.1\n', ("AP1",)),
        ('[[source]]\ntype = "fix"\nlever_arm_m = [1.0, 2.0]\n', ("lever_arm_m",)),
        ('[[source]]\ntype = "fix"\n', ("no `file`",)),
        ('[[source]]\ntype = "fix"\nfile = "nowhere.csv"\n', ("nowhere.csv",)),
    ],
)
def test_a_source_that_cannot_be_is_refused(vehicle, pnt, tmp_path, text, words):
    assert pnt("run", "--config", vehicle(text), "--out", tmp_path / "out").refused(*words)


def test_what_does_not_go_together_is_refused(vehicle, pnt, tmp_path):
    out = ("--out", tmp_path / "out")
    assert pnt("run", "--config", vehicle(imu=""), *out).refused("inertial")
    assert pnt("run", "--config", vehicle(estimator='"gnss_ins"'), *out).refused("source", "multi_source")
    assert pnt("run", "--config", vehicle(), "--fixes", tmp_path / "bow.csv", *out).refused("fixes")


def test_a_run_ends_at_its_end_where_the_unit_goes_on(vehicle):
    loaded = load_epochs(make_config(load_toml(vehicle()) | {"start": "10", "end": "20"}))
    assert [round((e.t_ns - START) * 1e-9) for e in loaded.epochs] == list(range(10, 21))


def test_priors_of_sources_are_those_of_their_tables_and_the_message_wins(vehicle, tmp_path):
    text = "".join(
        f'[[source]]\ntype = "fix"\nname = "{n}"\nfile = "{tmp_path / n}.csv"\nprior = {p}\n'
        for n, p in (("bow", 1e-4), ("stern", 1e-3))
    )
    values = load_toml(vehicle(text + "[ism]\nsources = {stern = 2e-3}\n"))
    ism = make_config(values).ism_model()
    assert (ism.source("bow"), ism.source("stern"), ism.source("keel")) == (1e-4, 2e-3, 1e-5)
    bad = load_toml(vehicle(text.replace("0.0001", "1.5")))
    with pytest.raises(InputError, match=r"bow.*1\.5"):
        make_config(bad)
