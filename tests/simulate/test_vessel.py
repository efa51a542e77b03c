"""The ship of the multi-level study, and many runs of a model at once."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.kernels.linear import whiten
from pntegrity.scenarios._vessel_runs import Study
from pntegrity.simulate.ensembles import draw_ensemble, filtered
from pntegrity.simulate.linear import gains
from pntegrity.simulate.vessel import DEG, _cross, _level


@pytest.fixture(scope="module")
def study():
    return Study("consistent", 50)


def measured(study, k, moved, turned):
    """Return range, bearing and elevation of the transponder for a small move and turn of the ship."""
    C = (np.eye(3) + _cross(turned)) @ _level(study.vessel.course.heading_rad[k])
    b = C.T @ (study.vessel.transponder_m - study.vessel.course.position_m[k] - moved)
    return np.array([np.linalg.norm(b), np.arctan2(b[1], b[0]), np.arctan2(b[2], np.hypot(b[0], b[1]))])


@pytest.mark.parametrize("k", [10, 99, 250])
def test_the_usbl_rows_are_the_derivatives_of_range_and_angles(study, k):
    H = study.model.at("H", k)[-3:]
    for i in range(3):
        small = 1e-4 * np.eye(3)[i]
        moved = (measured(study, k, small, 0.0 * small) - measured(study, k, -small, 0.0 * small)) / 2e-4
        turned = (measured(study, k, 0.0 * small, small) - measured(study, k, 0.0 * small, -small)) / 2e-4
        np.testing.assert_allclose(H[:, i], moved, atol=1e-6)
        np.testing.assert_allclose(H[:, 6 + i], turned, atol=1e-4)


def test_the_transponder_is_where_it_shall_be(study):
    near = int(np.argmin(np.abs(study.t_s - 50.0)))
    away = study.vessel.transponder_m - study.vessel.course.position_m[near]
    np.testing.assert_allclose(away, [0.0, 342.0, 73.0])


def test_the_course_keeps_its_speed(study):
    course = study.vessel.course
    speed = np.linalg.norm(np.diff(course.position_m, axis=0), axis=1) * study.vessel.rate_hz
    np.testing.assert_allclose(speed, 2.5, rtol=2e-3)
    turn = np.gradient(course.heading_rad, course.t_s)
    np.testing.assert_allclose(
        np.linalg.norm(course.acceleration_mps2, axis=1), 2.5 * np.abs(turn), atol=3e-3
    )


def test_printed_noise_has_rows_of_rates():
    keys = Study("printed", 1).model.keys
    assert sum(k.startswith("gnss:D.") for k in keys) == 11
    assert not [k for k in Study("consistent", 1).model.keys if ":D." in k]


def test_a_degree_and_a_second_are_what_they_are(study):
    assert study.vessel.unit("deg") == DEG
    assert study.vessel.unit("s") == 1500.0


def test_runs_of_the_whole_filter_are_those_of_its_gains(study):
    quiet = np.zeros((400, 18))
    run = filtered(study.model, study.noise, quiet, quiet == 0.0)
    updates = gains(study.model, 400)
    np.testing.assert_allclose(run.P[-1], updates[-1].posterior.P, atol=1e-12)
    white = np.stack([whiten(u.L, nu) for u, nu in zip(updates, run.nu, strict=True)])
    assert white.std() == pytest.approx(1.0, abs=0.01)
    lagged = (white[1:] * white[:-1]).mean()
    assert abs(lagged) < 0.01


def test_a_filter_that_goes_on_is_the_same_filter(study):
    quiet = np.zeros((60, 18))
    noise = draw_ensemble(study.model, 60, 4, np.random.default_rng(3))
    used = quiet == 0.0
    whole = filtered(study.model, noise, quiet, used)
    later = filtered(study.model, noise, quiet, used, after=whole, first=20, runs=np.array([1, 3]), last=40)
    np.testing.assert_allclose(later.error, whole.error[20:40][:, :, [1, 3]], atol=1e-12)
    np.testing.assert_allclose(later.prior(study.model, 25), whole.prior(study.model, 25), atol=1e-15)
