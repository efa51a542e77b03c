"""A wrong place: what satellites say as from elsewhere, and who notices."""

from __future__ import annotations

import numpy as np
import pytest

from gnss_logs import PLACE, SECOND, START, log, navigation, options
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, Observation
from pntegrity.satellite_source import merged
from pntegrity.sensors.snapshot import Fix, snapshot
from pntegrity.simulate.faults import apply_faults, parse_fault, signature, touches_any

AXES = enu_rotation(PLACE)


def fix(epoch) -> Fix:
    return snapshot(epoch, options(navigation()), np.zeros(3))


@pytest.mark.parametrize(
    ("towards", "enu"), [("north", (0, 1, 0)), ("west", (-1, 0, 0)), ("up", (0, 0, 1)), ("down", (0, 0, -1))]
)
def test_all_satellites_together_move_the_fix_and_leave_the_clock(towards, enu):
    for clean, faulty in zip(log(4), log(4, f"*:{towards} bias 80 m 2:"), strict=True):
        before, after = fix(clean), fix(faulty)
        size = 80.0 * (clean.t_ns >= START + 2 * SECOND)
        off = AXES @ (after.position_m - before.position_m) - size * np.array(enu)
        small_m = 0.03 + 0.1 * abs(enu[2])  # 80 m higher the filter's air weighs 1 % less
        assert np.abs(off[:2]).max() < 0.03
        assert abs(off[2]) < small_m
        assert after.clocks_m == pytest.approx(before.clocks_m, abs=small_m)


def test_a_drift_shows_in_the_range_rates_as_a_velocity():
    clean, faulty = log(10)[-1], log(10, "*:east ramp 2 m/s 0:")[-1]
    moved = fix(faulty)
    np.testing.assert_allclose(
        AXES @ (moved.velocity_mps - fix(clean).velocity_mps), [2.0, 0.0, 0.0], atol=0.01
    )
    np.testing.assert_allclose(AXES @ (moved.position_m - fix(clean).position_m), [18.0, 0.0, 0.0], atol=0.05)


def test_one_constellation_alone_leaves_the_others_as_they_are():
    clean, faulty = log(2)[1], log(2, "G:north bias 50 m")[1]
    for o, spoilt in zip(clean.observations, faulty.observations, strict=True):
        same = np.array([a == b for a, b in zip(o.y, spoilt.y, strict=True)])
        levels = np.array([k.startswith("G") and ":D" not in k for k in o.keys])
        np.testing.assert_array_equal(same, ~levels)


def test_satellites_of_a_source_move_as_well():
    name = "bow"
    made = [Epoch(e.t_ns, (merged(e, name),)) for e in log(2)]
    moved = apply_faults(made, [parse_fault("bow:north bias 80 m")])[0].observations[0]
    np.testing.assert_allclose(
        moved.y - made[0].observations[0].y,
        np.concatenate([o.y for o in log(2, "*:north bias 80 m")[0].observations if o.sensor != "carrier"])
        - np.concatenate([o.y for o in log(2)[0].observations if o.sensor != "carrier"]),
        atol=1e-6,
    )


def test_without_a_place_nothing_moves_and_rows_alone_are_refused():
    few = [Epoch(e.t_ns, tuple(o.select(np.arange(len(o.keys)) < 3) for o in e.observations)) for e in log(2)]
    faulty = apply_faults(few, [parse_fault("*:north bias 80 m")])
    assert all((a.y == b.y).all() for a, b in zip(few[0].observations, faulty[0].observations, strict=True))
    with pytest.raises(ValueError, match="needs positions"):
        signature(parse_fault("*:north bias 80 m"), ("G05:C1C",), START, START)


@pytest.mark.parametrize("names", [("RX", "RY", "RZ"), ("X", "Y", "Z")])
def test_positions_move_by_either_name(names):
    keys = tuple(f"fix:{n}" for n in (*names, "DX"))
    o = Observation("fix", START, keys, np.append(PLACE, 0.5))
    moved = apply_faults([Epoch(START, (o,))], [parse_fault("fix:east bias 3 m")])[0].observations[0].y - o.y
    np.testing.assert_allclose(AXES @ moved[:3], [3.0, 0.0, 0.0], atol=1e-6)
    assert moved[3] == 0.0


def test_products_do_not_move():
    epochs = log(1)
    assert touches_any(parse_fault("*:north bias 1 m"), epochs)
    assert not parse_fault("*:north bias 1 m").touches("iono:G05")
    assert not parse_fault("G:north bias 1 m").touches("E05:C1C")
