"""Rotation vectors and matrices, from turns of a nanoradian to half a turn."""

import numpy as np
import pytest
from scipy.linalg import expm

from pntegrity.kernels.rotations import rotation, rotvec_of, skew


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9.9e-5, 1.01e-4, 0.3, 2.0, 3.0, np.pi - 1e-9])
def test_a_rotation_is_the_exponential_of_its_vector_and_gives_it_back(angle):
    rng = np.random.default_rng(2)
    axes = rng.normal(size=(20, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    made = rotation(vectors)
    np.testing.assert_allclose(made, [expm(skew(v)) for v in vectors], atol=1e-14)
    np.testing.assert_allclose(
        np.swapaxes(made, 1, 2) @ made, np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-14
    )
    np.testing.assert_allclose(rotvec_of(made), vectors, rtol=1e-7, atol=1e-15)


def test_half_turns_about_every_axis_are_found():
    for axis in np.eye(3):
        assert np.abs(rotvec_of(rotation(np.pi * axis))) == pytest.approx(np.pi * axis)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(3).normal(size=(2, 5, 3))
    np.testing.assert_allclose((skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-15)
