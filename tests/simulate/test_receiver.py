"""Constellations, trajectories and the simulated receiver."""

import numpy as np
import pytest

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.rinex_write import write_navigation, write_observations
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.physics.time import from_iso
from pntegrity.records import State
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.constellation import NOMINAL, navigation_text, nominal_navigation
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.receiver import Receiver, epochs_of, keep_only, simulate, with_faults
from pntegrity.simulate.trajectory import Leg, car, static, straight

SECOND = 10**9
START = from_iso("2024-06-01T09:59:30")  # GLONASS and Galileo change ephemerides on the way
PLACE = geodetic_to_ecef(np.deg2rad(50.85), np.deg2rad(4.35), 60.0)
EXACT = Receiver(scale=0.0)


def times(n):
    return START + SECOND * np.arange(n, dtype=np.int64)


def errors(nav, simulated):
    kf, state, out = SppKf(GnssOptions(klobuchar=nav.klobuchar["G"])), State.empty(), []
    for epoch, place in zip(epochs_of(simulated.table, nav), simulated.position_m, strict=True):
        state = kf.correct(kf.predict(state, epoch), epoch).posterior
        out.append(np.linalg.norm(state.mean[:3] - place) if len(state) else np.nan)
    return np.array(out)


@pytest.mark.parametrize("systems", ["G", "E", "C", "R", "GREC"])
@pytest.mark.parametrize(
    "move", [static(PLACE), straight(PLACE, [30.0, -20.0, 1.0])], ids=["rest", "straight"]
)
def test_without_noise_the_filter_stays_on_truth(systems, move):
    nav = nominal_navigation(START, START + 60 * SECOND, systems)
    simulated = simulate(nav, move, times(60), EXACT, np.random.default_rng(1))
    assert errors(nav, simulated).max() < 0.01


def test_with_noise_the_errors_are_those_of_the_noise_model():
    nav = nominal_navigation(START, START + 80 * SECOND, "GE")
    found = errors(nav, simulate(nav, static(PLACE), times(80), Receiver(), np.random.default_rng(1)))
    assert 0.05 < np.median(found) < 3.0


def test_the_code_errors_have_the_variance_and_correlation_asked_for():
    noise = NoiseModel(code_white_m=0.01, code_multipath_m=1.0, code_multipath_tau_s=5.0, code_bias_m=0.0)
    nav = nominal_navigation(START, START + 600 * SECOND, "G")
    t = START + SECOND * np.arange(400, dtype=np.int64)
    runs = [simulate(nav, static(PLACE), t, Receiver(noise, s), np.random.default_rng(2)) for s in (0.0, 1.0)]
    clean, noisy = (r.table.pseudorange_m - r.clock_m[r.table.epoch] for r in runs)
    table = runs[0].table
    rows = table.sat == "G05"
    scale = noise.scale(np.arcsin((table.cn0_dbhz[rows] - 38.0) / 12.0), table.cn0_dbhz[rows])
    error = (noisy - clean)[rows] / scale
    assert np.std(error) == pytest.approx(1.0, abs=0.4)
    assert np.corrcoef(error[1:], error[:-1])[0, 1] == pytest.approx(np.exp(-0.2), abs=0.1)


def test_the_same_generator_gives_the_same_signals():
    nav = nominal_navigation(START, START + 10 * SECOND, "GE")
    a, b = (
        simulate(nav, static(PLACE), times(5), Receiver(), np.random.default_rng(7)).table for _ in range(2)
    )
    np.testing.assert_array_equal(a.pseudorange_m, b.pseudorange_m)
    np.testing.assert_array_equal(a.carrier_cycles, b.carrier_cycles)


def test_written_as_rinex_and_read_back_it_is_the_same_log(tmp_path):
    nav = nominal_navigation(START, START + 30 * SECOND, "GREC")
    table = simulate(nav, static(PLACE), times(10), Receiver(), np.random.default_rng(3)).table
    write_observations(tmp_path / "o.rnx", table)
    write_navigation(tmp_path / "n.rnx", nav)
    back, nav_back = read_observations(tmp_path / "o.rnx"), read_navigation(tmp_path / "n.rnx")
    assert not back.notes
    for a, b in zip(epochs_of(table, nav), epochs_of(back, nav_back), strict=True):
        for x, y in zip(a.observations, b.observations, strict=True):
            assert x.keys == y.keys
            np.testing.assert_allclose(x.y, y.y, atol=1e-3)
            np.testing.assert_allclose(x.aux["sv_pos_m"], y.aux["sv_pos_m"], atol=1e-2)


def test_carrier_code_and_range_rate_tell_the_same_motion():
    nav = nominal_navigation(START, START + 30 * SECOND, "G")
    table = simulate(nav, car(PLACE), times(3), EXACT, np.random.default_rng(3)).table
    epochs = epochs_of(table, nav)
    code, rate, carrier = ([e.sensor(s).y for e in epochs] for s in ("code", "doppler", "carrier"))
    # the range rate has no troposphere (some mm/s at low elevations) and no term of second order (2 mm/s)
    np.testing.assert_allclose(code[2] - code[0], 2.0 * rate[1], atol=0.03)
    np.testing.assert_allclose(carrier[2] - carrier[0], 2.0 * rate[1], atol=0.03)


def test_faults_in_the_signals_are_faults_in_the_epochs():
    nav = nominal_navigation(START, START + 30 * SECOND, "GE")
    table = simulate(nav, static(PLACE), times(8), Receiver(), np.random.default_rng(4)).table
    faults = [
        parse_fault(f) for f in ("G05 ramp 0.5 m/s 2:6", "G07:* ramp 3 m/s 1:", "clock-drift 1 m/s^2 3:")
    ]
    one, two = epochs_of(with_faults(table, faults), nav), apply_faults(epochs_of(table, nav), faults)
    for a, b in zip(one, two, strict=True):
        for x, y in zip(a.observations, b.observations, strict=True):
            np.testing.assert_allclose(x.y, y.y, atol=1e-6)


def test_an_outage_leaves_only_who_was_named():
    nav = nominal_navigation(START, START + 30 * SECOND, "G")
    table = simulate(nav, static(PLACE), times(8), Receiver(), np.random.default_rng(4)).table
    cut = keep_only(table, lambda t, sat: not 3.0 <= t < 5.0 or sat in ("G05", "G07"))
    seen = [set(cut.sat[cut.epoch == k].tolist()) for k in range(8)]
    assert seen[3] == seen[4] == {"G05", "G07"}
    assert len(seen[2]) == len(seen[5]) > 4


@pytest.mark.parametrize("t", [0.5, 30.0, 61.3, 75.0, 110.0, 149.0, 170.0, 301.0])
def test_velocity_is_the_derivative_of_position(t):
    drive = car(PLACE, heading_rad=0.4)
    slope = (drive(t + 1e-3)[0] - drive(t - 1e-3)[0]) / 2e-3
    np.testing.assert_allclose(slope, drive(t)[1], atol=2e-3)


def test_a_drive_must_have_legs_and_end_at_rest():
    with pytest.raises(ValueError, match="last leg"):
        car(PLACE, (Leg(5.0, 3.0),))
    with pytest.raises(ValueError, match="`legs`"):
        car(PLACE, ())


def test_constellations_have_their_satellites_and_radii():
    nav = nominal_navigation(START, START, "GREC")
    count = {
        s: len({r.satellite for r in (*nav.kepler, *nav.glonass) if r.satellite[0] == s}) for s in "GREC"
    }
    assert count == {s: NOMINAL[s].count for s in "GREC"}
    assert not nav.notes
    with pytest.raises(ValueError, match="letters"):
        navigation_text(START, START, "X")


def test_successive_ephemerides_are_one_orbit():
    nav = nominal_navigation(START, START + 7200 * SECOND, "GEC")
    for sat in ("G05", "E03", "C25"):
        records, toe = nav.of(sat)
        for a, b, ta, tb in zip(records, records[1:], toe, toe[1:], strict=False):
            middle = float(tb - ta) * 5e-10
            p, q = a.evaluate(a.elements.toe_sow + middle), b.evaluate(b.elements.toe_sow - middle)
            assert np.hypot(p.x_m - q.x_m, p.y_m - q.y_m) < 0.01
            assert abs(p.z_m - q.z_m) < 0.01
