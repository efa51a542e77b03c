"""ANTEX files."""

import math

import numpy as np
import pytest
from conftest_samples import header_line

from pntegrity.errors import InputError
from pntegrity.formats.antex import read_antex
from pntegrity.physics.time import civil_to_ns, from_iso

T = civil_to_ns(2020, 6, 25)


def section(code, pco_mm, rows):
    text = header_line(f"   {code}", "START OF FREQUENCY")
    text += header_line("".join(f"{v:10.2f}" for v in pco_mm), "NORTH / EAST / UP")
    for name, values in rows:
        text += f"{name:>8}" + "".join(f"{v:8.2f}" for v in values) + "\n"
    return text + header_line(f"   {code}", "END OF FREQUENCY")


def antenna(kind, serial, sections, dazi=0.0, zenith=(0.0, 2.0, 1.0), valid=()):
    zen = "".join(f"{v:6.1f}" for v in zenith)
    return (
        header_line("", "START OF ANTENNA")
        + header_line(f"{kind:<20}{serial:<20}", "TYPE / SERIAL NO")
        + header_line(f"{'ROBOT':<20}{'TEST':<20}{1:6d}    01-JAN-20", "METH / BY / # / DATE")
        + header_line(f"  {dazi:6.1f}", "DAZI")
        + header_line(f"  {zen}", "ZEN1 / ZEN2 / DZEN")
        + header_line(f"{len(sections):6d}", "# OF FREQUENCIES")
        + "".join(header_line(text, label) for label, text in valid)
        + "".join(sections)
        + header_line("", "END OF ANTENNA")
    )


def antex(*antennas, kind="A"):
    return (
        header_line(f"{1.4:8.1f}{'':12}M", "ANTEX VERSION / SYST")
        + header_line(kind, "PCV TYPE / REFANT")
        + header_line("", "END OF HEADER")
        + "".join(antennas)
    )


def satellite(serial="G05", z=1000.0, **more):
    noazi = [("NOAZI", (1.0, 2.0, 4.0))]
    sections = [
        section("G01", (100.0, -20.0, z), noazi),
        section("G02", (100.0, -20.0, z + 1), [("NOAZI", (0.0, 0.0, -3.0))]),
    ]
    return antenna("BLOCK IIF", serial, sections, **more)


AZIMUTHS = [
    ("NOAZI", (0.0, 0.0, 0.0)),
    *[(f"{a:.1f}", (0.0, 1.0 + a / 90.0, 10.0 + (a % 360.0) / 90.0)) for a in (0.0, 90.0, 180.0, 270.0)],
    ("360.0", (0.0, 1.0, 10.0)),
]


def receiver(kind="TRM59800.00     SCIS", serial="", up=90.0):
    sections = [
        section("G01", (1.0, 2.0, up), AZIMUTHS),
        section("G02", (3.0, 4.0, up + 30.0), AZIMUTHS),
        section("R02", (5.0, 6.0, up + 31.0), AZIMUTHS),
    ]
    return antenna(kind, serial, sections, dazi=90.0)


def test_a_satellite(save):
    found = read_antex(save(antex(satellite()))).satellite("G05", T)
    assert (found.block, found.valid_ns) == ("BLOCK IIF", (None, None))
    np.testing.assert_allclose(found.pco_m["1"], [0.1, -0.02, 1.0])
    np.testing.assert_allclose(found.pco_m["2"], [0.1, -0.02, 1.001])
    np.testing.assert_allclose(
        found.pcv_m("1", np.radians([0.0, 0.5, 1.5, 2.0, 9.0])), [1e-3, 1.5e-3, 3e-3, 4e-3, 4e-3]
    )
    assert not found.pco_m["1"].flags.writeable


def test_a_band_that_is_not_calibrated_is_taken_from_the_nearest(save):
    found = read_antex(save(antex(satellite()))).satellite("G05", T)
    assert found.calibrated_band("1") == ("1", "")
    assert found.calibrated_band("5") == ("2", "G05: no offset for band 5, band 2 taken")
    assert found.pcv_m("5", math.radians(2.0)) == pytest.approx(-3e-3)


def test_the_satellite_of_that_time(save):
    first = [("VALID FROM", "  2010     1     1     0     0    0.0000000")]
    first.append(("VALID UNTIL", "  2015     6    30    23    59   59.9999999"))
    then = [("VALID FROM", "  2016     1     1     0     0    0.0000000")]
    a = read_antex(save(antex(satellite(z=500.0, valid=first), satellite(z=700.0, valid=then))))
    assert a.satellite("G05", civil_to_ns(2012, 1, 1)).pco_m["1"][2] == pytest.approx(0.5)
    assert a.satellite("G05", T).pco_m["1"][2] == pytest.approx(0.7)
    assert a.satellite("G05", T).valid_ns == (civil_to_ns(2016, 1, 1), None)
    assert a.satellite("G05", civil_to_ns(2015, 10, 1)) is None
    assert a.satellite("G05", civil_to_ns(2009, 1, 1)) is None
    assert a.satellite("G06", T) is None


def test_a_receiver_over_zenith_and_azimuth(save):
    found = read_antex(save(antex(satellite(), receiver()))).receiver("TRM59800.00     SCIS")
    assert (found.antenna, found.radome, found.notes) == ("TRM59800.00", "SCIS", ())
    np.testing.assert_allclose(found.pco_neu_m[("G", "1")], [0.001, 0.002, 0.09])
    zenith = np.radians([0.0, 1.0, 1.0, 1.5, 2.0, 2.0, 1.0, 9.0])
    azimuth = np.radians([45.0, 0.0, 45.0, 90.0, 315.0, -45.0, 405.0, 90.0])
    expected = [0.0, 1.0, 1.5, 6.5, 11.5, 11.5, 1.5, 11.0]
    np.testing.assert_allclose(found.pcv_m("G", "1", zenith, azimuth), np.array(expected) * 1e-3, atol=1e-12)


def test_a_receiver_band_is_taken_from_the_nearest(save):
    found = read_antex(save(antex(receiver()))).receiver("TRM59800.00 SCIS")
    assert found.calibrated_band("G", "2") == (("G", "2"), "")
    assert found.calibrated_band("E", "1")[0] == ("G", "1")
    assert found.calibrated_band("R", "1") == (("G", "1"), "TRM59800.00: G1 taken for R1")
    assert found.calibrated_band("E", "7")[0] == ("G", "2")
    assert found.pcv_m("E", "1", math.radians(2.0), 0.0) == pytest.approx(0.010)


def test_a_radome_that_is_not_calibrated(save):
    a = read_antex(save(antex(receiver("AOAD/M_T        NONE", up=50.0), receiver())))
    found = a.receiver("AOAD/M_T        SCIS")
    assert found.radome == "NONE"
    assert found.pco_neu_m[("G", "1")][2] == pytest.approx(0.05)
    assert "not calibrated with radome SCIS" in found.notes[0]
    assert a.receiver("aoad/m_t").notes == ()
    assert a.receiver("TRM59800.00     NONE") is None
    assert a.receiver("") is None


def test_the_mean_of_a_type_comes_before_a_single_antenna(save):
    text = antex(receiver(serial="12345", up=50.0), receiver(up=60.0))
    found = read_antex(save(text)).receiver("TRM59800.00     SCIS")
    assert found.pco_neu_m[("G", "1")][2] == pytest.approx(0.06)
    alone = read_antex(save(antex(receiver(serial="12345")))).receiver("TRM59800.00     SCIS")
    assert "serial number 12345" in alone.notes[0]


def test_of_two_files_the_first_counts(save):
    a, b = save(antex(satellite(z=1.0)), "a.atx"), save(antex(satellite(z=2.0), receiver()), "b.atx")
    found = read_antex([a, b])
    assert found.satellite("G05", T).pco_m["1"][2] == pytest.approx(0.001)
    assert found.receiver("TRM59800.00     SCIS") is not None
    assert found.sources == ("a.atx (antennas: 1)", "b.atx (antennas: 2)")


def test_bad_files_raise(save, obs3, tmp_path):
    with pytest.raises(InputError, match="not an ANTEX file"):
        read_antex(save(obs3))
    with pytest.raises(InputError, match="relative"):
        read_antex(save(antex(satellite(), kind="R")))
    with pytest.raises(InputError, match="holds no antenna"):
        read_antex(save(antex()))
    with pytest.raises(InputError, match="does not end"):
        read_antex(save(antex(satellite())[:-300]))
    with pytest.raises(InputError, match="cannot be read"):
        read_antex(save(antex(satellite()).replace("1000.00", "10x0.00")))
    with pytest.raises(InputError, match="no such file"):
        read_antex(tmp_path / "nothing")
    with pytest.raises(InputError, match="no antenna file given"):
        read_antex([])


def test_shared_file(shared):
    a = read_antex(shared / "antex/igs14_sats_only.atx.gz")
    g01 = a.satellite("G01", from_iso("2020-06-25"))
    assert g01.block == "BLOCK IIF"
    np.testing.assert_allclose(g01.pco_m["1"], [0.394, 0.0, 1.5018], atol=1e-9)
    assert a.satellite("G01", from_iso("1995-01-01")).block == "BLOCK IIA"
    c06 = a.satellite("C06", from_iso("2022-01-01"))
    assert set(c06.pco_m) == {"1", "2", "6", "7"}
    assert c06.pco_m["6"][2] == pytest.approx(2.77)
    assert c06.calibrated_band("5")[0] == "7"
    assert set(a.satellite("E11", T).pco_m) == {"1", "5", "6", "7", "8"}
    assert a.receiver("TRM59800.00     SCIS") is None
