"""RINEX clock files."""

from dataclasses import replace

import numpy as np
import pytest
from conftest_samples import header_line

from pntegrity.errors import InputError
from pntegrity.formats.rinex_clk import read_clocks
from pntegrity.formats.sp3 import read_orbits
from pntegrity.physics.products import PreciseClocks
from pntegrity.physics.time import SECOND_NS, civil_to_ns, from_iso, to_iso

START = civil_to_ns(2020, 6, 25)


def row(sat, k, bias, step_s=30):
    stamp = to_iso(START + k * step_s * SECOND_NS)
    y, m, d = stamp[:10].split("-")
    return (
        f"AS {sat}  {y} {m} {d} {stamp[11:13]} {stamp[14:16]} {float(stamp[17:]):9.6f}"
        f"  2    {bias:.12E}  1.000000000000E-11\n"
    )


def bias(k):
    return 1e-5 + 1e-9 * k


def clk(rows, scale="GPS", agency="GRG"):
    return (
        header_line("     3.00           CLOCK DATA          G", "RINEX VERSION / TYPE")
        + (header_line(f"   {scale}", "TIME SYSTEM ID") if scale else "")
        + header_line("     2    AR    AS", "# / TYPES OF DATA")
        + header_line(f"{agency}  SOMEBODY", "ANALYSIS CENTER")
        + header_line("", "END OF HEADER")
        + "AR BRUX 2020 06 25 00 00  0.000000  1    1.000000000000E-06\n"
        + "".join(rows)
    )


def test_only_satellites_and_linear_between_samples(save):
    c = read_clocks(save(clk([row("G05", k, bias(k)) for k in range(5)]), "a.clk"))
    assert (c.sats, c.interval_s, c.kind, c.agency, c.notes) == (("G05",), 30.0, "CLK", "GRG", ())
    assert c.sources == ("a.clk (GRG, every 30 s, 2020-06-25 00:00 to 2020-06-25 00:02)",)
    assert c.series["G05"][0].tolist() == [START + 30 * k * SECOND_NS for k in range(5)]
    t = START + np.array([0, 15, 30, 100, 120]) * SECOND_NS
    value, ok = c.clock_s("G05", t, np.array([0.0, 0.0, 0.6, -0.3, 0.0]))
    assert ok.all()
    np.testing.assert_allclose(
        value, bias(np.array([0.0, 0.5, 1.02, 3.32333333333, 4.0])), atol=1e-16, rtol=0
    )


def test_no_extrapolation_and_nan_offsets(save):
    c = read_clocks(save(clk([row("G05", k, bias(k)) for k in range(5)])))
    s = SECOND_NS
    ends = START + np.array([-s, 0, 120 * s, 121 * s, 60])
    assert c.clock_s("G05", ends, [0, 0, 0, 0, np.nan])[1].tolist() == [False, True, True, False, False]
    # signals of the first epoch left before it: half a second on, the line of the first two samples
    value, ok = c.clock_s("G05", [START - s // 4, START + 120 * s + s // 4])
    assert ok.all()
    np.testing.assert_allclose(value, [bias(-0.25 / 30.0), bias(4 + 0.25 / 30.0)], rtol=1e-12)
    value, ok = c.clock_s("G12", ends)
    assert not ok.any()
    assert np.isnan(value).all()


def test_nothing_across_a_gap_or_a_break(save):
    c = read_clocks(save(clk([row("G05", k, bias(k)) for k in (0, 1, 2, 4, 5, 6, 7)])))
    at = [START + 30 * k * SECOND_NS for k in range(8)]
    assert c.restarts("G05").tolist() == [at[4]]
    ask = [at[2], at[2] + SECOND_NS, at[3], at[4] - SECOND_NS, at[4], at[5] + 1]
    assert c.clock_s("G05", ask)[1].tolist() == [True, False, False, False, True, True]
    broken = replace(c, breaks={"G05": np.array([at[6]])})
    assert broken.restarts("G05").tolist() == [at[4], at[6]]
    assert broken.clock_s("G05", [at[5], at[5] + SECOND_NS, at[6]])[1].tolist() == [True, False, True]
    assert c.restarts("G12").tolist() == []


def test_a_satellite_with_one_sample(save):
    c = read_clocks(save(clk([row("G05", 0, 1e-5)])))
    assert np.isnan(c.interval_s)
    assert c.clock_s("G05", [START, START + 1])[1].tolist() == [True, False]


@pytest.mark.parametrize(
    ("scale", "shift_s"),
    [("GPS", 0), ("GAL", 0), ("BDT", 14), ("UTC", 18), ("GLO", 18), ("TAI", -19), (None, 0)],
)
def test_time_scales_become_gps_time(save, scale, shift_s):
    c = read_clocks(save(clk([row("G05", k, bias(k)) for k in range(70)], scale)))
    expected = START + (np.arange(70) * 30 + shift_s) * SECOND_NS
    assert c.series["G05"][0].tolist() == expected.tolist()
    assert bool(c.notes) == (scale is None)


def test_files_are_joined_and_doubles_kept_once(save):
    a = save(clk([row("G05", k, bias(k)) for k in range(4)]), "a.clk")
    b = save(clk([row("G05", k, 2e-5) for k in range(3, 6)], agency="COD"), "b.clk")
    for paths in ([a, b], [b, a]):
        c = read_clocks(paths)
        assert len(c.series["G05"][0]) == 6
        np.testing.assert_array_equal(c.series["G05"][1][3:], 2e-5)
        assert c.agency == "GRG/COD"
        assert any("datum" in n for n in c.notes)


def test_rows_out_of_order_and_repeated(save):
    c = read_clocks(save(clk([row("G05", k, bias(k)) for k in (2, 0, 1, 1)])))
    np.testing.assert_allclose(c.series["G05"][1], bias(np.arange(3)), rtol=0, atol=1e-18)


def test_damaged_lines_are_left_out_and_told(save):
    rows = [row("G05", k, bias(k)) for k in range(4)]
    rows[1] = rows[1].replace("30.000000", "3x.000000")
    rows[2] = rows[2].replace("E-05", "E+05")
    c = read_clocks(save(clk(rows) + rows[3][:48], "a.clk"))
    assert c.series["G05"][0].tolist() == [START, START + 90 * SECOND_NS]
    assert any("a.clk: line 8 dropped" in n for n in c.notes)
    assert any("1 clock values dropped" in n for n in c.notes)
    assert any("cut off" in n for n in c.notes)


def test_bad_files_raise(save, obs3, tmp_path):
    with pytest.raises(InputError, match="holds 'OBSERVATION DATA', not clocks"):
        read_clocks(save(obs3))
    with pytest.raises(InputError, match="not a RINEX file"):
        read_clocks(save("hello\nworld\n"))
    with pytest.raises(InputError, match="no satellite clock can be used"):
        read_clocks(save(clk([])))
    with pytest.raises(InputError, match="header does not end"):
        read_clocks(save(clk([])[:200]))
    with pytest.raises(InputError, match="time system is unknown"):
        read_clocks(save(clk([row("G05", 0, 1e-5)], "XYZ")))
    with pytest.raises(InputError, match="no such file"):
        read_clocks(tmp_path / "nothing")
    with pytest.raises(InputError, match="no clock file given"):
        read_clocks([])


def test_a_series_must_rise():
    with pytest.raises(ValueError, match="strictly rising"):
        PreciseClocks({"G05": (np.array([1, 1]), np.zeros(2))}, 30.0, "CLK")


def test_shared_file(shared):
    esbc = shared / "esbc-static-2020177"
    c = read_clocks(next(esbc.glob("*CLK.gz")))
    assert (len(c.sats), c.interval_s, c.agency) == (75, 30.0, "GRG")
    # G21 lacks 01:50:00; nobody else lacks anything.
    hole = from_iso("2020-06-25T01:50:00")
    assert {s: c.restarts(s).tolist() for s in c.sats if len(c.restarts(s))} == {
        "G21": [hole + 30 * SECOND_NS]
    }
    ask = hole + np.array([-30, -29, 0, 29, 30]) * SECOND_NS
    assert c.clock_s("G21", ask)[1].tolist() == [True, False, False, False, True]
    # The same centre's SP3 file holds the same clocks at its epochs, apart from its last digit, 1 ps.
    o = read_orbits(sorted(esbc.glob("*SP3.gz")))
    quarters = from_iso("2020-06-25") + np.arange(0, 27) * 900 * SECOND_NS
    for sat in c.sats:
        a, b = (k.clock_s(sat, quarters)[0] for k in (c, o.clocks))
        np.testing.assert_allclose(a - b, 0.0, atol=1e-12)
