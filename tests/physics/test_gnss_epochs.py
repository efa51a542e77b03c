"""From files to epochs."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.physics.atmosphere import klobuchar_m, troposphere_m
from pntegrity.physics.frames import elevation_azimuth, enu_rotation
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.physics.tables import Navigation
from pntegrity.records import group_of

TRUTH = np.array([4027881.6280, 306998.5370, 4919498.9840])
EARTH_RATE, C = 7.2921151467e-5, 299_792_458.0


@pytest.fixture(scope="module")
def brux(brux_table, brux_nav):
    return gnss_epochs(brux_table, brux_nav)


def ranges(place, sv):
    d = sv - place
    r = np.linalg.norm(d, axis=1)
    return r + EARTH_RATE / C * (sv[:, 0] * place[1] - sv[:, 1] * place[0]), d / r[:, None]


def single_point(epoch, klobuchar=None, mask_deg=10.0):
    """A weighted least-squares fix with one clock a system: position and residuals."""
    o = epoch.sensor("code")
    letters = sorted({k[0] for k in o.keys})
    clocks = np.array([[float(k[0] == s) for s in letters] for k in o.keys])
    x, b = np.zeros(3), np.zeros(len(letters))
    for step in range(9):
        r, los = ranges(x, o.aux["sv_pos_m"])
        el, az = elevation_azimuth(x, los)
        sure = np.ones(len(el)) if step < 4 else np.where(el > np.radians(mask_deg), np.sin(el), 0.0)
        w = sure / np.sqrt(1.0 + o.aux["sv_var_m2"] / 10.0)
        iono = o.aux["iono_factor"] * klobuchar_m(klobuchar, x, el, az, o.t_ns, o.aux["freq_hz"])
        z = o.y - (r - o.aux["sv_clk_m"] + iono + troposphere_m(x, el, o.t_ns)) - clocks @ b
        h = np.hstack([-los, clocks]) * w[:, None]
        step_xb = np.linalg.lstsq(h, w * z, rcond=None)[0]
        x, b = x + step_xb[:3], b + step_xb[3:]
    return x


def fixes(result, truth, every, klobuchar=None):
    enu = enu_rotation(truth)
    errors = [enu @ (single_point(e, klobuchar) - truth) for e in result.epochs[::every]]
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_single_point_fix_on_a_static_log(brux):
    e, n, u = fixes(brux, TRUTH, every=45)
    assert np.hypot(e, n) < 1.2
    assert u < 4.0


def test_ionosphere_free_fix(brux_table, brux_nav):
    result = gnss_epochs(brux_table, brux_nav, ionosphere_free=True)
    e, n, u = fixes(result, TRUTH, every=45)
    assert np.hypot(e, n) < 1.2
    assert u < 4.0
    o = result.epochs[0].sensor("code")
    assert {k.partition(":")[2] for k in o.keys} == {"C1C+C2W", "C1C+C2C", "C1C+C5Q", "C2I+C7I"}
    assert (o.aux["iono_factor"] == 0.0).all()


def test_group_delays_help_across_systems(shared):
    """CLAS: GPS, Galileo and QZSS on a good receiver."""
    folder = shared / "clas-sept-2021078"
    table = read_observations(folder / "SEPT078M.21O.gz")
    nav = read_navigation([folder / "SEPT078M.21P.gz", folder / "30340780.21q.gz"])
    result = gnss_epochs(table, nav, systems="GEJ")
    truth = np.array([-3962108.673, 3381309.574, 3668678.638])
    e, n, u = fixes(result, truth, every=90, klobuchar=result.klobuchar)
    assert np.hypot(e, n) < 1.2
    assert u < 3.0


def test_doppler_is_the_range_rate_of_a_static_receiver(brux):
    for epoch in brux.epochs[::100]:
        o = epoch.sensor("doppler")
        _, los = ranges(TRUTH, o.aux["sv_pos_m"])
        sv, v = o.aux["sv_pos_m"], o.aux["sv_vel_mps"]
        sagnac = EARTH_RATE / C * (v[:, 0] * TRUTH[1] - v[:, 1] * TRUTH[0])
        z = o.y - (np.einsum("ij,ij->i", v, los) + sagnac - o.aux["sv_clk_rate_mps"])
        assert len(sv) > 25
        assert np.std(z) < 0.1


def test_carrier_and_code_change_alike(brux):
    a, b = brux.epochs[100], brux.epochs[130]
    code = [dict(zip(map(group_of, e.sensor("code").keys), e.sensor("code").y, strict=True)) for e in (a, b)]
    phase = [
        {k[:3]: y for k, y in zip(e.sensor("carrier").keys, e.sensor("carrier").y, strict=True)}
        for e in (a, b)
    ]
    lli = {k[:3]: v for k, v in zip(b.sensor("carrier").keys, b.sensor("carrier").aux["lli"], strict=True)}
    both = [s for s in code[0] if s in code[1] and s in phase[0] and s in phase[1] and not lli[s]]
    change = np.array([(code[1][s] - code[0][s]) - (phase[1][s] - phase[0][s]) for s in both])
    assert len(both) > 25
    assert np.median(np.abs(change)) < 1.0


def test_shapes_keys_and_notes(brux, brux_table):
    assert len(brux.epochs) == len(brux_table.t_ns)
    for epoch in brux.epochs[::50]:
        for name, letter in (("code", "C"), ("doppler", "D"), ("carrier", "L")):
            o = epoch.sensor(name)
            assert o.t_ns == epoch.t_ns
            assert all(re.fullmatch(rf"[GREC]\d\d:{letter}\d[A-Z]", k) for k in o.keys)
            assert len({group_of(k) for k in o.keys}) == len(o.keys)
            assert o.aux["sv_pos_m"].shape == (len(o.y), 3)
            finite = [k for k in o.aux if k != "cn0_dbhz"]
            assert all(np.isfinite(o.aux[k]).all() for k in finite)
    assert "E20: no ephemeris" in brux.epochs[0].notes
    assert any(
        n.startswith("unhealthy: ") and "E13 900" in n and n.endswith("of 900 epochs") for n in brux.notes
    )
    assert brux.klobuchar is None
    assert any("no GPS ionosphere coefficients" in n for n in brux.notes)


def test_arrays_are_read_only(brux):
    with pytest.raises(ValueError, match="read-only"):
        brux.epochs[0].sensor("code").aux["sv_pos_m"][0, 0] = 0.0


def test_interval_and_systems(brux_table, brux_nav, brux):
    t = brux_table.t_ns
    part = gnss_epochs(brux_table, brux_nav, systems="GE", start_ns=int(t[10]), end_ns=int(t[12]))
    assert [e.t_ns for e in part.epochs] == t[10:13].tolist()
    whole = brux.epochs[11].sensor("code")
    some = part.epochs[1].sensor("code")
    rows = [k[0] in "GE" for k in whole.keys]
    np.testing.assert_array_equal(whole.y[rows], some.y)
    np.testing.assert_array_equal(whole.aux["sv_clk_m"][rows], some.aux["sv_clk_m"])
    assert any("GLONASS, BeiDou" in n for n in part.notes)
    with pytest.raises(InputError, match="interval"):
        gnss_epochs(brux_table, brux_nav, start_ns=int(t[-1]) + 1)
    with pytest.raises(InputError, match="no satellite of the systems J"):
        gnss_epochs(brux_table, brux_nav, systems="J")
    with pytest.raises(ValueError, match="letters"):
        gnss_epochs(brux_table, brux_nav, systems="GX")


def test_signal_choice(brux_table, brux_nav):
    result = gnss_epochs(brux_table, brux_nav, systems="G", signals={"G": ("2W",)})
    assert {k[4:] for k in result.epochs[0].sensor("code").keys} == {"C2W"}
    with pytest.raises(InputError, match="no signal among 9Q"):
        gnss_epochs(brux_table, brux_nav, systems="G", signals={"G": ("9Q",)})


def test_bad_pseudoranges_are_dropped_and_a_clock_offset_is_not(brux_table, brux_nav):
    p = brux_table.pseudorange_m + 0.008 * C
    hit = (brux_table.epoch == 0) & np.isin(brux_table.sat, ["G01", "G03", "R05"])
    p[hit] = np.array([np.nan, 1.0e6, 9e9])[np.unique(brux_table.sat[hit], return_inverse=True)[1]]
    result = gnss_epochs(replace(brux_table, pseudorange_m=p), brux_nav)
    keys = {group_of(k) for k in result.epochs[0].sensor("code").keys}
    assert {"G01", "G03", "R05"}.isdisjoint(keys)
    assert len(keys) > 25
    reasons = Counter(n.split(": ")[1][:11] for n in result.epochs[0].notes)
    assert reasons["pseudorange"] == 3
    assert np.linalg.norm(single_point(result.epochs[1]) - TRUTH) < 30.0


def test_an_epoch_without_satellites_stays_with_its_reasons(brux_table, brux_nav):
    p = np.where(brux_table.epoch == 3, np.nan, brux_table.pseudorange_m)
    epoch = gnss_epochs(replace(brux_table, pseudorange_m=p), brux_nav).epochs[3]
    assert epoch.observations == ()
    assert len(epoch.notes) > 30


def test_a_system_without_ephemerides_is_told_once(brux_table, brux_nav):
    nav = Navigation(brux_nav.kepler, (), brux_nav.klobuchar)
    result = gnss_epochs(brux_table, nav)
    assert [n for n in result.notes if "GLONASS" in n] == [
        "GLONASS: no ephemerides in the navigation files, left out"
    ]
    assert not any(n.startswith("R") for e in result.epochs for n in e.notes)
    assert not any(k.startswith("R") for k in result.epochs[0].sensor("code").keys)


def test_navigation_of_another_day_names_the_days(shared, brux_table):
    nav = read_navigation(shared / "tst-urban-2019118/hksc1180.19n.gz")
    with pytest.raises(InputError, match=r"2019-01-14T06:15:00.*hksc1180.*2019-04-27") as caught:
        gnss_epochs(brux_table, nav)
    assert "same day" in caught.value.hint


def test_other_shared_logs(shared):
    tst, walk = shared / "tst-urban-2019118", shared / "imu-walk-2025240"
    nav = read_navigation([tst / "hksc1180.19n.gz", tst / "hksc1180.19b.gz"])
    result = gnss_epochs(read_observations(tst / "COM3_190428_124409.obs.gz"), nav)
    assert len(result.epochs) == 1760
    assert result.klobuchar == nav.klobuchar["G"]
    assert np.median([len(e.sensor("code").keys) for e in result.epochs if e.sensor("code")]) >= 10
    walk_result = gnss_epochs(read_observations(walk / "walk.obs.gz"), read_navigation(walk / "walk.nav.gz"))
    assert {k[0] for k in walk_result.epochs[9].sensor("code").keys} == set("GEC")
