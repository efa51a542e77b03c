"""Increments cut at epochs: nothing is lost, nothing is counted twice, and what is missing is said."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from pntegrity.records import Epoch, Inertial
from pntegrity.sensors.increments import with_increments

SECOND = 10**9
T0 = 1_400_000_000 * SECOND
STEP = 8_000_000


def unit(n=2500, seed=1, t0=T0):
    rng = np.random.default_rng(seed)
    t = t0 + STEP * np.arange(1, n + 1, dtype=np.int64)
    return Inertial(t, np.full(n, STEP * 1e-9), rng.normal(size=(n, 3)), rng.normal(size=(n, 3)))


def without(whole, i, j):
    keep = np.r_[0:i, j : len(whole.t_ns)]
    return Inertial(whole.t_ns[keep], whole.dt_s[keep], whole.angle_rad[keep], whole.velocity_mps[keep])


def epochs(*seconds):
    return [Epoch(T0 + round(s * SECOND)) for s in seconds]


def total(parts, name):
    return sum(getattr(e.imu, name).sum(axis=0) for e in parts)


def test_durations_add_up_to_the_time_since_the_epoch_before():
    at = np.sort(np.random.default_rng(2).uniform(0.0, 19.9, 60))
    out = with_increments(epochs(*at), unit())
    for before, after in pairwise(out):
        assert after.imu.dt_s.sum() == pytest.approx((after.t_ns - before.t_ns) * 1e-9, abs=1e-12)
        assert after.imu.t_ns[-1] == after.t_ns
        assert (np.diff(after.imu.t_ns) > 0).all()
        assert after.imu.reason == ""


def test_increments_are_kept_whole_and_cut_in_proportion():
    whole = unit()
    out = with_increments(epochs(0.0, 3.21, 3.2101, 9.9999, 20.0), whole, before_s=0.0)
    for name in ("angle_rad", "velocity_mps"):
        np.testing.assert_allclose(total(out, name), getattr(whole, name).sum(axis=0), atol=1e-10)
    k = int(3.21 / 0.008)  # the increment that 3.21 s cuts
    inside = (3.21 - k * 0.008) / 0.008
    np.testing.assert_allclose(out[1].imu.angle_rad[-1], inside * whole.angle_rad[k], atol=1e-9)
    assert out[2].imu.t_ns.tolist() == [T0 + 3_210_100_000]


def test_a_constant_rate_stays_that_rate():
    n = 2500
    t = T0 + STEP * np.arange(1, n + 1, dtype=np.int64)
    dt = np.full(n, STEP * 1e-9)
    whole = Inertial(t, dt, np.outer(dt, [0.1, 0.2, 0.3]), np.outer(dt, [1.0, 2.0, -9.8]))
    for epoch in with_increments(epochs(0.5, 1.003, 7.7777), whole):
        rate = epoch.imu.angle_rad / epoch.imu.dt_s[:, None]
        np.testing.assert_allclose(rate, np.tile([0.1, 0.2, 0.3], (len(rate), 1)))


def test_the_first_epoch_gets_what_there_is_before_it():
    out = with_increments(epochs(5.0, 6.0), unit())
    assert out[0].imu.dt_s.sum() == pytest.approx(1.0)
    assert with_increments(epochs(5.0, 6.0), unit(), before_s=3.0)[0].imu.dt_s.sum() == pytest.approx(3.0)
    early = with_increments(epochs(0.4, 6.0), unit())[0].imu
    assert early.dt_s.sum() == pytest.approx(0.4)
    assert early.reason == ""


def test_a_long_gap_is_left_and_said_where_it_falls():
    out = with_increments(epochs(0, 1, 2, 3, 4, 5), without(unit(), 150, 450))  # from 1.2 s to 3.6 s
    assert [bool(e.imu.reason) for e in out] == [False, False, True, True, True, False]
    assert "gap of 2.40 s" in out[3].imu.reason
    assert out[2].imu.dt_s.sum() == pytest.approx(0.2)
    assert out[3].imu.dt_s.sum() == 0.0
    assert out[4].imu.dt_s.sum() == pytest.approx(0.4)


def test_a_short_gap_is_bridged_with_the_rate_beside_it():
    whole = unit()
    gone = without(whole, 150, 155)
    out = with_increments(epochs(0, 1, 2), gone)
    assert out[2].imu.reason == ""
    assert out[2].imu.dt_s.sum() == pytest.approx(1.0)
    bridge = int(np.argmax(out[2].imu.dt_s))
    np.testing.assert_allclose(
        out[2].imu.angle_rad[bridge], 2.5 * (whole.angle_rad[149] + whole.angle_rad[155]), atol=1e-9
    )
    assert "gap of 0.04 s" in with_increments(epochs(0, 1, 2), gone, max_gap_s=0.01)[2].imu.reason


def test_epochs_before_and_after_the_unit_are_told_so():
    out = with_increments(epochs(-3, -2, -1, 0.5, 19, 20.5, 22), unit())
    assert ["begins" in e.imu.reason for e in out] == [False, True, True, True, False, False, False]
    assert ["ends" in e.imu.reason for e in out] == [False, False, False, False, False, True, True]
    assert out[3].imu.dt_s.sum() == pytest.approx(0.5)
    assert len(out[-1].imu.dt_s) == 0


def test_no_time_in_common_names_both_spans():
    with pytest.raises(ValueError, match=r"no time in common.*2024-05-17.*2024-05-17") as caught:
        with_increments(epochs(100, 200), unit())
    assert str(caught.value).count("to 2024") == 2
    with pytest.raises(ValueError, match="no time in common"):
        with_increments(epochs(-100, -50), unit())


def test_a_single_epoch_and_none():
    assert with_increments([], unit()) == ()
    (one,) = with_increments(epochs(2.0), unit())
    assert one.imu.dt_s.sum() == pytest.approx(1.0)


def test_stamps_that_touch_to_a_microsecond_leave_no_gap():
    whole = unit()
    jittered = Inertial(whole.t_ns, whole.dt_s - 3e-10, whole.angle_rad, whole.velocity_mps)
    out = with_increments(epochs(1, 2), jittered)
    assert out[1].imu.dt_s.sum() == pytest.approx(1.0, abs=1e-12)
    assert out[1].imu.reason == ""


def test_an_hour_at_125_hz_takes_less_than_a_second():
    whole = unit(450_000)
    log = epochs(*range(3600))
    begin = time.process_time()
    out = with_increments(log, whole)
    assert time.process_time() - begin < 1.0
    np.testing.assert_allclose(
        total(out[1:], "angle_rad"), whole.angle_rad[: 3599 * 125].sum(axis=0), atol=1e-9
    )
