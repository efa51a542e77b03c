"""Satellites from precise products: against RTKLIB, in gaps, and across what the products leave out."""

from dataclasses import replace

import numpy as np
import pyrtklib as rtk
import pytest
from precise_files import SECOND, T0, gps_time, vector

from pntegrity.physics.precise import clock_pieces, precise_states
from pntegrity.physics.products import PreciseClocks
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS as C

TRAVEL_M = 2.3e7


@pytest.mark.parametrize("system", ["G", "R", "E"])
def test_positions_and_clocks_agree_with_rtklib(orbits, clocks, rtklib, system):
    rs, dts, var = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2), rtk.Arr1Ddouble(1)
    compared, worst = 0, np.zeros(4)
    for sat in [s for s in orbits.sats if s[0] == system]:
        t = T0 + SECOND * np.arange(17, 6 * 3600, 1013)
        ours = precise_states(orbits, clocks, np.array([sat] * len(t)), t, np.full(len(t), TRAVEL_M))
        for i in np.flatnonzero(ours.ok):
            clock, _ = clocks.clock_s(sat, t[i : i + 1], np.array([-TRAVEL_M / C]))
            emitted = rtk.timeadd(gps_time(t[i]), float(-TRAVEL_M / C - clock[0]))
            assert rtk.peph2pos(emitted, rtk.satid2no(sat), rtklib.nav, 0, rs, dts, var) == 1
            theirs = vector(rs, 6)
            worst = np.maximum(worst, [
                np.linalg.norm(ours.position_m[i] - theirs[:3]),
                np.linalg.norm(ours.velocity_mps[i] - theirs[3:]),
                abs(ours.clock_m[i] - dts[0] * C), abs(ours.clock_rate_mps[i] - dts[1] * C),
            ])  # fmt: skip
            compared += 1
    assert compared > 400
    # measured: 0.4 mm, 0.3 mm/s, 0.25 mm (0.05 for GPS and GLONASS); their clock rate is that of 1 ms
    assert (worst < [1e-3, 1e-3, 5e-4, 5e-3]).all(), worst


def test_what_is_missing_is_told(orbits, clocks):
    series = dict(clocks.series)
    series.pop("G05")
    few = PreciseClocks(series, clocks.interval_s, clocks.kind)
    t = T0 + np.array([3600, 3600, 3600, 86400 * 3], dtype=np.int64) * SECOND
    ranges = np.array([TRAVEL_M, TRAVEL_M, np.nan, TRAVEL_M])
    found = precise_states(orbits, few, np.array(["G05", "G99", "G07", "G07"]), t, ranges)
    assert found.reason.tolist() == [
        "no precise clock", "no precise orbit", "no pseudorange", "no precise orbit",
    ]  # fmt: skip
    assert not found.ok.any()
    assert np.isnan(found.position_m).all()


def test_the_clock_moves_the_emission(orbits, clocks):
    # a satellite clock 1 ms ahead has sent what arrives now 1 ms earlier than it says: 3 m along the orbit
    t, p = np.array([T0 + 3600 * SECOND]), np.array([TRAVEL_M])
    times, values = clocks.series["G07"]
    ahead = replace(clocks, series=dict(clocks.series) | {"G07": (times, values + 1e-3)})
    a, b = (precise_states(orbits, c, np.array(["G07"]), t, p) for c in (clocks, ahead))
    # sidereon's times, float seconds since 2000, are good to 0.06 us: 0.25 mm of orbit
    np.testing.assert_allclose(b.position_m - a.position_m, -1e-3 * a.velocity_mps, atol=5e-4)
    assert b.clock_m[0] - a.clock_m[0] == pytest.approx(C * 1e-3, abs=1e-3)


def test_a_clock_product_that_begins_anew_is_another_piece():
    t = T0 + SECOND * np.array([0, 30, 60, 300, 330, 360], dtype=np.int64)
    clocks = PreciseClocks({"G05": (t, np.zeros(6)), "G07": (t[:3], np.zeros(3))}, 30.0, "CLK")
    times = T0 + SECOND * np.array([10, 50, 310, 350, 10, 50], dtype=np.int64)
    piece = clock_pieces(clocks, np.array(["G05"] * 4 + ["G07"] * 2), times)
    assert piece[0] == piece[1]
    assert piece[2] == piece[3] == piece[0] + 1
    assert piece[4] == piece[5]
    value, ok = clocks.clock_s("G05", np.array([T0 + 100 * SECOND]))
    assert not ok[0]
    assert np.isnan(value[0])
