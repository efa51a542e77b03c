"""Faults: the grammar, the signature, and that nothing else is touched."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pntegrity.physics.time import from_iso
from pntegrity.records import Epoch, Observation
from pntegrity.simulate.faults import (
    apply_faults,
    describe,
    parse_fault,
    signature,
    touches_any,
)

SECOND = 10**9
START = from_iso("2019-01-14T06:15:00")
KEYS = ("G05:C1C", "G05:L1C", "G05:D1C", "G07:C1C", "E11:C1X", "E11:D1X")


def at(text, keys, seconds):
    return signature(parse_fault(text), keys, START + round(seconds * SECOND), START)


def test_a_ramp_touches_the_code_of_its_satellite_only():
    np.testing.assert_allclose(at("G05 ramp 0.1 m/s 200:300", KEYS, 250), [5.0, 0, 0, 0, 0, 0])


def test_the_onset_belongs_to_the_fault_and_the_end_does_not():
    values = [at("G05 bias 15 m 60:100", KEYS, t)[0] for t in (59, 60, 99, 100)]
    assert values == [0.0, 15.0, 15.0, 0.0]


def test_a_satellite_clock_takes_code_carrier_and_rate_along():
    np.testing.assert_allclose(at("G05:* ramp 0.1 m/s 200:", KEYS, 230), [3.0, 3.0, 0.1, 0, 0, 0])


@pytest.mark.parametrize("family", ["G", "G*"])
def test_a_family_is_all_its_satellites(family):
    np.testing.assert_allclose(at(f"{family} bias 2 m", KEYS, 0), [2, 0, 0, 2, 0, 0])


def test_one_signal_the_carrier_or_the_range_rates_alone():
    np.testing.assert_allclose(at("G05:L bias 2 cm", KEYS, 1), [0, 0.02, 0, 0, 0, 0])
    np.testing.assert_allclose(at("E11:C1X bias 2 m", KEYS, 1), [0, 0, 0, 0, 2, 0])
    np.testing.assert_allclose(at("E11:D ramp 0.3 m/s^2 0:", KEYS, 2), [0, 0, 0, 0, 0, 0.6])


def test_a_clock_drift_is_on_every_row_and_its_phase_stays_when_it_is_over():
    keys = KEYS[:3]
    np.testing.assert_allclose(at("clock-drift 2 m/s^2 10:20", keys, 15), [25.0, 25.0, 10.0])
    np.testing.assert_allclose(at("clock-drift 2 m/s^2 10:20", keys, 30), [100.0, 100.0, 0.0])
    np.testing.assert_allclose(at("clock-drift 0.001 ns/s^2 200:300", keys, 300)[0], 0.299792458e-3 * 5000.0)
    np.testing.assert_allclose(at("clock-drift 3 ns/s", keys, 10), 0.899377374 * np.array([10, 10, 1]))


def test_a_rate_is_the_derivative_of_the_level():
    for text in ("G05:* sine 3 m 20 s", "G05:* ramp 0.2 m/s 3:", "clock-drift 0.1 m/s^2 2:"):
        before, now, after = (at(text, KEYS, 7.0 + d) for d in (-1e-3, 0.0, 1e-3))
        assert now[2] == pytest.approx((after[0] - before[0]) / 2e-3, rel=1e-6)


def test_gps_times_and_seconds_mean_the_same():
    relative = parse_fault("G05 ramp 0.1 m/s 300:600")
    absolute = parse_fault("G05 ramp 0.1 m/s 2019-01-14T06:20:00/2019-01-14T06:25:00")
    assert absolute.onset_ns(0) == relative.onset_ns(START)
    assert absolute.end_ns(0) == relative.end_ns(START)
    assert parse_fault("G05 bias 3 m 2019-01-14T06:20:00/").end_ns(0) is None


def test_other_groups_have_their_levels_touched():
    np.testing.assert_allclose(at("lbl bias 3 m", ("lbl:AP1", "lbl:D1", "usbl:x"), 0), [3, 0, 0])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "kind"),
        ("G05", "kind"),
        ("G05 jump 3 m", "kind"),
        ("bias 3 m", "target"),
        ("G05 bias 3 m/s", "must be m,"),
        ("G05 ramp 3 m", "must be m/s"),
        ("G05 bias x m", "size"),
        ("G05 bias 3 parsec", "no unit"),
        ("G05 sine 3 m 5:6", "period"),
        ("G05 sine 3 m 0 s", "above 0"),
        ("G05 bias 3 m 5:2", "after the start"),
        ("G05 bias 3 m 5:6 7", "too much"),
        ("G05 bias 3 m nan:", "interval"),
        ("G05 bias 3 m 2019:01:14", "interval"),
        ("G05 bias 3 m /2019-01-14", "interval"),
        ("clock-drift 3 m", "must be m/s or m/s^2"),
        ("G05:D ramp 1 m/s", "must be m/s^2"),
    ],
)
def test_a_bad_line_says_why_and_shows_the_grammar(text, why):
    with pytest.raises(ValueError, match="a fault is written") as caught:
        parse_fault(text)
    assert why in str(caught.value).splitlines()[0]


@given(st.text(max_size=40))
def test_any_text_is_a_fault_or_a_value_error(text):
    with contextlib.suppress(ValueError):
        describe(parse_fault(text))


@given(
    st.sampled_from(["G05", "G", "E*", "*", "G05:*", "G05:L"]),
    st.floats(-1e3, 1e3, allow_nan=False),
    st.integers(0, 5),
)
def test_apply_faults_adds_the_signature_and_leaves_all_else_bit_identical(target, size, onset):
    rng = np.random.default_rng(5)
    code = [Observation("code", START + k * SECOND, KEYS, rng.normal(2e7, 1.0, 6)) for k in range(8)]
    other = Observation("imu", START, ("imu:a",), np.ones(1))
    epochs = [Epoch(o.t_ns, (o, other)) for o in code]
    fault = parse_fault(f"{target} bias {size:.6f} m {onset}:7")
    for before, after in zip(epochs, apply_faults(epochs, [fault]), strict=True):
        expected = signature(fault, KEYS, before.t_ns, START)
        clean = expected == 0.0
        y, z = before.observations[0].y, after.observations[0].y
        assert np.array_equal(y[clean], z[clean])
        assert np.array_equal(z[~clean], (y + expected)[~clean])
        if clean.all() and target != "*":
            assert after is before
        if target != "*":
            assert after.observations[1] is other


def test_faults_add_up_and_seconds_can_count_from_elsewhere():
    epoch = Epoch(START + 5 * SECOND, (Observation("code", START + 5 * SECOND, KEYS, np.zeros(6)),))
    faults = [parse_fault("G05 bias 1 m"), parse_fault("G05 ramp 1 m/s")]
    assert apply_faults([epoch], faults, first_ns=START)[0].observations[0].y[0] == 6.0
    assert apply_faults([epoch], faults)[0].observations[0].y[0] == 1.0


ROWS = ("lbl:R.T1", "lbl:R.T2", "usbl:R.range", "usbl:A.bearing", "gnss:RX", "gnss:R.G05", "gnss:D.G05")


def said(keys, y=None, **aux):
    group = keys[0].partition(":")[0]
    return Observation(group, START, tuple(keys), np.zeros(len(keys)) if y is None else y, aux=aux)


def shift(text, *observations):
    (epoch,) = apply_faults([Epoch(START, observations)], [parse_fault(text)])
    return np.concatenate([o.y for o in epoch.observations]) - np.concatenate([o.y for o in observations])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lbl.T1 bias 5 ms", [5e-3, 0, 0, 0, 0, 0, 0]),
        ("lbl bias 0.1 s", [0.1, 0.1, 0, 0, 0, 0, 0]),
        ("usbl bias 2 m", [0, 0, 2, 0, 0, 0, 0]),
        ("usbl bias 0.5 deg", [0, 0, 0, np.deg2rad(0.5), 0, 0, 0]),
        ("usbl.bearing bias 3 mrad", [0, 0, 0, 3e-3, 0, 0, 0]),
        ("gnss:RX bias 2 m", [0, 0, 0, 0, 2, 0, 0]),
        ("gnss.G05 bias 100 ns", [0, 0, 0, 0, 0, 29.9792458, 0]),
        ("gnss.G05:* bias 2 m", [0, 0, 0, 0, 0, 2, 0]),
        ("lbl bias 2 m", [0] * 7),
    ],
)
def test_the_unit_of_a_fault_of_a_source_says_which_rows_it_falls_on(text, expected):
    lbl = said(ROWS[:2], ways=np.array([2, 2]))
    usbl, gnss = said(ROWS[2:4]), said(ROWS[4:])
    np.testing.assert_allclose(shift(text, lbl, usbl, gnss), expected, rtol=1e-12)


def test_a_drift_in_a_direction_is_turned_into_ecef_at_the_first_position():
    north_pole_side = np.array([0.0, -6.378137e6, 0.0])  # on the equator at 90 degrees west
    fix = said(("gnss:RX", "gnss:RY", "gnss:RZ"), north_pole_side)
    np.testing.assert_allclose(shift("gnss:north bias 3 m", fix), [0, 0, 3], atol=1e-9)
    np.testing.assert_allclose(shift("gnss:east bias 3 m", fix), [3, 0, 0], atol=1e-9)
    np.testing.assert_allclose(shift("gnss:down bias 3 m", fix), [0, 3, 0], atol=1e-9)
    later = Observation("gnss", START + 100 * SECOND, fix.keys, fix.y)
    epochs = [Epoch(START, (fix,)), Epoch(later.t_ns, (later,))]
    moved = apply_faults(epochs, [parse_fault("gnss:up ramp 0.05 m/s 20:")])[1].observations[0].y - later.y
    np.testing.assert_allclose(moved, [0, -4.0, 0], atol=1e-9)


def test_a_fault_that_falls_on_no_row_in_its_unit_touches_nothing():
    epochs = [Epoch(START, (said(ROWS[:2], ways=np.array([2, 2])),))]
    assert touches_any(parse_fault("lbl bias 5 ms"), epochs)
    assert not touches_any(parse_fault("lbl bias 5 m"), epochs)
    assert not touches_any(parse_fault("lbl.T3 bias 5 ms"), epochs)
    assert not touches_any(parse_fault("lbl:north bias 5 m"), epochs)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("lbl bias 500 us", "write travel times of lbl in ms or s"),
        ("G05 bias 5 ms", "no unit of what G05 measures"),
        ("gnss:north ramp 1 deg/s", "no unit"),
        ("clock-drift 1 ms/s", "no unit"),
        ("lbl bias 5 ms/s", "must be s,"),
        ("lbl. bias 5 ms", "no target"),
    ],
)
def test_units_that_rows_cannot_be_in_are_refused(text, why):
    with pytest.raises(ValueError, match="a fault is written") as caught:
        parse_fault(text)
    assert why in str(caught.value).splitlines()[0]


def test_faults_of_sensors_hit_the_sensor_and_its_source():
    fault = parse_fault("lbl.T1 bias 5 ms")
    assert fault.hits(["lbl", "lbl.T1", "lbl.T2", "gnss"]) == {"lbl", "lbl.T1"}
    assert parse_fault("lbl bias 5 ms").hits(["lbl.T1", "gnss"]) == {"lbl.T1"}


def test_words_for_faults_of_sources():
    assert describe(parse_fault("lbl.T1 bias 5 ms 10:20")) == "bias of 5 ms on lbl.T1, from 10 s to 20 s"
    assert (
        describe(parse_fault("gnss:north ramp 0.05 m/s"))
        == "ramp of 0.05 m/s on gnss northwards, from 0 s on"
    )
    assert describe(parse_fault("*:up bias 2 m")) == "bias of 2 m on all groups upwards, from 0 s on"
    assert (
        describe(parse_fault("G:down bias 2 m")) == "bias of 2 m on all G satellites downwards, from 0 s on"
    )
    assert describe(parse_fault("usbl bias 1 deg")) == "bias of 1 deg on usbl, from 0 s on"


def test_words_for_people():
    assert describe(parse_fault("clock-drift 0.01 m/s^2 100:200")) == (
        "clock drift of 0.01 m/s^2 on the receiver clock, from 100 s to 200 s"
    )
    assert describe(parse_fault("G* bias 3 m")) == "bias of 3 m on the code of all G satellites, from 0 s on"
