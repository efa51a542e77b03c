"""Reference trajectories in all the shapes they come in."""

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.truth import Truth, read_truth
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotations
from pntegrity.physics.time import from_iso, from_week_tow

T0 = int(from_week_tow(2036, 108900.0))
XYZ = (4027881.628, 306998.537, 4919498.984)


def test_the_three_times_and_two_positions_agree(save):
    lat, lon, h = ecef_to_geodetic(XYZ)
    x, y, z = XYZ
    llh = f"{np.degrees(lat):.12f},{np.degrees(lon):.12f},{h:.6f}"
    texts = (
        f"t_ns,x_m,y_m,z_m\n{T0},{x},{y},{z}\n",
        f"gps_week,tow_s,x_m,y_m,z_m\n2036,108900.0,{x},{y},{z}\n",
        f"time_gps,lat_deg,lon_deg,height_m\n2019-01-14T06:15:00,{llh}\n",
        f"GPS TOW (s),GPS Week,Latitude (deg), Longitude (deg), Ellipsoid Height (m)\n108900.0,2036,{llh}\n",
        f"2036,108900,{llh}\n",
    )
    for text in texts:
        t = read_truth(save(text, "truth.csv"))
        assert t.t_ns.tolist() == [T0]
        np.testing.assert_allclose(t.position_m[0], XYZ, atol=1e-5)


def test_rtklib_pos_in_both_forms(save):
    lat, lon, h = ecef_to_geodetic(XYZ)
    geodetic = (
        "% program   : RTKLIB\n"
        "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns\n"
        f"2019/01/14 06:15:00.000 {np.degrees(lat):.9f} {np.degrees(lon):.9f} {h:.4f} 5 9\n"
    )
    cartesian = (
        f"%  GPST  x-ecef(m) y-ecef(m) z-ecef(m) Q ns\n2036 108900.000 {XYZ[0]} {XYZ[1]} {XYZ[2]} 5 9\n"
    )
    for text in (geodetic, cartesian):
        t = read_truth(save(text, "run.pos"))
        assert t.t_ns.tolist() == [T0]
        np.testing.assert_allclose(t.position_m[0], XYZ, atol=1e-3)


def test_velocity_in_east_north_up_keeps_its_length_and_the_vertical(save):
    text = f"t_ns,x_m,y_m,z_m,ve_mps,vn_mps,vu_mps\n{T0},{XYZ[0]},{XYZ[1]},{XYZ[2]},3,4,12\n"
    v = read_truth(save(text, "t.csv")).velocity_mps[0]
    assert np.linalg.norm(v) == pytest.approx(13.0)
    lat, lon, _ = ecef_to_geodetic(XYZ)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    assert up @ v == pytest.approx(12.0)


@pytest.mark.parametrize(
    "names",
    ["Roll (deg),Pitch (deg),Heading (deg)", "roll_deg,pitch_deg,yaw_deg", "att2_deg,att1_deg,heading_deg"],
)
def test_attitude_is_roll_pitch_heading_in_radians(save, names):
    text = f"t_ns,x_m,y_m,z_m,{names}\n{T0},1e6,2e6,3e6,1.0,-2.0,270.5\n{T0 + 1},1e6,2e6,3e6,1.0,?,270.5\n"
    t = read_truth(save(text, "t.csv"))
    np.testing.assert_allclose(t.attitude_rad[0], np.radians([1.0, -2.0, 270.5]))
    assert np.isnan(t.attitude_rad[1]).tolist() == [False, True, False]
    assert not t.attitude_rad.flags.writeable


def test_without_all_three_angles_there_is_no_attitude(save):
    text = f"t_ns,x_m,y_m,z_m,pitch_deg,heading_deg\n{T0},1e6,2e6,3e6,1.0,270.5\n"
    assert read_truth(save(text, "t.csv")).attitude_rad is None


def test_the_nose_of_real_vehicles_points_along_their_way(shared):
    """Heading is the course, pitch the slope; the unit of the van sits a degree askew in it."""
    for name in ("nagoya-truth/20230711/reference.csv.gz", "cpt-van-2019087/cpt_pva_ref.csv.gz"):
        t = read_truth(shared / name)
        east, north, up = np.einsum("nij,nj->in", enu_rotations(t.position_m), t.velocity_mps)
        speed = np.hypot(east, north)
        fast = speed > 5.0
        off = np.angle(np.exp(1j * (np.arctan2(east, north) - t.attitude_rad[:, 2])))[fast]
        assert abs(np.degrees(np.median(off))) < 1.5
        pitch, slope = t.attitude_rad[fast, 1], np.arctan2(up, speed)[fast]
        roll = t.attitude_rad[fast, 0]
        assert np.corrcoef(pitch, slope)[0, 1] > max(0.5, 2.0 * abs(np.corrcoef(roll, slope)[0, 1]))


def test_interpolation_is_linear_and_stops_at_gaps():
    t = np.array([0, 1, 2, 6, 7], dtype=np.int64) * 10**9
    truth = Truth(t, np.outer(np.array([0.0, 1, 2, 6, 7]), [1.0, 2.0, 3.0]))
    at = np.array([-1, 0, 5 * 10**8, 2 * 10**9, 3 * 10**9, 65 * 10**8, 7 * 10**9, 8 * 10**9])
    position, valid = truth.at(at)
    assert valid.tolist() == [False, True, True, True, False, True, True, False]
    np.testing.assert_allclose(position[valid][:, 0], [0.0, 0.5, 2.0, 6.5, 7.0])
    assert np.isnan(position[~valid]).all()


def test_bad_lines_are_dropped_and_told(save):
    lines = [f"{T0 + k * 10**9},1e6,2e6,{z}" for k, z in ((0, "3e6"), (1, "x"), (2, "3e6"), (2, "3e6"))]
    t = read_truth(save("t_ns,x_m,y_m,z_m\n" + "\n".join([*lines, "late,1,2,3", ""]), "t.csv"))
    assert len(t.t_ns) == 2
    assert len(t.notes) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b,c\n1,2,3\n", "no columns for time and position"),
        ("t_ns,x_m,y_m\n1,2,3\n", "no columns for position"),
        ("1,2,3,4\n", "no header"),
        ("t_ns,x_m,y_m,z_m\n", "no line with a time"),
        ("t_ns,x_m,y_m,z_m\n5,x,y,z\n", "no usable line"),
        ("%  UTC  latitude(deg) longitude(deg) height(m)\n2019/01/14 06:15:00 1 2 3\n", "GPS time"),
    ],
)
def test_unusable_tables_raise_with_a_hint(save, text, words):
    with pytest.raises(InputError, match=words) as caught:
        read_truth(save(text, "t.csv"))
    assert caught.value.hint


def test_shared_references(shared):
    for name, n, first in (
        ("tst-urban-2019118/groundTruth_TST.csv.gz", 485, "2019-04-28T12:58:21"),
        ("imu-walk-2025240/gnss_1730_sf.pos.gz", 536, "2025-08-28T17:30:39.749"),
        ("nagoya-truth/20230711/reference.csv.gz", 6151, "2023-07-11T06:04:30"),
        ("cpt-van-2019087/cpt_pva_ref.csv.gz", 2363, "2019-03-28T03:17:33"),
    ):
        t = read_truth(shared / name)
        assert (len(t.t_ns), t.t_ns[0]) == (n, from_iso(first))
        assert t.notes == ()


def test_velocity_is_the_derivative_of_position(shared):
    for name in ("nagoya-truth/20230711/reference.csv.gz", "cpt-van-2019087/cpt_pva_ref.csv.gz"):
        t = read_truth(shared / name)
        dt = (t.t_ns[2:] - t.t_ns[:-2])[:, None] * 1e-9
        slope = (t.position_m[2:] - t.position_m[:-2]) / dt
        assert np.sqrt(np.mean((slope - t.velocity_mps[1:-1]) ** 2)) < 0.1
