"""Acoustic logs: two layouts of real campaigns, our own table, profiles, and what is wrong with them."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats._acoustics import check_in_common, epochs_of, seconds_text_to_ns, with_repeats
from pntegrity.formats.acoustic_garpos import read_garpos
from pntegrity.formats.acoustic_gnatss import read_gnatss
from pntegrity.formats.acoustic_profile import read_profile
from pntegrity.formats.acoustic_table import read_acoustics
from pntegrity.physics.frames import ecef_to_geodetic, geodetic_to_ecef
from pntegrity.physics.time import civil_to_ns, from_iso, utc_to_ns
from pntegrity.records import Observation

T0 = from_iso("2024-06-01T10:00:00")
SECOND = 10**9


# --- our own table ------------------------------------------------------------------------------------------

LBL = "time_gps,beacon,two_way_ms,sigma_two_way_ms\n"


@pytest.fixture
def table(save):
    def read(text, source="lbl", **options):
        return read_acoustics(save(text, "acoustics.csv"), source=source, **options)

    return read


def test_travel_times_of_several_beacons(table):
    first, second = table(
        LBL + "2024-06-01T10:00:00.5,A,812.5,0.1\n2024-06-01T10:00:00.5,B,900,0.2\n"
        "2024-06-01T10:00:15,A,813,0.1\n"
    )
    assert (first.sensor, first.t_ns, first.keys) == ("lbl", T0 + SECOND // 2, ("lbl:R.A", "lbl:R.B"))
    np.testing.assert_allclose(first.y, [0.8125, 0.9])
    np.testing.assert_allclose(first.sigma, [1e-4, 2e-4])
    np.testing.assert_array_equal(first.aux["ways"], [2, 2])
    assert "t0_ns" not in first.aux
    assert second.keys == ("lbl:R.A",)


def test_usbl_in_degrees_and_with_time_of_transmission(table):
    (o,) = table(
        f"t_ns,sent_t_ns,slant_range_m,bearing_deg,Elevation (rad)\n{T0},{T0 - 5},400,-90,-0.5\n", "usbl"
    )
    assert o.keys == ("usbl:R.range", "usbl:A.bearing", "usbl:A.elevation")
    np.testing.assert_allclose(o.y, [400.0, -np.pi / 2.0, -0.5])
    assert o.sigma is None
    np.testing.assert_array_equal(o.aux["t0_ns"], [T0 - 5] * 3)


def test_depths_and_velocities_at_bare_seconds(table):
    (o,) = table("t_s,depth_m\n2,31.5\n", "depth", origin_ns=T0)
    assert (o.t_ns, o.keys, o.y[0]) == (T0 + 2 * SECOND, ("depth:R.z",), 31.5)
    (o,) = table("t_s,forward_mps,right_mps,down_mps\n0,1,,0.5\n", "dvl", origin_ns=T0)
    assert o.keys == ("dvl:D.X", "dvl:D.Z")
    with pytest.raises(InputError, match="bare seconds"):
        table("t_s,depth_m\n2,31.5\n", "depth")


def test_lines_that_are_damaged_are_dropped_and_told(table):
    notes: list[str] = []
    rows = "2024-06-01T10:00:00,A,1,1\nnonsense,A,2,1\n2024-06-01T10:00:02,A,x,1\n2024-06-01T10:00:03\n"
    (o,) = table(LBL + rows, notes=notes)
    assert o.t_ns == T0
    assert notes == ["acoustics.csv: 3 lines dropped: no time or no usable number, first line 3"]


@pytest.mark.parametrize(
    ("text", "match"),
    [("t_ns,bearing_rad\n1,123\n", r"line 2: 123 rad .* more than a turn. These look like degrees.*_deg"),
     ("t_ns,bearing_deg\n1,400\n", "400 deg.*Directions lie within 360"),
     ("t_ns,bearing\n1,1\n", "'bearing' has no unit. Call it bearing_rad or bearing_mrad or bearing_deg"),
     ("t_ns,two_way_h\n1,1\n", "unknown unit 'h'. Known are s, ms, us"),
     ("t_ns,beacon\n1,A\n", "no column with a measurement among t_ns, beacon"),
     ("two_way_s\n1\n", "no column for the time"), ("t_ns,two_way_s\nx,1\n", "no usable line")],
)  # fmt: skip
def test_what_is_no_table(table, text, match):
    with pytest.raises(InputError, match=match):
        table(text)


@pytest.mark.parametrize("sent", ["bad", "9" * 20, "1e3"])
def test_a_line_whose_time_of_transmission_is_none_is_dropped_and_told(table, sent):
    notes = []
    (o,) = table(f"t_ns,sent_t_ns,range_m\n{T0},{T0 - 5},400\n{T0 + 1},{sent},400\n", "usbl", notes=notes)
    assert o.t_ns == T0
    assert notes == ["acoustics.csv: 1 lines dropped: no time or no usable number, first line 3"]


def test_lines_without_any_measurement_are_passed_over(table):
    (o,) = table(f"t_ns,forward_mps,right_mps\n{T0},1,2\n{T0 + 1},,\n", "dvl")
    assert o.t_ns == T0


def test_seconds_that_are_no_time_are_dropped(table):
    (o,) = table("t_s,range_m\n1e30,400\n2,4\n", "usbl", origin_ns=T0)
    assert o.t_ns == T0 + 2 * SECOND


def test_notes_name_the_line_of_the_file_comments_counted(table):
    notes = []
    table(f"# a\n\n# b\nt_ns,range_m\n{T0},400\nbad,400\n", "usbl", notes=notes)
    assert notes[0].endswith("first line 6")


def test_a_table_of_comments(table):
    with pytest.raises(InputError, match="nothing but comments"):
        table("# nothing\n")


def test_a_beacon_without_coordinates(table):
    text = LBL + "2024-06-01T10:00:00,A,1,1\n2024-06-01T10:00:01,C,1,1\n"
    with pytest.raises(InputError, match=r"line 3: beacon 'C' has no coordinates. There are those of A, B"):
        table(text, beacons=("A", "B"))


def test_a_source_that_repeats_its_last_value(table):
    notes: list[str] = []
    rows = [f"2024-06-01T10:00:{i:02d},A,{800 + min(i, 4)},1" for i in range(10)]
    observations = table(LBL + "\n".join(rows), notes=notes)
    assert [int(o.aux["repeated"][0]) for o in observations] == [0, 0, 0, 0, 0, 1, 2, 3, 4, 5]
    assert notes == ["lbl:R.A repeats its last value, up to 5 times"]


def test_clocks_that_disagree():
    acoustic, gnss = np.array([T0, T0 + 9 * SECOND]), T0 + 3600 * SECOND + SECOND * np.arange(5)
    with pytest.raises(InputError, match=r"clocks disagree: no time in common: lbl from 2024-06-01T10:.*, "
                       r"gnss from 2024-06-01T11:00:00"):  # fmt: skip
        check_in_common(("lbl", acoustic), ("gnss", gnss))
    notes: list[str] = []
    check_in_common(("lbl", np.append(acoustic, gnss)), ("gnss", gnss), notes=notes)
    assert notes == ["2 of 7 times of lbl are outside of the span of gnss"]


def test_observations_of_one_instant_share_an_epoch():
    def one(name, t):
        return Observation(name, t, (f"{name}:R.1",), np.ones(1))

    epochs = epochs_of([one("b", 5), one("a", 3), one("a", 5)])
    assert [(e.t_ns, [o.sensor for o in e.observations]) for e in epochs] == [(3, ["a"]), (5, ["b", "a"])]
    (o,) = with_repeats([one("a", 3)], [])
    assert o.aux["repeated"].tolist() == [0]


def test_seconds_are_read_without_rounding():
    assert seconds_text_to_ns("712215467.263261") == 712215467_263261000
    assert seconds_text_to_ns("-0.5") == -SECOND // 2
    with pytest.raises(ValueError, match="no number of seconds"):
        seconds_text_to_ns("1.5e3x")


# --- profiles -----------------------------------------------------------------------------------------------


def test_profiles(save):
    for text in ("depth,speed\n0,1500\n10,1490\n", "# cast\n-10 1490\n-0 1500\n", "10;1490;x\n0;1500;x\n"):
        profile = read_profile(save(text, "svp.csv"))
        np.testing.assert_array_equal(profile.depth_m, [0.0, 10.0])
        np.testing.assert_array_equal(profile.speed_mps, [1500.0, 1490.0])
    notes: list[str] = []
    assert len(read_profile(save("0 1500\n5 -9.99e-29\n9 1495\n", "ctd"), notes=notes).depth_m) == 2
    assert notes == ["ctd: 1 rows marked as bad dropped"]


def test_a_profile_that_is_too_short(save):
    path = save("0,1500\n100,1490\n", "svp.csv")
    with pytest.raises(
        InputError, match=r"svp.csv: the sound-speed profile ends at 100.0 m, .* is 350.0 m deep"
    ):
        read_profile(path, reach_m=350.0)
    assert read_profile(path, reach_m=350.0, extend=True).at(350.0) == pytest.approx(1465.0)


@pytest.mark.parametrize(
    ("text", "match"),
    [("speed,depth\n1500,0\n", "first column is called 'speed'"),
     ("0,1500\nx,1\n", "line 2: 'x,1' is no depth"),
     ("0,1500\n", "two or more"), ("0,1.5\n10,1.49\n", "1300 and 1800"), ("# nothing\n", "no row"),
     ("0,1500\n10\n", "line 2")],
)  # fmt: skip
def test_what_is_no_profile(save, text, match):
    with pytest.raises(InputError, match=match):
        read_profile(save(text, "svp.csv"))


# --- GNATSS -------------------------------------------------------------------------------------------------

YAML = """site_id: X
transponders:
  - lat: 45.30
    lon: -124.97
    height: -1100.5
    internal_delay: 0.2
  - lat: 45.29
    lon: -124.95
    height: -1000.0  # m
    internal_delay: 0.32
posfilter:
  atd_offsets:
    forward: 0.5
    rightward: -0.25
    downward: 1.0
solver:
  geoid_undulation: -26.0
"""
PING = civil_to_ns(2022, 7, 27, 17, 37, 45)
J2000 = 712215465


@pytest.fixture
def gnatss(tmp_path):
    def write(**texts):
        place = geodetic_to_ecef(np.radians(45.3), np.radians(-124.96), -25.0)
        xyz = " ".join(f"{v:.4f}" for v in place)
        times = (f"{J2000}.0", f"{J2000 + 2}.263261", f"{J2000 + 2}.3833981")
        files = {
            "config.yaml": YAML, "CTD_X": "2 1500\n1300 1480\n",
            "208/pxp_tt": "27-JUL-22 17:37:45.00 2263261 2383398 0\n27-JUL-22 17:38:00.00 0 0 0\n",
            "208/GPS_POS_FREED": "".join(f"{J2000 + s}.0 GPSPOS {xyz} 0.01 0.02 0.03\n" for s in (0, 9)),
            "208/RPH_TWTT": "".join(f"{t} 1.0 -2.0 400.0\n" for t in times),
            "208/POS_FREED_TRANS_TWTT": "".join(f"{t} {xyz} 1 0 0 0 1 0 0 0 1\n" for t in times),
        } | {k.replace("__", "/"): v for k, v in texts.items()}  # fmt: skip
        (tmp_path / "208").mkdir(exist_ok=True)
        for name, text in files.items():
            (tmp_path / name).write_bytes(gzip.compress(text.encode()) if "pxp" in name else text.encode())
        return tmp_path

    return write


def test_gnatss(gnatss):
    log = read_gnatss(gnatss())
    (o,) = log.observations
    assert (o.t_ns, o.keys) == (PING + 2_383_398_000, ("lbl:R.T1", "lbl:R.T2"))
    np.testing.assert_allclose(o.y, [2.263261, 2.383398])
    np.testing.assert_array_equal(o.aux["t0_ns"], PING)
    np.testing.assert_array_equal(o.aux["received_ns"], PING + np.array([2_263_261_000, 2_383_398_000]))
    assert log.beacons["T2"] == {"lat_deg": 45.29, "lon_deg": -124.95, "height_m": -1026.0, "delay_s": 0.32}
    assert (log.lever_arm_m, log.sea_height_m) == ((0.5, -0.25, 1.0), -26.0)
    assert "1 pings without any reply" in log.notes[0]
    fix = log.fixes[0]
    assert (fix.sensor, fix.t_ns, fix.keys) == ("fix", PING, ("fix:RX", "fix:RY", "fix:RZ"))
    np.testing.assert_allclose(fix.sigma, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(np.degrees(log.attitude.attitude_rad[0]), [1.0, -2.0, 40.0])
    # the files round times apart; the antenna is above the transducer
    assert log.attitude.t_ns[-1] == o.t_ns
    assert ecef_to_geodetic(log.attitude.position_m)[0, 2] == pytest.approx(-24.0, abs=0.02)
    assert [len(e.observations) for e in log.epochs()] == [1, 1, 1]
    assert read_gnatss(gnatss(), undulation_m=0.0).beacons["T2"]["height_m"] == -1000.0


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [("config.yaml", YAML.replace("- lat: 45.29", "- x: 1"), "`lat` is missing"),
     ("config.yaml", YAML.replace("-1000.0", "deep"), "`height` is no number"),
     ("config.yaml", "site_id: X\ngeoid_undulation: 1\n", "no list `transponders`"),
     ("208__pxp_tt", "27-JUL-22 17:37:45.00 2263261 2383398 77\n", "transponder 3, which has no coordinates"),
     ("208__pxp_tt", "27-XXX-22 17:37:45.00 2263261\n", r"line 1: no ping"),
     ("208__pxp_tt", f"27-JUL-22 17:37:45.00 {'9' * 20}\n", "line 1: no ping: a negative or an absurd"),
     ("208__pxp_tt", f"27-JUL-{'9' * 20} 17:37:45.00 2263261\n", "line 1: no ping"),
     ("208__RPH_TWTT", f"{'7' * 20}.0 1 2 3\n", "line 1: not a time and 3 numbers"),
     ("208__pxp_tt", "27-JUL-22 17:37:45.00 0 0 0\n", "no reply in any ping"),
     ("208__pxp_tt", "28-JUL-22 17:37:45.00 2263261 0 0\n", r"clocks disagree.*J2000 begins"),
     ("208__GPS_POS_FREED", "712215465.0 GPSPOS 1 2 3 0.01 0.02\n", "line 1: not a time and 6 numbers")],
)  # fmt: skip
def test_gnatss_files_that_cannot_be_used(gnatss, name, text, match):
    with pytest.raises(InputError, match=match):
        read_gnatss(gnatss(**{name: text}))


def test_gnatss_folders_that_lack_files(gnatss, tmp_path):
    folder = gnatss()
    (folder / "208/RPH_TWTT").unlink()
    with pytest.raises(InputError, match="no file RPH_TWTT"):
        read_gnatss(folder)
    with pytest.raises(InputError, match="no folder '209' of a day"):
        read_gnatss(folder, day="209")
    with pytest.raises(InputError, match="no such file"):
        read_gnatss(tmp_path / "nowhere")


# --- GARPOS -------------------------------------------------------------------------------------------------

INI = """[Obs-parameter]
 Date(UTC)   = 2019-03-15
[Site-parameter]
 Latitude0   =  34.96
 Longitude0  = 139.26
 Height0     =  43.00
 Stations    = M1 M2
# a comment
[Model-parameter]
 M1_dPos    =    -47.0    408.0  -1345.0      3.0   3.0
 M2_dPos    =    486.0     48.0  -1354.0      3.0   3.0
 ATDoffset  =      1.5     -1.25   23.75      0.0
"""
HEAD = (
    ",SET,MT,TT,flag,ST,ant_e0,ant_n0,ant_u0,head0,pitch0,roll0,RT,ant_e1,ant_n1,ant_u1,head1,pitch1,roll1\n"
)
SHOT = (
    "0,S01,M1,2.25,False,30072.395125,-27.0,1473.0,14.7,176.0,0.5,-1.5,"
    "30075.74594,-26.0,1462.0,14.3,-10,-0.5,-1\n"
)


@pytest.fixture
def garpos(tmp_path):
    def write(ini=INI, obs=HEAD + SHOT, svp="depth,speed\n0,1510\n1400,1480\n"):
        (tmp_path / "a-initcfg.ini").write_text(ini)
        (tmp_path / "a-obs.csv.gz").write_bytes(gzip.compress(f"# cfg\n{obs}".encode()))
        (tmp_path / "a-svp.csv").write_text(svp)
        return tmp_path

    return write


def test_garpos(garpos):
    log = read_garpos(garpos())
    (o,) = log.observations
    midnight = utc_to_ns(2019, 3, 15)
    assert (o.t_ns, o.keys, o.y[0]) == (midnight + 30075_745_940_000, ("lbl:R.M1",), 2.25)
    assert o.aux["t0_ns"][0] == midnight + 30072_395_125_000
    assert (log.lever_arm_m, log.sea_height_m) == ((1.5, -1.25, 23.75), pytest.approx(43.0))
    np.testing.assert_allclose(
        np.degrees(log.attitude.attitude_rad), [[-1.5, 0.5, 176.0], [-1.0, -0.5, 350.0]]
    )
    # 14.7 m above the plane that touches 43 m at the site; 1.5 km off it the Earth has fallen away 0.17 m
    height = ecef_to_geodetic(log.attitude.position_m)[0, 2]
    assert height == pytest.approx(43.0 + 14.7 + 1473.0**2 / 2.0 / 6.36e6, abs=0.01)
    beacon = np.array([log.beacons["M1"][n] for n in ("x_m", "y_m", "z_m")])
    assert ecef_to_geodetic(beacon)[2] == pytest.approx(43.0 - 1345.0, abs=0.05)
    assert [f.t_ns for f in log.fixes] == [o.aux["t0_ns"][0], o.t_ns]


def test_garpos_shots_that_the_file_flags_are_left_out(garpos):
    log = read_garpos(garpos(obs=HEAD + SHOT + SHOT.replace("False,30072", "True,30073")))
    assert len(log.observations) == 1
    assert "1 shots that the file flags" in log.notes[0]


@pytest.mark.parametrize(
    ("changes", "match"),
    [({"ini": INI.replace(" M2_dPos", "#M2_dPos")}, "`M2_dPos` of .Model-parameter. does not hold 3 numbers"),
     ({"obs": HEAD + SHOT.replace("M1", "M7")}, "transponder M7 has no coordinates.*M7_dPos"),
     ({"ini": INI.replace("2019-03-15", "March")}, "no date"), ({"ini": "x"}, "is no INI file"),
     ({"obs": HEAD + SHOT.replace("2.25", "")}, "line 3: this line is no shot"),
     ({"obs": HEAD.replace("TT", "T") + SHOT}, "no column TT"), ({"obs": HEAD}, "no usable shot"),
     ({"svp": "depth,speed\n0,10\n9,10\n"}, "1300 and 1800")],
)  # fmt: skip
def test_garpos_files_that_cannot_be_used(garpos, changes, match):
    with pytest.raises(InputError, match=match):
        read_garpos(garpos(**changes))
