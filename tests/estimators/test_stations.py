"""Products of a station whose place is known: the delays that were simulated, as well known as it says."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gnss_logs import PLACE, SECOND, START, navigation
from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.physics.atmosphere import zenith_delays_m
from pntegrity.physics.atmosphere_products import metres_per_tecu
from pntegrity.physics.orbits import satellite_states
from pntegrity.records import Epoch, Layout, Observation, State
from pntegrity.sensors.noise import PPP, PPP_RTK
from pntegrity.simulate.precise import PreciseReceiver, simulate_precise
from pntegrity.stations import SLANT_FLOOR_M, ZENITH_FLOOR_M, pinned, products_from_station

STEP = 30
N = 120
BANDS = {"G": (1575.42e6, 1227.60e6), "E": (1575.42e6, 1176.45e6)}
#: Code biases of the receiver in the slant delays of a constellation, m.
DATUM = {"G": 1.0, "E": -2.0}
QUIET = replace(
    PPP, code_white_m=1e-9, code_bias_m=0.0, carrier_m=1e-9, ambiguity_m=0.0, glonass_code_bias_m=0.0,
    zwd_walk_m=0.0, satellite_clock_m=0.0,
)  # fmt: skip


def slant_m(sat: str, k: int) -> float:
    """Return the delay on the first frequency that is simulated: it changes as satellites rise and set."""
    return 3.0 + 0.1 * int(sat[1:]) + (0.01 if int(sat[1:]) % 2 else -0.005) * k


@lru_cache(maxsize=4)
def log(n: int = N, code_m: float = 0.3, carrier_m: float = 0.002, seed: int = 3) -> tuple[Epoch, ...]:
    """Return uncombined epochs at `PLACE`: wet delay 0.15 m, slant delays `slant_m`, white errors."""
    nav = navigation("GE", 7200)
    names = sorted({r.satellite for r in nav.kepler})
    t_ns = START + STEP * SECOND * np.arange(n, dtype=np.int64)

    def states(sats, t, ranges):
        return satellite_states(
            nav, sats, t, ranges, [{"G": "1C+2W", "E": "1C+7Q"}[s[0]] for s in sats.tolist()]
        )

    rng = np.random.default_rng(seed)
    receiver = PreciseReceiver(noise=QUIET, wet_m=0.15)
    clean = simulate_precise(states, names, t_ns, np.tile(PLACE, (n, 1)), receiver, rng)
    return tuple(_uncombined(e, k, code_m, carrier_m, rng) for k, e in enumerate(clean))


def _uncombined(epoch: Epoch, k: int, code_m: float, carrier_m: float, rng: np.random.Generator) -> Epoch:
    one, sats = epoch.sensor("code"), [key[:3] for key in epoch.sensor("code").keys]
    delay = np.array([slant_m(s, k) for s in sats])
    datum = np.array([DATUM[s[0]] for s in sats])
    f = np.array([BANDS[s[0]] for s in sats]).T
    parts = []
    for sensor, letter, sign, size in (("code", "C", 1.0, code_m), ("carrier", "L", -1.0, carrier_m)):
        for band in (0, 1):
            factor = (f[0] / f[band]) ** 2
            y = one.y + sign * factor * delay + rng.normal(0.0, size, len(sats))
            y = y + (factor * datum if sensor == "code" else 7.0 * band)
            aux = dict(one.aux) | {"freq_hz": f[band], "iono_factor": factor, "model_m": np.zeros(len(sats))}
            if sensor == "carrier":
                aux |= {"arc": np.ones(len(sats), dtype=int), "arc_reason": np.zeros(len(sats), dtype=int)}
            keys = tuple(f"{s}:{letter}{band + 1}X" for s in sats)
            parts.append((sensor, keys, y, aux))
    observations = [
        _joined(epoch.t_ns, name, [p for p in parts if p[0] == name]) for name in ("code", "carrier")
    ]
    return replace(epoch, observations=tuple(observations))


def _joined(t_ns: int, sensor: str, parts) -> Observation:
    keys = tuple(k for p in parts for k in p[1])
    aux = {name: np.concatenate([p[3][name] for p in parts]) for name in parts[0][3]}
    return Observation(sensor, t_ns, keys, np.concatenate([p[2] for p in parts]), None, aux)


def options() -> GnssOptions:
    return GnssOptions(noise=PPP_RTK, max_gap_s=3600.0)


@pytest.fixture(scope="module")
def made():
    return products_from_station(log(), PLACE, options(), latency_s=30.0, source="SIMU")


def errors_m(made, sat: str) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and standard deviations of a satellite's slant delay on its first frequency."""
    t_ns, stec, sigma = made.ionosphere[sat]
    scale = metres_per_tecu(1575.42e6)
    k = (t_ns - 30 * SECOND - START) // (STEP * SECOND)
    return scale * stec - [slant_m(sat, int(i)) for i in k], scale * sigma


def test_a_sample_holds_the_estimate_of_a_latency_before(made):
    assert made.troposphere[0][0] == START + 30 * SECOND
    assert len(made.troposphere[0]) == N
    assert (made.latency_s, made.self_derived, made.interval_s, made.troposphere_kind) == (
        30.0,
        True,
        30.0,
        "ZWD",
    )
    assert "SIMU" in made.source
    assert "its noise is in it" in made.source


def test_slant_delays_are_right_between_the_satellites_of_a_constellation(made):
    whole = [s for s, v in made.ionosphere.items() if len(v[0]) == N]
    for letter in "GE":
        own = [s for s in whole if s[0] == letter]
        last = np.array([errors_m(made, s)[0][-1] for s in own])
        assert len(own) >= 4
        # the datum of the constellation is in them
        assert last.mean() == pytest.approx(DATUM[letter], abs=0.3)
        assert np.ptp(last) < 0.4, last


def test_errors_are_as_large_as_the_filter_says(made):
    # GIVEN white errors as large as the model's or smaller THEN no delay is further off than it says
    tested = []
    for sat in made.ionosphere:
        error, sigma = errors_m(made, sat)
        tested.append((error[-1] - DATUM[sat[0]]) / sigma[-1])
    assert np.abs(tested).max() < 3.0
    assert np.sqrt(np.mean(np.square(tested))) < 1.3
    wet, sigma = made.troposphere[1:]
    assert np.abs((wet - 0.15) / sigma)[10:].max() < 3.0
    assert abs(wet[-1] - 0.15) < 0.02
    assert sigma[-1] < 0.03


def test_with_better_data_delays_are_better():
    quiet = products_from_station(log(40, 0.003, 2e-5), PLACE, options(), latency_s=30.0)
    for sat in quiet.ionosphere:
        assert abs(errors_m(quiet, sat)[0][-1] - DATUM[sat[0]]) < 0.02
    assert abs(quiet.troposphere[1][-1] - 0.15) < 0.005


def test_sigmas_have_a_floor(made):
    slant = np.concatenate([errors_m(made, s)[1] for s in made.ionosphere])
    assert slant.min() >= SLANT_FLOOR_M - 1e-9
    assert made.troposphere[2].min() >= ZENITH_FLOOR_M


def test_an_interval_thins_the_samples():
    made = products_from_station(log(40), PLACE, options(), latency_s=0.0, interval_s=90.0)
    np.testing.assert_array_equal(np.diff(made.troposphere[0]), 90 * SECOND)
    assert made.troposphere[0][0] == START
    assert made.interval_s == 90.0


def test_a_pinned_state_is_the_state_given_the_position():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((6, 6))
    P = A @ A.T
    layout = Layout(("pos:x", "pos:y", "pos:z", "clk:G", "zwd", "ion:G05"))
    state = State(0, np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), P, layout)
    place = np.array([1.5, 1.5, 3.5])
    out = pinned(state, place)
    # by the textbook: the conditional of a Gaussian
    gain = np.linalg.solve(P[:3, :3], P[:3, 3:]).T
    np.testing.assert_allclose(out.mean[3:], state.mean[3:] + gain @ (place - state.mean[:3]), atol=1e-4)
    np.testing.assert_allclose(out.P[3:, 3:], P[3:, 3:] - gain @ P[:3, 3:], atol=1e-4)
    np.testing.assert_allclose(out.mean[:3], place, atol=1e-4)
    assert np.sqrt(np.diagonal(out.P)[:3]).max() < 1.1e-3
    assert pinned(State.empty(), place).mean.size == 0


def test_coordinates_of_another_place_are_refused():
    with pytest.raises(InputError, match="from the coordinates") as caught:
        products_from_station(log(40), PLACE + np.array([500.0, 0.0, 0.0]), options())
    assert "--position" in str(caught.value)


def test_epochs_without_enough_satellites_are_refused():
    few = [replace(e, observations=tuple(o.select(np.arange(2)) for o in e.observations)) for e in log(40)]
    with pytest.raises(InputError, match="no slant delay could be estimated"):
        products_from_station(few, PLACE, options())


@pytest.mark.parametrize(("place", "latency"), [(PLACE[:2], 30.0), (PLACE * np.nan, 30.0), (PLACE, -1.0)])
def test_what_makes_no_sense_is_refused(place, latency):
    with pytest.raises(ValueError, match="must be"):
        products_from_station(log(40), place, options(), latency_s=latency)


def test_the_simulated_wet_delay_is_not_the_one_that_is_expected():
    assert abs(zenith_delays_m(PLACE)[1] - 0.15) > 0.02  # else the filter would have nothing to find


def shifted(epochs, sat: str, metres: float, at: range):
    """Return epochs with the codes of a satellite, or of all (""), off by alternating amounts."""
    out = []
    for k, e in enumerate(epochs):
        code = e.sensor("code")
        y = code.y + np.array([metres * (1 + i % 7) * key.startswith(sat) for i, key in enumerate(code.keys)])
        changed = replace(code, y=y if k in at else code.y)
        out.append(replace(e, observations=(changed, *e.observations[1:])))
    return out


def test_a_satellite_at_fault_gives_no_sample_and_leaves_the_others_alone(made):
    sat = next(s for s, v in made.ionosphere.items() if len(v[0]) == N)
    out = products_from_station(shifted(log(), sat, 20.0, range(60, 65)), PLACE, options(), latency_s=30.0)
    missing = np.setdiff1d(made.ionosphere[sat][0], out.ionosphere[sat][0])
    k = (missing - 30 * SECOND - START) // (STEP * SECOND)
    assert set(range(60, 65)) <= set(k.tolist())
    assert k.max() < 110
    assert f"excluded as faulty, no sample: {sat}" in out.notes[-1]
    for other in set(made.ionosphere) - {sat}:
        a, b = errors_m(made, other)[0], errors_m(out, other)[0]
        assert np.abs(a - b).max() < 0.15
    assert np.abs(out.troposphere[1] - made.troposphere[1]).max() < 0.02


def test_epochs_that_stay_suspect_give_no_sample():
    out = products_from_station(shifted(log(40), "", 30.0, range(30, 33)), PLACE, options(), latency_s=0.0)
    k = (out.troposphere[0] - START) // (STEP * SECOND)
    assert not set(range(30, 33)) & set(k.tolist())
    assert any("an alert that nobody could resolve" in note for note in out.notes)
