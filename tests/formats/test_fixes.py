"""A receiver's own fixes as measurements."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.fixes import POSITION_KEYS, VELOCITY_KEYS, read_fixes
from pntegrity.formats.truth import read_truth
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation
from pntegrity.physics.time import from_iso

XYZ = np.array([4027881.628, 306998.537, 4919498.984])
LAT, LON, HEIGHT = ecef_to_geodetic(XYZ)
PLACE = f"{np.degrees(LAT):.12f} {np.degrees(LON):.12f} {HEIGHT:.6f}"
POS_HEAD = (
    "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s) "
    "ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun\n"
)
POS_LINE = (
    f"2019/01/14 06:15:00.250 {PLACE} 1 9 0.2 0.3 0.5 0.1 -0.2 0.05 0 0 3 4 12 0.04 0.05 0.06 0.01 -0.02 0\n"
)
CSV_HEAD = (
    "t_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps,pos_std_n_m,pos_std_e_m,pos_std_d_m,"
    "vel_std_n_mps,vel_std_e_mps,vel_std_d_mps\n"
)
CSV_LINE = "0.25," + PLACE.replace(" ", ",") + ",3,4,-12,0.2,0.3,0.5,0.04,0.05,0.06\n"
T0 = from_iso("2019-01-14T06:15:00.25")


@pytest.fixture
def fixes(save):
    def read(text, name="run.pos", **options):
        return read_fixes(save(text, name), **options)

    return read


def only(epochs):
    (epoch,) = epochs
    (fix,) = epoch.observations
    assert epoch.t_ns == fix.t_ns == T0
    assert fix.sensor == "fix"
    return fix


def test_rtklib_with_velocities_and_full_covariances(fixes):
    fix = only(fixes(POS_HEAD + POS_LINE))
    assert fix.keys == POSITION_KEYS + VELOCITY_KEYS
    np.testing.assert_allclose(fix.y[:3], XYZ, atol=1e-5)
    C = enu_rotation(XYZ)
    np.testing.assert_allclose(C @ fix.y[3:], [4.0, 3.0, 12.0], atol=1e-9)
    place, speed = (C @ fix.aux["cov"][i : i + 3, i : i + 3] @ C.T for i in (0, 3))
    # RTKLIB's sdne, sdeu, sdun: roots of covariances with their signs
    east_north_up = [[0.09, 0.01, -0.04], [0.01, 0.04, 0.0025], [-0.04, 0.0025, 0.25]]
    np.testing.assert_allclose(place, east_north_up, atol=1e-9)
    np.testing.assert_allclose(
        speed, [[0.0025, 1e-4, -4e-4], [1e-4, 0.0016, 0.0], [-4e-4, 0.0, 0.0036]], atol=1e-9
    )
    assert not fix.aux["cov"][:3, 3:].any()
    np.testing.assert_allclose(fix.sigma**2, np.diagonal(fix.aux["cov"]))


def test_csv_with_bare_seconds_and_velocity_down(fixes):
    fix = only(fixes(CSV_HEAD + CSV_LINE, "gnss.csv", origin_ns=from_iso("2019-01-14T06:15:00")))
    C = enu_rotation(XYZ)
    np.testing.assert_allclose(C @ fix.y[3:], [4.0, 3.0, 12.0], atol=1e-9)
    place = C @ fix.aux["cov"][:3, :3] @ C.T
    np.testing.assert_allclose(place, np.diag([0.09, 0.04, 0.25]), atol=1e-9)
    with pytest.raises(InputError, match=r"bare seconds.*--imu-start"):
        fixes(CSV_HEAD + CSV_LINE, "gnss.csv")


def test_floors_raise_small_sigmas_only(fixes):
    fix = only(fixes(POS_HEAD + POS_LINE, sigma_floor_m=0.4, sigma_floor_mps=1.0))
    C = enu_rotation(XYZ)
    place, speed = (C @ fix.aux["cov"][i : i + 3, i : i + 3] @ C.T for i in (0, 3))
    np.testing.assert_allclose(np.diagonal(place), [0.16, 0.16, 0.25], atol=1e-9)
    np.testing.assert_allclose(np.diagonal(speed), np.ones(3), atol=1e-9)


def test_positions_without_velocities_and_a_line_without(fixes):
    notes: list[str] = []
    head = "t_ns,x_m,y_m,z_m,sde,sdn,sdu\n"
    fix = only(fixes(f"{head}{T0},{XYZ[0]},{XYZ[1]},{XYZ[2]},1,1,2\n", "f.csv", notes=notes))
    assert fix.keys == POSITION_KEYS
    assert fix.aux["cov"].shape == (3, 3)
    assert "positions alone" in notes[0]
    broken = POS_LINE.replace(" 3 4 12 ", " nan 4 12 ")
    assert only(fixes(POS_HEAD + broken)).keys == POSITION_KEYS


def test_lines_that_are_no_fix_are_dropped_and_told(fixes):
    notes: list[str] = []
    no_place = POS_LINE.replace("06:15:00.250", "06:15:01.000").replace(PLACE, "nan nan nan")
    no_sigma = POS_LINE.replace("06:15:00.250", "06:15:02.000").replace(" 0.2 0.3 0.5", " 0 0 0")
    only(fixes(POS_HEAD + POS_LINE + no_place + no_sigma + POS_LINE, notes=notes))
    assert any("no number or no place" in n for n in notes)
    assert any("repeats or goes back" in n for n in notes)
    assert any("standard deviation" in n for n in notes)


def test_what_is_no_table_of_fixes(fixes):
    with pytest.raises(InputError, match=r"standard deviations of positions.*sdn, sde, sdu"):
        fixes(f"t_ns,x_m,y_m,z_m\n{T0},1e6,2e6,6e6\n", "f.csv")
    with pytest.raises(InputError, match="no columns for position"):
        fixes("t_ns,sdn,sde,sdu\n1,1,1,1\n", "f.csv")
    with pytest.raises(InputError, match="no usable line"):
        fixes(POS_HEAD + POS_LINE.replace(" 0.2 0.3 0.5", " 0 0 0"))


def test_real_fixes_are_the_trajectory_of_the_same_file(shared):
    path = shared / "imu-drive-2025189/gnss_1934_sf.pos.gz"
    epochs, track = read_fixes(path), read_truth(path)
    assert len(epochs) == 2197
    np.testing.assert_array_equal([e.t_ns for e in epochs], track.t_ns)
    np.testing.assert_allclose([e.observations[0].y[:3] for e in epochs], track.position_m)
    np.testing.assert_allclose([e.observations[0].y[3:] for e in epochs], track.velocity_mps)
    assert np.median([e.observations[0].sigma[0] for e in epochs]) == pytest.approx(0.0099, abs=2e-4)


def track_of(n=6):
    """Speeding up towards north by 0.4 m/s a step of 0.25 s, at 1 m/s at first."""
    line = "{t:.2f}," + PLACE.replace(" ", ",") + ",{v:.3f},0,0,0.02,0.02,0.02,0.04,0.04,0.04\n"
    return CSV_HEAD + "".join(line.format(t=0.25 * k, v=1.0 + 0.4 * k) for k in range(n))


def test_late_velocities_are_taken_from_between_later_fixes(fixes):
    epochs = fixes(track_of(), "run.csv", origin_ns=T0, velocity_lag_s=0.125)
    *first, last = [e.observations[0] for e in epochs]
    C = enu_rotation(XYZ)
    north = [float((C @ fix.y[3:])[1]) for fix in first]
    np.testing.assert_allclose(north, [1.2 + 0.4 * k for k in range(5)], atol=1e-9)
    # the last has no later one to look at
    assert last.keys == POSITION_KEYS


def test_late_velocities_are_not_taken_across_a_gap(fixes):
    lines = track_of(9).splitlines(keepends=True)
    epochs = fixes("".join(lines[:5] + lines[8:]), "run.csv", origin_ns=T0, velocity_lag_s=0.125)
    known = [len(e.observations[0].keys) == 6 for e in epochs]
    assert known == [True, True, True, False, True, False]


def test_velocities_can_be_left(fixes):
    notes: list[str] = []
    epochs = fixes(track_of(), "run.csv", origin_ns=T0, velocity=False, notes=notes)
    assert {e.observations[0].keys for e in epochs} == {POSITION_KEYS}
    assert any("not used" in n for n in notes)
