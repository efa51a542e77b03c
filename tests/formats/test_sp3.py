"""SP3 files."""

import gzip
import math

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.sp3 import read_orbits
from pntegrity.physics.time import DAY_NS, SECOND_NS, civil_to_ns, from_iso, to_iso

DAY1 = civil_to_ns(2024, 2, 3)
NO_CLOCK = 999999.999999
RADIUS, RATE, TILT = 26_560e3, 2.0 * math.pi / 43_080.0, 0.96
NODE = {"G05": 0.3, "E11": 1.7}


def place(sat, t_ns):
    """A circular orbit, m, in the axes of the file."""
    a = RATE * (np.asarray(t_ns) - DAY1) / SECOND_NS + NODE[sat]
    return RADIUS * np.stack([np.cos(a), np.sin(a) * math.cos(TILT), np.sin(a) * math.sin(TILT)], axis=-1)


def clock_us(sat, t_ns):
    return 100.0 + 10.0 * NODE[sat] + 1e-3 * (t_ns - DAY1) / SECOND_NS / 900.0


def sp3(
    day=DAY1,
    epochs=96,
    step_s=900,
    scale="GPS",
    agency="TEST",
    frame="IGb14",
    sats=("E11", "G05"),
    absent=(),
    clockless=(),
    jumps=(),
    offset_us=0.0,
):
    """One file; `absent`, `clockless` and `jumps` hold (satellite, index of the epoch)."""
    y, m, d = to_iso(day)[:10].split("-")
    names = "".join(sats) + "  0" * (17 - len(sats))
    lines = [
        f"#dP{y} {int(m):2d} {int(d):2d}  0  0  0.00000000 {epochs:7d} ORBIT {frame} FIT {agency:>4}",
        f"## 2299 518400.00000000 {step_s:14.8f} 60343 0.0000000000000",
        f"+  {len(sats):3d}   {names}",
        *["+        " + "  0" * 17] * 4,
        *["++       " + "  5" * 17] * 5,
        f"%c M  cc {scale} ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%f  1.2500000  1.025000000  0.00000000000  0.000000000000000",
        "%f  0.0000000  0.000000000  0.00000000000  0.000000000000000",
        *["%i    0    0    0    0      0      0      0      0         0"] * 2,
        *["/* written by a test"] * 4,
    ]
    for k in range(epochs):
        t = day + k * step_s * SECOND_NS
        y, m, d, hh, mm = (int(n) for n in to_iso(t)[:16].replace("T", "-").replace(":", "-").split("-"))
        lines.append(f"*  {y} {m:2d} {d:2d} {hh:2d} {mm:2d}  0.00000000")
        for sat in sats:
            x, y_, z = (0.0, 0.0, 0.0) if (sat, k) in absent else place(sat, t) / 1e3
            c = NO_CLOCK if (sat, k) in clockless else clock_us(sat, t) + offset_us
            flag = "              E" if (sat, k) in jumps else ""
            lines.append(f"P{sat}{x:14.6f}{y_:14.6f}{z:14.6f}{c:14.6f}{flag}")
    return "\n".join([*lines, "EOF", ""])


def test_positions_and_clocks(save):
    o = read_orbits(save(sp3(), "a.sp3"))
    assert (o.sats, o.interval_s, o.agency, o.frame) == (("E11", "G05"), 900.0, "TEST", "IGb14")
    assert o.coverage_ns == (DAY1, DAY1 + 95 * 900 * SECOND_NS)
    assert o.sources == ("a.sp3 (TEST, GE, 2024-02-03 00:00 to 2024-02-03 23:45)",)
    assert o.notes == ()
    t = DAY1 + np.array([12_000, 43_210, 50_000]) * SECOND_NS
    offset = np.array([-0.07, 0.0, 0.25])
    for sat in o.sats:
        p, ok = o.position_m(sat, t, offset)
        assert ok.all()
        np.testing.assert_allclose(p, place(sat, t + np.rint(offset * 1e9).astype(np.int64)), atol=0.005)
        c, ok = o.clocks.clock_s(sat, t, offset)
        assert ok.all()
        np.testing.assert_allclose(c, clock_us(sat, t + offset * 1e9) * 1e-6, atol=2e-12)


def test_two_days_with_a_shared_midnight(save):
    first = save(sp3(epochs=97), "a.sp3")
    second = save(sp3(DAY1 + DAY_NS, offset_us=0.5), "b.sp3")
    for paths in ([first, second], [second, first]):
        o = read_orbits(paths)
        assert len(o.t_ns) == 192
        assert (np.diff(o.t_ns) == 900 * SECOND_NS).all()
        assert o.notes == ()
        midnight = DAY1 + DAY_NS
        p, ok = o.position_m("G05", midnight + np.array([-400, 0, 400]) * SECOND_NS)
        assert ok.all()
        np.testing.assert_allclose(
            p, place("G05", midnight + np.array([-400, 0, 400]) * SECOND_NS), atol=0.005
        )
        t, bias = o.clocks.series["G05"]
        assert len(t) == 192
        expected = clock_us("G05", t) + np.where(t >= midnight, 0.5, 0.0)
        np.testing.assert_allclose(bias, expected * 1e-6, atol=1e-12)


def test_nothing_across_a_missing_day_or_outside(save):
    o = read_orbits([save(sp3(), "a.sp3"), save(sp3(DAY1 + 2 * DAY_NS), "b.sp3")])
    last, again = DAY1 + 95 * 900 * SECOND_NS, DAY1 + 2 * DAY_NS
    inside = np.array([DAY1, last, again, o.coverage_ns[1]])
    outside = np.array(
        [DAY1 - SECOND_NS, last + 10**9, last + 2 * SECOND_NS, DAY1 + DAY_NS, again - SECOND_NS]
    )
    outside = np.append(outside, o.coverage_ns[1] + SECOND_NS)
    for ask in (o.position_m, o.clocks.clock_s):
        value, ok = ask("G05", inside)
        assert ok.all()
        value, ok = ask("G05", outside)
        assert not ok.any()
        assert np.isnan(value).all()
    assert o.clocks.restarts("G05").tolist() == [again]
    assert not o.position_m("G07", inside)[1].any()
    assert not o.clocks.clock_s("G07", inside)[1].any()


def test_absent_positions_and_clocks(save):
    o = read_orbits(save(sp3(absent=[("G05", 40)], clockless=[("G05", 60), ("E11", 95)])))
    at = [DAY1 + k * 900 * SECOND_NS for k in range(96)]
    assert sorted(set(at) - set(o.nodes["G05"].tolist())) == [at[40]]
    assert o.covers("G05", [at[39], at[40], at[40] + 1, at[41]]).tolist() == [True, False, False, True]
    assert not o.position_m("G05", [at[39] + SECOND_NS, at[40]])[1].any()
    assert o.position_m("E11", at[40])[1].all()
    # A record without a position may still hold a clock.
    assert o.clocks.clock_s("G05", at[40])[1]
    assert not o.clocks.clock_s("G05", [at[60], at[60] - 1])[1].any()
    assert o.clocks.restarts("G05").tolist() == [at[61]]
    assert o.clocks.restarts("E11").tolist() == []
    assert not o.clocks.clock_s("E11", at[95])[1]


def test_no_interpolation_to_a_flagged_jump(save):
    o = read_orbits(save(sp3(jumps=[("G05", 10)])))
    jump = DAY1 + 9000 * SECOND_NS
    assert o.clocks.restarts("G05").tolist() == [jump]
    ok = o.clocks.clock_s("G05", [jump - SECOND_NS, jump, jump + SECOND_NS])[1]
    assert ok.tolist() == [False, True, True]
    assert o.clocks.clock_s("E11", [jump - SECOND_NS])[1].all()


@pytest.mark.parametrize(
    ("scale", "shift_s"),
    [("GPS", 0), ("GAL", 0), ("QZS", 0), ("BDT", 14), ("UTC", 18), ("GLO", 18), ("TAI", -19)],
)
def test_time_scales_become_gps_time(save, scale, shift_s):
    o = read_orbits(save(sp3(scale=scale)))
    assert o.coverage_ns[0] == DAY1 + shift_s * SECOND_NS
    t = DAY1 + 40_000 * SECOND_NS
    p, ok = o.position_m("G05", [t + shift_s * SECOND_NS])
    assert ok.all()
    np.testing.assert_allclose(p[0], place("G05", t), atol=0.005)
    assert o.clocks.series["G05"][0][0] == DAY1 + shift_s * SECOND_NS


def test_different_makers_and_intervals_are_told(save):
    a = save(sp3(), "a.sp3")
    b = save(sp3(DAY1 + DAY_NS, agency="OTHR", frame="IGS20", epochs=288, step_s=300), "b.sp3")
    o = read_orbits([a, b])
    assert (o.agency, o.frame) == ("TEST/OTHR", "IGb14/IGS20")
    assert any("datum may differ" in n and "OTHR in IGS20" in n for n in o.notes)
    assert any("900 s between epochs, b.sp3 300 s" in n for n in o.notes)
    assert not o.position_m("G05", [DAY1 + 450 * SECOND_NS])[1].any()
    assert o.position_m("G05", [DAY1 + DAY_NS + 450 * SECOND_NS])[1].all()


def test_the_same_day_twice_is_told(save):
    o = read_orbits([save(sp3(), "a.sp3"), save(sp3(sats=("G05",)), "b.sp3")])
    assert any("share 96 epochs" in n for n in o.notes)


def test_satellites_without_a_clock_and_a_missing_end_are_told(save):
    text = sp3(epochs=12, clockless=[("E11", k) for k in range(12)])
    o = read_orbits(save(text.replace("EOF\n", "")))
    assert "no clock at all for E11" in o.notes
    assert any("no 'EOF' line" in n for n in o.notes)


def test_bad_files_raise(save, obs3, tmp_path):
    text = sp3(epochs=12)
    with pytest.raises(InputError, match="not an SP3 file") as info:
        read_orbits(save(obs3, "obs.rnx"))
    assert info.value.path.name == "obs.rnx"
    with pytest.raises(InputError, match="empty"):
        read_orbits(save(""))
    with pytest.raises(InputError, match="no such file"):
        read_orbits(tmp_path / "nothing")
    with pytest.raises(InputError, match="no orbit file given"):
        read_orbits([])
    with pytest.raises(InputError, match="no satellite has a position"):
        read_orbits(save(sp3(epochs=2, absent=[(s, k) for s in ("G05", "E11") for k in range(2)])))
    with pytest.raises(InputError, match="cut off"):
        read_orbits(save(text[: text.rindex("*")]))
    with pytest.raises(InputError, match="cannot be read"):
        read_orbits(save(text[:-30]))
    row = text.splitlines()[-3]
    with pytest.raises(InputError, match="cannot be read") as info:
        read_orbits(save(text.replace(row, row[:9] + "x" + row[10:])))
    assert info.value.line == len(text.splitlines()) - 2


def test_shared_files(shared):
    esbc = shared / "esbc-static-2020177"
    paths = sorted(esbc.glob("*SP3.gz"))
    o = read_orbits(paths)
    assert (len(o.sats), len(o.t_ns), o.agency, o.frame) == (75, 192, "GRGS", "IGb14")
    # The clocks of both days: a merge by sidereon loses the second's.
    midnight = from_iso("2020-06-25")
    assert all(len(t) == 192 for t, _ in o.clocks.series.values())
    line = next(x for x in gzip.decompress(paths[1].read_bytes()).decode().splitlines() if x[:4] == "PG05")
    np.testing.assert_allclose(o.position_m("G05", [midnight])[0][0] / 1e3, _floats(line)[:3], atol=1e-9)
    assert o.clocks.clock_s("G05", midnight)[0] == pytest.approx(_floats(line)[3] * 1e-6, abs=1e-15)
    assert o.position_m("R05", midnight + np.arange(-890, 890, 89) * SECOND_NS)[1].all()
    opec = read_orbits(next((shared / "opec-static-2022001").glob("*SP3.gz")))
    assert (len(opec.t_ns), opec.interval_s, opec.coverage_ns[1]) == (289, 300.0, from_iso("2022-01-02"))
    assert {s[0] for s in opec.sats} == set("GRECJ")
    wum = read_orbits(shared / "cpt-van-2019087/wum20464.sp3.gz")
    assert (len(wum.t_ns), wum.agency, len(wum.sats)) == (96, "WHU", 108)


def _floats(line):
    return [float(line[a : a + 14]) for a in (4, 18, 32, 46)]
