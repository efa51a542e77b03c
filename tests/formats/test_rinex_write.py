"""What is written reads back."""

import os
from dataclasses import replace

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.rinex_write import write_navigation, write_observations

COLUMNS = (
    "t_ns", "epoch", "sat", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz", "lli",
)  # fmt: skip


def same(a, b):
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_observations_round_trip(obs3, save, tmp_path):
    t = read_observations(save(obs3))
    lli = np.where(np.isnan(t.carrier_cycles), 0, np.arange(len(t)) % 4).astype(np.int8)
    t = replace(t, lli=lli, glonass_channels={"R03": 5, "R24": -7})
    write_observations(tmp_path / "out.rnx", t, comment="round trip")
    back = read_observations(tmp_path / "out.rnx")
    same(t, back)
    assert (back.marker, back.interval_s, dict(back.glonass_channels)) == ("SAMP", 1.0, {"R03": 5, "R24": -7})
    np.testing.assert_array_equal(back.approx_position_m, t.approx_position_m)


def test_real_log_round_trip(shared, tmp_path):
    t = read_observations(shared / "clas-sept-2021078/SEPT078M.21O.gz")
    write_observations(tmp_path / "out.rnx", t)
    same(t, read_observations(tmp_path / "out.rnx"))


def test_time_tags_keep_100_ns_over_a_full_minute(obs3, save, tmp_path):
    t = read_observations(save(obs3))
    times = t.t_ns[0] // 10**9 * 10**9 - 7 * 10**9 + np.array([0, 300, 999_999_900, 1_000_000_000])
    write_observations(tmp_path / "out.rnx", replace(t, t_ns=times))
    assert read_observations(tmp_path / "out.rnx").t_ns.tolist() == times.tolist()


def test_navigation_round_trip(nav3, save, tmp_path):
    n = read_navigation(save(nav3))
    write_navigation(tmp_path / "out.nav", n, comment="round trip")
    back = read_navigation(tmp_path / "out.nav")
    assert (back.klobuchar, back.leap_seconds, back.coverage_ns) == (
        n.klobuchar,
        n.leap_seconds,
        n.coverage_ns,
    )
    for a, b in zip(n.kepler, back.kepler, strict=True):
        assert a.evaluate(533_000.0).x_m == b.evaluate(533_000.0).x_m
        assert a.evaluate(533_000.0).clock_s == b.evaluate(533_000.0).clock_s
    a, b = n.glonass[0], back.glonass[0]
    assert a.position_m.tolist() == b.position_m.tolist()
    assert (a.clock_bias_s, a.freq_channel) == (b.clock_bias_s, b.freq_channel)


def test_nothing_is_left_behind_where_writing_fails(obs3, save, tmp_path):
    t = read_observations(save(obs3))
    with pytest.raises(InputError, match="cannot be written"):
        write_observations(tmp_path / "no folder" / "out.rnx", t)
    with pytest.raises(ValueError, match="has room"):
        write_observations(tmp_path / "out.rnx", replace(t, doppler_hz=t.doppler_hz * 1e9))
    assert os.listdir(tmp_path) == ["sample.rnx"]
