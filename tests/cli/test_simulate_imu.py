"""A real log as a vehicle: a unit simulated on its track, and what may be wrong with its sources."""

from __future__ import annotations

import numpy as np
import pytest

from acoustic_logs import MIDNIGHT_S, pose, write_log
from pntegrity.formats.imu_table import read_imu
from pntegrity.physics.time import utc_to_ns

START_NS = utc_to_ns(2024, 6, 1) + round(MIDNIGHT_S * 1e9)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("logs") / "boat")


@pytest.fixture(scope="module")
def imu(log, tmp_path_factory):
    """Simulate a unit once for all tests of this file."""
    from click.testing import CliRunner

    from pntegrity.cli import cli

    out = tmp_path_factory.mktemp("imu") / "imu.csv"
    args = ["simulate-imu", "--log", str(log), "--format", "garpos", "--rate-hz", "50", "--start", "10"]
    result = CliRunner().invoke(cli, [*args, "--end", "220", "--out", str(out)])
    assert result.exit_code == 0, result.output
    return out, result.output


def toml(log, imu, **changes):
    """Return the description of the boat; `changes` are lines of the source named, or of the head."""
    lines = {
        "head": f'estimator = "multi_source"\nimu = "{imu}"\nheading_deg = 72\nstart = "10"\nend = "220"\n',
        "gnss": f'[[source]]\ntype = "fix"\nname = "gnss"\nfile = "{log}"\nformat = "garpos"\n',
        "lbl": f'[[source]]\ntype = "lbl"\nfile = "{log}"\nformat = "garpos"\n',
    }
    return "".join(changes.get(k, text) for k, text in lines.items())


@pytest.fixture
def boat(log, imu, pnt, tmp_path):
    def run(*options, **changes):
        path = tmp_path / "boat.toml"
        path.write_text(toml(log, imu[0], **changes))
        return pnt("run", "--config", path, *options, "--out", tmp_path / "out")

    return run


def test_a_simulated_unit_is_read_again_and_feels_the_log_s_motion(imu):
    path, said = imu
    unit = read_imu(path)
    assert unit.reason == ""
    assert unit.t_ns[0] == START_NS + 9_020_000_000  # a second before the run, one step of 50 Hz
    assert unit.t_ns[-1] == START_NS + 220_000_000_000
    _, before = pose(10.0)
    _, after = pose(210.0)
    inside = (unit.t_ns > START_NS + 10_000_000_000) & (unit.t_ns <= START_NS + 210_000_000_000)
    turned = unit.angle_rad[inside, 2].sum()
    assert turned == pytest.approx((after - before)[2], abs=0.03)  # less the turn of the Earth: 0.008
    told = float(said.partition("heading_deg = ")[2].split()[0])
    assert told == pytest.approx(np.degrees(before[2]), abs=0.1)
    assert 'start = "10", end = "220"' in said


def test_the_same_seed_gives_the_same_bytes_also_packed(log, pnt, tmp_path):
    args = ("simulate-imu", "--log", log, "--format", "garpos", "--end", "30", "--rate-hz", "10")
    for name, seed in (("a.csv.gz", 1), ("b.csv.gz", 1), ("c.csv.gz", 2)):
        assert pnt(*args, "--seed", seed, "--out", tmp_path / name).code == 0
    a, b, c = ((tmp_path / f"{n}.csv.gz").read_bytes() for n in "abc")
    assert a == b
    assert a != c


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"--log": "nowhere"}, ("nowhere", "no such folder")),
        ({"--out": "imu.parquet"}, ("imu.parquet", ".csv")),
        ({"--start": "5000"}, ("no unit can be simulated", "--start")),
        ({"--imu-spec": "nowhere.toml"}, ("nowhere.toml",)),
    ],
)
def test_what_cannot_be_simulated_is_refused(log, pnt, tmp_path, changes, words):
    args = {"--log": log, "--format": "garpos", "--out": tmp_path / "imu.csv"} | changes
    assert pnt("simulate-imu", *(x for pair in args.items() for x in pair)).refused(*words)
    assert not (tmp_path / "imu.csv").exists()


def test_the_log_runs_as_a_vehicle_and_a_beacon_that_is_wrong_is_left_out(boat, tmp_path):
    assert boat().code == 0
    assert "lbl" not in (tmp_path / "out" / "exclusions.csv").read_text()
    assert boat("--fault", "lbl.M2 bias 5 ms 100:").code == 0
    told = (tmp_path / "out" / "exclusions.csv").read_text()
    assert "lbl.M2" in told
    assert "gnss" not in told


def test_a_fault_in_a_unit_that_nothing_has_is_refused_with_what_there_is(boat):
    assert boat("--fault", "lbl bias 5 m 100:").refused("no such row", "lbl.M2", "ms")


def lines_of(boat_out):
    return (boat_out / "out" / "summary.json").read_text()


def test_a_source_that_never_appears_late_or_ends_early_is_told(boat, log, tmp_path):
    late = tmp_path / "late"
    late.mkdir()
    for path in log.iterdir():
        text = path.read_text().splitlines()
        kept = [text[0], *text[60:80]] if path.name.endswith("obs.csv") else text
        (late / path.name).write_text("\n".join(kept) + "\n")
    source = f'[[source]]\ntype = "lbl"\nfile = "{late}"\nformat = "garpos"\n'
    assert boat(lbl=source).code == 0
    told = lines_of(tmp_path)
    assert "source lbl begins" in told
    assert "source lbl ends" in told
    assert boat("--end", "100", lbl=source).code == 0
    assert "source lbl says nothing in the time of the run" in lines_of(tmp_path)


def fixes(path, shift_s=0.0, stuck=False):
    """Write fixes of the boat as a table."""
    rows = ["t_ns,x_m,y_m,z_m,pos_std_e_m,pos_std_n_m,pos_std_u_m"]
    for k in range(10, 220):
        x, _ = pose(100.0 if stuck and k > 100 else float(k))
        t = START_NS + round((k + shift_s) * 1e9)
        rows.append(f"{t}," + ",".join(f"{v:.4f}" for v in x) + ",0.05,0.05,0.05")
    path.write_text("\n".join(rows) + "\n")
    return f'[[source]]\ntype = "fix"\nname = "gnss"\nfile = "{path}"\n'


def test_a_fix_that_repeats_its_last_value_is_told(boat, tmp_path):
    assert boat(gnss=fixes(tmp_path / "fixes.csv", stuck=True)).code == 0
    assert "gnss:RX repeats its last value" in lines_of(tmp_path)


def test_sources_without_a_time_in_common_are_told_with_both_spans(boat, tmp_path):
    assert boat(gnss=fixes(tmp_path / "fixes.csv", shift_s=86400.0)).code == 0
    assert "sources gnss and lbl: clocks disagree" in lines_of(tmp_path)
    assert "source gnss says nothing in the time of the run" in lines_of(tmp_path)


def test_a_source_whose_clock_disagrees_with_the_unit_is_refused(boat, log, imu, tmp_path):
    source = fixes(tmp_path / "fixes.csv", shift_s=3600.0)
    head = f'estimator = "multi_source"\nimu = "{imu[0]}"\nheading_deg = 72\n'
    assert boat(head=head, gnss=source).refused("clocks disagree", "gnss from", "the IMU from")


def test_angles_in_degrees_in_a_column_of_radians_are_refused(boat, tmp_path):
    path = tmp_path / "usbl.csv"
    path.write_text(f"t_ns,range_m,bearing_rad,elevation_rad\n{START_NS + 10**11},100,90,-45\n")
    source = (
        f'[[source]]\ntype = "usbl"\nfile = "{path}"\n[source.transponder]\n'
        "lat_deg = 34.96\nlon_deg = 139.26\nheight_m = -860\n"
    )
    assert boat(lbl=source).refused("bearing_rad", "more than a turn", "line 2")


def test_a_beacon_without_coordinates_and_a_short_profile_are_refused(boat, log, tmp_path):
    own = f'[[source]]\ntype = "lbl"\nfile = "{log}"\nformat = "garpos"\n'
    only = "[source.beacons.M1]\nlat_deg = 34.96\nlon_deg = 139.26\nheight_m = -860\n"
    assert boat(lbl=own + only).refused("M2", "no coordinates", "M1")
    shallow = write_log(tmp_path / "shallow", 20.0, profile_m=500.0)
    assert boat(lbl=own.replace(str(log), str(shallow))).refused("500", "beacon", "M1")
