"""Fixes that contradict an inertial unit: left out, bridged, back when they agree or when time is up."""

from __future__ import annotations

import numpy as np
import pytest

from gnss_logs import PLACE
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.exclusion import Policy
from pntegrity.inertial import with_course
from pntegrity.kernels.gravity import EARTH_RATE, gravity
from pntegrity.kernels.rotations import from_angles
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Pipeline
from pntegrity.records import Epoch, Inertial, Observation
from pntegrity.sensors.imu import STIM300
from pntegrity.sensors.increments import with_increments
from pntegrity.simulate.faults import apply_faults, parse_fault

SECOND = 10**9
START = 1_300_000_000 * SECOND
TO_ENU = enu_rotation(PLACE)
KEYS = ("fix:X", "fix:Y", "fix:Z", "fix:DX", "fix:DY", "fix:DZ")
SIGMA = np.array([0.05] * 3 + [0.05] * 3)


def fix(k, y):
    n = len(y)
    return Epoch(START + k * SECOND, (
        Observation("fix", START + k * SECOND, KEYS[:n], y, SIGMA[:n], {"cov": np.diag(SIGMA[:n] ** 2)}),
    ))  # fmt: skip


def log(*faults, seconds=140, bias=(0.0, 0.0, 0.0)):
    """Return fixes of a vehicle at rest, heading 30 degrees, with a unit whose forces are off by `bias`."""
    rng = np.random.default_rng(5)
    still = np.append(PLACE, np.zeros(3))
    epochs = [fix(k, still + 0.5 * SIGMA * rng.normal(size=6)) for k in range(seconds)]
    C = TO_ENU.T @ from_angles([0.0, 0.0, np.radians(30.0)])
    n = 20 * (seconds + 2)
    dt = np.full(n, 0.05)
    rate = C.T @ np.array([0.0, 0.0, EARTH_RATE])
    force = -C.T @ np.array(gravity(*PLACE)) + np.asarray(bias)
    late = (np.arange(n) >= 20 * 50)[:, None]  # the bias comes after the alignment
    force = np.where(late, force, force - np.asarray(bias))
    unit = Inertial(
        START - SECOND + SECOND // 20 * np.arange(1, n + 1), dt, np.outer(dt, rate), dt[:, None] * force
    )
    return apply_faults(with_increments(epochs, unit), [parse_fault(f) for f in faults])


def drive(epochs, **changes):
    options = InsOptions(spec=STIM300, coupling="loose", heading_rad=float(np.radians(30.0)))
    estimator = GnssIns(GnssOptions(ins=options, max_gap_s=600.0))
    pipeline = Pipeline(estimator, (Rctm(), Glr()), Policy(**(dict(estimator.policy) | changes)))
    return [pipeline.push(e) for e in epochs]


def errors(outcomes):
    return np.array([
        np.linalg.norm(o.update.posterior.mean[:3] - PLACE) if len(o.update.posterior) else np.nan
        for o in outcomes
    ])  # fmt: skip


def made(outcomes):
    return [(k, e.group) for k, o in enumerate(outcomes) for e in o.exclusions]


def back(outcomes):
    return [k for k, o in enumerate(outcomes) if o.readmitted]


def test_without_a_fault_nothing_is_left_out():
    outcomes = drive(log())
    assert made(outcomes) == []
    assert errors(outcomes)[10:].max() < 0.1


@pytest.mark.parametrize("fault", ["fix bias 5 m 60:80", "fix:X bias 20 m 60:80"])
def test_a_jump_of_the_only_source_is_left_out_and_bridged(fault):
    # GIVEN fixes that agree with each other, and jump against the unit
    outcomes = drive(log(fault))
    # THEN they go at once, the unit bridges, and they are back some seconds after the jump is over
    assert made(outcomes) == [(60, "fix")]
    assert len(back(outcomes)) == 1
    assert 80 <= back(outcomes)[0] <= 90
    assert errors(outcomes)[10:].max() < 2.0
    assert errors(outcomes)[100:].max() < 0.1


def test_a_ramp_is_repaired_from_its_onset():
    outcomes = drive(log("fix:X ramp 0.5 m/s 60:80"))
    assert made(outcomes)[0][0] <= 64
    assert errors(outcomes)[10:].max() < 2.0


def test_without_trust_in_the_prior_a_jump_is_followed():
    outcomes = drive(log("fix bias 5 m 60:80"), trust_prior=False)
    assert made(outcomes) == []
    assert errors(outcomes)[60:80].max() > 8.0


def test_a_fault_that_stays_comes_back_when_time_is_up_and_says_so():
    outcomes = drive(log("fix bias 20 m 60:"))
    assert made(outcomes) == [(60, "fix")]
    (when,) = back(outcomes)
    assert when == 90
    assert "position and velocity started anew" in outcomes[when + 1].update.events
    # a unit cannot tell for ever: what the fix says is taken, and nothing more is left out
    assert errors(outcomes)[100:].min() > 30.0


def test_a_unit_that_is_wrong_does_not_lock_good_fixes_out():
    # GIVEN a unit whose forward force is off by 0.5 m/s^2 from 49 s on, far beyond its specification
    outcomes = drive(log(bias=(0.5, 0.0, 0.0)))
    # THEN good fixes are left out for the time of one re-acquisition, not again and again
    spells = [k for k, _ in made(outcomes)]
    assert len(spells) == 1
    left = sum("fix" in o.update.excluded for o in outcomes)
    assert left <= 35
    assert errors(outcomes)[95:].max() < 1.0


def test_fixes_without_velocities_get_a_course_to_start_with_and_no_more():
    def going(k):
        return PLACE + TO_ENU.T @ np.array([0.0, max(k - 5, 0) * 8.0, 0.0])

    epochs = with_course([fix(k, going(k)) for k in range(12)])
    known = [len(e.observations[0].keys) == 6 for e in epochs]
    first_fast = 6
    assert known == [False] + [True] * first_fast + [False] * (11 - first_fast)
    moved = epochs[first_fast].observations[0]
    np.testing.assert_allclose(TO_ENU @ moved.y[3:], [0.0, 8.0, 0.0], atol=1e-9)
    assert np.sqrt(moved.aux["cov"][3, 3]) == pytest.approx(np.hypot(0.05 * np.sqrt(2.0), 0.5))
