"""What a user may give beside a log for an inertial filter, and everything that can be wrong with it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gnss_logs import PLACE, START
from pntegrity.physics.frames import ecef_to_geodetic
from pntegrity.physics.time import to_iso, to_week_tow

SECOND = 10**9
HEAD = "gps_week,tow_s,gyr_x_rps,gyr_y_rps,gyr_z_rps,acc_x_mps2,acc_y_mps2,acc_z_mps2"
FORCE = (0.02, -0.01, -9.81)


def imu_lines(force=FORCE, shift_s=0.0, hz=50, seconds=70.0):
    """Return a unit at rest that is there from 5 s before the log on."""
    week, tow = to_week_tow(START)
    rng = np.random.default_rng(3)
    n = int(seconds * hz)
    gyro = 1e-4 * rng.normal(size=(n, 3))
    accel = np.asarray(force) + 2e-3 * rng.normal(size=(n, 3))
    t = tow - 5.0 + shift_s + np.arange(1, n + 1) / hz
    return [
        f"{week},{a:.4f}," + ",".join(f"{v:.6f}" for v in [*g, *f])
        for a, g, f in zip(t, gyro.tolist(), accel.tolist(), strict=True)
    ]


@pytest.fixture
def imu(tmp_path):
    def write(lines=None, head=HEAD, **options):
        path = tmp_path / "imu.csv"
        path.write_text("\n".join([head, *(imu_lines(**options) if lines is None else lines)]) + "\n")
        return path

    return write


@pytest.fixture
def ins(run):
    """Run the log of a receiver at rest with an inertial filter."""

    def go(imu, *options, **changed):
        return run("--estimator", "gnss_ins", "--heading-deg", "30", "--imu", imu, *options, **changed)

    return go


def test_a_run_and_the_same_run_from_its_own_configuration(ins, imu, pnt, tmp_path):
    first = ins(imu(), "--imu-spec", "low-cost", "--lever-arm", "0.5,0,-1", "--imu-lag-s", "0.01", "--zupt")
    assert first.called.code == 0, first.called
    assert np.isfinite(first.solution["heading_deg"].to_numpy()).all()
    again = tmp_path / "again"
    assert pnt("run", "--config", first.folder / "config.toml", "--out", again).code == 0
    assert json.loads((again / "summary.json").read_text()) == first.summary
    text = (first.folder / "config.toml").read_text()
    for line in (
        'imu_spec = "low-cost"',
        "lever_arm_m = [0.5, 0.0, -1.0]",
        "imu_lag_s = 0.01",
        "zupt = true",
    ):
        assert line in text


def test_each_detection_and_coupling_runs(ins, imu):
    table = imu()
    for options in (("--fde", "none"), ("--fde", "factor-set", "--variant", "published"), ("--fde", "lsr"),
                    ("--coupling", "loose"), ("--no-doppler",)):  # fmt: skip
        assert ins(table, *options).called.code == 0, options


def test_fewer_than_four_satellites_and_absent_gnss(ins, imu, files):
    few = [e if i < 20 or i > 40 else only_satellites(e, 3) for i, e in enumerate(files.epochs)]
    result = ins(imu(), epochs=few)
    assert result.called.code == 0
    assert len(result.solution) == len(files.epochs)
    absent = [*files.epochs[:20], *files.epochs[45:]]
    result = ins(imu(), epochs=absent)
    assert result.called.code == 0
    assert len(result.solution) == len(absent)
    sigma = result.solution["sigma_e_m"].to_numpy()
    assert np.isfinite(sigma[-10:]).all()


def only_satellites(epoch, n):
    head, *rest = epoch.rstrip("\n").split("\n")
    return "\n".join([f"{head[:32]}{n:3d}{head[35:]}", *rest[:n]]) + "\n"


def test_a_gap_of_the_unit_is_told_and_survived(ins, imu):
    lines = imu_lines()
    result = ins(imu([*lines[:1500], *lines[1650:]]))
    assert result.called.code == 0, result.called
    assert "the IMU has 1 gap (" in result.notes
    assert "3.00 s" in result.notes


def test_unsorted_stamps_are_sorted_or_refused(ins, imu):
    lines = imu_lines()
    lines[100], lines[101] = lines[101], lines[100]
    result = ins(imu(lines))
    assert result.called.code == 0
    assert "1 stamps go back" in result.notes
    np.random.default_rng(1).shuffle(lines)
    assert ins(imu(lines)).called.refused("imu.csv", "Sort the table")


def test_a_fault_beyond_the_end_of_the_log_is_refused_with_when_it_ends(ins, run, imu, files):
    last = f"from 0 s to {len(files.epochs) - 1} s after the first, every 1 s"
    for refused in (
        ins(imu(), "--fault", "* bias 10 m 5000:6000"),
        run("--fault", "* ramp 1 m/s 5000:"),
        run("--fault", "clock-drift 1 m/s 5000:6000"),
    ):
        assert refused.called.refused("fault", "no epoch in that time", last, "START:END")
    absolute = run("--fault", "* sine 9 m 5 s 1999-01-01T00:00:00/1999-01-01T01:00:00").called
    assert absolute.refused("no epoch in that time", f"from {to_iso(START)} to ")


def test_forces_and_increments_that_are_taken_for_each_other_are_told(ins, imu):
    dt = 0.02
    small = tuple(v * dt for v in FORCE)
    assert ins(imu(force=small)).called.refused("imu.csv", "increments that are named forces", "dv_x_mps")
    angles = (
        HEAD.replace("gyr_", "dtheta_").replace("rps", "rad").replace("acc_", "dv_").replace("mps2", "mps")
    )
    assert ins(imu(head=angles)).called.refused("imu.csv", "forces that are named increments", "acc_x_mps2")


def test_times_that_do_not_overlap(ins, imu):
    assert ins(imu(shift_s=86400.0)).called.refused("imu.csv", "no time in common", "GPS time")


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ((0.0, 0.0, -1.0), ("looks like g", "acc_x_g")),
        ((0.0, 0.0, 9.81), ("+z", "points up", "--imu-axes")),
        ((9.81, 0.0, 0.0), ("+x", "--imu-axes", "--imu-mount-deg")),
        ((0.0, 0.0, 0.0), ("taken off",)),
    ],
)
def test_swapped_axes_and_units(ins, imu, force, words):
    assert ins(imu(force=force)).called.refused("imu.csv", *words)


def test_axes_that_are_given_turn_it_right(ins, imu):
    assert ins(imu(force=(0.0, 0.0, 9.81)), "--imu-axes", "flu").called.code == 0
    assert ins(imu(force=(-9.81, 0.0, 0.0)), "--imu-axes", "z,-y,x").called.code == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--imu-axes", "x,y,-z"), ("mirror image",)),
        (("--imu-axes", "up"), ("three of x, y and z",)),
        (("--imu-mount-deg", "1,2"), ("--imu-mount-deg", "ROLL,PITCH,YAW")),
        (("--lever-arm", "300,0,-150"), ("implausible", "metres")),
        (("--lever-arm", "1,2"), ("--lever-arm", "FORWARD,RIGHT,DOWN")),
        (("--lever-arm", "nan,0,0"), ("lever_arm_m",)),
        (("--imu-lag-s", "late"), ("imu_lag_s",)),
        (("--imu-lag-s", "1000"), ("imu_lag_s",)),
        (("--imu-lag-s", "auto"), ("imu.csv", "cannot be told", "--imu-lag-s SECONDS")),
        (("--imu-spec", "adis"), ("'adis'", "stim300")),
        (("--imu-spec", "none.toml"), ("none.toml", "no such file")),
        (("--imu-start", "noon"), ("imu_start", "2025-07-08")),
        (("--coupling", "tight", "--fde", "lsr"), ("loose",)),
        (("--factors", "none.toml"), ("--fde factor-set",)),
        (("--fde", "factor-set", "--factors", "none.toml"), ("none.toml", "no such file")),
        (("--heading-deg", "4000"), ("heading_deg",)),
    ],
)
def test_options_that_cannot_be(ins, imu, options, words):
    assert ins(imu(), *options).called.refused(*words)


def test_tables_that_are_none(ins, imu, tmp_path, files):
    assert ins(tmp_path / "none.csv").called.refused("none.csv", "no such file")
    assert ins(files.obs).called.refused("rover.rnx", "does not name the columns")
    assert ins(imu(head=HEAD.replace("gyr_x_rps", "gyr_x"))).called.refused("imu.csv", "gyr_x", "no unit")
    assert ins(imu(head=HEAD.replace("gps_week,tow_s", "k,t_s"))).called.refused(
        "bare seconds", "--imu-start"
    )


def test_what_goes_with_which_estimator(run, imu):
    assert run("--estimator", "gnss_ins").called.refused("--imu")
    assert run("--imu", imu()).called.refused("`imu`", "gnss_ins", "spp_kf")
    assert run("--lever-arm", "1,0,0").called.refused("`lever_arm_m`", "gnss_ins")
    assert run("--fde", "lsr").called.refused("`fde`", "gnss_ins")


FACTORS = "[factors]\nmissed_limit_m = 9.0\nfalse_alarm_limit_m = 12.0\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[other]\n", ("no [factors] table", "train-factors")),
        (FACTORS + "more = 1\n", ("unknown name 'more'",)),
        (FACTORS.replace("9.0", "-9.0"), ("missed_limit_m", "positive")),
        (FACTORS + 'variant = "published"\n', ("--variant published",)),
        ("= 3", ("is not TOML",)),
    ],
)
def test_thresholds_that_cannot_be_used(ins, imu, tmp_path, text, words):
    path = tmp_path / "factors.toml"
    path.write_text(text)
    called = ins(imu(), "--fde", "factor-set", "--factors", path).called
    assert called.refused("factors.toml", *words)


def test_thresholds_that_can(ins, imu, tmp_path):
    path = tmp_path / "factors.toml"
    path.write_text(FACTORS)
    assert ins(imu(), "--fde", "factor-set", "--factors", path).called.code == 0


def fix_table(tmp_path):
    lat, lon, height = ecef_to_geodetic(PLACE)
    llh = f"{np.degrees(lat):.12f},{np.degrees(lon):.12f},{height:.4f}"
    lines = [f"{START + k * SECOND},{llh},0,0,0,1,1,2,0.1,0.1,0.1" for k in range(60)]
    path = tmp_path / "fixes.csv"
    head = "t_ns,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vu_mps,sdn,sde,sdu,sdvn,sdve,sdvu"
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def test_fixes_instead_of_observations(pnt, imu, tmp_path, files):
    out = tmp_path / "r"
    given = ("run", "--estimator", "gnss_ins", "--heading-deg", "30", "--imu", imu(), "--out", out)
    fixes = fix_table(tmp_path)
    assert pnt(*given, "--fixes", fixes).code == 0
    config = (out / "config.toml").read_text()
    assert 'monitors = ["rctm", "srctm", "aime", "sraime", "glr"]' in config
    assert pnt(*given, "--fixes", fixes, "--fix-velocity-lag-s", "0.1", "--monitors", "rctm").code == 0
    config = (out / "config.toml").read_text()
    assert "fix_velocity_lag_s = 0.1" in config
    assert 'monitors = ["rctm"]' in config
    assert pnt(*given, "--fixes", fixes, "--no-fix-velocity").code == 0
    assert pnt(*given, "--fixes", fixes, "--fix-velocity-lag-s", "9").refused("fix_velocity_lag_s")
    assert pnt(*given, "--fixes", fixes, "--start", "10", "--end", "30", "--fix-floor-m", "2").code == 0
    assert json.loads((out / "summary.json").read_text())["epochs"] == 21
    assert pnt(*given, "--fixes", fixes, "--start", "1000").refused("--start")
    assert pnt(*given, "--fixes", fixes, "--obs", files.obs).refused("`fixes` or `obs`")
    assert pnt(*given, "--fixes", fixes, "--coupling", "tight").refused("loose coupling")
    assert pnt(*given, "--fixes", fixes, "--fde", "lsr").refused("pseudoranges")
    assert pnt(*given, "--fixes", tmp_path / "no.pos").refused("no.pos", "no such file")
    assert pnt("run", "--fixes", fixes, "--out", out).refused("`fixes`", "gnss_ins")
    assert pnt("run", "--obs", files.obs, "--nav", files.nav, "--no-fix-velocity", "--out", out).refused(
        "`fix_velocity`", "gnss_ins"
    )
    assert pnt(*given).refused("no obs file")
