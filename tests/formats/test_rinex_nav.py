"""Navigation files."""

import pytest
from conftest_samples import NAV_GPS, header_line, nav3_header, nav_record

from pntegrity.errors import InputError
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.physics.time import civil_to_ns

TOE = civil_to_ns(2024, 2, 3, 4, 0, 0)


def test_everything_is_found(nav3, save):
    n = read_navigation([save(nav3)])
    assert (n.systems, len(n.kepler), len(n.glonass)) == ("GR", 2, 1)
    assert n.klobuchar["G"].alpha == (1.1176e-08, 7.4506e-09, -5.9605e-08, -5.9605e-08)
    assert n.leap_seconds == 18
    assert n.glonass_channels == {"R03": 5}
    assert n.notes == ()


def test_reference_times_are_gps_time(nav3, save):
    n = read_navigation(save(nav3))
    assert n.of("G05")[1].tolist() == [TOE]
    assert n.of("R03")[1].tolist() == [TOE + (15 * 60 + 18) * 10**9]
    assert n.coverage_ns == (TOE, TOE + (15 * 60 + 18) * 10**9)


def test_beidou_time_is_14_s_behind(save):
    rows = [list(r) for r in NAV_GPS]
    rows[5][2] = 943.0  # BeiDou week of the same day
    n = read_navigation(save(nav3_header() + nav_record("C11 2024 02 03 04 00 00", rows)))
    assert n.of("C11")[1].tolist() == [TOE + 14 * 10**9]


def test_two_files_are_one_store_without_doubles(nav3, save):
    n = read_navigation([save(nav3, "a.rnx"), save(nav3, "b.rnx")])
    assert (len(n.kepler), len(n.glonass), len(n.sources)) == (2, 1, 2)
    assert "a.rnx (GR, 2024-02-03 04:00 to 2024-02-03 04:15)" in n.sources


def test_of_equal_reference_times_the_later_upload_wins(save):
    early, late = [list(r) for r in NAV_GPS], [list(r) for r in NAV_GPS]
    late[7][0], late[0][0] = 530_000.0, -2.0e-4
    head = "G05 2024 02 03 04 00 00"
    n = read_navigation(save(nav3_header() + nav_record(head, late) + nav_record(head, early)))
    assert n.of("G05")[0][-1].clock.af0 == -2.0e-4


@pytest.mark.parametrize("version", ["     2.10", "     2   "])
def test_rinex_2(save, version):
    text = header_line(f"{version}           N: GPS NAV DATA", "RINEX VERSION / TYPE")
    text += header_line("  1.1176D-08  7.4506D-09 -5.9605D-08 -5.9605D-08", "ION ALPHA")
    text += header_line("  9.0112D+04  0.0000D+00 -1.9661D+05 -6.5536D+04", "ION BETA")
    text += header_line("", "END OF HEADER")
    rows = nav_record(" 5 24  2  3  4  0  0.0", NAV_GPS).replace("\n    ", "\n   ")
    n = read_navigation(save(text + rows))
    assert n.of("G05")[1].tolist() == [TOE]
    assert n.klobuchar["G"].beta == (90112.0, 0.0, -196610.0, -65536.0)


def test_a_damaged_record_is_left_out_and_told(nav3, save):
    n = read_navigation(save(nav3.replace("5.153700000000E+03", "5.1537xx000000E+03", 1)))
    assert len(n.kepler) == 1
    assert any("G05 dropped" in note for note in n.notes)


def test_impossible_orbits_are_left_out_and_told(save):
    rows = [list(r) for r in NAV_GPS]
    rows[4][0] = 0.96 / 3.141592653589793  # semicircles for radians
    heads = (f"C{k} 2024 02 03 04 00 00" for k in (11, 12, 13))
    text = nav3_header() + nav_record("G05 2024 02 03 04 00 00", NAV_GPS)
    n = read_navigation(save(text + "".join(nav_record(h, rows) for h in heads)))
    assert n.systems == "G"
    assert any("3 ephemerides dropped" in note and "BeiDou" in note for note in n.notes)


def test_nothing_usable_raises(save, obs3, tmp_path):
    with pytest.raises(InputError, match="not navigation"):
        read_navigation(save(obs3))
    with pytest.raises(InputError, match="no ephemeris"):
        read_navigation(save(nav3_header()))
    with pytest.raises(InputError, match="no such file"):
        read_navigation(tmp_path / "nothing")
    with pytest.raises(InputError, match="no navigation file given"):
        read_navigation([])


def test_shared_files(shared):
    tst = shared / "tst-urban-2019118"
    n = read_navigation([tst / "hksc1180.19n.gz", tst / "hksc1180.19b.gz"])
    assert n.systems == "GC"
    assert {"G", "C"} <= set(n.klobuchar)
    clas = shared / "clas-sept-2021078"
    assert read_navigation([clas / "SEPT078M.21P.gz", clas / "30340780.21q.gz"]).systems == "GEJ"
    assert read_navigation(shared / "cpt-van-2019087/brdc0870.19n.gz").systems == "G"
    assert read_navigation(shared / "imu-walk-2025240/walk.nav.gz").systems == "GEC"
