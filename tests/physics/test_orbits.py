"""Satellite positions and clocks against RTKLIB, and by their properties."""

import gzip

import numpy as np
import pyrtklib as rtk
import pytest

from pntegrity.physics.group_delays import group_delay_s
from pntegrity.physics.orbits import satellite_states
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS as C
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.time import to_week_tow

OWN_PAIR = {"G": "1C+2W", "R": "1C", "E": "1C+7Q", "C": "6I"}
"""Signals or pairs that the broadcast clocks are for: RTKLIB's clocks are without group delays."""


@pytest.fixture(scope="module")
def rtklib_nav(shared, tmp_path_factory):
    path = tmp_path_factory.mktemp("nav") / "brdc.19p"
    packed = shared / "brux-static-2019014/BRDC00WRD_R_20190140000_01D_MN.rnx.gz"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    nav, obs, sta = rtk.nav_t(), rtk.obs_t(), rtk.sta_t()
    assert rtk.readrnx(str(path), 1, "", obs, nav, sta) == 1
    return nav


@pytest.fixture(scope="module")
def rows(brux_table):
    """First-frequency rows of every 60th epoch."""
    first = np.isin(brux_table.signal, ["1C", "2I"]) & (brux_table.epoch % 60 == 0)
    return np.flatnonzero(first & np.isfinite(brux_table.pseudorange_m))


@pytest.fixture(scope="module")
def states(brux_table, brux_nav, rows):
    t = brux_table
    pairs = [OWN_PAIR[s[0]] for s in t.sat[rows].tolist()]
    return satellite_states(brux_nav, t.sat[rows], t.t_ns[t.epoch[rows]], t.pseudorange_m[rows], pairs)


def rtklib_state(nav, sat, t_ns, pseudorange_m):
    rs, dts, var, svh = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2), rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
    t_rx = rtk.gpst2time(*to_week_tow(t_ns))
    emitted = rtk.timeadd(t_rx, -pseudorange_m / C)
    args = (t_rx, rtk.satid2no(sat), rtk.EPHOPT_BRDC, nav, rs, dts, var, svh)
    rtk.satpos(emitted, *args)
    ok = rtk.satpos(rtk.timeadd(emitted, -dts[0]), *args)
    return bool(ok), svh[0], np.array([rs[k] for k in range(6)]), dts[0] * C, dts[1] * C


def test_positions_and_clocks_agree_with_rtklib(brux_table, rtklib_nav, rows, states):
    compared = {}
    for i, r in enumerate(rows):
        sat, t = str(brux_table.sat[r]), int(brux_table.t_ns[brux_table.epoch[r]])
        ok, health, state, clock, rate = rtklib_state(rtklib_nav, sat, t, brux_table.pseudorange_m[r])
        assert states.ok[i] == (ok and health == 0), (sat, states.reason[i])
        if not states.ok[i]:
            continue
        assert np.linalg.norm(states.position_m[i] - state[:3]) < 1e-3
        assert np.linalg.norm(states.velocity_mps[i] - state[3:]) < 1e-3  # theirs is a forward difference
        assert abs(states.clock_m[i] - clock) < 1e-3
        assert abs(states.clock_rate_mps[i] - rate) < 1e-4
        compared[sat[0]] = compared.get(sat[0], 0) + 1
    assert all(compared[s] > 80 for s in "GREC")


def test_reasons(brux_table, rows, states):
    reason = dict(zip(brux_table.sat[rows].tolist(), states.reason.tolist(), strict=True))
    assert reason["E20"] == "no ephemeris"
    assert reason["E13"] == reason["R21"] == "unhealthy"
    assert (states.ok == (states.reason == "")).all()
    assert np.isnan(states.position_m[~states.ok]).all()
    assert np.isfinite(states.clock_m[states.ok]).all()


def test_velocity_is_the_derivative_of_position(brux_table, brux_nav):
    sats = np.array(["G01", "R05", "E07", "C05", "C22"])
    t0 = int(brux_table.t_ns[10])
    steps = [
        satellite_states(
            brux_nav, sats, np.full(5, t0 + s * 10**9), np.full(5, 2.2e7), ["1C", "1C", "1C", "2I", "2I"]
        )
        for s in (-1, 0, 1)
    ]
    slope = (steps[2].position_m - steps[0].position_m) / 2.0
    np.testing.assert_allclose(steps[1].velocity_mps, slope, atol=1e-3)  # third derivative: 1e-4 m/s
    drift = (steps[2].clock_m - steps[0].clock_m) / 2.0
    np.testing.assert_allclose(steps[1].clock_rate_mps, drift, atol=1e-5)


def test_a_receiver_clock_offset_does_not_move_the_satellite(brux_table, brux_nav):
    sat, t, p = np.array(["G01"]), int(brux_table.t_ns[0]), 2.1e7
    a = satellite_states(brux_nav, sat, np.array([t]), np.array([p]), ["1C"])
    offset_ns = 5_000_000
    b = satellite_states(
        brux_nav, sat, np.array([t + offset_ns]), np.array([p + C * offset_ns * 1e-9]), ["1C"]
    )
    np.testing.assert_allclose(a.position_m, b.position_m, atol=1e-5)


def test_age_limits_and_missing_ranges(brux_table, brux_nav):
    t = int(brux_table.t_ns[0])
    day = 86_400 * 10**9
    s = satellite_states(brux_nav, np.array(["G01", "G99", "G01"]), np.array([t + 9 * day, t, t]),
                         np.array([2.1e7, 2.1e7, np.nan]), ["1C"] * 3)  # fmt: skip
    assert s.reason.tolist() == ["too old", "no ephemeris", "no pseudorange"]
    assert not s.ok.any()


def test_no_rows(brux_nav):
    s = satellite_states(brux_nav, np.zeros(0, dtype="<U3"), np.zeros(0, dtype=np.int64), np.zeros(0), [])
    assert len(s.ok) == 0


def record(nav, sat, fnav=False):
    return nav.of(sat, fnav=fnav)[0][-1]


@pytest.mark.parametrize(
    ("sat", "fnav", "pair"), [("G01", False, "1C+2W"), ("E07", True, "1C+5Q"), ("E07", False, "1C+7Q")]
)
def test_the_pair_of_the_clock_has_no_delay(brux_nav, sat, fnav, pair):
    r = record(brux_nav, sat, fnav)
    assert group_delay_s(r, pair) == pytest.approx(0.0, abs=1e-18)
    assert group_delay_s(r, pair[:2]) == pytest.approx(r.group_delay_s)


def test_delays_scale_with_the_square_of_the_wavelength(brux_nav):
    gamma = (frequency_hz("G", "1C") / frequency_hz("G", "2W")) ** 2
    r = record(brux_nav, "G01")
    assert group_delay_s(r, "2W") == pytest.approx(gamma * group_delay_s(r, "1C"))
    assert np.isnan(group_delay_s(r, "5Q"))


def test_galileos_two_messages_describe_the_same_e1_clock(brux_nav):
    sat, t = np.array(["E07"]), np.array([brux_nav.of("E07")[1][30] + 300 * 10**9])
    a = satellite_states(brux_nav, sat, t, np.array([2.4e7]), ["1C"])
    r = record(brux_nav, "E07", fnav=True)
    b = satellite_states(brux_nav, sat, t, np.array([2.4e7]), ["1C+5Q"])
    e1_by_fnav = b.clock_m[0] - C * group_delay_s(r, "1C")
    assert a.clock_m[0] == pytest.approx(e1_by_fnav, abs=0.2)


def test_beidou_delays(brux_nav):
    r = record(brux_nav, "C11")
    assert group_delay_s(r, "6I") == 0.0
    assert group_delay_s(r, "2I") == r.group_delays.beidou_tgd1_s
    assert np.isnan(group_delay_s(r, "1P"))
