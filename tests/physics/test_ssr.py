"""Broadcast orbits and clocks with corrections: the right message, the right way, and never too old."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gnss_logs import SECOND, START, navigation
from pntegrity.physics.atmosphere_products import metres_per_tecu
from pntegrity.physics.ephemeris import toe_ns
from pntegrity.physics.orbits import satellite_states
from pntegrity.physics.precise import precise_states
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS, frequency_hz
from pntegrity.physics.ssr import SsrBiases, SsrClocks, SsrOrbits
from pntegrity.physics.ssr_corrections import ClasCorrections, SatelliteCorrections, in_force, quality_tecu
from pntegrity.physics.tables import Navigation

SAT = "G05"


def corrections(t_s=(0, 5, 10), iode=None, orbit=(0.0, 0.0, 0.0), clock=0.0, ura=0.1, sat=SAT, **biases):
    n = len(t_s)
    issue = next(iter(navigation().of(sat)[0])).issue if iode is None else iode
    row = SatelliteCorrections(
        START + SECOND * np.array(t_s, dtype=np.int64), np.full(n, issue), np.tile(orbit, (n, 1)),
        np.broadcast_to(clock, n), np.broadcast_to(ura, n), np.zeros(n), np.full(n, 0.3),
        biases.get("code", {}), biases.get("phase", {}),
    )  # fmt: skip
    return ClasCorrections({sat: row}, row.t_ns, np.full(n, 2.3), np.full(n, 0.15))


def orbits(**changes) -> SsrOrbits:
    return SsrOrbits(corrections(**changes), navigation())


def place(found: SsrOrbits, t_s: float = 10.0) -> np.ndarray:
    position, ok = found.position_m(SAT, [START + int(t_s * SECOND)])
    assert ok.all()
    return position[0]


def test_without_corrections_it_is_the_broadcast_message():
    # GIVEN corrections of zero WHEN a satellite is placed as precise products are
    t = START + SECOND * np.arange(8, dtype=np.int64)
    sats, code = np.full(8, SAT), np.full(8, 2.2e7)
    o = orbits()
    found = precise_states(o, SsrClocks(o), sats, t, code)
    # THEN orbit and clock are those of the message, whose clock is that of L1 and L2 P combined
    expected = satellite_states(navigation(), sats, t, code, ["1W+2W"] * 8)
    assert found.ok.all()
    assert np.abs(found.position_m - expected.position_m).max() < 1e-3
    assert np.abs(found.velocity_mps - expected.velocity_mps).max() < 1e-3
    assert np.abs(found.clock_m - expected.clock_m).max() < 1e-3


def test_an_orbit_correction_is_taken_off_along_its_axes():
    base = place(orbits())
    before, after = (place(orbits(), 10.0 + s) for s in (-0.5, 0.5))
    along = (after - before) / np.linalg.norm(after - before)
    up = base / np.linalg.norm(base)
    radial, forward, sideways = (
        place(orbits(orbit=np.eye(3)[i])) - base for i in range(3)
    )  # fmt: skip
    for step in (radial, forward, sideways):
        assert np.linalg.norm(step) == pytest.approx(1.0, abs=1e-6)
    # all are taken off; radial is up but for the orbit's eccentricity, cross that of position x velocity
    assert radial @ up < -0.999
    assert forward @ along == pytest.approx(-1.0, abs=1e-6)
    assert sideways @ np.cross(base, along) < 0.0
    assert abs(radial @ forward) < 1e-6
    assert abs(forward @ sideways) < 1e-6


def test_a_clock_correction_is_added():
    plain, corrected = SsrClocks(orbits()), SsrClocks(orbits(clock=3.0))
    t = np.array([START + 10 * SECOND])
    difference = corrected.clock_s(SAT, t, -0.07)[0] - plain.clock_s(SAT, t, -0.07)[0]
    assert difference == pytest.approx(3.0 / SPEED_OF_LIGHT_MPS, abs=1e-18)


class Issued:
    """A message under another issue of data."""

    def __init__(self, record, issue: int) -> None:
        self.record, self.issue = record, issue

    def __getattr__(self, name: str):
        return getattr(self.record, name)


@pytest.mark.parametrize("wanted", [40, 41])
def test_the_message_is_that_of_the_issue_not_the_nearest(wanted):
    # GIVEN two messages that are valid at the same time WHEN one is named by the corrections
    records, _ = navigation().of(SAT)
    nav = Navigation(tuple(Issued(r, 40 + i) for i, r in enumerate(records[:2])))
    t = START + 10 * SECOND
    position, ok = SsrOrbits(corrections(iode=wanted), nav).position_m(SAT, [t])
    # THEN that one is taken
    record = records[wanted - 40]
    state = record.evaluate((t - toe_ns(record)) * 1e-9 + record.elements.toe_sow)
    assert ok.all()
    assert np.abs(position[0] - [state.x_m, state.y_m, state.z_m]).max() < 1e-3


def test_an_issue_that_comes_again_is_the_one_nearby():
    # the simulated messages all have issue 1: days apart that happens to real ones
    records, toe = navigation().of(SAT)
    nearest = records[int(np.argmin(np.abs(toe - START - 10 * SECOND)))]
    state = nearest.evaluate((START + 10 * SECOND - toe_ns(nearest)) * 1e-9 + nearest.elements.toe_sow)
    assert np.abs(place(orbits()) - [state.x_m, state.y_m, state.z_m]).max() < 1e-3
    late = corrections(t_s=(86_400,))
    reason = SsrOrbits(late, navigation()).reasons(SAT, [START + 86_400 * SECOND])
    assert reason.tolist() == ["no broadcast message of issue 1"]


def test_a_missing_message_is_told_by_its_issue():
    o = orbits(iode=199)
    assert not o.position_m(SAT, [START])[1].any()
    assert not SsrClocks(o).clock_s(SAT, [START])[1].any()
    assert o.reasons(SAT, [START]).tolist() == ["no broadcast message of issue 199"]


@pytest.mark.parametrize(
    ("at_s", "reason"),
    [(-1, "no correction"), (0, ""), (70, ""), (71, "correction older than 60 s")],
)
def test_corrections_hold_for_a_minute_and_never_before_they_came(at_s, reason):
    o = orbits()
    t = [START + at_s * SECOND]
    assert o.reasons(SAT, t).tolist() == [reason]
    for ok in (o.position_m(SAT, t)[1], SsrClocks(o).clock_s(SAT, t)[1]):
        assert ok.tolist() == [reason == ""]


def test_the_emission_time_does_not_choose_the_correction():
    # a correction is at hand when the signal is received; what left the satellite earlier gets it too
    c = corrections(clock=np.array([0.0, 1.0, 2.0]))
    clocks = SsrClocks(SsrOrbits(c, navigation()))
    t = np.array([START + 5 * SECOND])
    received, emitted = (clocks.clock_s(SAT, t, offset)[0][0] for offset in (0.0, -0.07))
    assert abs(received - emitted) < 1e-12


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"ura": np.nan}, "correction states no accuracy"),
        ({"clock": np.nan}, "correction is marked as not available"),
        ({"orbit": (0.0, np.nan, 0.0)}, "correction is marked as not available"),
    ],
)
def test_what_is_not_known_is_not_used(change, reason):
    o = orbits(**change)
    assert o.reasons(SAT, [START]).tolist() == [reason]
    assert not o.position_m(SAT, [START])[1].any()


def test_satellites_without_corrections_or_with_a_nan_time():
    o = orbits()
    assert o.reasons("G06", [START]).tolist() == ["no correction"]
    position, ok = o.position_m(SAT, [START, START], [np.nan, 0.0])
    assert ok.tolist() == [False, True]
    assert np.isnan(position[0]).all()


def test_a_clock_begins_anew_after_a_gap_longer_than_corrections_hold():
    clocks = SsrClocks(orbits(t_s=(0, 5, 60, 121, 130)))
    assert clocks.restarts(SAT).tolist() == [START + 121 * SECOND]
    assert clocks.restarts("G06").tolist() == []
    assert clocks.interval_s == 5.0
    assert clocks.series[SAT][1].tolist() == [0.0] * 5


BIASES = {
    "code": {"1C": [0.0] * 3, "2W": [2.0] * 3, "2X": [1.8, 1.9, 2.0], "5X": [np.nan] * 3},
    "phase": {"1C": [0.5] * 3, "2W": [0.7] * 3, "2X": [0.6] * 3, "5X": [0.0] * 3},
}  # fmt: skip


def test_biases_follow_time_and_one_channel_stands_for_both():
    b = SsrBiases(corrections(**BIASES))
    t = START + SECOND * np.array([0, 5, 12, 71, 5, 5, 5, 5], dtype=np.int64)
    signals = np.array(["2L", "2L", "2L", "2L", "2W", "5Q", "7Q", "1W"])
    sats = np.full(8, SAT)
    code = b.of_m("code", sats, signals, t)
    assert code[:3] == pytest.approx([1.8, 1.9, 2.0])
    assert np.isnan(code[[3, 5, 6, 7]]).all()  # too old, not known, no such signal, encrypted
    assert code[4] == 2.0
    assert b.of_m("phase", sats, signals, t)[[0, 4, 5]] == pytest.approx([0.6, 0.7, 0.0])
    assert np.isnan(b.of_m("code", np.array(["G06"]), np.array(["1C"]), t[:1])).all()
    assert b.difference_s(SAT, "1C", "1W") == 0.0


def test_quality_is_coded_as_metres_on_l1():
    # 1 TECU delays L1 by 0.162 m (40.3e16 / f^2)
    assert quality_tecu(0.1624) == pytest.approx(1.0, rel=1e-3)
    assert metres_per_tecu(frequency_hz("G", "1C")) * quality_tecu(0.04) == pytest.approx(0.04)
    assert np.isnan(quality_tecu(np.nan))


def test_an_unhealthy_satellite_is_not_used(monkeypatch):
    monkeypatch.setattr("pntegrity.physics.ssr.is_healthy", lambda record: False)
    assert orbits().reasons(SAT, [START]).tolist() == ["unhealthy"]


def test_columns_must_fit_and_times_must_rise():
    row = corrections().satellites[SAT]
    with pytest.raises(ValueError, match="clock_m"):
        replace(row, clock_m=np.zeros(2))
    with pytest.raises(ValueError, match="rise"):
        replace(row, t_ns=row.t_ns[::-1])
    assert in_force(None, [START]).reason.tolist() == ["no correction"]
    with pytest.raises(ValueError, match="read-only"):
        row.clock_m[0] = 1.0
