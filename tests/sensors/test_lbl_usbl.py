"""Acoustic sources, velocity log, depth: Jacobians against numerical differentiation; what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pntegrity.kernels.rotations import from_angles, rotation
from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation, geodetic_to_ecef
from pntegrity.records import Observation
from pntegrity.sensors.depth import Depth
from pntegrity.sensors.dvl import Dvl
from pntegrity.sensors.lbl import Lbl
from pntegrity.sensors.source import Nuisance, Pose, Source, Track
from pntegrity.sensors.usbl import Usbl

SECOND = 10**9
T = 1000 * SECOND
SEA = 40.0
PLACE = geodetic_to_ecef(0.6, -2.1, SEA - 6.0)
AXES = enu_rotation(PLACE)
PROFILE = {
    "depth_m": [0.0, 30.0, 100.0, 500.0, 1500.0],
    "speed_mps": [1520.0, 1519.0, 1495.0, 1484.0, 1490.0],
}
VELOCITY = AXES.T @ [1.2, 2.0, 0.1]
RATE = np.array([0.02, -0.03, 0.05])
ARM = (2.0, -1.5, 6.0)


def at(east, north, up):
    lat, lon, height = ecef_to_geodetic(PLACE + AXES.T @ [east, north, up])
    return {"lat_deg": float(np.degrees(lat)), "lon_deg": float(np.degrees(lon)), "height_m": float(height)}


BEACONS = {
    "AP1": at(800.0, 640.0, -1100.0) | {"delay_s": 0.2},
    "AP2": dict(
        zip(("x_m", "y_m", "z_m"), (PLACE + AXES.T @ [-700.0, 300.0, -1050.0]).tolist(), strict=True)
    ),
    "AP3": at(20.0, -10.0, -1200.0),
}
TRANSPONDER = at(342.0, 80.0, -173.0)


def pose_at(move=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), dv=(0.0, 0.0, 0.0), dbg=(0.0, 0.0, 0.0), **nuisance):
    """Return the pose with errors of the state taken into it, over all of its track."""
    t = T + np.arange(-300, 1, dtype=np.int64) * SECOND // 100
    s = (t - T)[:, None] / SECOND
    C = AXES.T @ from_angles([0.1, -0.05, 0.7]) @ rotation(s * RATE)
    tilt = rotation(turn)
    track = Track(t, PLACE + move + s * (VELOCITY + np.asarray(dv)), tilt @ C)
    return Pose(T, track.position_m[-1], VELOCITY + np.asarray(dv), track.C[-1], RATE - np.asarray(dbg),
                track, nuisance)  # fmt: skip


def observed(source, keys, y=None, **aux):
    """Return an observation that agrees with the true pose."""
    blank = Observation(source.name, T, keys, np.full(len(keys), 2.0) if y is None else y, None, aux)
    rows = source.rows(blank, pose_at())
    assert rows.keys == keys, rows.reason
    return replace(blank, y=blank.y - rows.nu)


STEPS = {"pos": ("move", 0.5), "att": ("turn", 1e-4), "vel": ("dv", 1e-2), "bg": ("dbg", 1e-3)}


def check_jacobians(source, observation, atol):
    """Compare each block with differences of the prediction at the true pose."""
    rows = source.rows(observation, pose_at())
    np.testing.assert_allclose(rows.nu, 0.0, atol=1e-9)
    for block, H in rows.H.items():
        name, e = STEPS.get(block, (block, 1e-4))
        for k in range(H.shape[1]):
            d = e * np.eye(H.shape[1])[k]
            more, less = (
                source.rows(observation, pose_at(**{name: s * d if block in STEPS else float(s * d[0])})).nu
                for s in (1.0, -1.0)
            )
            np.testing.assert_allclose(H[:, k], (less - more) / (2.0 * e), atol=atol[block], err_msg=block)
    return rows


WATERS = {"constant": {"sound_speed_mps": 1490.0}, "profile": {"profile": PROFILE, "sea_height_m": SEA}}
LBL_KEYS = ("lbl:R.AP1", "lbl:R.AP2", "lbl:R.AP3")


@pytest.mark.parametrize("two_way", [False, True], ids=["one way", "two way"])
@pytest.mark.parametrize("water", WATERS)
def test_lbl_jacobians(water, two_way):
    lbl = Lbl(beacons=BEACONS, lever_arm_m=ARM, two_way=two_way, sound_scale_sigma=1e-3, **WATERS[water])
    assert isinstance(lbl, Source)
    assert lbl.nuisances() == (Nuisance("lbl.sound_speed", 1e-3, 0.0),)
    aux = {"t0_ns": np.full(3, T - 2 * SECOND)}
    found = check_jacobians(
        lbl, observed(lbl, LBL_KEYS, **aux), {"pos": 1e-8, "vel": 1e-8, "att": 1e-6, "lbl.sound_speed": 1e-6}
    )
    assert found.H["pos"].shape == found.H["att"].shape == (3, 3)
    assert np.linalg.norm(found.H["pos"][0]) == pytest.approx((1 + two_way) / 1490.0, rel=0.02)
    np.testing.assert_allclose(found.R, np.eye(3) * 1e-6)


def test_lbl_on_a_moving_ship_is_the_sum_of_both_ways():
    lbl = Lbl(beacons=BEACONS, lever_arm_m=ARM, two_way=True, sound_speed_mps=1490.0)
    sent, received = T - 3 * SECOND // 2, T - SECOND // 4
    aux = {"t0_ns": np.array([sent]), "received_ns": np.array([received])}
    y = observed(lbl, LBL_KEYS[:1], **aux).y[0]
    pose, beacon = pose_at(), lbl.places["AP1"].position_m
    ways = 0.0
    for t in (sent, received):
        x, C = pose.track.at(t)
        ways += np.linalg.norm(x + C @ ARM - beacon)
    assert y == pytest.approx(ways / 1490.0 + 0.2, abs=1e-12)
    still = replace(
        pose, track=Track(np.array([sent, T]), np.stack([pose.position_m] * 2), np.stack([pose.C] * 2))
    )
    assert abs(lbl.rows(observed(lbl, LBL_KEYS[:1], **aux), still).nu[0]) > 1e-4


def test_what_the_file_says_of_the_ways_goes_before_the_configuration():
    one, two = (Lbl(beacons=BEACONS, two_way=w) for w in (False, True))
    o = observed(two, LBL_KEYS[1:2], t0_ns=np.array([T - SECOND]))
    said = replace(o, aux={**o.aux, "ways": np.array([2])})
    np.testing.assert_allclose(one.rows(said, pose_at()).nu, 0.0, atol=1e-12)


def test_rows_that_cannot_be_used_say_why():
    lbl = Lbl(beacons=BEACONS, two_way=True)
    good = observed(lbl, LBL_KEYS, t0_ns=np.full(3, T - SECOND))

    def reason(o, which=lbl):
        rows = which.rows(o, pose_at())
        assert len(rows.keys) == len(rows.nu) == len(rows.H["pos"]) < len(o.keys)
        return rows.reason

    stranger = replace(good, keys=("lbl:R.AP9", *good.keys[1:]))
    assert "lbl:R.AP9: beacon 'AP9' has no coordinates; there are those of AP1, AP2, AP3" in reason(stranger)
    assert "is no travel time" in reason(replace(good, y=good.y * [0.0, 1.0, 1.0]))
    late = replace(good, aux={"t0_ns": np.array([T - 9 * SECOND, T - SECOND, T - SECOND])})
    assert "the track begins 6.000 s after the signal was sent" in reason(late)
    ahead = replace(good, aux={**good.aux, "received_ns": np.array([T, T + SECOND, T])})
    assert "its time is 1.000 s ahead of the vehicle's" in reason(ahead)
    stuck = replace(good, aux={**good.aux, "repeated": np.array([0, 5, 1])})
    assert "lbl:R.AP2: its value came 5 times unchanged" in reason(stuck)
    assert lbl.rows(stuck, pose_at()).keys == ("lbl:R.AP1", "lbl:R.AP3")
    assert len(replace(lbl, most_repeats=0).rows(stuck, pose_at()).keys) == 3


def test_a_vehicle_below_its_profile_has_no_rows():
    lbl = Lbl(beacons={"A": at(300.0, 0.0, -30.0)}, profile={"depth_m": [0, 50], "speed_mps": [1500, 1490]},
              sea_height_m=SEA)  # fmt: skip
    deep = pose_at(move=AXES.T @ [0.0, 0.0, -200.0])
    rows = lbl.rows(Observation("lbl", T, ("lbl:R.A",), np.array([0.2])), deep)
    assert "ends at 50.0 m, a place is 206.0 m deep" in rows.reason
    assert rows.H["pos"].shape == (0, 3)


@pytest.mark.parametrize(
    ("fields", "match"),
    [({"beacons": {}}, "`beacons` must name one"),
     ({"beacons": {"A": {"delay_s": 0.1}}}, "beacon 'A' has no coordinates: give x_m, y_m, z_m"),
     ({"beacons": {"A": {"lat_deg": 95.0, "lon_deg": 0.0, "height_m": 0.0}}}, "are no place"),
     ({"beacons": {"A": {"x_m": 100.0, "y_m": 50.0, "z_m": -300.0}}}, "not near the surface"),
     ({"beacons": {"A": {"lat": 1.0}}}, "unknown keys: lat"),
     ({"beacons": {"A": at(0, 0, 0) | {"delay_s": -1.0}}}, "`delay_s` must be 0 or positive"),
     ({"sigma_s": 0.0}, "`sigma_s` must be positive"),
     ({"lever_arm_m": (1.0, 2.0)}, "`lever_arm_m` must be three"),
     ({"profile": PROFILE}, "`sea_height_m`.*goes with `profile`"),
     ({"profile": {"depth_m": [0.0, 900.0], "speed_mps": [1500.0, 1490.0]}, "sea_height_m": SEA},
      r"ends at 900\.0 m, beacon 'AP1' is 110[56]\.\d m deep"),
     ({"sound_speed_mps": 4900.0}, "between 1300 and 1800")],
)  # fmt: skip
def test_lbl_that_cannot_be(fields, match):
    with pytest.raises(ValueError, match=match):
        Lbl(**({"beacons": BEACONS} | fields))


USBL_KEYS = ("usbl:R.range", "usbl:R.time", "usbl:A.bearing", "usbl:A.elevation")


@pytest.mark.parametrize("two_way", [False, True], ids=["one way", "two way"])
@pytest.mark.parametrize("water", WATERS)
def test_usbl_jacobians(water, two_way):
    usbl = Usbl(
        transponder=TRANSPONDER,
        lever_arm_m=ARM,
        mount_deg=(2.0, -3.0, 40.0),
        two_way=two_way,
        **WATERS[water],
    )
    assert isinstance(usbl, Source)
    aux = {"t0_ns": np.full(4, T - SECOND)}
    o = observed(usbl, USBL_KEYS, y=np.array([400.0, 0.3, 1.0, -0.5]), **aux)
    found = check_jacobians(usbl, o, {"pos": 2e-6, "vel": 1e-8, "att": 1e-4})
    angle = np.radians(0.4)
    np.testing.assert_allclose(np.diagonal(found.R), [1.0, 1e-8, angle**2, angle**2])
    # 1 degree of heading moves the bearing by about that
    assert found.H["att"][2] @ AXES[2] == pytest.approx(1.0, abs=0.2)


def test_usbl_angles_of_a_level_ship():
    usbl = Usbl(transponder=at(100.0, 0.0, -100.0), sound_speed_mps=1500.0)
    level = replace(pose_at(), C=AXES.T @ from_angles([0.0, 0.0, np.radians(30.0)]))
    o = Observation("usbl", T, USBL_KEYS[2:], np.array([0.0, 0.0]))
    bearing, elevation = -usbl.rows(o, level).nu
    # a transponder in the east of a ship that heads 30 degrees is 60 degrees to the right, 45 below; its
    # geodetic coordinates are good to 2 mm
    assert np.degrees([bearing, elevation]) == pytest.approx([60.0, -45.0], abs=2e-3)
    turned = replace(usbl, mount_deg=(0.0, 0.0, 90.0)).rows(o, level).nu[0]
    assert np.degrees(-turned) == pytest.approx(-30.0, abs=2e-3)


def test_usbl_bearings_wrap():
    usbl = Usbl(transponder=TRANSPONDER)
    o = observed(usbl, USBL_KEYS[2:3], y=np.array([0.0]))
    near = replace(o, y=o.y + 2.0 * np.pi * np.sign(-o.y) + 0.01)
    assert usbl.rows(near, pose_at()).nu[0] == pytest.approx(0.01)


def test_sound_arrives_from_elsewhere_than_the_transponder_is():
    straight, bent = (Usbl(transponder=BEACONS["AP1"], **w) for w in WATERS.values())
    o = observed(straight, USBL_KEYS[2:], y=np.array([0.0, 0.0]))
    bearing, elevation = bent.rows(o, pose_at()).nu
    assert abs(bearing) < 0.01 < abs(elevation)


def test_usbl_rows_that_cannot_be_used_say_why():
    usbl = Usbl(transponder=TRANSPONDER)
    rows = usbl.rows(Observation("usbl", T, (*USBL_KEYS[2:], "usbl:R.range", "usbl:X.y"),
                                 np.array([123.0, -0.4, -5.0, 1.0])), pose_at())  # fmt: skip
    assert rows.keys == ("usbl:A.elevation",)
    assert (
        "usbl:A.bearing: 123 is no angle in rad: the file must declare degrees (`bearing_deg`)" in rows.reason
    )
    assert "-5 is no distance" in rows.reason
    assert "known are range, time, bearing and elevation" in rows.reason
    with pytest.raises(ValueError, match="'transponder' has no coordinates"):
        Usbl()
    level = replace(pose_at(), C=AXES.T @ from_angles([0.0, 0.0, 0.0]))
    below = Usbl(transponder=at(0.0, 0.0, -100.0))
    assert "no bearing" in below.rows(Observation("usbl", T, USBL_KEYS[2:3], np.array([0.1])), level).reason


@pytest.mark.parametrize("scale", [0.0, 0.02], ids=["no state", "scale"])
def test_dvl_jacobians(scale):
    dvl = Dvl(lever_arm_m=ARM, mount_deg=(1.0, 2.0, 45.0), scale_sigma=scale)
    assert isinstance(dvl, Source)
    o = observed(dvl, ("dvl:D.X", "dvl:D.Y", "dvl:D.Z"))
    found = check_jacobians(dvl, o, dict.fromkeys(("vel", "att", "bg", "dvl.scale"), 1e-6))
    assert set(found.H) == {"vel", "att", "bg"} | ({"dvl.scale"} if scale else set())
    assert dvl.rows(replace(o, keys=("dvl:D.XY", *o.keys[1:])), pose_at()).keys == o.keys[1:]


def test_dvl_of_a_ship_that_goes_ahead():
    ahead = replace(pose_at(), velocity_mps=pose_at().C @ [3.0, 0.0, 0.0], rate_radps=np.zeros(3))
    rows = Dvl(mount_deg=(0.0, 0.0, 45.0)).rows(
        Observation("dvl", T, ("dvl:D.X", "dvl:D.Y", "dvl:D.Z"), np.zeros(3)), ahead
    )
    np.testing.assert_allclose(-rows.nu, [3.0 / np.sqrt(2.0), -3.0 / np.sqrt(2.0), 0.0], atol=1e-12)


def test_depth_jacobians():
    depth = Depth(lever_arm_m=ARM, sea_height_m=SEA, tide_sigma_m=1.0)
    assert isinstance(depth, Source)
    o = observed(depth, ("depth:R.z",))
    check_jacobians(depth, o, {"pos": 1e-6, "att": 1e-5, "depth.tide": 1e-8})
    # 6 m below the surface the IMU, and the arm by the attitude
    arm = from_angles([0.1, -0.05, 0.7]) @ ARM
    assert o.y[0] == pytest.approx(6.0 - arm[2], abs=1e-4)
    nothing = depth.rows(replace(o, y=np.array([np.nan])), pose_at())
    assert (nothing.keys, nothing.reason) == ((), "depth:R.z: no depth")


def test_what_the_observation_declares_is_its_noise():
    o = replace(observed(Depth(), ("depth:R.z",)), sigma=np.array([0.5]))
    assert Depth(sigma_m=0.1).rows(o, pose_at()).R[0, 0] == 0.25


def test_a_sound_speed_value_serves_as_a_table():
    value = SoundSpeed(PROFILE["depth_m"], PROFILE["speed_mps"])
    tables = [Lbl(beacons=BEACONS, profile=p, sea_height_m=SEA) for p in (value, PROFILE)]
    o = observed(tables[0], LBL_KEYS)
    np.testing.assert_array_equal(*(lbl.rows(o, pose_at()).nu for lbl in tables))
