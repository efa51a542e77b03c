"""Files of code biases."""

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.bias import read_biases
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.physics.products import CodeBiases
from pntegrity.physics.time import civil_to_ns, from_iso

NOON = civil_to_ns(2021, 3, 19, 12)


def osb(sat, obs, ns, start="2021:078:00000", end="2021:079:00000", station=""):
    return f" OSB  G063 {sat:3} {station:9} {obs:4} {'':4} {start} {end} ns   {ns:21.4f} {0.006:11.4f}\n"


def dsb(sat, a, b, ns, start="2021:078:00000", end="2021:079:00000", station=""):
    return f" DSB  G063 {sat:3} {station:9} {a:4} {b:4} {start} {end} ns   {ns:21.4f} {0.006:11.4f}\n"


def sinex(rows, mode="ABSOLUTE", end=True):
    return (
        f"%=BIA 1.00 TST 2021:085:57514 TST 2021:078:00000 2021:079:00000 A {len(rows):08d}\n"
        "+BIAS/DESCRIPTION\n"
        f" BIAS_MODE                               {mode}\n"
        " TIME_SYSTEM                             G  \n"
        " SATELLITE_CLOCK_REFERENCE_OBSERVABLES   G  C1W  C2W \n"
        "-BIAS/DESCRIPTION\n"
        "+BIAS/SOLUTION\n"
        "*BIAS SVN_ PRN STATION__ OBS1 OBS2 BIAS_START____ BIAS_END______ UNIT __ESTIMATED_VALUE____\n"
        + "".join(rows)
        + "-BIAS/SOLUTION\n"
        + ("%=ENDBIA\n" if end else "")
    )


def dcb(pair, rows, month=3):
    return (
        f"CODE'S MONTHLY GNSS {pair} DCB SOLUTION, YEAR 2021, MONTH {month:02d}      08-APR-21 08:42\n"
        + "-" * 80
        + f"\n\nDIFFERENTIAL ({pair}) CODE BIASES FOR SATELLITES AND RECEIVERS:\n\n"
        "PRN / STATION NAME        VALUE (NS)  RMS (NS)\n***   ****************    *****.***   *****.***\n"
        + "".join(f"{sat}{'':23}{value:9.3f}{0.001:12.3f}\n" for sat, value in rows)
        + "\n"
    )


def test_absolute_biases(save):
    rows = [osb("G01", "C1C", -1.5), osb("G01", "C1W", 0.25), osb("G01", "C2W", 0.5), osb("G01", "L1C", 0.1)]
    b = read_biases(save(sinex(rows), "a.bia"), NOON)
    assert b.osb_s == pytest.approx({("G01", "1C"): -1.5e-9, ("G01", "1W"): 0.25e-9, ("G01", "2W"): 0.5e-9})
    assert b.difference_s("G01", "1C", "1W") == pytest.approx(-1.75e-9)
    assert b.difference_s("G01", "1W", "1C") == pytest.approx(1.75e-9)
    assert b.difference_s("G01", "1C", "1C") == 0.0
    assert b.difference_s("G01", "1C", "5Q") is None
    assert b.difference_s("G02", "1C", "1W") is None
    assert b.clock_reference == {"G": ("1W", "2W")}
    assert b.sources == ("a.bia (3 code biases)",)
    assert b.notes == ("a.bia: 1 phase biases left out",)


def test_differential_biases_also_in_steps(save):
    rows = [dsb("G01", "C1C", "C1W", -1.0), dsb("G01", "C1C", "C2W", 3.0), dsb("G01", "C2W", "C2X", 0.5)]
    rows += [dsb("G02", "C1W", "C1C", 4.0), dsb("G", "C1C", "C1W", 9.0, station="CUT0")]
    b = read_biases(save(sinex(rows, "RELATIVE")), NOON)
    assert set(b.dsb_s) == {
        ("G01", "1C", "1W"),
        ("G01", "1C", "2W"),
        ("G01", "2W", "2X"),
        ("G02", "1W", "1C"),
    }
    assert b.difference_s("G01", "1C", "1W") == pytest.approx(-1e-9)
    assert b.difference_s("G01", "1W", "1C") == pytest.approx(1e-9)
    assert b.difference_s("G01", "2X", "2W") == pytest.approx(-0.5e-9)
    assert b.difference_s("G01", "1W", "2X") == pytest.approx((1.0 + 3.0 + 0.5) * 1e-9)
    assert b.difference_s("G02", "1C", "1W") == pytest.approx(-4e-9)
    assert b.difference_s("G02", "1C", "2W") is None


def test_absolute_biases_come_before_differential_ones():
    b = CodeBiases({("G01", "1C"): 2e-9, ("G01", "1W"): 1e-9}, {("G01", "1C", "1W"): 7e-9}, 0)
    assert b.difference_s("G01", "1C", "1W") == pytest.approx(1e-9)


def test_only_what_holds_at_that_time(save):
    rows = [
        osb("G01", "C1C", 1.0, "2021:077:00000", "2021:078:00000"),
        osb("G01", "C1C", 2.0),
        osb("G01", "C1W", 3.0, "2021:070:00000", "2021:090:00000"),
    ]
    path = save(sinex(rows))
    assert read_biases(path, NOON).osb_s == pytest.approx({("G01", "1C"): 2e-9, ("G01", "1W"): 3e-9})
    early = read_biases(path, civil_to_ns(2021, 3, 18, 12))
    assert early.osb_s == pytest.approx({("G01", "1C"): 1e-9, ("G01", "1W"): 3e-9})
    with pytest.raises(InputError, match="no code bias of a satellite holds at 2021-06-01 00:00"):
        read_biases(path, civil_to_ns(2021, 6, 1))


def test_codes_monthly_tables(save):
    one = save(dcb("P1-C1", [("G01", 1.0), ("R03", 0.5)]), "P1C1.DCB")
    two = save(dcb("P1-P2", [("G01", -7.0)]), "P1P2.DCB")
    b = read_biases([one, two], NOON)
    assert b.difference_s("G01", "1C", "1W") == pytest.approx(-1e-9)
    assert b.difference_s("R03", "1P", "1C") == pytest.approx(0.5e-9)
    assert b.difference_s("G01", "1C", "2W") == pytest.approx(-8e-9)
    with pytest.raises(InputError, match="another time"):
        read_biases(one, civil_to_ns(2021, 4, 2))


def test_of_two_files_the_later_counts(save):
    a, b = (save(sinex([osb("G01", "C1C", v)]), f"{v}.bia") for v in (1.0, 2.0))
    assert read_biases([a, b], NOON).osb_s[("G01", "1C")] == pytest.approx(2e-9)


def test_a_cut_file_is_told(save):
    b = read_biases(save(sinex([osb("G01", "C1C", 1.0)], end=False)), NOON)
    assert any("ENDBIA" in n for n in b.notes)


def test_a_damaged_record_is_left_out_and_told(save):
    text = sinex([osb("G01", "C1C", 1.0), osb("G02", "C1C", 2.0)]).replace("2.0000", "2.x000")
    b = read_biases(save(text), NOON)
    assert list(b.osb_s) == [("G01", "1C")]
    assert any("1 records dropped" in n for n in b.notes)


def test_bad_files_raise(save, obs3, tmp_path):
    with pytest.raises(InputError, match="no file of code biases"):
        read_biases(save(obs3), NOON)
    with pytest.raises(InputError, match="no such file"):
        read_biases(tmp_path / "nothing", NOON)
    with pytest.raises(InputError, match="no bias file given"):
        read_biases([], NOON)
    with pytest.raises(InputError, match="no code bias"):
        read_biases(save(sinex([])), NOON)
    with pytest.raises(InputError, match="cannot be read"):
        read_biases(save(dcb("P1-C1", [("G01", 1.0)]).replace("YEAR 2021", "YEAR xxxx")), NOON)


def test_the_sign_agrees_with_real_observations(shared):
    """C1C - C1W of a receiver scatters over the satellites as their biases of that day do."""
    clas = shared / "clas-sept-2021078"
    table = read_observations(clas / "SEPT078M.21O.gz")
    b = read_biases(next(clas.glob("*OSB.BIA.gz")), int(table.t_ns[0]))
    seen, told = [], []
    for sat in np.unique(table.sat[np.char.startswith(table.sat, "G")]).tolist():
        rows = [(table.sat == sat) & (table.signal == s) for s in ("1C", "1W")]
        common = np.intersect1d(*(table.epoch[r] for r in rows))
        expected = b.difference_s(sat, "1C", "1W")
        if len(common) > 100 and expected is not None:
            codes = (table.pseudorange_m[r & np.isin(table.epoch, common)] for r in rows)
            seen.append(float(np.nanmedian(np.subtract(*codes))) / 299_792_458.0)
            told.append(expected)
    assert len(seen) > 6
    assert np.corrcoef(seen, told)[0, 1] > 0.9
    assert np.polyfit(told, seen, 1)[0] == pytest.approx(1.0, abs=0.2)


def test_shared_files(shared):
    clas = next((shared / "clas-sept-2021078").glob("*OSB.BIA.gz"))
    b = read_biases(clas, NOON)
    assert b.difference_s("G01", "1C", "1W") == pytest.approx(-1.4928e-9)
    assert b.clock_reference["E"] == ("1C", "5Q")
    cpt, day = shared / "cpt-van-2019087", from_iso("2019-03-28T12:00")
    code = read_biases(sorted(cpt.glob("P*.DCB.gz")), day)
    cas = read_biases(cpt / "CAS0MGXRAP_20190870000_01D_01D_DCB.BSX.gz", day)
    assert code.difference_s("G01", "1C", "1W") == pytest.approx(-1.0e-9)
    assert code.difference_s("R01", "1P", "1C") == pytest.approx(-0.135e-9)
    both = [
        (code.difference_s(f"G{n:02d}", "1C", "1W"), cas.difference_s(f"G{n:02d}", "1C", "1W"))
        for n in range(1, 33)
    ]
    apart = np.array([(x, y) for x, y in both if x is not None and y is not None])
    assert len(apart) > 28
    assert np.abs(apart[:, 0] - apart[:, 1]).max() < 0.3e-9
    assert cas.difference_s("G05", "2X", "2W") is not None
    assert cas.difference_s("R01", "1C", "1P") is not None
