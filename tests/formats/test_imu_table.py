"""Tables of inertial measurement units in all the shapes they come in, and what is refused."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.imu_table import mounting, read_imu
from pntegrity.physics.time import SECOND_NS, from_iso, from_week_tow, to_iso

T0 = int(from_week_tow(2381, 408640.0))
STEP_NS = 8_000_000
N = 500
RATE = np.array([0.01, -0.02, 0.03])
FORCE = np.array([0.1, -0.2, -9.8])
HEAD = "gps_week,tow_s,gyr_x_rps,gyr_y_rps,gyr_z_rps,acc_x_mps2,acc_y_mps2,acc_z_mps2"


def rows(rate=RATE, force=FORCE, times=None):
    """Return the samples of a unit that turns and feels the same all the time, as lists of cells."""
    times = [f"2381,{408640.0 + (k + 1) * STEP_NS * 1e-9:.4f}" for k in range(N)] if times is None else times
    cells = ",".join(f"{v!r}" for v in [*np.asarray(rate).tolist(), *np.asarray(force).tolist()])
    return [f"{t},{cells}" for t in times]


def table(head=HEAD, **samples):
    return "\n".join([head, *rows(**samples)]) + "\n"


@pytest.fixture
def imu(save):
    def read(text, **options):
        return read_imu(save(text, "imu.csv"), **options)

    return read


def assert_as_sampled(whole):
    assert whole.t_ns.tolist() == [T0 + (k + 1) * STEP_NS for k in range(N)]
    np.testing.assert_allclose(whole.dt_s, STEP_NS * 1e-9, rtol=1e-9)
    np.testing.assert_allclose(whole.angle_rad, np.tile(RATE * STEP_NS * 1e-9, (N, 1)), rtol=1e-9)
    np.testing.assert_allclose(whole.velocity_mps, np.tile(FORCE * STEP_NS * 1e-9, (N, 1)), rtol=1e-9)
    assert whole.reason == ""


def test_all_times_names_and_units_say_the_same(imu):
    t_ns = [T0 + (k + 1) * STEP_NS for k in range(N)]
    g = 9.80665
    dt = STEP_NS * 1e-9
    texts = [
        table(),
        table("t_ns,wx,wy,wz,ax,ay,az".replace(",w", ",gyro_").replace(",a", ",accel_")
              .replace("gyro_x", "gyro_x (rad/s)").replace("gyro_y", "gyro_y [rad/s]")
              .replace("gyro_z", "Gyro Z (rad/s)").replace("accel_x", "ax (m/s^2)")
              .replace("accel_y", "ay_mps2").replace("accel_z", "Acc Z [m/s2]"), times=t_ns),
        table("time_gps,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g", rate=np.degrees(RATE), force=FORCE / g,
              times=[to_iso(t) for t in t_ns]),
        table("t_ns,dtheta_x_rad,dtheta_y_rad,dtheta_z_rad,dv_x_mps,dv_y_mps,dv_z_mps",
              rate=RATE * dt, force=FORCE * dt, times=t_ns),
        table().replace(",", ";"),
        "# a comment\n" + table(),
    ]  # fmt: skip
    for text in texts:
        assert_as_sampled(imu(text))


def test_gzip_and_bare_seconds_with_their_origin(save):
    times = [f"{(k + 1) * STEP_NS * 1e-9:.3f}" for k in range(N)]
    text = table("t_s,gx_rps,gy_rps,gz_rps,ax_mps2,ay_mps2,az_mps2", times=times)
    path = save(gzip.compress(text.encode()), "imu.csv.gz")
    assert_as_sampled(read_imu(path, origin_ns=T0))
    with pytest.raises(InputError, match=r"bare seconds.*--imu-start"):
        read_imu(path)


def test_a_lag_moves_stamps_back(imu):
    late = imu(table(), lag_s=0.25)
    assert late.t_ns[0] == T0 + STEP_NS - SECOND_NS // 4


def test_axes_and_mounting_turn_into_forward_right_down(imu):
    up = imu(table(force=FORCE * [1, -1, -1], rate=RATE * [1, -1, -1]), axes="flu")
    assert_as_sampled(up)
    np.testing.assert_allclose(mounting("-y,-x,-z") @ [1.0, 2.0, 3.0], [-2.0, -1.0, -3.0])
    # a nose that points 10 deg up feels gravity's reaction along its x axis
    nose_up = mounting("x,y,z", (0.0, 10.0, 0.0))
    np.testing.assert_allclose(
        nose_up @ [np.sin(np.radians(10.0)), 0.0, -np.cos(np.radians(10.0))], [0.0, 0.0, -1.0], atol=1e-12
    )
    # a unit turned to the right has its nose there
    np.testing.assert_allclose(mounting("x,y,z", (0, 0, 90.0)) @ [1.0, 0.0, 0.0], [0, 1, 0], atol=1e-12)
    # rolled to the right: its right side is down
    np.testing.assert_allclose(mounting("x,y,z", (90.0, 0, 0)) @ [0.0, 1.0, 0.0], [0, 0, 1], atol=1e-12)
    for matrix in (nose_up, mounting("rfu", (1.0, 2.0, 3.0))):
        assert np.linalg.det(matrix) == pytest.approx(1.0)


@pytest.mark.parametrize("axes", ["x,y", "x,y,y", "a,b,c", "", "x,y,z,x"])
def test_axes_that_are_none(axes):
    with pytest.raises(InputError, match="not three of x, y and z"):
        mounting(axes)


def test_mirrored_axes_and_angles_that_are_none():
    with pytest.raises(InputError, match="mirror image"):
        mounting("x,y,-z")
    with pytest.raises(InputError, match="roll, pitch and yaw"):
        mounting("x,y,z", (1.0, np.nan, 0.0))


def test_unsorted_stamps_are_sorted_and_repeated_ones_dropped(imu):
    lines = rows()
    lines[100], lines[101] = lines[101], lines[100]
    lines.insert(200, lines[200])
    lines.insert(300, "2381,nothing,1,2,3,4,5,6")
    lines.insert(301, "2381")
    notes: list[str] = []
    assert_as_sampled(imu("\n".join([HEAD, *lines]) + "\n", notes=notes))
    assert [("sorted" in n, "repeats" in n, "2 lines dropped" in n) for n in notes] == [
        (False, False, True), (True, False, False), (False, True, False),
    ]  # fmt: skip


def test_stamps_in_no_order_are_an_error(imu):
    lines = rows()
    np.random.default_rng(1).shuffle(lines)
    with pytest.raises(InputError, match=r"stamps are before the one above.*Sort the table"):
        imu("\n".join([HEAD, *lines]) + "\n")


def test_a_gap_is_kept_as_a_gap_and_told(imu):
    lines = rows()
    notes: list[str] = []
    whole = imu("\n".join([HEAD, *lines[:200], *lines[260:]]) + "\n", notes=notes)
    assert "1 gap (" in whole.reason
    assert "0.48 s" in whole.reason
    assert to_iso(T0 + 200 * STEP_NS) in notes[0]
    assert whole.dt_s[200] == pytest.approx(STEP_NS * 1e-9)  # not stretched over the gap
    late = imu("\n".join([HEAD, *lines[:200], *lines[203:]]) + "\n")
    assert late.reason == ""
    assert late.dt_s[200] == pytest.approx(4 * STEP_NS * 1e-9)  # a late stamp: held


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (table(force=FORCE / 9.80665), "looks like g"),
        (table(force=FORCE * 102.0), "looks like mg"),
        (table(force=FORCE * [1, 1, 0]), "Gravity seems to be taken off"),
        (table(force=FORCE * 0.7), "unit or the scale"),
        (table(HEAD.replace("mps2", "g")), "m/s2 that is named g"),
        (table(rate=RATE * 57.3), "look like deg/s"),
        (table(force=FORCE * [1, 1, -1]), r"along \+z.*points up.*--imu-axes.*--imu-mount-deg"),
        (table(force=FORCE[[2, 1, 0]]), r"along -x.*points down.*--imu-axes"),
        (table(force=-FORCE[[0, 2, 1]]), r"along \+y.*--imu-axes"),
    ],
)  # fmt: skip
def test_gravity_tells_units_and_axes(imu, text, words):
    with pytest.raises(InputError, match=words) as caught:
        imu(text)
    assert caught.value.path.name == "imu.csv"


def test_a_tilted_body_may_be_asked_for(imu):
    assert len(imu(table(force=FORCE[[2, 1, 0]]), level=False).t_ns) == N
    tilted = FORCE @ mounting("x,y,z", (40.0, 0.0, 0.0))
    assert len(imu(table(force=tilted)).t_ns) == N


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (HEAD.replace("gyr_x_rps", "gyr_x"), "'gyr_x' has no unit.*gyr_x_rps"),
        (HEAD.replace("acc_y_mps2", "acc_y (furlong)"), "furlong.*not known"),
        (HEAD.replace("acc_y_mps2", "noise"), "not one column of specific forces"),
        (HEAD.replace("gyr_y_rps", "gyr_x_dps"), "not one column of angular rates"),
        (HEAD.replace("tow_s", "when"), "no columns for time"),
        ("1,2,3,4,5,6,7,8", "does not name the columns"),
        ("a,b", "does not name the columns"),
    ],
)
def test_heads_that_do_not_say_enough(imu, head, words):
    with pytest.raises(InputError, match=words) as caught:
        imu(table(head))
    assert caught.value.line == 1


def test_nothing_usable(imu):
    with pytest.raises(InputError, match="fewer than two usable lines"):
        imu(HEAD + "\n2381,1.0,x,y,z,1,2,3\n")
    with pytest.raises(InputError, match="fewer than two usable lines"):
        imu(HEAD + "\n")


def test_times_of_other_kinds_of_nonsense_are_dropped(imu):
    lines = [f"{t},1,2,3,4,5,6" for t in ("later", "2019-13-45T00:00:00", "")]
    with pytest.raises(InputError, match="fewer than two"):
        imu("\n".join(["time_gps,gx_rps,gy_rps,gz_rps,ax_mps2,ay_mps2,az_mps2", *lines]) + "\n")


@pytest.mark.parametrize(
    ("name", "axes", "samples", "begins"),
    [
        ("imu-walk-2025240/imu_gpst.csv.gz", "-y,-x,-z", 20455, "2025-08-28T17:30:40.961"),
        ("imu-drive-2025189/imu_gpst.csv.gz", "-x,y,-z", 54858, "2025-07-08T19:34:21.854"),
    ],
)
def test_real_tables(shared, name, axes, samples, begins):
    notes: list[str] = []
    whole = read_imu(shared / name, axes=axes, notes=notes)
    assert len(whole.t_ns) == samples
    assert abs(int(whole.t_ns[0]) - from_iso(begins)) < SECOND_NS
    assert notes == []
    down = whole.velocity_mps.sum(axis=0) / whole.dt_s.sum()
    assert down[2] == pytest.approx(-9.9, abs=0.1)
    with pytest.raises(InputError, match=r"along \+z"):
        read_imu(shared / name)
