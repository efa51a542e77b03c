"""A fix's standard deviations grow by factors, along the horizon and upright."""

from __future__ import annotations

import numpy as np
import pytest

from gnss_logs import PLACE
from pntegrity.kernels.axes import local_axes
from pntegrity.records import Observation
from pntegrity.sensors.fix import Fix
from pntegrity.sensors.source import Pose, Track

SIGMAS = np.array([0.3, 0.4, 0.9, 0.02, 0.03, 0.05])  # east, north, up; of the velocity the same
TURN = np.kron(np.eye(2), local_axes(PLACE))
KEYS = tuple(f"gnss:{k}" for k in ("RX", "RY", "RZ", "DX", "DY", "DZ"))


def fix(rows=slice(None)) -> Observation:
    """Return a fix with independent errors east, north and up."""
    cov = (TURN.T @ np.diag(SIGMAS**2) @ TURN)[rows]
    y = np.concatenate([PLACE, np.zeros(3)])[rows]
    return Observation("gnss", 10**9, KEYS[rows], y, aux={"cov": cov})


def local(cov):
    return TURN[: len(cov), : len(cov)] @ cov @ TURN[: len(cov), : len(cov)].T


def rows_of(source: Fix, observation: Observation):
    C = np.eye(3)
    track = Track(np.array([10**9]), PLACE[None], C[None])
    return source.rows(observation, Pose(10**9, PLACE + 0.5, np.zeros(3), C, np.zeros(3), track)).R


FACTORS = {"horizontal_factor": 2.0, "vertical_factor": 3.0, "velocity_factor": 5.0}
GROWN = np.array([2.0, 2.0, 3.0, 5.0, 5.0, 5.0])


def test_rows_and_the_position_of_a_start_have_the_same_larger_covariance():
    source = Fix("gnss", sigma_floor_m=0.1, **FACTORS)
    expected = np.diag((GROWN**2) * (SIGMAS**2 + np.repeat([0.01, 0.0], 3)))
    np.testing.assert_allclose(local(rows_of(source, fix())), expected, atol=1e-6)
    _, _, cov = source.position(fix())
    np.testing.assert_allclose(local(cov), expected, atol=1e-12)


@pytest.mark.parametrize("rows", [slice(0, 3), slice(3, 6)])
def test_a_position_or_a_velocity_alone_has_its_part(rows):
    found = local(rows_of(Fix("gnss", **FACTORS), fix(rows)))
    np.testing.assert_allclose(found, np.diag((GROWN * SIGMAS)[rows] ** 2), atol=1e-6)


def test_factors_of_one_change_no_bit():
    plain = fix()
    assert np.array_equal(rows_of(Fix("gnss"), plain), plain.aux["cov"])


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
@pytest.mark.parametrize("field", list(FACTORS))
def test_factors_that_cannot_be_are_refused(field, value):
    with pytest.raises(ValueError, match=f"gnss: `{field}` must be above 0"):
        Fix("gnss", **{field: value})
